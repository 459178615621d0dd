"""Jobs that run on threads, ahead of whoever reads their results."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


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
