"""The model of a table: columns, and rows of values. The terminal, pages, JSON and CSV are made from it."""

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from numbers import Real
from typing import IO, Any, Literal

from lidarcfg.report.text import LISTED, truncate

NOTHING = "–"  # a value that there is not
COUNT = ",.0f"
PRICE = ",.15g"  # with all its figures
Row = Sequence[Any]  # values, or cells where a value alone does not say how it is shown


@dataclass(frozen=True)
class Cell:
    """A value with words or a format of its own, a mark, or a link."""

    value: Any
    text: str | None = None  # None: by the format
    form: str = ""  # none: the column's
    mark: Literal["", "best", "pass", "fail", "total"] = ""
    link: str = ""  # of a page, relative to that of the table


@dataclass(frozen=True)
class Column:
    """What values of one kind are called and how they are written."""

    name: str
    form: str = ""  # of numbers, as `format` reads it; none: texts
    unit: str = ""
    key: str | tuple[str, ...] = ""  # in JSON and CSV, several inside each other; none: the name

    @property
    def head(self) -> str:
        """The name with the unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    @property
    def keys(self) -> tuple[str, ...]:
        """Where JSON has a value, from the outside in."""
        return self.key if isinstance(self.key, tuple) else (self.key or self.name,)

    @property
    def is_number(self) -> bool:
        """Whether it is aligned to the right."""
        return bool(self.form)

    def cell(self, value: Any) -> Cell:
        """A value as a cell with its format and its text."""
        cell = value if isinstance(value, Cell) else Cell(value)
        form = cell.form or self.form
        text = _text(cell.value, form) if cell.text is None else cell.text
        return replace(cell, text=text, form=form)

    def difference(self, own: Any, other: Any) -> str:
        """The difference of two numbers as they are written; empty if one is none."""
        first, second = self.cell(own), self.cell(other)
        if not (first.form and _is_number(first.value) and _is_number(second.value)):
            return ""
        less = as_written(first.value, first.form) - as_written(second.value, first.form)
        return written(less, f"+{first.form.removeprefix('+')}")


@dataclass(frozen=True)
class Table:
    """Rows of values; the first column names the row."""

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Row]

    @property
    def cells(self) -> list[list[Cell]]:
        """The rows as cells with texts."""
        return [[column.cell(value) for column, value in zip(self.columns, row, strict=True)] for row in self.rows]

    @property
    def texts(self) -> list[list[str]]:
        """The rows as texts."""
        return [[cell.text or "" for cell in row] for row in self.cells]

    @property
    def records(self) -> list[dict[str, Any]]:
        """The rows as objects of JSON, by the columns' keys."""
        found = []
        for row in self.cells:
            record: dict[str, Any] = {}
            for column, cell in zip(self.columns, row, strict=True):
                *outer, last = column.keys
                reduce(lambda inner, key: inner.setdefault(key, {}), outer, record)[last] = cell.value
            found.append(record)
        return found

    def without(self, *names: str) -> "Table":
        """The table without the columns of these names."""
        return self._of([n for n, column in enumerate(self.columns) if column.name not in names])

    def parts(self, most: int) -> list["Table"]:
        """Tables of at most so many columns beside the first, which each of them begins with."""
        count = len(self.columns)
        return [self._of([0, *range(first, min(first + most, count))]) for first in range(1, count, most)]

    def _of(self, chosen: Sequence[int]) -> "Table":
        """The table of some of its columns."""
        rows = [[row[n] for n in chosen] for row in self.rows]
        return Table(self.caption, [self.columns[n] for n in chosen], rows)

    def write_csv(self, file: IO[str], digits: int | None = 12) -> None:
        """Write the rows as CSV, with numbers to so many figures; None: so that they are read back as they are."""
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(".".join(column.keys) for column in self.columns)
        for row in self.cells:
            values = (cell.value for cell in row)
            writer.writerow(f"{v:.{digits}g}" if digits and isinstance(v, float) else v for v in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


def _text(value: Any, form: str) -> str:
    """A value as text: numbers by a format, several with commas between them."""
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return ", ".join(_text(one, form) for one in value)
    if value is None or (form and not math.isfinite(value)):
        return NOTHING
    return written(value, form) if form else str(value)


def written(value: float, form: str) -> str:
    """A number as a format writes it, without negative zeros."""
    sign = "+" * form.startswith("+")
    return f"{value:{sign}z{form.removeprefix('+')}}"


def as_written(value: float, form: str) -> float:
    """A number with the digits that a format leaves of it."""
    text = written(value, form).replace(",", "")
    return float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)


def named(name: str, most: int = LISTED) -> Cell:
    """A name, shortened where it is shown."""
    return Cell(name, truncate(name, most))


def with_baseline(table: Table | None, baseline: Table | None) -> Table | None:
    """The table with two more rows after each: the baseline's, and the difference.

    Rows of one name belong together, the others in their order.
    """
    if table is None or baseline is None:
        return table
    rows: list[Row] = []
    for own, other in _pairs(table, baseline):
        if own:
            rows.append(own)
        if other:
            name = table.columns[0].cell(other[0])
            said = "" if own and _name(own) == name.value else f": {name.text}"
            rows.append([Cell(name.value, f"baseline{said}"), *other[1:]])
        if own and other:
            both = zip(table.columns[1:], own[1:], other[1:], strict=True)
            rows.append(["difference", *(column.difference(*pair) for column, *pair in both)])
    return Table(f"{table.caption.removesuffix('.')}; below each row, the baseline's", table.columns, rows)


def _pairs(table: Table, baseline: Table) -> Iterator[tuple[Row | None, Row | None]]:
    """Each row with the one of its name, or else with the next of those that belong to none; then what is left."""
    left = list(baseline.rows)

    def take(name: Any) -> Row | None:
        found = (i for i, row in enumerate(left) if _name(row) == name)
        return left.pop(i) if (i := next(found, None)) is not None else None

    known = [take(_name(row)) for row in table.rows]
    for own, other in zip(table.rows, known, strict=True):
        yield own, other or (left.pop(0) if left else None)
    yield from ((None, row) for row in left)


def _name(row: Row) -> Any:
    """The value that names a row."""
    return row[0].value if isinstance(row[0], Cell) else row[0]
