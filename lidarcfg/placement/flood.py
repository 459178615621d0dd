"""Subspaces by flooding the links of rows.py, a row of bits at a time; their faces are counted by counting bits."""

# mypy: disallow-untyped-decorators=False
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, outer
from lidarcfg.placement.cones import FIRST, Lidar, beam_gap, cone_rows
from lidarcfg.placement.rows import (
    ALL,
    BIT,
    EVERYTHING,
    NONE,
    ONE,
    Counts,
    Grid,
    Words,
    Work,
    at_or_above,
    link,
    room,
    row_of,
    square_up,
    steps,
)
from lidarcfg.placement.visibility_kernels import Looks, Sight, new_looks, seen_of_row

AGAIN = 4  # layers along x, after which it is looked anew where something is left
Labels = NDArray[np.int32]


class Walls(NamedTuple):
    """What separates cuboids: missing links, and the cones of LiDARs whose links are not computed."""

    links: Words  # (3, rows) of all LiDARs but `moved`
    cones: Array  # (lidars, 6 + beams), see cone_rows
    moved: Counts  # the LiDARs whose beam gap is computed row by row, as a flood gets there
    sight: Sight


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


def _ones(_: Any, word: Any) -> Any:
    return types.int64(types.uint64), lambda _c, builder, _s, args: builder.ctpop(args[0])


def _lowest(_: Any, word: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, args: Any) -> Any:
        return builder.cttz(args[0], context.get_constant(types.boolean, False))

    return types.int64(types.uint64), generate


def _highest(_: Any, word: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, args: Any) -> Any:
        leading = builder.ctlz(args[0], context.get_constant(types.boolean, False))
        return builder.sub(context.get_constant(types.int64, 63), leading)

    return types.int64(types.uint64), generate


ones: Any = intrinsic(_ones)  # how many bits of a word are 1
lowest: Any = intrinsic(_lowest)  # the number of the lowest of them; 64 where none is
highest: Any = intrinsic(_highest)  # the number of the highest of them; −1 where none is


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


@inner()
def vsr(counts: Counts, edge: tuple[float, float, float]) -> float:
    """Volume to surface of the last flood; metric.vsr_m, term by term."""
    ex, ey, ez = edge
    n, x, y, z = counts[0], counts[1], counts[2], counts[3]
    volume = float(n * (ex * ey * ez))
    surface: float = 2.0 * ((n - x) * (ey * ez) + (n - y) * (ex * ez) + (n - z) * (ex * ey))
    return volume / surface


@inner()
def _weight(grid: Grid, floods: Floods) -> float:
    """The greatest weight of the last flood's cuboids."""
    weight, weighted, reached = grid.weight, grid.weighted, floods.reached
    for level in range(weight.size - 1):
        for step in range(floods.counts[4]):
            if reached[step, 1] & weighted[level, int(reached[step, 0])]:
                return float(weight[level])
    return float(weight[-1])


@inner(forceinline=True)
def worth(grid: Grid, edge: tuple[float, float, float], weighted: bool, floods: Floods) -> float:
    """Volume to surface of the last flood; times its weight, where cuboids are weighted."""
    value: float = vsr(floods.counts, edge)
    if weighted:
        value *= _weight(grid, floods)
    return value


@inner(forceinline=True)
def _at_least(one: np.uint64, other: np.uint64, all_of_them: np.uint64, number: int) -> np.uint64:
    """The bits set in at least `number` of two words, 0 … 2."""
    return all_of_them if number == 0 else (one | other if number == 1 else one & other)


@inner()
def links_needed(least: float, edge: tuple[float, float, float], need: Counts) -> None:
    """need[3 z + y]: how many links along x a cuboid with z and y along those axes needs, 0 … 2; 3 if none suffice.

    In a subspace of V / S > least, the mean cuboid has less outer surface than its volume / least, so some cuboid has.
    """
    ex, ey, ez = edge
    inner = 2.0 * (ey * ez + ex * ez + ex * ey) * (1.0 - 1e-9) - ex * ey * ez / least if least > 0.0 else -1.0
    for z in range(3):
        for y in range(3):
            x = 0
            while x < 3 and x * (ey * ez) + y * (ex * ez) + z * (ex * ey) < inner:
                x += 1
            need[3 * z + y] = x


@inner(forceinline=True)
def promising(row: int, step_y: int, step_z: int, need: Counts, included: Words, links: Words) -> np.uint64:
    """The cuboids of a row with enough links; see links_needed."""
    all_of_them = included[row]
    before, after = links[0, row], links[0, row] >> ONE | links[0, row + 1] << np.uint64(63)
    word = NONE
    for z in range(3):
        deep = _at_least(links[2, row], links[2, row + step_z], all_of_them, z)
        for y in range(3):
            if need[3 * z + y] < 3:
                wide = _at_least(links[1, row], links[1, row + step_y], all_of_them, y)
                word |= deep & wide & _at_least(before, after, all_of_them, need[3 * z + y])
    return word


@inner(forceinline=True)
def keep(value: float, cuboid: int, values: Array, cuboids: Counts) -> bool:
    """Insert a subspace into the worst ones, values (n,) descending, if it belongs there."""
    place = values.size
    while place > 0 and value > values[place - 1]:
        place -= 1
    if place == values.size:
        return False
    for after in range(values.size - 1, place, -1):
        values[after], cuboids[after] = values[after - 1], cuboids[after - 1]
    values[place], cuboids[place] = value, cuboid
    return True


