"""The compiled loops of a search: many trials, each drawn around a food source and kept only if it beats it.

Of each food source the links of every LiDAR are kept, so that a trial computes only those of the LiDARs that moved.
"""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.cones import FIRST
from lidarcfg.placement.flood import Walls, flood, flood_room, inner_cuboid, keep, vsr, worst
from lidarcfg.placement.rows import Counts, Grid, Words, link, room
from lidarcfg.placement.visibility_kernels import ALL, NONE, Looks, Obstacles, Sight, new_looks

WITNESSES = 12
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
    witness: Counts  # (n, WITNESSES) cuboids whose subspaces may refute a trial, −1 for none
    links: Words  # (sources, lidars, 3, rows), see renew; no rows where all LiDARs count as moved
    stays: Flags  # (n, lidars) the LiDARs of which `clear` of the source is true, because they are where its are
    clear: Words  # (sources, lidars, rows), see Looks; no rows where `stays` is false


class Sources(NamedTuple):
    """Food sources, and what is to be renewed of them."""

    placed: Placed
    changed: Flags  # (sources, lidars) whose links are those of another pose
    links: Words  # as in Batch
    stays: Flags  # (sources, lidars) whose `clear` is not
    clear: Words  # as in Batch


class Verdicts(NamedTuple):
    """What becomes of the trials."""

    cost: Array  # (n,) max VSR, or inf where it is not below what had to be beaten; NaN where it was not computed
    refuter: Counts  # (n,) the cuboid whose subspace refuted a trial, or −1
    fresh: Counts  # (n, WITNESSES) cuboids of the worst subspaces of a trial that was not refuted


@njit(cache=True, nogil=True)
def _keep_common(out: Words, links: Words) -> None:
    """Take from `out` the links that are not in `links` too, (3, rows) both."""
    for axis in range(3):
        for row in range(out.shape[1]):
            out[axis, row] &= links[axis, row]


@njit(cache=True, nogil=True)
def remind(looks: Looks, lidar: int, stays: bool, clear: Words, source: int, number: int) -> None:
    """Have a LiDAR know what is clear of LiDAR `number` of a source, if it is where that is, or else nothing."""
    for row in range(looks.clear.shape[1]):
        looks.clear[lidar, row] = clear[source, number, row] if stays else NONE
        looks.known[lidar, row] = ALL if stays else NONE


@njit(cache=True, nogil=True)
def try_out(trials: Counts, batch: Batch, grid: Grid, in_full: bool, verdicts: Verdicts) -> tuple[int, int, int]:
    """Write the verdicts on some trials (t,) of a batch.

    First the subspaces of a trial's witnesses are flooded, and rows are compared with cones as the flood gets to them;
    one whose VSR is no less than what has to be beaten refutes the trial. Only without one are all links computed, and
    only if `in_full`. Returns how many trials were evaluated in full, how many rows were compared for the others, and
    how many segments were cast.
    """
    lidars, beams = batch.placed.cones.shape[1], batch.placed.cones.shape[2] - FIRST
    floods, fixed = flood_room(grid, lidars), np.empty_like(grid.links)
    work = room(grid, lidars, beams, floods.looks)
    values, cuboids = np.empty(WITNESSES), np.empty(WITNESSES, np.int64)
    moved, source, links = batch.moved, batch.source, batch.links
    full = compared = stamp = 0
    limited = batch.placed.limits.shape[1] > 0
    for t in trials:
        to_beat = batch.to_beat[t]
        sight = Sight(batch.placed.limits[t], batch.placed.obstacles)
        walls = Walls(fixed, batch.placed.cones[t], np.flatnonzero(batch.moved[t]), sight)
        if limited:
            for lidar in walls.moved:
                remind(floods.looks, lidar, batch.stays[t, lidar], batch.clear, source[t], lidar)
        fixed[:] = grid.links
        for lidar in range(lidars):
            if not moved[t, lidar]:
                for axis in range(3):
                    for row in range(fixed.shape[1]):
                        fixed[axis, row] &= links[source[t], lidar, axis, row]
        floods.left[:] = grid.included
        values[:], cuboids[:] = -1.0, -1
        verdicts.cost[t], verdicts.refuter[t] = np.inf, -1
        rows = 0
        for w in batch.witness[t] if to_beat < np.inf else batch.witness[t, :0]:
            if w >= 0 and floods.left[w >> 6] >> np.uint64(w & 63) & np.uint64(1):
                stamp += 1
                rows += flood(grid, walls, stamp, w, floods)
                value = vsr(floods.counts, grid.edge)
                if value >= to_beat:
                    verdicts.refuter[t] = w
                    break
                keep(value, inner_cuboid(floods), values, cuboids)
        if verdicts.refuter[t] >= 0 or not in_full:
            verdicts.cost[t] = np.inf if verdicts.refuter[t] >= 0 else np.nan
            compared += rows
            continue
        full += 1
        link(grid, fixed, walls.cones, walls.moved, sight, work)
        worst(grid, Walls(work.links, walls.cones, walls.moved[:0], sight), to_beat, floods, values, cuboids)
        if values[0] < to_beat:
            verdicts.cost[t], verdicts.fresh[t] = values[0], cuboids
        else:
            verdicts.refuter[t] = cuboids[0]
    return full, compared, floods.looks.shadows.cast[0]


@njit(cache=True, nogil=True)
def renew(rows: Counts, sources: Sources, grid: Grid) -> None:
    """Compute links and clear for some food sources, of the LiDARs that have changed."""
    cones, limits, obstacles = sources.placed.cones, sources.placed.limits, sources.placed.obstacles
    links, clear, looks = sources.links, sources.clear, new_looks(1, grid.included.size)
    work, alone = room(grid, 1, cones.shape[2] - FIRST, looks), np.zeros(1, np.int64)
    for row in rows:
        for lidar in np.flatnonzero(sources.changed[row]):
            if limits.shape[1]:
                remind(looks, 0, sources.stays[row, lidar], clear, row, int(lidar))
            sight = Sight(limits[row, lidar : lidar + 1], obstacles)
            link(grid, grid.links, cones[row, lidar : lidar + 1], alone, sight, work)
            links[row, lidar] = work.links
            if limits.shape[1]:
                clear[row, lidar] = looks.clear[0]


@njit(cache=True, nogil=True)
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
