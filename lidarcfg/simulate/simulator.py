"""The echoes of one sensor's firings: rays from the vehicle's pose at each firing, traced and turned into echoes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Firings
from lidarcfg.realism import Realism
from lidarcfg.rig import Mount
from lidarcfg.sensor import Sensor
from lidarcfg.simulate.aim_kernels import Frames, Lasers
from lidarcfg.simulate.beam_kernels import trace_beams
from lidarcfg.simulate.echoes import CELLS, Echoes, SubRays, beam, echoes, extinction_per_m, single
from lidarcfg.simulate.noise import laser_errors_m, separate
from lidarcfg.simulate.simulator_kernels import looked_up, new_work, trace_firings
from lidarcfg.world.bvh import NO_TREE, Tree
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.numba_trees import numba_world, packed
from lidarcfg.world.scene import Weather
from lidarcfg.world.tracer import Tracer
from lidarcfg.world.world_kernels import NOTHING, Found

EXACT, CLEAR = Realism(), Weather()
BEYOND_M = 1.0  # beyond a sensor's range nothing is reported; rays are traced this much farther


class Counts(NamedTuple):
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
        self._index, self._mount, self._tracer, self._trajectory = index, mount, tracer, trajectory
        self._bodies = numba_world(bodies).static if bodies else NO_TREE
        own = bodies.scene.reflectivity if bodies else np.empty(0, np.uint8)
        self._objects = _objects(tracer, self._bodies)
        self._reflectivity = np.concatenate([tracer.scene.reflectivity, own, np.zeros(1, np.uint8)])[self._objects]
        self._realism, self._weather = mount.realism or EXACT, tracer.scene.file.weather
        if self._realism.divergence is True and not mount.sensor.optics:
            raise ConfigError(f"{mount.name}: divergence: sensor {mount.sensor.name!r} has no optics facts")
        self._exact = self._realism.model_copy(update={"seed": 0}) == EXACT and self._weather == CLEAR
        across, above, self._weights = beam(mount.sensor, self._realism)
        self._errors_m = laser_errors_m(self._realism, index, mount.sensor.count)
        self._lasers = _lasers(mount.sensor, across, above)
        self._frames = _frames(mount, trajectory, tracer.origin_m, self._bodies)
        cells = CELLS if extinction_per_m(self._weather) else 0
        self.width = len(across) + cells  # rays and cells per firing

    def echoes(self, fired: Firings, first: int) -> tuple[Echoes, Counts]:
        """The echoes of N firings, (N, 1), or (N, 2) for dual returns; firings are numbered from `first` on.

        Has no side effects, so threads may call it concurrently. Raises ConfigError outside timed poses.
        """
        sensor, mount = self._mount.sensor, self._mount
        assert sensor.range
        count, width, (_, most_m) = len(fired.time_ns), len(self._weights), sensor.range.reported_m
        found = Found(
            range_m=np.empty(count * width),
            slot=np.empty(count * width, np.int32),
            normal=np.empty((0, 3)),
            cosine=np.empty(0 if self._exact else count * width),
        )
        if count:
            self._check_span(int(fired.time_ns.min()), int(fired.time_ns.max()))
            columns, limit_m = (fired.time_ns, fired.laser, fired.encoder_rad), most_m + BEYOND_M
            world = numba_world(self._tracer)
            work = new_work(self._frames, len(world.dynamic.roots))
            told = world, self._lasers, self._frames, columns, self._tracer.zero_ns, limit_m, work
            if width == 1:
                trace_firings(*told, found)
            else:
                trace_beams(*told, found)
        objects, reflectivity = np.empty((count, width), np.int32), np.empty((count, width), np.uint8)
        tables = self._objects, self._reflectivity
        hits = looked_up(found.range_m, found.slot, most_m, *tables, objects.ravel(), reflectivity.ravel())
        counts, range_m = Counts(count * width, hits), found.range_m.reshape(count, width)
        if self._exact:
            return single(range_m, reflectivity, objects, mount.return_mode), counts
        sub_rays = SubRays(range_m, reflectivity, objects, found.cosine.reshape(count, width), fired.laser)
        candidates = echoes(sensor, self._realism, self._weather, self._index, first, self._weights, sub_rays)
        reported = candidates.reported(mount.return_mode)
        reported.noise_m[:] += self._errors_m[fired.laser][:, None]
        if mount.return_mode == "dual":
            separate(reported, self._realism, self._index, first)
        return reported, counts

    def _check_span(self, first_ns: int, last_ns: int) -> None:
        """Raises ConfigError unless vehicle and dynamic objects have poses from the first time to the last."""
        for zero_ns, check in (
            (self._trajectory.zero_ns, self._trajectory.path.check_span),
            (self._tracer.zero_ns, self._tracer.check_span),
        ):
            check((first_ns - zero_ns) / 1e9, (last_ns - zero_ns) / 1e9)


def _objects(tracer: Tracer, bodies: Tree) -> NDArray[np.int32]:
    """The objects by slot number, from NONE on: nothing, ground, static and dynamic objects, the vehicle's bodies."""
    world, own = numba_world(tracer), len(tracer.scene.names) + bodies.object
    return np.concatenate([[NOTHING, 0], world.static.object, world.dynamic.trees.object, own], dtype=np.int32)


def _lasers(sensor: Sensor, across: Array, above: Array) -> Lasers:
    return Lasers(
        cos_elevation=np.cos(sensor.elevation_rad),
        sin_elevation=np.sin(sensor.elevation_rad),
        cos_offset=np.cos(sensor.azimuth_offset_rad),
        sin_offset=np.sin(sensor.azimuth_offset_rad),
        forward_m=np.ascontiguousarray(sensor.forward_offset_m),
        left_m=np.ascontiguousarray(sensor.lateral_offset_m),
        up_m=np.ascontiguousarray(sensor.vertical_offset_m),
        across=across,
        above=above,
    )


def _frames(mount: Mount, trajectory: Trajectory, origin_m: Array, bodies: Tree) -> Frames:
    outer, inner = trajectory.T_world_start, mount.T_vehicle_sensor
    return Frames(
        R_world_start=np.ascontiguousarray(outer[:3, :3]),
        t_world_start=outer[:3, 3] - origin_m,
        paths=packed([trajectory.path]),
        zero_ns=trajectory.zero_ns,
        R_vehicle_sensor=np.ascontiguousarray(inner[:3, :3]),
        t_vehicle_sensor=np.ascontiguousarray(inner[:3, 3]),
        bodies=bodies,
    )
