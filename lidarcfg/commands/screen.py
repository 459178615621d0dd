"""What a command shows on a terminal while it works: a bar, and what is being compiled."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import TYPE_CHECKING

import click

from lidarcfg.compiling import compiling

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

LONG_S = 2.0  # of compiling, before a log is told of it


class Screen:
    """One bar on stderr for all that a command does, with a line for what is being compiled meanwhile."""

    def __init__(self) -> None:
        self.quiet = False
        self._bar: Progress | None = None
        self._compiling: TaskID | None = None
        self._told, self._lock = False, RLock()  # loops may be compiled by any thread

    def bar(self) -> "Progress":
        """The bar, on the screen."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        with self._lock:
            if self._bar is None:
                left = TextColumn("{task.fields[left]}")
                columns = (BarColumn(30), TextColumn("{task.description}"), TimeElapsedColumn(), left)
                self._bar = Progress(*columns, console=Console(stderr=True))
                self._bar.start()
            return self._bar

    def close(self, clear: bool = False) -> None:
        """Leave the last state of the bar, and go on below it, or leave nothing."""
        with self._lock:
            bar, self._bar = self._bar, None
            if bar:
                self._hide(bar)
                bar.live.transient = clear
                bar.stop()

    def work(self) -> None:
        """Show no longer what was compiled."""
        with self._lock:
            if self._bar:
                self._hide(self._bar)

    def _hide(self, bar: "Progress") -> None:
        if self._compiling is not None:
            bar.remove_task(self._compiling)
            self._compiling = None

    def compile(self) -> None:
        """Show what is being compiled; where nobody watches, one line once that takes long."""
        if self.quiet or not compiling.depth:
            return
        with self._lock:
            if not sys.stderr.isatty():
                if not self._told and compiling.seconds > LONG_S:
                    click.echo("compiling, once: later runs start without", err=True)
                    self._told = True
                return
            bar = self.bar()
            if self._compiling is None:
                self._compiling = bar.add_task("", left="")
            done, expected = compiling.compiled, compiling.expected
            text = f"compiling, once: {done + 1} of about {expected}"
            bar.update(self._compiling, completed=done, total=expected, description=text)


@contextmanager
def shown(screen: Screen) -> Iterator[None]:
    """Show what is being compiled, for the rest of a command."""
    before, compiling.on_change = compiling.on_change, screen.compile
    try:
        yield
    finally:
        screen.close()
        compiling.on_change = before
