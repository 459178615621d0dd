"""How much numba has compiled, and how long it took: time that no budget and no rate counts."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock


class Compiling:
    """The loops that this process compiles, which is one at a time, with those that it calls."""

    def __init__(self) -> None:
        self.depth = 0  # how many are being compiled; each is needed by the one before
        self.compiled = 0  # how many are done
        self.expected = 0  # about how many will be, with those that the current ones need
        self.may_be_left = False  # it waits for what another process compiles, and nothing breaks if it no longer does
        self.on_change: Callable[[], None] | None = None
        self.others: Callable[[], None] | None = None  # waits until no other process compiles for this one
        self._left = 0  # how many are expected and not yet done, of those that the first of the current ones needs
        self._spent, self._since, self._lock = 0.0, 0.0, Lock()

    @property
    def seconds(self) -> float:
        """Spent on it so far."""
        return self._spent + (time.perf_counter() - self._since if self.depth else 0.0)

    def begin(self, parts: int) -> None:
        """A loop is being compiled, with so many loops in all."""
        if not self.depth:
            self._since, self._left = time.perf_counter(), parts
        self.depth += 1
        self.count(parts if self.depth == 1 else 0, 0)

    def end(self) -> None:
        """The last one is done."""
        if self.depth == 1:
            self._spent = self.seconds
        self.depth -= 1
        left = max(self._left - 1, self.depth) if self.depth else 0  # the current ones have yet to be done
        unexpected, self._left = left - (self._left - 1), left
        self.count(unexpected, 1)

    @contextmanager
    def loading(self) -> Iterator[None]:
        """While what was compiled before is loaded; nothing is shown."""
        if self.depth:
            yield
            return
        self._since, self.depth = time.perf_counter(), 1
        try:
            yield
        finally:
            self._spent, self.depth = self.seconds, 0

    def count(self, expected: int, compiled: int) -> None:
        """So many more are expected to be compiled, and are, here or elsewhere."""
        with self._lock:
            self.expected, self.compiled = self.expected + expected, self.compiled + compiled
        self._changed()

    @contextmanager
    def elsewhere(self) -> Iterator[None]:
        """While another process compiles a loop that this one waits for."""
        self.may_be_left = not self.depth
        self.begin(1)
        try:
            yield
        finally:
            self.may_be_left = False
            self.end()

    def _changed(self) -> None:
        if self.on_change:
            self.on_change()


compiling = Compiling()  # numba has one compiler in a process


def stopwatch() -> float:
    """Seconds since some moment, those aside in which this process compiled or waited for what others compile."""
    return time.perf_counter() - compiling.seconds


def clock() -> float:
    """The same for budgets, which begin when nothing is compiled elsewhere either."""
    others, compiling.others = compiling.others, None
    if others:
        others()
    return stopwatch()
