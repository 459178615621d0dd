"""What the firings of one sensor report: its rays from the vehicle's pose at each firing, cast, and made echoes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.firing import Firings, Times, rays
from lidarcfg.capture.raycast import NOTHING, Hits, Mask, Raycaster
from lidarcfg.capture.reach import Balls, Reach, masks_of
from lidarcfg.capture.returns import Echoes, Met, echoes, single, spread_rad, sub_rays, wide
from lidarcfg.capture.scene import Weather
from lidarcfg.capture.trajectory import Trajectory, rotated
from lidarcfg.geometry import Array, transform
from lidarcfg.realism import Realism
from lidarcfg.rig import Mount

T = TypeVar("T", bound=np.generic)
EXACT, CLEAR = Realism(), Weather()


@dataclass(frozen=True)
class Stage:
    """What all sensors share."""

    caster: Raycaster
    trajectory: Trajectory
    still: Balls | None  # None: every ray is cast


@dataclass(frozen=True)
class Plan:
    """What must be known of firings before they are observed, in whatever order that is."""

    fired: Firings
    first: int  # the number of the first, by which random numbers are found
    tables: Sequence[Mask] | None  # which beams may meet what; None: every ray is cast


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
        self.sub_rays = sub_rays(mount.sensor, self._realism)
        self._fired = 0  # firings so far

    def plan(self, fired: Firings) -> Plan:
        """For the next firings: these are asked in the order of time."""
        first, count = self._fired, fired.time_ns.size
        self._fired += count
        return Plan(fired, first, self._reach.tables(fired.time_ns) if self._reach and count else None)

    def report(self, plan: Plan) -> tuple[Echoes, int, int]:
        """What the N firings planned report, (N, 1) or with dual returns (N, 2); how many rays, and how many were cast.

        Changes nothing, so that threads may ask for several at a time. Raises ConfigError outside timed poses.
        """
        sensor, fired, count = self._mount.sensor, plan.fired, plan.fired.time_ns.size
        origins, axes = (values.reshape(-1, 3) for values in rays(sensor, fired))
        masks = masks_of(plan.tables, fired.azimuth_rad) if plan.tables else None
        may_meet, time_ns = None, fired.time_ns.ravel()
        rows: NDArray[np.intp] | slice = slice(None)
        if masks is not None:
            masks = masks.reshape(-1, count)
            rows = np.flatnonzero(masks.any(axis=0))
            origins, axes, time_ns, may_meet = origins[rows], axes[rows], time_ns[rows], masks[:, rows]
        directions, shares = wide(axes, sensor, self._realism)
        hits, cosine = self._cast(origins, directions, time_ns, may_meet)
        width = len(shares)

        def whole(values: NDArray[T], missing: float) -> NDArray[T]:
            """Of all firings (N, K), from those that were cast."""
            if masks is None:
                return values.reshape(count, width)
            out = np.full((count, width), missing, values.dtype)
            out[rows] = values.reshape(-1, width)
            return out

        range_m, reflectivity = whole(hits.range_m, np.inf), whole(hits.reflectivity, 0)
        objects = whole(hits.object, NOTHING)
        if self._exact:
            found = single(range_m, reflectivity, objects, self._mount.return_mode)
        else:
            met = Met(range_m, reflectivity, objects, whole(cosine(), 1))
            all_three = echoes(sensor, self._realism, self._weather, self._index, plan.first, shares, met)
            found = all_three.reported(self._mount.return_mode)
        return found, count * width, len(hits.range_m)

    def _cast(
        self, origins: Array, directions: Array, time_ns: Times, may_meet: Mask | None
    ) -> tuple[Hits, Callable[[], Array]]:
        """Sub-rays (n, K, 3) of the sensor frame: hits (n × K), and the cosines of incidence when asked for."""
        width, mount, trajectory = directions.shape[1], self._mount, self._stage.trajectory
        R, t = trajectory.motion(time_ns)
        if len(t) == 1:  # it stands
            T_world_sensor = trajectory.pose(int(time_ns[0]) if len(time_ns) else 0) @ mount.T_vehicle_sensor
            starts, along = transform(T_world_sensor, origins), directions.reshape(-1, 3) @ T_world_sensor[:3, :3].T
        else:
            starts = rotated(R, transform(mount.T_vehicle_sensor, origins)) + t
            starts = transform(trajectory.T_world_start, starts)
            R = R if len(R) == 1 else np.repeat(R, width, axis=0)
            along = rotated(R, directions.reshape(-1, 3) @ mount.T_vehicle_sensor[:3, :3].T)
            along = along @ trajectory.T_world_start[:3, :3].T
        if width > 1:
            starts, time_ns = np.repeat(starts, width, axis=0), np.repeat(time_ns, width)
            may_meet = None if may_meet is None else np.repeat(may_meet, width, axis=1)
        hits = self._stage.caster.cast(starts, along, time_ns, may_meet, normals=not self._exact)
        return hits, lambda: abs(np.einsum("ij,ij->i", hits.normal, along))
