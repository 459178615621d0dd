"""Where results are printed."""

import sys
from typing import Any

from rich.console import Console
from rich.text import Text

from lidarcfg.errors import one_line


class Terminal(Console):
    """A console that writes the control characters of names as escapes, and their line ends too."""

    def render_str(self, text: str, **options: Any) -> Text:
        """A text, or a table's cell."""
        return super().render_str(one_line(text), **options)


def terminal() -> Console:
    """Standard output, as wide as the terminal, or as the tables need where there is none."""
    return Terminal(width=None if sys.stdout.isatty() else 110, highlight=False, markup=False, emoji=False)
