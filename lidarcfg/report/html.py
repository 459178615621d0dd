"""HTML by Jinja2: one file, readable offline and in print. Every text is escaped unless it is Markup."""

from collections.abc import Container, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


class Best(str):
    """A table's cell that is marked as the best of its row."""

    __slots__ = ()
    best = True


@dataclass(frozen=True)
class Table:
    """A table whose first column names the row; the others hold numbers, except those of `texts`."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[object]]
    texts: Container[int] = ()

    def is_number(self, column: int) -> bool:
        """Whether a column is aligned as numbers are."""
        return column > 0 and column not in self.texts


@dataclass(frozen=True)
class Figure:
    """A figure of the summary."""

    what: str
    value: str
    detail: str


def printable(text: object) -> str:
    """A text with unprintable characters as escapes, except for line ends and joiners of letters."""
    return "".join(c if c.isprintable() or c in "\n\u200c\u200d" else repr(c)[1:-1] for c in str(text))


def render(template: str, **values: Any) -> str:
    """The document that a template makes of the values."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("lidarcfg.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=lambda value: value if isinstance(value, Markup) else printable(value),
    )
