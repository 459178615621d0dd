"""The echoes of one sensor's firings: rays from the vehicle's pose at each firing, traced and turned into echoes."""

from copy import copy
from typing import NamedTuple

import numpy as np

from lidarcfg.core import simulate, world
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.firing import Firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.aim import firings_of, lasers_of, mounting_of
from lidarcfg.simulate.echoes import (
    CELLS,
    EXACT,
    REPORTED,
    Echoes,
    SensorErrors,
    beam_rays,
    extinction_per_m,
    thin_beam_echoes,
    wide_beam_echoes,
)
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene_file import Weather
from lidarcfg.world.tracer import NO_SHAPES, NO_SLOT, Tracer

CLEAR = Weather()
BEYOND_M = 1.0  # beyond a sensor's range nothing is reported; rays are traced this much farther


class RayCounts(NamedTuple):
    """Numbers of rays: all that were traced, and those that hit something within range."""

    rays: int
    hits: int


class Simulator:
    """Sensor number `index` of a rig on a vehicle in a tracer's scene, and among its bodies. Raises ConfigError.

    The bodies are those of a tracer in the vehicle frame; as objects they follow those of the scene.
    """

    def __init__(
        self, index: int, mount: Mount, tracer: Tracer, trajectory: Trajectory, bodies: Tracer | None = None
    ) -> None:
        self._index = index
        self._mount = mount
        self._tracer = tracer
        self._trajectory = trajectory
        self._bodies = bodies.world.fixed if bodies else world.Bvh(*NO_SHAPES)
        self._surfaces = _surfaces(tracer, bodies)
        self._realism = mount.realism or EXACT
        self._weather = tracer.scene.file.weather
        if self._realism.divergence is True and not mount.sensor.optics:
            raise ConfigError(f"{mount.name}: divergence: sensor {mount.sensor.name!r} has no optics facts")
        self._exact = self._realism.model_copy(update={"seed": 0}) == EXACT and self._weather == CLEAR
        across, above, self._weights = beam_rays(mount.sensor, self._realism)
        self._errors = SensorErrors(index, mount)
        self._lasers = lasers_of(mount.sensor, across, above)
        self._mounting = mounting_of(mount, trajectory, tracer.origin_m)
        cells = CELLS if extinction_per_m(self._weather) else 0
        self.width = len(across) + cells  # rays and cells per firing

    def along(self, tracer: Tracer, trajectory: Trajectory) -> "Simulator":
        """This simulator where objects and vehicle follow other paths; the tracer is one `along` its own."""
        moved = copy(self)
        moved._tracer = tracer
        moved._trajectory = trajectory
        moved._mounting = mounting_of(self._mount, trajectory, tracer.origin_m)
        return moved

    def echoes(self, fired: Firings, first: int) -> tuple[Echoes, RayCounts]:
        """The echoes of N firings, (N, 1), or (N, 2) for dual returns; firings are numbered from `first` on.

        Has no side effects, so threads may call it concurrently. Raises ConfigError outside timed poses.
        """
        mount = self._mount
        sensor = mount.sensor
        assert sensor.range
        hits = self._trace(fired)
        counts = RayCounts(hits.range_m.size, int(np.count_nonzero(hits.range_m <= sensor.range.reported_m[1])))
        if self._exact:
            return thin_beam_echoes(hits.range_m, hits.reflectivity, hits.object, mount.return_mode), counts
        rays = simulate.SubRays(hits.range_m, hits.reflectivity, hits.object, hits.cosine, fired.laser)
        candidates = REPORTED[mount.return_mode]
        reported = wide_beam_echoes(
            sensor, self._realism, self._weather, self._index, first, self._weights, rays, candidates
        )
        self._errors.add(reported, fired.laser, first)
        return reported, counts

    def _trace(self, fired: Firings) -> simulate.Hits:
        """What the rays of firings hit; the cosines are left out where echoes do not depend on them."""
        assert self._mount.sensor.range
        shape = len(fired.time_ns), len(self._weights)
        hits = simulate.Hits(
            range_m=np.empty(shape),
            reflectivity=np.empty(shape, np.uint8),
            object=np.empty(shape, np.int32),
            cosine=np.empty((0, 0) if self._exact else shape),
        )
        if len(fired.time_ns):
            self._check_span(int(fired.time_ns.min()), int(fired.time_ns.max()))
        simulate.trace_firings(
            self._tracer.world,
            self._bodies,
            self._surfaces,
            self._lasers,
            self._mounting,
            firings_of(fired),
            self._tracer.zero_ns,
            self._mount.sensor.range.reported_m[1] + BEYOND_M,
            hits,
        )
        return hits

    def _check_span(self, first_ns: int, last_ns: int) -> None:
        """Raises ConfigError unless vehicle and dynamic objects have poses from the first time to the last."""
        for zero_ns, check in (
            (self._trajectory.zero_ns, self._trajectory.path.check_span),
            (self._tracer.zero_ns, self._tracer.check_span),
        ):
            check((first_ns - zero_ns) / 1e9, (last_ns - zero_ns) / 1e9)


def _surfaces(tracer: Tracer, bodies: Tracer | None) -> simulate.Surfaces:
    """What rays of a tracer may hit, and bodies."""
    objects, _ = tracer.world.resolve(np.arange(NO_SLOT, len(tracer.world), dtype=np.int32))
    reflectivity = [np.zeros(1, np.uint8), tracer.scene.reflectivity]
    if bodies:
        objects = np.concatenate([objects, len(tracer.scene.names) + bodies.world.fixed.object], dtype=np.int32)
        reflectivity.append(bodies.scene.reflectivity)
    return simulate.Surfaces(object=objects, reflectivity=np.concatenate(reflectivity))
