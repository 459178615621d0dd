"""Threads that work side by side, and now and then one alone.

Open3D casts on all cores at once and holds Python's lock meanwhile. Kernels beside it would take its cores away without
getting on themselves, so that both would wait for each other.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Condition, local


class Turns:
    """Who waits to be alone comes before who waits to go on, so that all are alone one after another."""

    def __init__(self) -> None:
        self._changed, self._mine = Condition(), local()
        self._together, self._waiting, self._alone = 0, 0, False

    @contextmanager
    def together(self) -> Iterator[None]:
        """While nobody is alone."""
        self._join()
        try:
            yield
        finally:
            self._leave()

    @contextmanager
    def alone(self) -> Iterator[None]:
        """While nobody else is here; from within `together` or from outside."""
        joined = getattr(self._mine, "joined", False)
        if joined:
            self._leave()
        with self._changed:
            self._waiting += 1
            self._changed.wait_for(lambda: not self._alone and not self._together)
            self._waiting, self._alone = self._waiting - 1, True
        try:
            yield
        finally:
            with self._changed:
                self._alone = False
                self._changed.notify_all()
            if joined:
                self._join()

    def _join(self) -> None:
        with self._changed:
            self._changed.wait_for(lambda: not self._alone and not self._waiting)
            self._together += 1
        self._mine.joined = True

    def _leave(self) -> None:
        self._mine.joined = False
        with self._changed:
            self._together -= 1
            self._changed.notify_all()