@inner()
def worst(grid: Grid, walls: Walls, enough: float, floods: Floods, values: Array, cuboids: Counts, first: int) -> None:
    """The worst subspaces: values (n,) their V / S, descending, and a cuboid in each; both may hold some already.

    V / S is taken times the weight of a subspace, where cuboids have weights. walls: without moved LiDARs. `first` is
    added to the numbers of cuboids. Ends as soon as a subspace of at least `enough` is found. Skips cuboids that
    cannot be in one of the worst: see links_needed.
    """
    step_y, step_z = steps(grid)
    left, included, edge, links = floods.left, grid.included, grid.edge, walls.links
    weighted = grid.weight.size > 0
    need, most = floods.need, grid.weight[0] if weighted else 1.0
    links_needed(values[-1] / most, edge, need)
    for row in range(step_z, included.size - step_z):
        if left[row] == NONE:
            continue
        word = promising(row, step_y, step_z, need, included, links) & left[row]
        while word != NONE:
            flood(grid, walls, 0, row << 6 | lowest(word), floods)
            word &= left[row]
            if keep(worth(grid, edge, weighted, floods), first + inner_cuboid(floods), values, cuboids):
                if values[0] >= enough:
                    return
                links_needed(values[-1] / most, edge, need)
                word &= promising(row, step_y, step_z, need, included, links)


@outer()
def _label(
    grid: Grid,
    walls: Walls,
    floods: Floods,
    label: Labels,
    first: Counts,
    cuboids: Counts,
    internal: Counts,
    some: Words,
) -> int:
    """Write what `components` returns, for as many as there are.

    label (nx, ny, nz) of −1 and floods are new; some (ny,) is scratch memory.
    """
    nx, ny, nz = label.shape
    step_y, step_z = steps(grid)
    total = 0
    for i in range(nx):
        if i % AGAIN == 0:  # which layers along x of 64 have something left, by row along y, so that not all are read
            for j in range(ny):
                some[j] = NONE
            for k in range(nz):
                row = (k + 1) * step_z + step_y + (i >> 6)
                for j in range(ny):
                    some[j] |= floods.left[row + j * step_y]
        for j in range(ny):
            for k in range(nz if some[j] & BIT[i & 63] else 0):
                row = (k + 1) * step_z + (j + 1) * step_y + (i >> 6)
                if floods.left[row] & BIT[i & 63] == NONE:
                    continue
                flood(grid, walls, 0, row << 6 | i & 63, floods)
                for step in range(floods.counts[4]):
                    row, bits = int(floods.reached[step, 0]), floods.reached[step, 1]
                    at, b, c = row % step_y << 6, row % step_z // step_y - 1, row // step_z - 1
                    while bits != NONE:
                        label[at + lowest(bits), b, c] = total
                        bits &= bits - ONE
                first[total] = (i * ny + j) * nz + k
                cuboids[total] = floods.counts[0]
                for axis in range(3):
                    internal[total, axis] = floods.counts[1 + axis]
                total += 1
    return total


def joined(links: Words) -> Walls:
    """Walls of no moved LiDARs, by the links (3, rows) of all."""
    return Walls(links, np.empty((0, FIRST)), np.empty(0, np.int64), EVERYTHING)


def components(grid: Grid, shape: tuple[int, int, int], links: Words) -> tuple[Labels, Counts, Counts, Counts]:
    """The connected components of the cuboids under some links (3, rows), in raster order.

    Returns label (nx, ny, nz), the number of each cuboid's component, −1 where excluded; cuboids (n,) in each;
    internal (n, 3), the faces inside each across x, y and z; and first (n,), its first cuboid as a flat index.
    """
    out, most = np.full(shape, -1, np.int32), math.prod(shape)
    first, cuboids, internal = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 3), np.int64)
    total = _label(
        grid, joined(links), flood_room(grid, 0), out, first, cuboids, internal, np.empty(shape[1], np.uint64)
    )
    return out, cuboids[:total].copy(), internal[:total].copy(), first[:total].copy()


@outer()
def _worst(
    grid: Grid, cones: Array, moved: Counts, sight: Sight, work: Work, floods: Floods, values: Array, cuboids: Counts
) -> None:
    link(grid, grid.links, cones, moved, sight, work)
    worst(grid, Walls(work.links, cones, moved[:0], sight), np.inf, floods, values, cuboids, 0)


def scratch_for(grid: Grid, lidars: int, beams: int) -> tuple[Work, Floods]:
    """Room for evaluations of up to so many LiDARs of so many beams."""
    floods = flood_room(grid, 0)
    return room(grid, lidars, beams, new_looks(lidars, grid.included.size)), floods


def max_vsr(
    grid: Grid, lidars: Sequence[Lidar], scratch: tuple[Work, Floods] | None = None, sight: Sight = EVERYTHING
) -> float:
    """The largest V / S, in metres. `scratch`: room for as many LiDARs and beams, to be used again."""
    cones = cone_rows(lidars)
    work, floods = scratch or scratch_for(grid, len(cones), cones.shape[1] - FIRST)
    floods.left[:], work.looks.clear[:], work.looks.known[:] = grid.included, 0, 0
    worst_m = np.full(1, -1.0)
    _worst(grid, cones, np.arange(len(cones)), sight, work, floods, worst_m, np.empty(1, np.int64))
    return float(worst_m[0])
