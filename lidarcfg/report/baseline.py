"""A rig that every table of a report shows beside the result, with the differences."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from lidarcfg.placement.report_inputs import ReportInputs
from lidarcfg.report.html import Figure, Table
from lidarcfg.sensors.rig import Rig

Row = Sequence[object]
COUNT = re.compile(r"^\d+ ")  # before a name, such as that of the first sensor
NUMBER = re.compile(r"(?:≥ )?(-?[\d,]+(?:\.(\d+))?)( ?%)?(?![\d.]| ?…)")  # that a cell begins with


@dataclass(frozen=True)
class Baseline:
    """A rig to compare a result with, and its evaluation in the same study."""

    rig: Rig
    file: str
    details: ReportInputs


def beside(table: Table | None, baseline: Table | None) -> Table | None:
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
    """What a row is of, without its number."""
    return COUNT.sub("", str(row[0]))


def difference(own: object, other: object) -> str:
    """The difference of the numbers that two cells begin with, to their digits; empty if one has no number."""
    found = [NUMBER.match(str(cell)) for cell in (own, other)]
    if found[0] is None or found[1] is None:
        return ""
    first, second = (float(match[1].replace(",", "")) for match in found if match)
    digits = max(len(match[2] or "") for match in found if match)
    return f"{first - second:+z,.{digits}f}{found[0][3] or ''}"


def figures_beside(figures: list[Figure], baseline: list[Figure]) -> list[Figure]:
    """The figures of a summary, each with the baseline's."""
    known = {figure.what: figure.value for figure in baseline}
    return [
        Figure(figure.what, figure.value, f"{figure.detail}; the baseline: {known[figure.what]}")
        if figure.what in known
        else figure
        for figure in figures
    ]
