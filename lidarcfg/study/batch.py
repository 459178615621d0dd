"""Threads that share the trials of a batch."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Counter = NDArray[np.int64]  # (1,) the next trial
T = TypeVar("T")
R = TypeVar("R")


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
