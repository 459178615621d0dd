"""Which cuboids a LiDAR sees, a row at a time: by range, by field of view, and by what stands in between."""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.world.bvh import EMPTY, Tree
from lidarcfg.world.tracer_kernels import Packet, blocked, new_packet

LIMITS = 9  # columns of Sight.limits
ANY, WITHIN, BEYOND = 0.0, 1.0, 2.0  # kinds of fields of view: all around; up to half a turn; more
ROW = 64


class Obstacles(NamedTuple):
    """What blocks beams, relative to a point."""

    tree: Tree
    origin_m: Array  # (3,) the point, in the vehicle frame
    ground_m: float  # height of the ground in the vehicle frame; inf: none


class Sight(NamedTuple):
    """What LiDARs at known poses may see; no rows of limits: everything."""

    limits: Array  # (lidars, 9) least and greatest range, squared; the normals of two planes; kind of field of view
    obstacles: Obstacles


class Looks(NamedTuple):
    """What LiDARs see, as far as it is known, and working memory; each thread has its own."""

    seen: NDArray[np.uint64]  # (lidars, rows) the cuboids that each sees
    known: NDArray[np.bool_]  # (lidars, rows) where that is known
    points: Array  # (3, 64) to look at
    starts: Array  # (3, 64) segments to cast
    ways: Array  # (3, 64)
    which: NDArray[np.int64]  # (64,) the points that they lead to
    blocked: NDArray[np.bool_]  # (64,)
    out: NDArray[np.bool_]  # (64,) whether each point is seen
    packet: Packet


@njit(cache=True, nogil=True)
def new_looks(lidars: int, rows: int) -> Looks:
    """Nothing known yet."""
    return Looks(
        np.zeros((lidars, rows), np.uint64),
        np.zeros((lidars, rows), np.bool_),
        np.empty((3, ROW)),
        np.empty((3, ROW)),
        np.empty((3, ROW)),
        np.empty(ROW, np.int64),
        np.empty(ROW, np.bool_),
        np.empty(ROW, np.bool_),
        new_packet(0),
    )


@njit(cache=True, nogil=True)
def look(cone: Array, limit: Array, obstacles: Obstacles, count: int, looks: Looks) -> None:
    """Write to looks.out which of the first `count` of looks.points the LiDAR at cone[:3] sees; see Sight."""
    points, starts, ways, which, out = looks.points, looks.starts, looks.ways, looks.which, looks.out
    x, y, z, ground_m, origin_m = cone[0], cone[1], cone[2], obstacles.ground_m, obstacles.origin_m
    some = 0
    for i in range(count):
        dx, dy, dz = points[0, i] - x, points[1, i] - y, points[2, i] - z
        square = (dx * dx + dy * dy) + dz * dz
        out[i] = limit[0] <= square <= limit[1]
        if limit[8] != ANY:
            one = (dx * limit[2] + dy * limit[3]) + dz * limit[4] >= 0.0
            other = (dx * limit[5] + dy * limit[6]) + dz * limit[7] >= 0.0
            out[i] &= one and other if limit[8] == WITHIN else one or other
        out[i] &= not min(z, points[2, i]) < ground_m < max(z, points[2, i])
        if out[i] and square > 0.0:
            starts[0, some], starts[1, some], starts[2, some] = x - origin_m[0], y - origin_m[1], z - origin_m[2]
            ways[0, some], ways[1, some], ways[2, some] = dx, dy, dz
            which[some] = i
            some += 1
    if obstacles.tree.root != EMPTY and some:
        blocked(obstacles.tree, looks.packet, starts, ways, some, looks.blocked)
        for n in range(some):
            out[which[n]] = not looks.blocked[n]


@njit(cache=True, nogil=True)
def seen_of_row(
    lidar: int, row: int, xs: Array, y: float, z: float, wanted: np.uint64, cones: Array, sight: Sight, looks: Looks
) -> np.uint64:
    """Which of the cuboids `wanted` of a row, centred at xs (64,), y, z, a LiDAR sees; from memory if it is known."""
    if not looks.known[lidar, row]:
        one, count = np.uint64(1), 0
        for i in range(ROW):
            if wanted >> np.uint64(i) & one:
                looks.points[0, count], looks.points[1, count], looks.points[2, count] = xs[i], y, z
                count += 1
        look(cones[lidar], sight.limits[lidar], sight.obstacles, count, looks)
        word, n = np.uint64(0), 0
        for i in range(ROW):
            if wanted >> np.uint64(i) & one:
                word |= np.uint64(looks.out[n]) << np.uint64(i)
                n += 1
        looks.seen[lidar, row], looks.known[lidar, row] = word, True
    seen: np.uint64 = looks.seen[lidar, row]
    return seen


@njit(cache=True, nogil=True)
def seen_points(points: Array, cone: Array, limit: Array, obstacles: Obstacles, out: NDArray[np.bool_]) -> None:
    """Write to out (N,) which of points (3, N) a LiDAR sees."""
    looks = new_looks(1, 1)
    for first in range(0, len(out), ROW):
        count = min(ROW, len(out) - first)
        looks.points[:, :count] = points[:, first : first + count]
        look(cone, limit, obstacles, count, looks)
        out[first : first + count] = looks.out[:count]
