"""Which beams can meet anything in range: the others need not be cast, and leaving them out changes nothing.

The proof is by cones and balls. All directions of a laser within a sector of azimuth lie in a cone about the
sector's middle; all that stands still lies in balls; a cone that passes a ball by more than their half-angles, or
a ball that begins beyond the sensor's range, cannot meet. A sensor that moves widens the balls by how far it can
get within the time for which a table holds, and the cones by how far it can turn.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.firing import Firings, rays
from lidarcfg.capture.raycast import Mask, Raycaster
from lidarcfg.capture.trajectory import SECOND_NS, Trajectory
from lidarcfg.geometry import Array
from lidarcfg.rig import Mount

SECTORS = 120
BALLS = 256  # about so many; a piece is as large as that asks, but not below PIECE_MIN_M
PIECE_MIN_M = 2.0
TRAVEL_M, TURN_RAD = 2.0, math.radians(2)  # how far a table may be carried along
WORTH = 0.1  # a table that leaves out less than this share costs more than it saves
SLACK_M, SLACK_RAD = 0.01, 1e-4  # far more than float32 rays are off
BLOCK = 4_000_000  # pairs of cones and balls at a time


@dataclass(frozen=True)
class Balls:
    """Balls that hold everything that stands still, but for the ground."""

    centre_m: Array  # (B, 3)
    radius_m: Array  # (B,)


def balls(caster: Raycaster) -> Balls:
    """Still triangles, cut into pieces and gathered by the cells of a grid."""
    corners = caster.scene.vertices_m[caster.still_triangles]
    if not len(corners):
        return Balls(np.empty((0, 3)), np.empty(0))
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    size_m = max(PIECE_MIN_M, math.sqrt(doubled.sum() / 2 / BALLS))
    pieces = []
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        long = edges.max(axis=1) > 2 * size_m
        pieces.append(corners[~long])
        corners, edges = corners[long], edges[long]
        turn = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3  # the longest edge first
        a, b, c = np.take_along_axis(corners, turn[:, :, None], axis=1).transpose(1, 0, 2)
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    piece = np.concatenate(pieces)
    low, high = piece.min(axis=1), piece.max(axis=1)
    cells = np.floor((low + high) / 2 / size_m)
    order = np.lexsort(cells.T)
    starts = np.flatnonzero(np.append(True, np.diff(cells[order], axis=0).any(axis=1)))
    low, high = np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts)
    return Balls((low + high) / 2, np.linalg.norm(high - low, axis=1) / 2)


class Reach:
    """For one sensor of a vehicle on its way: what may meet what, laser by laser and sector by sector."""

    def __init__(
        self, mount: Mount, caster: Raycaster, still: Balls, trajectory: Trajectory, spread_rad: float
    ) -> None:
        """`spread_rad`: by how much rays leave their laser's axis, for the divergence of a beam."""
        assert mount.sensor.range
        self._mount, self._caster, self._still, self._trajectory = mount, caster, still, trajectory
        self._range_m = mount.sensor.range.max_m
        path, arm_m = trajectory.path, float(np.linalg.norm(mount.position_m))
        self._speed_m_s = path.speed_max_m_s + arm_m * path.turn_max_rad_s
        self._turn_rad_s = path.turn_max_rad_s
        self._half_s = min(TRAVEL_M / self._speed_m_s if self._speed_m_s else math.inf, 1e9)
        self._half_s = min(self._half_s, TURN_RAD / self._turn_rad_s if self._turn_rad_s else math.inf)
        sensor = mount.sensor
        middle = (np.arange(SECTORS) + 0.5) * (2 * math.pi / SECTORS)
        azimuth = np.broadcast_to(middle[:, None, None], (SECTORS, 1, sensor.count))
        origins, axes = rays(sensor, Firings(np.zeros(azimuth.shape, np.int64), azimuth))
        self._axes = axes.reshape(-1, 3)  # (SECTORS × L, 3)
        self._cone_rad = math.pi / SECTORS + spread_rad + SLACK_RAD
        self._offset_m = float(np.linalg.norm(origins, axis=-1).max()) + SLACK_M
        self._table: Mask = np.empty((0, 0), np.bool_)
        self._from_ns, self._to_ns = 0, -1

    def tables(self, time_ns: NDArray[np.int64]) -> Mask | None:
        """(1 + movers, SECTORS, L): what of firings at these times may meet what stands still, and each mover.

        None: so many may that it is not worth telling. Times are asked in order, as a table is kept for the next.
        """
        first_ns, last_ns = int(time_ns.min()), int(time_ns.max())
        if not self._from_ns <= first_ns <= last_ns <= self._to_ns:
            half_ns = max(int(self._half_s * SECOND_NS), (last_ns - first_ns + 1) // 2)
            self._from_ns, self._to_ns = first_ns, first_ns + 2 * half_ns
            if len(self._trajectory.path.times_s):  # no pose is asked for beyond the last
                end_ns = self._trajectory.zero_ns + int(self._trajectory.path.times_s[-1] * SECOND_NS)
                self._to_ns = max(min(self._to_ns, end_ns), last_ns)
            self._table = self._still_table((self._from_ns + self._to_ns) // 2)
        tables = np.stack([self._table, *self._mover_tables(first_ns, last_ns)])
        return None if tables.mean(axis=(1, 2)).min() > 1 - WORTH else tables

    def _frame(self, middle_ns: int, half_ns: int) -> tuple[Array, Array, float, float]:
        """Where the sensor is and where its cones point in the middle, and how far both may be off."""
        T = self._trajectory.pose(middle_ns) @ self._mount.T_vehicle_sensor
        half_s = half_ns / SECOND_NS
        axes = self._axes @ T[:3, :3].T
        return T[:3, 3], axes, self._offset_m + self._speed_m_s * half_s, self._cone_rad + self._turn_rad_s * half_s

    def _still_table(self, middle_ns: int) -> Mask:
        place, axes, off_m, cone_rad = self._frame(middle_ns, (self._to_ns - self._from_ns + 1) // 2)
        table = self._meets(axes, cone_rad, self._still.centre_m - place, self._still.radius_m + off_m)
        if self._caster.scene.file.ground:
            height = self._caster.scene.file.ground.z_m - place[2]
            steepest = np.minimum(np.arcsin(np.clip(axes[:, 2] * np.sign(height), -1, 1)) + cone_rad, math.pi / 2)
            near_m = abs(height) - off_m
            table |= (near_m <= 0) | (np.sin(steepest) * self._range_m >= near_m)
        return table.reshape(SECTORS, -1)

    def _mover_tables(self, first_ns: int, last_ns: int) -> list[Mask]:
        if not self._caster.movers:
            return []
        middle_ns, half_ns = (first_ns + last_ns) // 2, (last_ns - first_ns + 1) // 2
        place, axes, off_m, cone_rad = self._frame(middle_ns, half_ns)
        tables = []
        for mover in self._caster.movers:
            seconds = np.array([(middle_ns - self._caster.zero_ns) / SECOND_NS])
            centre = mover.place_m + mover.path.at(seconds)[1] - place
            radius = mover.radius_m + off_m + mover.path.speed_max_m_s * half_ns / SECOND_NS
            tables.append(self._meets(axes, cone_rad, centre, np.array([radius])).reshape(SECTORS, -1))
        return tables

    def _meets(self, axes: Array, cone_rad: float, centre_m: Array, radius_m: Array) -> Mask:
        """(N,): whether each cone can meet one of the balls, relative to the sensor, within its range."""
        distance = np.linalg.norm(centre_m, axis=1)
        near = distance - radius_m <= self._range_m
        if (distance <= radius_m).any():
            return np.ones(len(axes), np.bool_)
        centre_m, radius_m, distance = centre_m[near], radius_m[near], distance[near]
        widest = np.cos(np.minimum(np.arcsin(radius_m / distance) + cone_rad, math.pi)).astype(np.float32)
        towards, axes32 = (centre_m / distance[:, None]).T.astype(np.float32), axes.astype(np.float32)
        rows = max(BLOCK // max(len(distance), 1), 1)
        parts = [(axes32[i : i + rows] @ towards >= widest - 1e-6).any(axis=1) for i in range(0, len(axes), rows)]
        return np.concatenate(parts)
