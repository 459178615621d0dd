"""The worst subspaces: those of the largest volume to surface, without flooding those that cannot be among them."""

# mypy: disallow-untyped-decorators=False
from collections.abc import Sequence

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, outer
from lidarcfg.placement.bits import NONE, ONE, Words, lowest
from lidarcfg.placement.cones import FIRST, Lidar, cone_rows
from lidarcfg.placement.flood import Floods, Walls, flood, flood_room, inner_cuboid
from lidarcfg.placement.rows import EVERYTHING, Counts, Grid, Work, link, room, steps
from lidarcfg.placement.visibility_kernels import Sight, new_looks

SURELY = 1e-9  # how much larger than a sum another one must be that rounding has no part in it, by far


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
def smoothed(values: Array, smoothing: float) -> float:
    """The p-norm of values (n,), descending, p = 1 / smoothing: at least the greatest. Counts those above 0."""
    if smoothing == 0.0 or values[0] <= 0.0:
        return float(values[0])
    total = 0.0
    for value in values:
        total += (max(value, 0.0) / values[0]) ** (1.0 / smoothing)
    norm: float = values[0] * total**smoothing
    return norm


@inner()
def reaches(values: Array, smoothing: float, least: float) -> bool:
    """Whether the cost of values (n,), descending, is surely at least so much, whatever values may be added."""
    greatest: bool = values[0] >= least
    return greatest or (smoothing > 0.0 and smoothed(values, smoothing) >= least * (1.0 + SURELY))


@inner()
def worst(
    grid: Grid,
    walls: Walls,
    enough: float,
    smoothing: float,
    floods: Floods,
    values: Array,
    cuboids: Counts,
    first: int,
) -> bool:
    """The worst subspaces: values (n,) their V / S, descending, and a cuboid in each; both may hold some already.

    V / S is taken times the weight of a subspace, where cuboids have weights. walls: without moved LiDARs. `first` is
    added to the numbers of cuboids. Ends as soon as the cost reaches `enough`; returns whether it did. Skips cuboids
    that cannot be in one of the worst: see links_needed.
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
                if reaches(values, smoothing, enough):
                    return True
                links_needed(values[-1] / most, edge, need)
                word &= promising(row, step_y, step_z, need, included, links)
    return False


@outer()
def _worst(
    grid: Grid, cones: Array, moved: Counts, sight: Sight, work: Work, floods: Floods, values: Array, cuboids: Counts
) -> None:
    link(grid, grid.links, cones, moved, sight, work)
    worst(grid, Walls(work.links, cones, moved[:0], sight), np.inf, 0.0, floods, values, cuboids, 0)


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
