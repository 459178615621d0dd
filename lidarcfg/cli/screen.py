"""The progress bar that a command shows on a terminal while it works."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress


class Screen:
    """One bar on stderr for all that a command does."""

    def __init__(self) -> None:
        self._bar: Progress | None = None

    def bar(self) -> "Progress":
        """The bar, on the screen."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        if self._bar is None:
            left = TextColumn("{task.fields[left]}")
            columns = (BarColumn(30), TextColumn("{task.description}"), TimeElapsedColumn(), left)
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._bar.start()
        return self._bar

    def close(self, clear: bool = False) -> None:
        """Leave the last state of the bar, and go on below it, or leave nothing."""
        bar = self._bar
        self._bar = None
        if bar:
            bar.live.transient = clear
            bar.stop()
