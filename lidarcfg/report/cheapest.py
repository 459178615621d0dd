"""The combinations that were searched for the cheapest rig that meets all: as a table, and as a file."""

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import SIMPLE
from rich.table import Column, Table

from lidarcfg.files import replacing
from lidarcfg.report.describe import counted, price
from lidarcfg.report.text import terminal, truncate

if TYPE_CHECKING:
    from lidarcfg.placement.cheapest import Cheapest, Tried

COMBINATIONS = "combinations.csv"
SHOWN = 20  # combinations on the terminal
COLUMNS = ("combination", "price", "sensors", "evaluations", "shortfall", "missed", "meets", "too_dear")


def save_combinations(found: "Cheapest", folder: Path) -> None:
    """Write combinations.csv: how long each was searched, and how short it fell; empty if it was not."""
    with replacing(folder / COMBINATIONS) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for one in found.tried:
            short = one.shortfall if math.isfinite(one.shortfall) else ""
            missed = "; ".join(one.failing)
            row = (one.name, one.price, one.sensors, one.evaluations, short, missed, int(one.meets), int(one.too_dear))
            writer.writerow(row)


def print_cheapest(found: "Cheapest") -> None:
    """Print the answer, then the cheaper combinations, or those that come closest if none meets all."""
    console = terminal()
    asked = found.combination
    rest = found.combinations - found.allowed
    dear = f"; {rest:,} cost too much or have too many sensors" if rest else ""
    if found.meets:
        console.print(f"the cheapest rig found that meets all requirements: {asked.sensors}, for {price(asked.price)}")
    else:
        console.print(f"no rig found meets all requirements; {asked.sensors}, for {price(asked.price)}, comes closest")
    searched = sum(math.isfinite(one.shortfall) for one in found.tried)
    console.print(
        f"{searched:,} of {counted(found.combinations, 'combination')} searched{dear}; "
        f"{found.evaluations:,} evaluations, {found.seconds:.1f} s"
    )
    shown = [one for one in found.tried if one.price < asked.price] if found.meets else _closest(found.tried)
    if not shown:
        return
    table = Table(
        Column("price", justify="right"),
        Column("combination", overflow="fold"),
        Column("evaluations", justify="right"),
        Column("short by", justify="right"),
        Column("misses", overflow="fold"),
        title="cheaper combinations" if found.meets else "the closest combinations",
        box=SIMPLE,
    )
    for one in shown[:SHOWN]:
        table.add_row(
            price(one.price),
            truncate(one.name),
            f"{one.evaluations:,}",
            f"{one.shortfall:.4g}" if math.isfinite(one.shortfall) else "–",
            "too dear" if one.too_dear else _missed(one),
        )
    console.print(table)
    if len(shown) > SHOWN:
        console.print(f"and {len(shown) - SHOWN:,} more: see {COMBINATIONS}")


def _closest(tried: "tuple[Tried, ...]") -> "list[Tried]":
    return sorted((one for one in tried if math.isfinite(one.shortfall)), key=lambda one: one.shortfall)


def _missed(one: "Tried") -> str:
    if not math.isfinite(one.shortfall):
        return "not searched"
    if one.failing:
        return ", ".join(truncate(name) for name in one.failing)
    return "" if one.meets else "places between those of the grid"
