"""A subspace by flooding the links of rows.py, a row of bits at a time; its faces are counted by counting bits."""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.jit import inner
from lidarcfg.placement.bits import ALL, BIT, NONE, ONE, Words, lowest, ones
from lidarcfg.placement.cones import FIRST, beam_gap
from lidarcfg.placement.rows import EVERYTHING, Counts, Grid, at_or_above, row_of, square_up, steps
from lidarcfg.placement.visibility_kernels import Looks, Sight, new_looks, seen_of_row


class Walls(NamedTuple):
    """What separates cuboids: missing links, and the cones of LiDARs whose links are not computed."""

    links: Words  # (3, rows) of all LiDARs but `moved`
    cones: Array  # (lidars, 6 + beams), see cone_rows
    moved: Counts  # the LiDARs whose beam gap is computed row by row, as a flood gets there
    sight: Sight


def joined(links: Words) -> Walls:
    """Walls of no moved LiDARs, by the links (3, rows) of all."""
    return Walls(links, np.empty((0, FIRST)), np.empty(0, np.int64), EVERYTHING)


class Floods(NamedTuple):
    """Scratch memory of `flood`, and what the last flood found; each thread has its own."""

    left: Words  # (rows,) cuboids that no flood has reached
    gaps: Array  # (lidars, 9) the subspace's beam gaps; see _bound
    known: Counts  # (rows,) the stamp of the flood that `inside` belongs to
    inside: Words  # (rows,) the centres in the gaps
    squares: Array  # (2, 64)
    stack: Words  # (192 rows, 2) a row and bits of it from which to go on
    reached: Words  # (32 rows, 2) the last flood, step by step: a row and bits of it
    counts: Counts  # (6,) cuboids, internal faces across x, y and z, steps, and the fullest step
    looks: Looks  # what the LiDARs see
    need: Counts  # (9,) see links_needed


def flood_room(grid: Grid, lidars: int) -> Floods:
    """Scratch memory for floods of a grid with up to so many LiDARs."""
    rows = grid.included.size
    return Floods(
        grid.included.copy(),
        np.empty((lidars, FIRST + 3)),
        np.full(rows, -1, np.int64),
        np.empty(rows, np.uint64),
        np.empty((2, 64)),
        np.empty((192 * rows, 2), np.uint64),
        np.empty((32 * rows, 2), np.uint64),
        np.empty(6, np.int64),
        new_looks(lidars, rows),
        np.empty(9, np.int64),
    )


@inner(forceinline=True)
def _along(bits: np.uint64, links: np.uint64) -> np.uint64:
    """The cuboids of a row that links along x join to some of them."""
    start = bits << ONE & links
    bits |= start | (links ^ links + start) & links  # upwards: a carry runs to the end of the links
    bits |= (bits & links) >> ONE
    links &= links << ONE
    bits |= (bits & links) >> np.uint64(2)
    links &= links << np.uint64(2)
    if (bits & links) >> np.uint64(4) & ~bits == NONE:  # most neighbours' ends are no further apart
        return bits
    bits |= (bits & links) >> np.uint64(4)
    links &= links << np.uint64(4)
    bits |= (bits & links) >> np.uint64(8)
    links &= links << np.uint64(8)
    bits |= (bits & links) >> np.uint64(16)
    links &= links << np.uint64(16)
    return bits | (bits & links) >> np.uint64(32)


@inner()
def _bound(grid: Grid, walls: Walls, cuboid: int, gaps: Array, looks: Looks) -> None:
    """Write the gap of a cuboid for each moved LiDAR: position, axis, u_k of the beams below and above (else ∓inf).

    And 1 where the LiDAR sees the cuboid, 0 where it is blind to it.
    """
    first, y, z = row_of(grid, cuboid >> 6)
    for n in range(walls.moved.size):
        cone = walls.cones[walls.moved[n]]
        gap = beam_gap(grid.x[first | cuboid & 63], y, z, cone)
        for column in range(FIRST):
            gaps[n, column] = cone[column]
        gaps[n, FIRST] = cone[FIRST + gap - 1] if gap > 0 else -np.inf
        gaps[n, FIRST + 1] = cone[FIRST + gap] if FIRST + gap < cone.size else np.inf
        gaps[n, FIRST + 2] = 1.0
        if walls.sight.limits.shape[0]:
            bit = BIT[cuboid & 63]
            gaps[n, FIRST + 2] = 0.0 if _seen(grid, walls, walls.moved[n], cuboid >> 6, bit, looks) == NONE else 1.0


@inner()
def _seen(grid: Grid, walls: Walls, lidar: int, row: int, wanted: np.uint64, looks: Looks) -> np.uint64:
    """Which cuboids of a row, of those wanted, a LiDAR sees."""
    first, y, z = row_of(grid, row)
    seen: np.uint64 = seen_of_row(
        lidar, row, grid.x, first, grid.edge[0], y, z, wanted & grid.included[row], walls.cones, walls.sight, looks
    )
    return seen


@inner()
def _alike(grid: Grid, walls: Walls, row: int, word: np.uint64, gaps: Array, looks: Looks) -> np.uint64:
    """Those of some cuboids of a row that each moved LiDAR sees, or does not see, as it does the gaps' cuboid."""
    for n in range(walls.moved.size):
        if word != NONE:
            seen = _seen(grid, walls, walls.moved[n], row, word, looks)
            word &= seen if gaps[n, FIRST + 2] > 0.0 else ~seen
    return word


