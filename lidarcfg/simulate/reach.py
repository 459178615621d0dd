"""Which beams can meet anything in range: the others need not be cast, and leaving them out changes nothing.

The proof is by caps and balls. All that stands still lies in balls. A ball within the sensor's range takes up a cap of
directions; the ground does so too, as far as it is in range. A laser's beams lie on a cone about the axis on which the
sensor turns, and those that come into a cap are an interval of azimuth; beams of all other sectors cannot meet it. A
sensor that moves widens the balls by how far it can get within the time for which a table holds, and the caps by how
far it can turn. All is in float64; the slack by which balls and caps are larger besides is some 1e5 times what that
rounds, and far more than the float32 rays are off.

A sensor that stands for long is told more: which few triangles are all that beams may meet first (sights.py).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import codec
from lidarcfg.rig import Mount
from lidarcfg.simulate.reach_kernels import gathered, mark_balls, mark_cap
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.raycast import Mask, Raycaster
from lidarcfg.world.sights import MANY, Index, Sights, longest_m, sighted

SECTORS = 360
CELL_M, BALLS = 1.0, 16_384  # a ball a cell; cells are doubled until there are no more balls
TRAVEL_M, TURN_RAD = 0.5, math.radians(2)  # how far a table may be carried along
WORTH = 0.05  # a table that leaves out less than this share costs more to use than it saves
PATIENCE = 20  # where a table does not save what it takes to make, as many times are passed over
SLACK_M, SLACK_RAD = 0.01, 1e-4
LARGE = 4096  # triangles at most that may be looked at one by one; each has an edge longer than CELL_M
BEAMS = 6  # a laser and a large triangle: when tables have been asked for so many, sights are worth their making


@dataclass(frozen=True)
class Balls:
    """Balls that hold something."""

    centre_m: Array  # (B, 3)
    radius_m: Array  # (B,)


class Still:
    """Everything that stands still, but for the ground."""

    def __init__(self, caster: Raycaster) -> None:
        self.vertices_m, self.triangles = caster.scene.vertices_m, caster.still_triangles
        self.balls = self._around(self.triangles)

    @cached_property
    def large(self) -> Index:
        """(C,) the large triangles."""
        length_m = longest_m(self.vertices_m, self.triangles)
        large = np.flatnonzero(length_m > CELL_M)
        return np.sort(large[np.argsort(-length_m[large], kind="stable")[:LARGE]])

    @cached_property
    def small(self) -> Balls:
        """Around all others."""
        return self._around(np.delete(self.triangles, self.large, axis=0))

    def _around(self, triangles: Index) -> Balls:
        """Around triangles (T, 3), as they are gathered by the cells of a grid."""
        size_m, enough = CELL_M / 2, False
        while not enough:
            size_m *= 2
            low, high, enough = gathered(self.vertices_m, triangles, size_m, BALLS)
        return Balls((low + high) / 2, np.linalg.norm(high - low, axis=1) / 2)


class Known(NamedTuple):
    """What beams may meet, by laser and by the sector into which the head points."""

    tables: Mask  # (2 + movers, SECTORS, L) the ground, what stands still, each mover
    sights: Sights | None  # of what stands still; None: not known


class Reach:
    """For one sensor of a vehicle on its way: what may meet what, laser by laser and sector by sector."""

    def __init__(
        self, mount: Mount, caster: Raycaster, still: Still, trajectory: Trajectory, spread_rad: float
    ) -> None:
        """`spread_rad`: by how much rays leave their laser's axis, for the divergence of a beam."""
        self._mount, self._caster, self._still, self._trajectory = mount, caster, still, trajectory
        sensor, path, arm_m = mount.sensor, trajectory.path, float(np.linalg.norm(mount.position_m))
        assert sensor.range
        self._range_m = sensor.range.max_m
        self._speed_m_s = path.speed_max_m_s + arm_m * path.turn_max_rad_s
        self._turn_rad_s = path.turn_max_rad_s
        self._half_s = min(TRAVEL_M / self._speed_m_s if self._speed_m_s else math.inf, 1e9)
        self._half_s = min(self._half_s, TURN_RAD / self._turn_rad_s if self._turn_rad_s else math.inf)
        self._fan = np.stack([np.sin(sensor.elevation_rad), np.cos(sensor.elevation_rad), sensor.azimuth_offset_rad])
        self._offset_m = float(np.hypot(sensor.lateral_offset_m, sensor.vertical_offset_m).max()) + SLACK_M
        self._wide_rad = spread_rad + SLACK_RAD
        pace = codec(sensor).pace(mount)
        self._beams_per_ns = pace.firings / pace.period_ns
        self._tables: Mask = np.empty((0, 0, 0), np.bool_)
        self._from_ns, self._to_ns = 0, -1
        self._sights: Sights | None = None
        self._beams = 0.0  # of which something was asked since

    def known(self, first_ns: int, last_ns: int) -> Known | None:
        """Of firings within a time. None: so much may be met that it is not worth telling.

        Times are asked in order, as what is found is kept for the next.
        """
        if not self._from_ns <= first_ns <= last_ns <= self._to_ns:
            self._renew(first_ns, last_ns)
        large = len(self._still.large)
        if large and self._beams >= BEAMS * len(self._fan.T) * large and last_ns <= self._held_ns:
            self._look()
        self._beams += (last_ns - first_ns) * self._beams_per_ns
        tables = np.concatenate([self._tables, *self._mover_tables(first_ns, last_ns)])
        worth = self._sights or tables[1:].mean(axis=(1, 2)).min() <= 1 - WORTH
        return Known(tables, self._sights) if worth else None

    def _renew(self, first_ns: int, last_ns: int) -> None:
        """Make the tables of what does not move, to hold from the first time on for as long as may be."""
        half_ns = max(int(self._half_s * SECOND_NS), (last_ns - first_ns + 1) // 2)
        self._from_ns, self._to_ns = first_ns, first_ns + 2 * half_ns
        if len(self._trajectory.path.times_s):  # no pose is asked for beyond the last
            end_ns = self._trajectory.zero_ns + int(self._trajectory.path.times_s[-1] * SECOND_NS)
            self._to_ns = max(min(self._to_ns, end_ns), last_ns)
        span_ns = self._to_ns - self._from_ns
        self._held, self._held_ns = self._frame((self._from_ns + self._to_ns) // 2, (span_ns + 1) // 2), self._to_ns
        self._sights, self._beams = None, 0.0
        still = self._meets(*self._held, self._still.balls)
        self._tables = np.stack([self._meets_ground(*self._held), still])
        saved = (1 - WORTH - still.mean()) * span_ns * self._beams_per_ns
        if saved < len(self._still.balls.radius_m):  # a ball takes about as long as a ray
            self._tables[:] = True
            self._to_ns += PATIENCE * span_ns

    def _look(self) -> None:
        """Find the lists of large triangles, if there are many."""
        self._beams = -math.inf  # once
        R, t, off_m, wide_rad = self._held
        many = np.ascontiguousarray(self._meets(*self._held, self._still.small).T)
        mesh = self._still.vertices_m, self._still.triangles, self._still.large
        sights = sighted(*mesh, R, t, self._range_m, off_m, wide_rad, self._fan, many)
        empty = (sights.which != MANY) & (sights.lists[sights.which, 0] < 0)
        if (sights.which[~empty] != MANY).sum() > WORTH * empty.size:
            self._sights, self._to_ns = sights, self._held_ns
            self._tables[1] &= ~empty

    def _frame(self, middle_ns: int, half_ns: int) -> tuple[Array, Array, float, float]:
        """How the sensor is turned and where it is in the middle, and how far its place and its rays may be off."""
        T = self._trajectory.pose(middle_ns) @ self._mount.T_vehicle_sensor
        half_s = half_ns / SECOND_NS
        R, t = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
        return R, t, self._offset_m + self._speed_m_s * half_s, self._wide_rad + self._turn_rad_s * half_s

    def _mover_tables(self, first_ns: int, last_ns: int) -> list[Mask]:
        if not self._caster.movers:
            return []
        middle_ns, half_ns = (first_ns + last_ns) // 2, (last_ns - first_ns + 1) // 2
        frame = self._frame(middle_ns, half_ns)
        tables = []
        for mover in self._caster.movers:
            seconds = np.array([(middle_ns - self._caster.zero_ns) / SECOND_NS])
            radius_m = mover.radius_m + mover.path.speed_max_m_s * half_ns / SECOND_NS
            tables.append(
                self._meets(*frame, Balls(mover.place_m + mover.path.at(seconds)[1], np.array([radius_m])))[None]
            )
        return tables

    def _meets(self, R: Array, t: Array, off_m: float, wide_rad: float, balls: Balls) -> Mask:
        """(SECTORS, L): which beams can meet one of the balls within range."""
        table = np.full((self._fan.shape[1], SECTORS), wide_rad >= math.pi / 2)
        if not table.any():
            mark_balls(balls.centre_m, balls.radius_m, R, t, self._range_m, off_m, wide_rad, self._fan, table)
        return np.ascontiguousarray(table.T)

    def _meets_ground(self, R: Array, t: Array, off_m: float, wide_rad: float) -> Mask:
        """(SECTORS, L): which can meet the ground within range."""
        table, ground = np.zeros((self._fan.shape[1], SECTORS), np.bool_), self._caster.scene.file.ground
        if ground:
            height_m = ground.z_m - t[2]
            near_m = abs(height_m) - off_m
            if near_m <= 0 or wide_rad >= math.pi / 2:
                table[:] = True
            elif near_m <= self._range_m:
                least = math.cos(math.acos(near_m / self._range_m) + wide_rad)
                mark_cap(R[2] * np.sign(height_m), least, self._fan, table)
        return np.ascontiguousarray(table.T)
