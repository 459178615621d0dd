"""A batch of trials: what the core takes and returns, and the threads that share the work.

The types are those of core/vsr/evaluator.h, field by field.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.vsr.subspaces import Counts, Words
from lidarcfg.world.tracer import Obstacles

Flags = NDArray[np.bool_]


Counter = NDArray[np.int64]  # (1,) the next trial
T = TypeVar("T")
R = TypeVar("R")


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
    same_position: Flags  # (n, lidars) the LiDARs at the same position as the source's, whose `clear` holds for them
    clear: Words  # (sources, lidars, rows) the cuboids that are near and not hidden; no sources if that is not known
    smoothing: float  # p-norm of the worst subspaces, p = 1 / smoothing; 0: the greatest


class BatchResult(NamedTuple):
    """What becomes of the trials."""

    cost: Array  # (n,) or inf where it is not below the bound; NaN where it was not computed
    refuted_by: Counts  # (n,) the certificate whose subspace refuted a trial, or −1
    certificates: Counts  # (n, c) in the worst subspaces of a trial that was not refuted
    links: Words  # (n, rows, 3) the links of the last LiDAR that moved in such a trial; or none
    clear: Words  # (n, rows) and what is clear of it; or none


class Sources(NamedTuple):
    """Some food sources, and what is to be computed anew of them."""

    row: Counts  # (n,) of `links` and `clear`
    placed: Placed
    changed: Flags  # (n, lidars) whose links are those of another pose
    same_position: Flags  # (n, lidars) whose `clear` is not
    links: Words  # as in Batch
    clear: Words  # as in Batch


def parallel_for(
    pool: Executor,
    workspaces: Sequence[T],
    count: int,
    most: int,
    work: Callable[[Counter, int, T], R],
    on_begun: Callable[[int], None] | None = None,
) -> list[R]:
    """Have a thread for each workspace call work(counter, most, workspace), which takes numbers below `count`.

    This thread has the first workspace, and takes at most `most` numbers at a time. In between it may be interrupted,
    and tells `on_begun` how many more numbers were taken. After an exception other threads take no more. Returns what
    the calls return.
    """
    counter = np.zeros(1, np.int64)
    reported = 0
    done = []
    others = [pool.submit(work, counter, count, workspace) for workspace in workspaces[1:count]]
    try:
        while counter[0] < count:
            done.append(work(counter, most, workspaces[0]))
            if on_begun:
                taken = min(int(counter[0]), count)
                on_begun(taken - reported)
                reported = taken
        if on_begun and reported < count:
            on_begun(count - reported)
    except BaseException:  # an interrupt, too: other threads stop
        counter[0] = count
        raise
    return done + [other.result() for other in others]
