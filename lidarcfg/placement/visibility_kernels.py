"""Which cuboids a LiDAR sees, a row at a time: by range, by field of view, and by what stands in between."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.placement.bits import ALL, NONE, Words
from lidarcfg.world.bvh import Tree
from lidarcfg.world.shadow_kernels import ROW, Shadows, begin, behind, finish, new_shadows, shade

LIMITS = 9  # columns of Sight.limits
ANY, WITHIN, BEYOND = 0.0, 1.0, 2.0  # kinds of fields of view: all around; up to half a turn; more


class Obstacles(NamedTuple):
    """What blocks beams, relative to a point."""

    tree: Tree
    boxes: Array  # (6, BOXES) that hold its shapes, see boxes_of
    origin_m: Array  # (3,) the point, in the vehicle frame
    ground_m: float  # height of the ground in the vehicle frame; inf: none


class Sight(NamedTuple):
    """What LiDARs at known poses may see; no rows of limits: everything."""

    limits: Array  # (lidars, 9) least and greatest range, squared; the normals of two planes; kind of field of view
    obstacles: Obstacles


class Looks(NamedTuple):
    """What is near enough and not hidden from LiDARs, as far as it is known; each thread has its own."""

    clear: Words  # (lidars, rows)
    known: Words  # (lidars, rows) the cuboids of which that is known
    shadows: Shadows


def new_looks(lidars: int, rows: int) -> Looks:
    """Nothing known yet."""
    return Looks(np.zeros((lidars, rows), np.uint64), np.zeros((lidars, rows), np.uint64), new_shadows())


@inner()
def _near(xs, first, y, z, cones, limits, lidar, ground_m):
    """The centres of a row, xs[first : first + 64], y, z, within a LiDAR's range, and not across the ground."""
    x, least, most, word = cones[lidar, 0], limits[lidar, 0], limits[lidar, 1], NONE
    dy, dz = y - cones[lidar, 1], z - cones[lidar, 2]
    if min(z, cones[lidar, 2]) < ground_m < max(z, cones[lidar, 2]):
        return NONE
    start, end = xs[first] - x, xs[first + ROW - 1] - x
    if dy * dy + dz * dz >= least and (max(start * start, end * end) + dy * dy) + dz * dz <= most:
        return ALL  # rounding is monotonic, so the ends speak for what is between
    for i in range(ROW):
        dx = xs[first + i] - x
        square = (dx * dx + dy * dy) + dz * dz
        word |= (np.uint64(1) << np.uint64(i)) if (square >= least) & (square <= most) else NONE
    return word


@inner()
def in_field(xs, first, y, z, cones, limits, lidar):
    """The centres of a row within a LiDAR's field of view."""
    kind, word = limits[lidar, 8], NONE
    if kind == ANY:
        return ALL
    x, dy, dz = cones[lidar, 0], y - cones[lidar, 1], z - cones[lidar, 2]
    ax, ay, az, bx, by, bz = (
        limits[lidar, 2], limits[lidar, 3], limits[lidar, 4], limits[lidar, 5], limits[lidar, 6], limits[lidar, 7],
    )  # fmt: skip
    for i in range(ROW):
        dx = xs[first + i] - x
        one, other = (dx * ax + dy * ay) + dz * az >= 0.0, (dx * bx + dy * by) + dz * bz >= 0.0
        within = (one & other) if kind == WITHIN else (one | other)
        word |= (np.uint64(1) << np.uint64(i)) if within else NONE
    return word


@inner()
def start(lidar, cones, obstacles, looks):
    """Have segments start at a LiDAR."""
    origin = obstacles.origin_m
    begin(looks.shadows, cones[lidar, 0] - origin[0], cones[lidar, 1] - origin[1], cones[lidar, 2] - origin[2])


@inner(kept=True)
def clear_up(lidar, row, xs, first, edge, y, z, wanted, cones, sight, looks):
    """Find which of the cuboids `wanted` of a row, xs[first : first + 64], y, z, are clear; after `start`.

    What segments have to say comes with `settle`.
    """
    clear, known, obstacles = looks.clear, looks.known, sight.obstacles
    need = wanted & ~known[lidar, row]
    if need != NONE:
        word = need & _near(xs, first, y, z, cones, sight.limits, lidar, obstacles.ground_m)
        clear[lidar, row] |= word
        known[lidar, row] |= need
        if word != NONE and obstacles.boxes.shape[1]:
            ox, oy, oz = obstacles.origin_m[0], obstacles.origin_m[1], obstacles.origin_m[2]
            x, y, z = xs[first] - ox, y - oy, z - oz
            word &= behind(
                looks.shadows,
                obstacles.boxes,
                cones[lidar, 0] - ox,
                cones[lidar, 1] - oy,
                cones[lidar, 2] - oz,
                x,
                edge,
                y,
                z,
            )
            if word != NONE:
                shade(obstacles.tree, looks.shadows, xs, ox, first, edge, y, z, word, row, clear[lidar])


@inner()
def settle(lidar, sight, looks):
    """Cast the segments that wait."""
    finish(sight.obstacles.tree, looks.shadows, looks.clear[lidar])


@inner()
def seen_of_row(lidar, row, xs, first, edge, y, z, wanted, cones, sight, looks):
    """Which of the cuboids `wanted` of a row, xs[first : first + 64], y, z, a LiDAR sees."""
    if wanted & ~looks.known[lidar, row]:
        start(lidar, cones, sight.obstacles, looks)
        clear_up(lidar, row, xs, first, edge, y, z, wanted, cones, sight, looks)
        settle(lidar, sight, looks)
    return wanted & looks.clear[lidar, row] & in_field(xs, first, y, z, cones, sight.limits, lidar)


@njit(cache=True, nogil=True)
def seen_points(points: Array, cones: Array, sight: Sight, looks: Looks, xs: Array, out: NDArray[np.bool_]) -> None:
    """Write to out (N,) which of points (3, N) a LiDAR, the first of some, sees.

    looks: new ones, of one LiDAR and N rows; xs (64,) is scratch memory.
    """
    one = np.uint64(1)
    start(0, cones, sight.obstacles, looks)
    for n in range(len(out)):
        _fill(xs, points[0, n])
        clear_up(0, n, xs, 0, 1.0, points[1, n], points[2, n], one, cones, sight, looks)
    settle(0, sight, looks)
    for n in range(len(out)):
        _fill(xs, points[0, n])
        seen = looks.clear[0, n] & in_field(xs, 0, points[1, n], points[2, n], cones, sight.limits, 0)
        out[n] = seen & one != NONE


@inner()
def _fill(xs, x):
    for i in range(ROW):
        xs[i] = x
