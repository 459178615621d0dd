"""The compiled loops of a search: many trials, each drawn around a food source and kept only if it beats it.

Of each food source the links of every LiDAR are kept, so that a trial computes only those of the LiDARs that moved.
"""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, outer
from lidarcfg.placement.bits import ALL, NONE, Words
from lidarcfg.placement.flood import Floods, Walls, flood, flood_room, inner_cuboid
from lidarcfg.placement.rows import Counts, Grid, Work, link, put, put_links, room
from lidarcfg.placement.turns import Turns, take
from lidarcfg.placement.visibility_kernels import Looks, Obstacles, Sight
from lidarcfg.placement.worst_subspaces import keep, reaches, smoothed, worst, worth

WITNESSES = 12
LAZY = 4  # once floods have compared more than one in so many rows, all are, which costs less than one by one
Flags = NDArray[np.bool_]


class Placed(NamedTuple):
    """LiDARs at poses."""

    cones: Array  # (n, lidars, 6 + beams), see cone_rows
    limits: Array  # (n, lidars, 9), see Sight; (n, 0, 9) where everything is seen
    obstacles: Obstacles


class Batch(NamedTuple):
    """Trials to evaluate, and what is known of the food sources that they were drawn around."""

    placed: Placed
    to_beat: Array  # (n,) max VSR that a trial has to be below
    moved: Flags  # (n, lidars) the LiDARs whose pose differs from the source's
    source: Counts  # (n,) a row of `links`
    kept: Flags  # (cases, lidars) the LiDARs of each case; a trial is as bad as its worst case
    witness: Counts  # (n, WITNESSES) cuboids whose subspaces may refute a trial, see _order; −1 for none
    links: Words  # (sources, lidars, 3, rows), see renew; no rows where all LiDARs count as moved
    stays: Flags  # (n, lidars) the LiDARs of which `clear` of the source is true, because they are where its are
    clear: Words  # (sources, lidars, rows), see Looks; no rows where `stays` is false
    smoothing: float  # see smoothed; 0: none


class Sources(NamedTuple):
    """Some food sources, and what is to be renewed of them."""

    row: Counts  # (n,) of `links` and `clear`
    placed: Placed
    changed: Flags  # (n, lidars) whose links are those of another pose
    stays: Flags  # (n, lidars) whose `clear` is not
    links: Words  # as in Batch
    clear: Words  # as in Batch


class Verdicts(NamedTuple):
    """What becomes of the trials."""

    cost: Array  # (n,) max VSR, or inf where it is not below what had to be beaten; NaN where it was not computed
    refuter: Counts  # (n,) the witness whose subspace refuted a trial, or −1
    fresh: Counts  # (n, WITNESSES) witnesses in the worst subspaces of a trial that was not refuted
    links: Words  # (n, 3, rows) of such a trial the links of the last LiDAR that moved; or none
    clear: Words  # (n, rows) and what is clear of it, see Looks; or none


class Found(NamedTuple):
    """What is found of one trial."""

    links: Words  # (3, rows)
    own: Words  # (lidars, 3, rows) the links of LiDARs that moved
    left: Words  # (cases, rows) cuboids that no flood from a witness has reached
    values: Array  # (WITNESSES,) the worst subspaces of all cases, descending
    cuboids: Counts  # (WITNESSES,) a witness in each, see _order
    refuter: Counts  # (1,) a witness
    stamp: Counts  # (1,) of the last flood


class Scratch(NamedTuple):
    """Working memory for trials; each thread has its own."""

    work: Work
    floods: Floods
    found: Found
    cases: Counts  # (cases,) in the order of evaluation
    moved: Counts  # (lidars,) numbers of LiDARs


def scratch_for(grid: Grid, kept: Flags, beams: int) -> Scratch:
    """Room for trials with `kept` (cases, lidars) of LiDARs of up to so many beams."""
    cases, lidars = kept.shape
    floods = flood_room(grid, lidars)
    found = Found(
        np.empty_like(grid.links),
        np.empty((lidars, *grid.links.shape), np.uint64),
        np.empty((cases, grid.included.size), np.uint64),
        np.empty(WITNESSES),
        np.empty(WITNESSES, np.int64),
        np.empty(1, np.int64),
        np.zeros(1, np.int64),
    )
    work = room(grid, lidars, beams, floods.looks)
    return Scratch(work, floods, found, np.zeros(cases, np.int64), np.zeros(lidars, np.int64))


@inner()
def _keep_common(out: Words, links: Words) -> None:
    """Take from `out` the links that are not in `links` too, (3, rows) both."""
    for axis in range(3):
        for row in range(out.shape[1]):
            out[axis, row] &= links[axis, row]


@inner()
def remind(looks: Looks, lidar: int, stays: bool, clear: Words, source: int, number: int) -> None:
    """Have a LiDAR know what is clear of LiDAR `number` of a source, if it is where that is, or else nothing."""
    for row in range(looks.clear.shape[1]):
        looks.clear[lidar, row] = clear[source, number, row] if stays else NONE
        looks.known[lidar, row] = ALL if stays else NONE


