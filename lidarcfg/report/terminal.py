"""The terminal: standard output, and tables on it."""

import sys
from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column as TerminalColumn
from rich.table import Table as TerminalTable
from rich.text import Text

from lidarcfg.errors import one_line
from lidarcfg.report.table import Cell, Column, Table

WIDTH = 110  # where there is no terminal
WORD_MAX = 24  # letters that the first column leaves together
WORD_LEAST = 8  # of columns that are wrapped
GAP = 3  # between columns


class Terminal(Console):
    """A console that writes the control characters of names as escapes, and their line ends too."""

    def render_str(self, text: str, **options: Any) -> Text:
        """A text, or a table's cell."""
        return super().render_str(one_line(text), **options)


def terminal(width: int = WIDTH) -> Console:
    """Standard output, as wide as the terminal, or of this width where there is none."""
    return Terminal(width=None if sys.stdout.isatty() else width, highlight=False, markup=False, emoji=False)


def print_table(table: Table, title: str | None = None, width: int = WIDTH) -> None:
    """Print a table; a star is behind what is best of its row. Columns that do not fit stand in tables below."""
    cells = table.cells
    stars = any(cell.mark == "best" for row in cells for cell in row)
    console = terminal(width)
    for part in table.parts(_fitting(table, console.width)) if stars else [table]:
        _print_part(console, part, title, stars)
    if stars:
        console.print("* best of its row")


def print_facts(rows: Sequence[tuple[str, object]]) -> None:
    """Print what each of some things is."""
    shown = TerminalTable(box=SIMPLE, show_header=False)
    for what, value in rows:
        shown.add_row(what, str(value))
    terminal().print(shown)


def _print_part(console: Console, table: Table, title: str | None, stars: bool) -> None:
    shown = TerminalTable(*_columns(table, stars, console.width), title=title, box=SIMPLE)
    for row in table.cells:
        texts = [_text(column, cell, stars) for column, cell in zip(table.columns, row, strict=True)]
        shown.add_row(*texts, style="bold" if any(cell.mark == "total" for cell in row) else None)
    console.print(shown)


def _columns(table: Table, stars: bool, width: int) -> list[TerminalColumn]:
    """Numbers to the right and in one line where all of them fit, names in whole words, other texts as they fit."""
    texts = list(zip(*table.texts, strict=True)) or [()] * len(table.columns)
    words = [word for text in (table.columns[0].head, *texts[0]) for word in text.split()]
    least = [max(map(len, cells), default=0) + 2 * stars if column.is_number else 0
             for column, cells in zip(table.columns, texts, strict=True)]  # fmt: skip
    if not table.columns[0].is_number:
        least[0] = min(max(map(len, words), default=0), WORD_MAX)
    fits = sum(max(one, WORD_LEAST) + GAP for one in least) <= width
    return [
        TerminalColumn(
            column.head + "  " * (stars and column.is_number),
            justify="right" if column.is_number else "left",
            overflow="fold",
            min_width=one if fits or not n else None,
        )
        for n, (column, one) in enumerate(zip(table.columns, least, strict=True))
    ]


def _text(column: Column, cell: Cell, stars: bool) -> str:
    star = (" *" if cell.mark == "best" else "  ") if stars and column.is_number else ""
    return f"{cell.text}{star}"


def _fitting(table: Table, width: int) -> int:
    """How many columns beside the first fit, all as wide as the widest."""
    first, *others = zip([column.head for column in table.columns], *table.texts, strict=True)
    widest = max(len(text) for column in others for text in column) + 5  # with a star and a gap
    return max((width - max(map(len, first)) - 4) // widest, 1)
