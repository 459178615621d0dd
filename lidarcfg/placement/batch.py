"""What the core takes and returns of a search's trials; see core/placement/evaluator.h."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.grid import Counts, Words
from lidarcfg.world.obstacles import Obstacles

Flags = NDArray[np.bool_]


class Placed(NamedTuple):
    """LiDARs at poses."""

    cones: Array  # (n, lidars, 6 + beams), see cone_rows
    limits: Array  # (n, lidars, 9), see Sight; (n, 0, 9) where everything is seen
    obstacles: Obstacles


class Batch(NamedTuple):
    """Trials to evaluate, and what is known of the food sources that they were drawn around."""

    placed: Placed
    upper_bound: Array  # (n,) the cost that a trial has to be below
    moved: Flags  # (n, lidars) the LiDARs whose pose differs from the source's
    source: Counts  # (n,) a row of `links`
    certificates: Counts  # (n, c) cuboids whose subspaces may refute a trial; −1 for none
    links: Words  # (sources, lidars, rows, 3); no sources where all LiDARs count as moved
    same_position: Flags  # (n, lidars) the LiDARs of which `clear` of the source is true: they are where its are
    clear: Words  # (sources, lidars, rows) the cuboids that are near and not hidden; no sources if that is not known
    smoothing: float  # p-norm of the worst subspaces, p = 1 / smoothing; 0: the greatest


class BatchResult(NamedTuple):
    """What becomes of the trials."""

    cost: Array  # (n,) or inf where it is not below the bound; NaN where it was not computed
    refuted_by: Counts  # (n,) the certificate whose subspace refuted a trial, or −1
    certificates: Counts  # (n, c) in the worst subspaces of a trial that was not refuted
    links: Words  # (n, rows, 3) of such a trial the links of the last LiDAR that moved; or none
    clear: Words  # (n, rows) and what is clear of it; or none


class Sources(NamedTuple):
    """Some food sources, and what is to be computed anew of them."""

    row: Counts  # (n,) of `links` and `clear`
    placed: Placed
    changed: Flags  # (n, lidars) whose links are those of another pose
    same_position: Flags  # (n, lidars) whose `clear` is not
    links: Words  # as in Batch
    clear: Words  # as in Batch
