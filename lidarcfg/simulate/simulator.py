"""What the firings of one sensor report: its rays from the vehicle's pose at each firing, cast, and made echoes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Firings, Times
from lidarcfg.realism import Realism
from lidarcfg.rig import Mount
from lidarcfg.sensor import Sensor
from lidarcfg.simulate.echoes import (
    CELLS,
    NODES,
    Echoes,
    Met,
    echoes,
    extinction_per_m,
    single,
    spread_rad,
    sub_rays,
    wide,
)
from lidarcfg.simulate.reach import Known, Reach, Still
from lidarcfg.world.kernels import beams, chained, may_meet
from lidarcfg.world.motion import Trajectory, rotated
from lidarcfg.world.raycast import Listed, Raycaster
from lidarcfg.world.scene import Weather

EXACT, CLEAR = Realism(), Weather()
NO_LISTS = np.empty((0, 0), np.int32)


@dataclass(frozen=True)
class Stage:
    """What all sensors share."""

    caster: Raycaster
    trajectory: Trajectory
    still: Still | None  # None: every ray is cast


@dataclass(frozen=True)
class Plan:
    """What must be known of firings before they are observed, in whatever order that is."""

    fired: Firings
    first: int  # the number of the first, by which random numbers are found
    known: Known | None  # which beams may meet what; None: every ray is cast


class Counts(NamedTuple):
    """Of rays: all, those that could meet nothing in range, and those that a few triangles settled without a cast."""

    rays: int
    nothing: int
    few: int


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
        self._sub_rays = sub_rays(mount.sensor, self._realism)
        cells = CELLS if extinction_per_m(self._weather) else 0
        self.width = 1 if self._exact else max(self._sub_rays + cells, len(NODES) ** 2)  # numbers a firing, at a time
        self._fired = 0  # firings so far

    def plan(self, fired: Firings) -> Plan:
        """For the next firings: these are asked in the order of time."""
        first, count = self._fired, len(fired.time_ns)
        self._fired += count
        known = None
        if self._reach and count:
            known = self._reach.known(int(fired.time_ns.min()), int(fired.time_ns.max()))
        return Plan(fired, first, known)

    def report(self, plan: Plan) -> tuple[Echoes, Counts]:
        """What the N firings planned report, (N, 1) or with dual returns (N, 2); and of how many rays.

        Changes nothing, so that threads may ask for several at a time. Raises ConfigError outside timed poses.
        """
        fired, count, caster = plan.fired, len(plan.fired.time_ns), self._stage.caster
        time_ns, what, listed = fired.time_ns, None, None
        if plan.known is None:
            rows = np.arange(count)
        else:
            tables, sights = plan.known
            azimuth_rad = fired.encoder_rad.reshape(-1, self._mount.sensor.count)
            rows, what, which = may_meet(azimuth_rad, tables, sights.which if sights else NO_LISTS)
            listed = Listed(which, sights) if sights else None
            time_ns = time_ns[rows] if caster.movers or not self._stage.trajectory.path.stands else time_ns[:0]
        starts, along, shares = self._rays(fired, rows, time_ns)
        width, at = len(shares), rows
        if width > 1:
            time_ns = np.repeat(time_ns, width)
            what = None if what is None else np.repeat(what, width, axis=1)
            listed = Listed(np.repeat(listed.which, width), listed.sights) if listed else None
            at = (rows[:, None] * width + np.arange(width)).ravel()
        hits = caster.cast(
            starts, along, time_ns, what, normals=not self._exact, at=at, total=count * width, listed=listed
        )
        if self._exact:
            columns = hits.range_m[:, None], hits.reflectivity[:, None], hits.object[:, None]
            found = single(*columns, self._mount.return_mode)
        else:
            cosine = np.ones(count * width)
            cosine[at] = abs(np.einsum("ij,ij->i", hits.normal[at], along))
            shape = count, width
            met = Met(
                hits.range_m.reshape(shape),
                hits.reflectivity.reshape(shape),
                hits.object.reshape(shape),
                cosine.reshape(shape),
            )
            all_three = echoes(self._mount.sensor, self._realism, self._weather, self._index, plan.first, shares, met)
            found = all_three.reported(self._mount.return_mode)
        return found, Counts(count * width, count * width - len(along), hits.settled)

    def _rays(self, fired: Firings, rows: NDArray[np.int64], time_ns: Times) -> tuple[Array, Array, Array]:
        """Origins and directions (M × K, 3) in the world of the K sub-rays of the firings `rows`; their shares (K,)."""
        mount, trajectory = self._mount, self._stage.trajectory
        outer, inner = trajectory.T_world_start, mount.T_vehicle_sensor
        motion = trajectory.motion(time_ns)
        R, t = chained(*_parted(outer), *motion, *_parted(inner))
        if self._sub_rays == 1:
            return *aimed(mount.sensor, fired, rows, R, t), np.ones(1)
        origins, axes = aimed(mount.sensor, fired, rows, np.eye(3)[None], np.zeros((1, 3)))
        directions, shares = wide(axes, mount.sensor)
        starts = np.repeat(rotated(R, origins) + t, self._sub_rays, axis=0)
        R = R if len(R) == 1 else np.repeat(R, self._sub_rays, axis=0)
        return starts, rotated(R, directions.reshape(-1, 3)), shares


def _parted(T: Array) -> tuple[Array, Array]:
    """R (1, 3, 3) and t (3,) of a rigid motion (4, 4)."""
    return np.ascontiguousarray(T[None, :3, :3]), np.ascontiguousarray(T[:3, 3])


def aimed(sensor: Sensor, fired: Firings, rows: NDArray[np.int64], R: Array, t: Array) -> tuple[Array, Array]:
    """Origins and unit directions (M, 3) of the firings `rows` (M,), in the frame into which R and t lead.

    These are (M or 1, 3, 3) and (M or 1, 3): one each or one for all. The lasers fire in the order of their numbers.
    """
    lasers = sensor.elevation_rad, sensor.azimuth_offset_rad, sensor.lateral_offset_m, sensor.vertical_offset_m
    origins, directions = beams(fired.encoder_rad.reshape(-1, sensor.count), rows, *lasers, R, t)
    return origins, directions
