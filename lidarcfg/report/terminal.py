"""Where results are printed."""

import sys
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from lidarcfg.errors import one_line


class Terminal(Console):
    """A console that writes the control characters of names as escapes."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The pieces of text."""
        for piece in super().render(renderable, options):
            lines = map(one_line, piece.text.split("\n"))
            yield piece if piece.control else Segment("\n".join(lines), piece.style)


def terminal() -> Console:
    """Standard output, as wide as the terminal, or as the tables need where there is none."""
    return Terminal(width=None if sys.stdout.isatty() else 110, highlight=False, markup=False, emoji=False)
