"""What the firings of one sensor report: its rays from the vehicle's pose at each firing, cast, and made echoes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lidarcfg.capture.firing import Firings, Times, rays
from lidarcfg.capture.raycast import NOTHING, Hits, Mask, Raycaster
from lidarcfg.capture.reach import Balls, Reach
from lidarcfg.capture.returns import Echoes, Met, echoes, single, spread_rad, wide
from lidarcfg.capture.scene import Weather
from lidarcfg.capture.trajectory import Trajectory, rotated
from lidarcfg.geometry import Array, transform
from lidarcfg.realism import Realism
from lidarcfg.rig import Mount

EXACT, CLEAR = Realism(), Weather()


@dataclass(frozen=True)
class Stage:
    """What all sensors share."""

    caster: Raycaster
    trajectory: Trajectory
    still: Balls | None  # None: every ray is cast
    on_rays: Callable[[int, int], None]  # told how many rays there were and how many were cast


class Observer:
    """Sensor number `index` of a rig on its stage."""

    def __init__(self, index: int, mount: Mount, stage: Stage) -> None:
        self._index, self._mount, self._stage = index, mount, stage
        self._realism, self._weather = mount.realism or EXACT, stage.caster.scene.file.weather
        self._exact = self._realism.model_copy(update={"seed": 0}) == EXACT and self._weather == CLEAR
        self._reach = None
        if stage.still:
            spread = spread_rad(mount.sensor, self._realism)
            self._reach = Reach(mount, stage.caster, stage.still, stage.trajectory, spread)
        self._fired = 0  # firings so far, by which random numbers are found

    def report(self, fired: Firings) -> Echoes:
        """Of the next N firings, (N, 1) or with dual returns (N, 2). Raises ConfigError outside timed poses."""
        sensor, count = self._mount.sensor, fired.time_ns.size
        first, self._fired = self._fired, self._fired + count
        origins, axes = (values.reshape(-1, 3) for values in rays(sensor, fired))
        masks = self._reach.masks(fired.time_ns, fired.azimuth_rad).reshape(-1, count) if self._reach else None
        rows = np.arange(count) if masks is None else np.flatnonzero(masks.any(axis=0))
        directions, shares = wide(axes[rows], sensor, self._realism)
        width = len(shares)
        may_meet = None if masks is None else np.repeat(masks[:, rows], width, axis=1)
        hits, cosine = self._cast(origins[rows], directions, fired.time_ns.ravel()[rows], may_meet)
        self._stage.on_rays(count * width, len(rows) * width)

        range_m = np.full((count, width), np.inf)
        reflectivity = np.zeros((count, width), np.uint8)
        objects = np.full((count, width), NOTHING, np.int32)
        for whole, part in ((range_m, hits.range_m), (reflectivity, hits.reflectivity), (objects, hits.object)):
            whole[rows] = part.reshape(-1, width)
        if self._exact:
            return single(range_m, reflectivity, objects, self._mount.return_mode)
        slant = np.ones((count, width))
        slant[rows] = cosine().reshape(-1, width)
        met = Met(range_m, reflectivity, objects, slant)
        return echoes(sensor, self._realism, self._weather, self._index, first, shares, met).reported(
            self._mount.return_mode
        )

    def _cast(
        self, origins: Array, directions: Array, time_ns: Times, may_meet: Mask | None
    ) -> tuple[Hits, Callable[[], Array]]:
        """Sub-rays (n, K, 3) of the sensor frame: hits (n × K), and the cosines of incidence when asked for."""
        width, T_vehicle_sensor = directions.shape[1], self._mount.T_vehicle_sensor
        trajectory = self._stage.trajectory
        R, t = trajectory.motion(time_ns)
        starts = transform(trajectory.T_world_start, rotated(R, transform(T_vehicle_sensor, origins)) + t)
        if width > 1:
            starts, time_ns = np.repeat(starts, width, axis=0), np.repeat(time_ns, width)
            R = R if len(R) == 1 else np.repeat(R, width, axis=0)
        along = rotated(R, directions.reshape(-1, 3) @ T_vehicle_sensor[:3, :3].T) @ trajectory.T_world_start[:3, :3].T
        hits = self._stage.caster.cast(starts, along, time_ns, may_meet, normals=not self._exact)
        return hits, lambda: abs(np.einsum("ij,ij->i", hits.normal, along))
