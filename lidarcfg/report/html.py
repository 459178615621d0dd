"""Tables, figures and pages in HTML, readable offline and in print. Every text is escaped unless it is Markup."""

import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from lidarcfg.report.text import printable

if TYPE_CHECKING:
    from jinja2 import Environment

Row = Sequence[object]
COUNT = re.compile(r"^\d+ ")  # before a name, such as that of the first sensor
NUMBER = re.compile(r"(?:≥ )?(-?[\d,]+(?:\.(\d+))?)( ?%)?(?![\d.]| ?…)")  # that a cell begins with


class BestCell(str):
    """A table's cell that is marked as the best of its row."""

    __slots__ = ()
    mark = "best"


class PassCell(str):
    """A table's cell that says that a requirement is met."""

    __slots__ = ()
    mark = "pass"


class FailCell(str):
    """A table's cell that says that a requirement is not met."""

    __slots__ = ()
    mark = "fail"


class TotalCell(str):
    """A table's cell that sums up its column."""

    __slots__ = ()
    mark = "total"


@dataclass(frozen=True)
class Table:
    """A table whose first column names the row; the others hold numbers, except those of `texts`."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[object]]
    texts: Container[int] = ()

    def is_number(self, column: int) -> bool:
        """Whether a column is right-aligned."""
        return column > 0 and column not in self.texts


@dataclass(frozen=True)
class KeyFigure:
    """A key figure of the summary: what it is, its value, and one more detail."""

    what: str
    value: str
    detail: str


def render(template: str, **values: Any) -> str:
    """The document that a template makes of the values."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("lidarcfg.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=lambda value: value if isinstance(value, Markup) else printable(value),
    )


def with_baseline_rows(table: Table | None, baseline: Table | None) -> Table | None:
    """The table with two more rows after each: the baseline's, and the difference.

    Rows of one name belong together, the others in their order.
    """
    if table is None or baseline is None:
        return table
    rows: list[Row] = []
    for own, other in _pairs(table.rows, baseline.rows):
        if own:
            rows.append(own)
        if other:
            named = "" if own and own[0] == other[0] else f": {other[0]}"
            rows.append([f"baseline{named}", *other[1:]])
        if own and other:
            cells = enumerate(zip(own[1:], other[1:], strict=True), 1)
            rows.append(["difference", *(difference(*pair) if table.is_number(n) else "" for n, pair in cells)])
    return Table(f"{table.caption.removesuffix('.')}; below each row, the baseline's", table.head, rows, table.texts)


def _pairs(rows: Sequence[Row], others: Sequence[Row]) -> Iterator[tuple[Row | None, Row | None]]:
    """Each row with the one of its name, or else with the next of those that belong to none; then what is left."""
    left = list(others)

    def take(name: str) -> Row | None:
        found = (i for i, row in enumerate(left) if _name(row) == name)
        return left.pop(i) if (i := next(found, None)) is not None else None

    known = [take(_name(row)) for row in rows]
    for own, other in zip(rows, known, strict=True):
        yield own, other or (left.pop(0) if left else None)
    yield from ((None, row) for row in left)


def _name(row: Row) -> str:
    """The row's name, without its number."""
    return COUNT.sub("", str(row[0]))


def difference(own: object, other: object) -> str:
    """The difference of the numbers that two cells begin with, to their digits; empty if one has no number."""
    found = [NUMBER.match(str(cell)) for cell in (own, other)]
    if found[0] is None or found[1] is None:
        return ""
    first, second = (float(match[1].replace(",", "")) for match in found if match)
    digits = max(len(match[2] or "") for match in found if match)
    return f"{first - second:+z,.{digits}f}{found[0][3] or ''}"


def with_baseline_figures(figures: list[KeyFigure], baseline: list[KeyFigure]) -> list[KeyFigure]:
    """The figures of a summary, each with the baseline's."""
    known = {figure.what: figure.value for figure in baseline}
    return [
        KeyFigure(figure.what, figure.value, f"{figure.detail}; the baseline: {known[figure.what]}")
        if figure.what in known
        else figure
        for figure in figures
    ]