@inner()
def _holds(order: Counts, count: int, case: int) -> bool:
    """Whether a case is among the first `count` of some."""
    found = False
    for n in range(count):
        found |= order[n] == case
    return found


@inner()
def _order(witness: Counts, size: int, order: Counts) -> int:
    """Write the cases to order (cases,), first those of witnesses, as these stand; returns how many these are.

    A witness is a cuboid's number + `size` × the case's.
    """
    known = 0
    for w in witness:
        if w >= 0 and not _holds(order, known, w // size):
            order[known] = w // size
            known += 1
    last = known
    for case in range(order.size):
        if not _holds(order, known, case):
            order[last] = case
            last += 1
    return known


@inner()
def _moved(trial: int, case: int, batch: Batch, out: Counts) -> int:
    """Write to `out` which LiDARs of a case have moved, or of all cases if it is −1; returns how many."""
    count = 0
    for lidar in range(batch.moved.shape[1]):
        if batch.moved[trial, lidar] and (case < 0 or batch.kept[case, lidar]):
            out[count] = lidar
            count += 1
    return count


@inner()
def _join(trial: int, case: int, batch: Batch, own: Words, out: Words) -> None:
    """Take from `out` (3, rows) the links that not all LiDARs of a case have.

    Those of LiDARs that moved are in `own` (lidars, 3, rows); without it they are not looked at.
    """
    for lidar in range(batch.kept.shape[1]):
        if batch.kept[case, lidar] and not batch.moved[trial, lidar]:
            _keep_common(out, batch.links[batch.source[trial], lidar])
        elif batch.kept[case, lidar] and len(own):
            _keep_common(out, own[lidar])


@inner()
def _link_moved(trial: int, batch: Batch, grid: Grid, scratch: Scratch) -> None:
    """Compute all links of the LiDARs that moved, to found.own."""
    work, cones = scratch.work, batch.placed.cones[trial]
    sight = Sight(batch.placed.limits[trial], batch.placed.obstacles)
    moved = scratch.moved[: _moved(trial, -1, batch, scratch.moved)]
    for n in range(moved.size):
        link(grid, grid.links, cones, moved[n : n + 1], sight, work)
        put_links(scratch.found.own[moved[n]], work.links)


@inner()
def _refute(trial: int, known: int, batch: Batch, grid: Grid, scratch: Scratch) -> tuple[int, bool]:
    """Flood the subspaces of a trial's witnesses, those of the first `known` cases, until one refutes it.

    Where costs are smoothed, several together may.

    Writes the refuter to found.refuter, or −1. Returns for how many rows the gaps of moved LiDARs were computed, and
    whether all links were (see LAZY); not where LiDARs may be blind to cuboids, as rows that no flood gets to would
    cost most there.
    """
    floods, found, size, to_beat = scratch.floods, scratch.found, grid.included.size << 6, batch.to_beat[trial]
    sight, fixed, cones = (
        Sight(batch.placed.limits[trial], batch.placed.obstacles),
        found.links,
        batch.placed.cones[trial],
    )
    found.refuter[0] = -1
    rows, linked, limited = 0, False, sight.limits.shape[0] > 0
    for number in range(known):
        case = scratch.cases[number]
        put_links(fixed, grid.links)
        put(floods.left, found.left[case])
        _join(trial, case, batch, found.own if linked else found.own[:0], fixed)
        count = 0 if linked else _moved(trial, case, batch, scratch.moved)
        walls = Walls(fixed, cones, scratch.moved[:count], sight)
        for w in batch.witness[trial]:
            cuboid = w - case * size
            if 0 <= cuboid < size and floods.left[cuboid >> 6] >> np.uint64(cuboid & 63) & np.uint64(1):
                if LAZY * rows > grid.included.size and not linked and not limited:
                    linked, rows = True, rows + grid.x.size // 64 * grid.y.size * grid.z.size
                    _link_moved(trial, batch, grid, scratch)
                    _join(trial, case, batch, found.own, fixed)
                    walls = Walls(fixed, cones, scratch.moved[:0], sight)
                found.stamp[0] += 1
                rows += int(flood(grid, walls, found.stamp[0], cuboid, floods))
                value = worth(grid, grid.edge, grid.weight.size > 0, floods)
                if value >= to_beat or (
                    keep(value, case * size + inner_cuboid(floods), found.values, found.cuboids)
                    and reaches(found.values, batch.smoothing, to_beat)
                ):
                    found.refuter[0] = w
                    return rows, linked
        put(found.left[case], floods.left)
    return rows, linked


@inner()
def _evaluate(trial: int, batch: Batch, grid: Grid, scratch: Scratch) -> int:
    """Find the worst subspaces of a trial in all cases, or until one is no less than what has to be beaten.

    All links must be known. Returns how many cases were evaluated.
    """
    floods, found, cases, size = scratch.floods, scratch.found, scratch.cases, grid.included.size << 6
    cones, sight = batch.placed.cones[trial], Sight(batch.placed.limits[trial], batch.placed.obstacles)
    links, to_beat = found.links, batch.to_beat[trial]
    for number in range(cases.size):
        case = cases[number]
        put_links(links, grid.links)
        put(floods.left, found.left[case])
        _join(trial, case, batch, found.own, links)
        walls = Walls(links, cones, scratch.moved[:0], sight)
        if worst(grid, walls, to_beat, batch.smoothing, floods, found.values, found.cuboids, case * size):
            return number + 1
    return int(cases.size)


@inner()
def _hand_over(trial: int, batch: Batch, scratch: Scratch, verdicts: Verdicts) -> None:
    """Write what a source will need that takes the trial's place."""
    count = _moved(trial, -1, batch, scratch.moved)
    if count and len(verdicts.links):
        put_links(verdicts.links[trial], scratch.found.own[scratch.moved[count - 1]])
    if count and len(verdicts.clear):
        put(verdicts.clear[trial], scratch.floods.looks.clear[scratch.moved[count - 1]])


@outer()
def try_out(
    turns: Turns, most: int, batch: Batch, grid: Grid, in_full: bool, scratch: Scratch, verdicts: Verdicts
) -> tuple[int, int, int]:
    """Take at most so many turns, and write the verdicts on these trials of a batch.

    First the subspaces of a trial's witnesses are flooded, and rows are compared with cones as the flood gets to them;
    one whose VSR is no less than what has to be beaten refutes the trial. Only without one are all links computed, once
    for all cases, and only if `in_full`. Returns how many cases were evaluated in full, how many rows were compared for
    other trials, and how many segments were cast.
    """
    looks, found = scratch.floods.looks, scratch.found
    looks.shadows.cast[0] = full = compared = 0
    for _ in range(most):
        t = take(turns)
        if t >= batch.source.size:
            break
        if batch.placed.limits.shape[1] > 0:
            for lidar in range(batch.moved.shape[1]):
                if batch.moved[t, lidar]:
                    remind(looks, lidar, batch.stays[t, lidar], batch.clear, batch.source[t], lidar)
        for n in range(found.values.size):
            found.values[n], found.cuboids[n] = -1.0, -1
        for case in range(len(found.left)):
            put(found.left[case], grid.included)
        witnesses = batch.witness.shape[1] if batch.to_beat[t] < np.inf else 0
        known = _order(batch.witness[t, :witnesses], grid.included.size << 6, scratch.cases)
        rows, linked = _refute(t, known, batch, grid, scratch)
        verdicts.cost[t], verdicts.refuter[t] = np.inf, found.refuter[0]
        if found.refuter[0] >= 0 or not in_full:
            verdicts.cost[t] = np.inf if found.refuter[0] >= 0 else np.nan
            compared += rows
            continue
        if not linked:
            _link_moved(t, batch, grid, scratch)
        full += _evaluate(t, batch, grid, scratch)
        cost = smoothed(found.values, batch.smoothing)
        if cost < batch.to_beat[t]:
            verdicts.cost[t] = cost
            for n in range(found.cuboids.size):
                verdicts.fresh[t, n] = found.cuboids[n]
            _hand_over(t, batch, scratch, verdicts)
        else:
            verdicts.refuter[t] = found.cuboids[0]
    return full, compared, looks.shadows.cast[0]


@outer()
def renew(turns: Turns, most: int, sources: Sources, grid: Grid, scratch: Scratch) -> None:
    """Take at most so many turns, and compute links and clear for these food sources, of LiDARs that have changed."""
    cones, limits, obstacles = sources.placed.cones, sources.placed.limits, sources.placed.obstacles
    links, clear, work, looks, alone = sources.links, sources.clear, scratch.work, scratch.work.looks, scratch.moved[:1]
    alone[0] = 0
    for _ in range(most):
        n = take(turns)
        if n >= sources.row.size:
            break
        row = sources.row[n]
        for lidar in range(cones.shape[1]):
            if not sources.changed[n, lidar]:
                continue
            if limits.shape[1]:
                remind(looks, 0, sources.stays[n, lidar], clear, row, lidar)
            sight = Sight(limits[n, lidar : lidar + 1], obstacles)
            link(grid, grid.links, cones[n, lidar : lidar + 1], alone, sight, work)
            put_links(links[row, lidar], work.links)
            if limits.shape[1]:
                put(clear[row, lidar], looks.clear[0])


@outer()
def remember(witness: Counts, source: Counts, refuter: Counts) -> None:
    """Move what refuted a trial, in the order of trials, to the front of its source's witnesses (sources, …)."""
    for t in range(source.size):
        if refuter[t] >= 0:
            row = witness[source[t]]
            place = 0
            while place < row.size - 1 and row[place] != refuter[t]:
                place += 1
            while place > 0:
                row[place] = row[place - 1]
                place -= 1
            row[0] = refuter[t]
