"""What numba is compiling, and how long it has: time that no budget and no rate counts."""

import time
from collections.abc import Callable


class Compiling:
    """The loops that this process compiles, which is one at a time, with those that it calls."""

    def __init__(self) -> None:
        self.loops: list[str] = []  # being compiled; each is needed by the one before
        self.compiled = 0  # how many are done
        self.expected = 0  # about how many will be, of these and of those that the current ones need
        self.on_change: Callable[[], None] | None = None
        self._spent, self._since = 0.0, 0.0

    @property
    def seconds(self) -> float:
        """Spent on it so far."""
        return self._spent + (time.perf_counter() - self._since if self.loops else 0.0)

    def begin(self, loop: str, parts: int) -> None:
        """A loop is being compiled, with so many loops in all."""
        if not self.loops:
            self._since, self.expected = time.perf_counter(), self.compiled + parts
        self.loops = [*self.loops, loop]
        self._changed()

    def end(self) -> None:
        """The last one is done."""
        if len(self.loops) == 1:
            self._spent = self.seconds
        self.loops, self.compiled = self.loops[:-1], self.compiled + 1
        self._changed()

    def _changed(self) -> None:
        if self.on_change:
            self.on_change()


compiling = Compiling()  # numba has one compiler in a process


def clock() -> float:
    """Seconds since some moment, those spent on compiling aside."""
    return time.perf_counter() - compiling.seconds
