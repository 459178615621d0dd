"""Jobs that run on threads: ahead of whoever reads their results, or on numbers that the threads share."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Counter = NDArray[np.int64]  # (1,) the next number
T = TypeVar("T")
R = TypeVar("R")


def ordered_results(jobs: Iterator["Future[T]"], ahead: int) -> Iterator[T]:
    """The results of jobs in the order in which the iterator starts them, at most `ahead` before their turn."""
    waiting: deque[Future[T]] = deque()
    for job in jobs:
        waiting.append(job)
        del job  # its result would stay in memory, or its error's traceback
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


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
