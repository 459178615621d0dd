"""The combinations searched for the cheapest rig: on the terminal, as a CSV file, and in the report."""

import math
from collections.abc import Sequence
from pathlib import Path

from lidarcfg.files import replacing
from lidarcfg.report.describe import counted, price
from lidarcfg.report.results import COMBINATIONS
from lidarcfg.report.rig_report import ChoicePart
from lidarcfg.report.table import COUNT, NOTHING, PRICE, Cell, Column, Table, named
from lidarcfg.report.terminal import print_table, terminal
from lidarcfg.report.text import truncate
from lidarcfg.search.cheapest import TOO_DEAR, Cheapest, SearchedCombination

SHOWN = 20  # combinations on the terminal and in the report


def combinations_table(found: Cheapest, tried: Sequence[SearchedCombination]) -> Table:
    """A row for each combination, with a column for each group of sensors that are chosen."""
    columns = [
        Column("price", PRICE),
        *(Column(truncate(name), key=name) for name in found.combination.group_names),
        Column("sensors", COUNT),
        Column("verdict"),
        Column("short by", ".0%", key="worst"),
        Column("shortfall", ".6g"),
        Column("not met", key="missed"),
        Column("rigs tried", COUNT, key="rigs"),
        Column("excluded"),
        Column("name"),
    ]
    rows = [
        [
            one.price,
            *(Cell(models or "none", models or NOTHING) for models in one.models),
            one.sensors,
            _verdict(one),
            _short(one),
            _finite(one.shortfall),
            Cell("; ".join(one.failing), ", ".join(map(truncate, one.failing))),
            one.evaluations,
            one.excluded or "",
            named(one.name),
        ]
        for one in tried
    ]
    caption = "Cheaper combinations, the closest first" if found.meets else "The combinations that come closest"
    caption += "; short by: of what is demanded, at the worst place of the best rig; 100%: no returns there"
    return Table(caption, columns, rows)


def _short(one: SearchedCombination) -> Cell:
    """How far the best rig's worst place falls short."""
    between = one.worst <= 0 and not one.meets
    return Cell(_finite(one.worst), "places between" if between else f"{max(one.worst, 0):.0%}")


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def save_combinations(found: Cheapest, folder: Path) -> None:
    """Write combinations.csv: a line for each, by price; empty cells where a combination was not looked at."""
    with replacing(folder / COMBINATIONS) as file:
        combinations_table(found, found.tried).write_csv(file)


def print_cheapest(found: Cheapest) -> None:
    """Print the answer, then the cheaper combinations that come closest, or the closest if none meets all."""
    console = terminal()
    console.print(_answer(found))
    console.print(_searched(found))
    table = _shown_table(found)
    if table.rows:
        print_table(table, table.caption)
    if (more := len(_shown(found)) - SHOWN) > 0:
        console.print(f"and {more:,} more: see {COMBINATIONS}")
    first = next((one for one in found.tried if one.excluded), None)
    if first:
        of_which = f"{counted(found.excluded, 'combination')} cannot meet all requirements"
        console.print(f"{of_which}, such as {', '.join(_models(first))}: {_why(first)}; {COMBINATIONS} has the reasons")


def choice_part(found: Cheapest, command: str | None) -> ChoicePart:
    """The part of the report; `command` goes on with the search, if that may help."""
    return ChoicePart(
        answer=_answer(found),
        searched=f"{_searched(found)}. {COMBINATIONS} has all of them.",
        table=_shown_table(found),
        again=command,
    )


def _shown_table(found: Cheapest) -> Table:
    """The first combinations to show, in the columns that people read."""
    table = combinations_table(found, _shown(found)[:SHOWN])
    return table.without("sensors", "verdict", "shortfall", "excluded", "name")


def _answer(found: Cheapest) -> str:
    asked = found.combination
    if found.meets:
        return f"the cheapest rig found that meets all requirements: {asked.sensors}, for {price(asked.price)}"
    if found.cannot:
        cheapest = min(found.tried, key=lambda one: one.price)
        what = (
            f"the cheapest combination, {', '.join(_models(cheapest))} for {price(cheapest.price)}: {cheapest.excluded}"
        )
        return f"no rig can meet all requirements: {what}. Relax a requirement, or let other models be chosen"
    return f"no rig found meets all requirements; {asked.sensors}, for {price(asked.price)}, comes closest"


def _searched(found: Cheapest) -> str:
    looked_at = sum(math.isfinite(one.worst) for one in found.tried)
    rigs = sum(one.evaluations for one in found.tried)
    all_of_them = counted(len(found.tried), "combination")
    return f"{looked_at:,} of {all_of_them} looked at; {counted(rigs, 'rig')} evaluated, {found.seconds:.1f} s"


def _shown(found: Cheapest) -> list[SearchedCombination]:
    """The combinations to show, the closest first; if one meets all, only those that cost less."""
    most = found.combination.price if found.meets else math.inf
    looked_at = [one for one in found.tried if math.isfinite(one.worst) and one.price < most and not one.excluded]
    return sorted(looked_at, key=lambda one: (one.worst, one.price))


def _models(one: SearchedCombination) -> list[str]:
    return [models for models in one.models if models]


def _why(one: SearchedCombination) -> str:
    """Why no rig of a combination can meet all."""
    return f"too dear, at {price(one.price)}" if one.excluded == TOO_DEAR else str(one.excluded)


def _verdict(one: SearchedCombination) -> str:
    if one.excluded:
        return "cannot meet all"
    if not math.isfinite(one.worst):
        return "not looked at"
    return "meets all" if one.meets else "misses"
