"""A verdict as tables, on the terminal, and as JSON, alone or beside another rig's."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from lidarcfg.report.table import Cell, Column, Table, named
from lidarcfg.report.terminal import print_table, terminal
from lidarcfg.report.text import truncate
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict

PASS, FAIL = "PASS", "FAIL"
ROUNDING = 1e-9  # of a margin


def verdict_table(found: Verdict, against: Verdict | None = None) -> Table:
    """A row for each requirement. `against`: the verdict on another rig by the same requirements, shown beside it."""
    loses = any(one.lost for one in found.requirements)
    columns = [
        Column("requirement"),
        Column("verdict"),
        *(Column(name, ".6g") for name in ("demanded", "reached", "margin")),
        *([Column("margin of the other"), Column("change")] if against else []),
        Column("worst at x, y", ".2f", "m"),
        Column("heading", ".0f", "°"),
        Column("from body", ".2f", "m"),
        Column("phases there"),
        *([Column("sensors lost there")] if loses else []),
    ]
    rows = [
        [
            named(one.name),
            _passed(one.passed),
            Cell(one.demanded, demanded(one)),
            Cell(one.reached, quantity(one.reached, one.unit)),
            Cell(one.margin, signed(one.margin, one.unit)),
            *(compared(one, against.requirements[n]) if against else []),
            *_worst_cells(one),
            Cell(one.phases, phases(one)),
            *([Cell(one.lost, ", ".join(map(truncate, one.lost)))] if loses else []),
        ]
        for n, one in enumerate(found.requirements)
    ]
    phased = any(one.phases for one in found.requirements)
    steps = "Phases are quarters of the step between two firings, by sensor, where the fewest beams return"
    table = Table(steps if phased else "Each requirement, in its worst place", columns, rows)
    texts = zip(*table.texts, strict=True)
    return table.without(*(column.name for column, cells in zip(columns, texts, strict=True) if not any(cells)))


def print_verdict(found: Verdict, against: Verdict | None = None) -> None:
    """Print a line for each requirement, then what sampling cannot exclude, then the verdict.

    `against`: the verdict on another rig by the same requirements, whose margins are shown in place of some columns.
    """
    table = verdict_table(found, against)
    print_table(table.without("heading", "from body", "phases there") if against else table)
    for one in speeds_tables(found, against):
        terminal().print(f"{one.caption}:")
        print_table(one)
    for line in [*remarks(found, against), conclusion(found)]:
        terminal().print(line)


def speeds_table(one: RequirementVerdict, other: RequirementVerdict | None = None) -> Table:
    """A row for each speed of a scenario, as JSON has them. `other`: the verdict on another rig, shown beside it."""
    assert one.speeds
    records = one.speeds.to_dict()["tested"]
    others = other.speeds.to_dict()["tested"] if other and other.speeds else []
    columns = [
        Column("km/h", "g", key="speed_km_h"),
        *([Column("hit at", ".0%", key="impact")] if len({record["impact"] for record in records}) > 1 else []),
        Column("in sight", ".1f", "m", key="sight_m"),
        Column("seen", ".1f", "m", key="seen_m"),
        Column("needed", ".1f", "m", key="needed_m"),
        Column("margin", "+.1f", "m", key="margin_m"),
        Column("margin", "+.2f", "s", key="margin_s"),
        Column("verdict", key="pass"),
        *([Column("other's", "+.1f", "m"), Column("change", "+.1f", "m")] if others else []),
        *([Column("why", key="why")] if any(record["why"] for record in records) else []),
        *([Column("sensors lost", key="lost")] if any(record["lost"] for record in records) else []),
    ]
    for record, beside in zip(records, others, strict=bool(others)):
        record["other's"] = beside["margin_m"]
        record["change"] = record["margin_m"] - beside["margin_m"]
    caption = (
        f"{truncate(one.name)}, in metres before the impact: in sight from the best place within the sensors' bounds, "
        "seen by the rig, and needed to brake; nothing is known of speeds between"
    )
    return Table(caption, columns, [[_at_speed(record, *column.keys) for column in columns] for record in records])


def _at_speed(record: Mapping[str, Any], key: str) -> Cell:
    """A value of a record of a speed."""
    value = record[key]
    if key == "pass":
        return _passed(value)
    if key in ("sight_m", "seen_m") and value is None:
        return Cell(None, "never")
    return Cell(value, ", ".join(map(truncate, value)) if key == "lost" else None)


def speeds_tables(found: Verdict, against: Verdict | None = None) -> list[Table]:
    """The tables by speed of all scenarios."""
    others = against.requirements if against else [None] * len(found.requirements)
    pairs = zip(found.requirements, others, strict=True)
    return [speeds_table(one, other) for one, other in pairs if one.speeds]


def _passed(passed: bool) -> Cell:
    return Cell(passed, PASS, mark="pass") if passed else Cell(passed, FAIL, mark="fail")


def conclusion(found: Verdict) -> str:
    """The verdict in a sentence."""
    failed = sum(not one.passed for one in found.requirements)
    count = len(found.requirements)
    if not failed:
        return f"{PASS}: the rig meets {'its requirement' if count == 1 else f'all {count} requirements'}"
    return f"{FAIL}: {failed} of {count} requirement{'s' * (count > 1)} {'is' if failed == 1 else 'are'} not met"


def remarks(found: Verdict, against: Verdict | None = None) -> list[str]:
    """The notes on a requirement that its row of the table does not hold."""
    out = []
    for n, one in enumerate(found.requirements):
        texts = list(one.notes)
        if one.speeds:
            texts.insert(0, one.speeds.text)
        if against and (other := against.requirements[n].speeds):
            texts.insert(1, f"the other rig: {other.text}")
        if one.passed and one.breaking:
            texts.append(f"fails without any one of {', '.join(map(truncate, one.breaking))}")
        if one.not_achievable:
            texts.append(f"not achievable: {one.not_achievable}")
        if one.fraction is not None:
            texts.append(f"met at {one.fraction:.2%} of the base grid's positions")
        if one.sampling:
            texts.append(one.sampling.text)
        out += [f"{truncate(one.name)}: {text}" for text in texts]
    return out


def demanded(one: RequirementVerdict) -> str:
    """What a requirement asks for."""
    return f"{'≤' if one.at_most else '≥'} {quantity(one.demanded, one.unit)}"


def phases(one: RequirementVerdict) -> str:
    """The phase of each sensor at the worst place: quarters of the step between firings; – for one that is lost."""
    return " ".join("–" if phase < 0 else str(phase) for phase in one.phases or ())


def quantity(value: float, unit: str) -> str:
    """A figure with its unit."""
    return f"{number(value, unit)} {unit}".rstrip() if math.isfinite(value) else number(value, unit)


def number(value: float, unit: str) -> str:
    """A number to the digits that matter in its unit."""
    if not math.isfinite(value):
        return "never" if value > 0 else "–"
    return f"{value:,.0f}" if unit in ("returns", "sensors") else f"{value:,.2f}" if unit else f"{value:,.6g}"


def signed(value: float, unit: str) -> str:
    """A margin with its sign and unit."""
    if not math.isfinite(value):
        return "–"
    return ("+" if value > -ROUNDING else "-") + quantity(abs(value), unit)


def verdict_text(one: RequirementVerdict) -> str:
    """The verdict on a requirement with its margin."""
    return f"{PASS if one.passed else FAIL} {signed(one.margin, one.unit)}"


def worst_place(one: RequirementVerdict) -> str:
    """Where the requirement is closest to being missed."""
    if one.worst is None:
        return ""
    at = f"x {one.worst.x_m:.2f}, y {one.worst.y_m:.2f} m"
    if one.worst.heading_deg is not None:
        at += f", heading {one.worst.heading_deg:.0f}°"
    if one.worst.distance_m is not None:
        at += f"; {one.worst.distance_m:.2f} m from the body"
    return at


def _worst_cells(one: RequirementVerdict) -> list[Any]:
    """The worst place for the table: where, the heading, the distance from the body."""
    worst = one.worst
    if worst is None:
        return [Cell(None, "")] * 3
    rest = [Cell(None, "") if value is None else value for value in (worst.heading_deg, worst.distance_m)]
    return [(worst.x_m, worst.y_m), *rest]


def compared(one: RequirementVerdict, other: RequirementVerdict) -> list[Cell]:
    """Another rig's margin, and by how much this one's is better."""
    change = one.margin - other.margin
    if not math.isfinite(change):
        word = "" if one.margin == other.margin else "better" if one.margin > other.margin else "worse"
    else:
        word = "the same" if change == 0 else f"{signed(change, one.unit)} {'better' if change > 0 else 'worse'}"
    return [Cell(other.margin, verdict_text(other)), Cell(change, word)]


def verdict_dict(found: Verdict, against: Verdict | None = None, names: Sequence[str] = ()) -> dict[str, object]:
    """The verdict as a JSON object, with that of another rig; `names`: of the rigs."""
    out: dict[str, object] = {"rig": names[0] if names else "", **found.to_dict()}
    if against:
        changes = []
        for one, other in zip(found.requirements, against.requirements, strict=True):
            change = one.margin - other.margin
            changes.append(
                {
                    "name": one.name,
                    "pass": one.passed,
                    "pass_against": other.passed,
                    "change": change if math.isfinite(change) else None,
                }
            )
        out["against"] = {"rig": names[1] if len(names) > 1 else "", **against.to_dict()}
        out["changes"] = changes
    return out