@inner(forceinline=True)
def _inside(x: Array, ys: Array, zs: Array, row: int, gaps: Array, lidars: int, squares: Array) -> np.uint64:
    """The centres of a row in the first `lidars` of some gaps; see _bound."""
    word = ALL
    step_y = x.size // 64
    step_z = step_y * (ys.size + 2)
    first, y, z = row % step_y << 6, ys[row % step_z // step_y - 1], zs[row // step_z - 1]
    for n in range(lidars):
        if gaps[n, FIRST + 2] > 0.0:
            square_up(x, first, y, z, gaps, n, squares)
            word &= at_or_above(gaps[n, FIRST], squares) & ~at_or_above(gaps[n, FIRST + 1], squares)
    return word


@inner(forceinline=True)
def _beside(side: int, row: int, bits: np.uint64, links: Words, step_y: int, step_z: int) -> tuple[int, np.uint64]:
    """The row on one of six sides of a row, and the cuboids there that links join to some of its own."""
    if side == 0:
        return row - step_y, bits & links[1, row]
    if side == 1:
        return row + step_y, bits & links[1, row + step_y]
    if side == 2:
        return row - step_z, bits & links[2, row]
    if side == 3:
        return row + step_z, bits & links[2, row + step_z]
    if side == 4:  # along x, where the region is longer than a row
        return row - 1, (bits & links[0, row]) << np.uint64(63)
    return row + 1, bits >> np.uint64(63) & links[0, row + 1]


@inner(kept=True, forceinline=True)
def flood(grid: Grid, walls: Walls, stamp: int, cuboid: int, floods: Floods) -> int:
    """Flood the subspace of a cuboid: remove it from floods.left and count it in floods.counts.

    stamp: another number for every flood. Returns for how many rows the gaps of moved LiDARs were computed.
    """
    links, left, stack, reached, counts = walls.links, floods.left, floods.stack, floods.reached, floods.counts
    known, inside, squares, x, ys, zs = floods.known, floods.inside, floods.squares, grid.x, grid.y, grid.z
    gaps, looks, lidars, limited = floods.gaps, floods.looks, walls.moved.size, walls.sight.limits.shape[0] > 0
    step_y, step_z = steps(grid)
    sides = 4 if step_y == 1 else 6
    lazily = lidars > 0
    cuboids = faces_x = faces_y = faces_z = computed = step = most = fullest = 0
    row = cuboid >> 6
    if lazily:
        _bound(grid, walls, cuboid, gaps, looks)
        known[row], inside[row], computed = stamp, _inside(x, ys, zs, row, gaps, lidars, squares), 1
        if limited:
            inside[row] = _alike(grid, walls, row, inside[row], gaps, looks)
    stack[0, 0], stack[0, 1] = row, BIT[cuboid & 63]
    top = 1
    while top > 0:
        top -= 1
        row = int(stack[top, 0])
        bits = stack[top, 1] & left[row]
        if bits == NONE:
            continue
        within = links[0, row] & ~ONE  # the link to the row before is side 4's
        if lazily:
            within &= inside[row] & inside[row] << ONE
        bits = _along(bits, within)
        left[row] &= ~bits
        reached[step, 0], reached[step, 1] = row, bits
        count = ones(bits)
        if count > most:
            most, fullest = count, step
        step += 1
        cuboids += count
        faces_x += ones(bits & within)
        for side in range(sides):
            other, word = _beside(side, row, bits, links, step_y, step_z)
            if word == NONE:
                continue
            if lazily:
                if known[other] != stamp:
                    known[other], inside[other] = stamp, ALL  # _inside, whose arguments numba would count each time
                    first, y, z = other % step_y << 6, ys[other % step_z // step_y - 1], zs[other // step_z - 1]
                    for n in range(lidars):
                        if gaps[n, FIRST + 2] > 0.0:
                            square_up(x, first, y, z, gaps, n, squares)
                            inside[other] &= at_or_above(gaps[n, FIRST], squares)
                            inside[other] &= ~at_or_above(gaps[n, FIRST + 1], squares)
                    if limited:
                        inside[other] = _alike(grid, walls, other, inside[other], gaps, looks)
                    computed += 1
                word &= inside[other]
            if side == 0:
                faces_y += ones(word)
            elif side == 2:
                faces_z += ones(word)
            elif side == 4:
                faces_x += ones(word)
            word &= left[other]
            if word != NONE:
                stack[top, 0], stack[top, 1] = other, word
                top += 1
    counts[0], counts[1], counts[2], counts[3], counts[4], counts[5] = cuboids, faces_x, faces_y, faces_z, step, fullest
    return computed


@inner(forceinline=True)
def inner_cuboid(floods: Floods) -> int:
    """A cuboid of the last flood, halfway along its fullest row."""
    fullest = floods.counts[5]
    row, bits = int(floods.reached[fullest, 0]), floods.reached[fullest, 1]
    for _ in range(ones(bits) // 2):
        bits &= bits - ONE
    return row << 6 | int(lowest(bits))
