"""A verdict as a table, on the terminal, and as JSON and JUnit XML, alone or beside another rig's."""

import math
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from lidarcfg.report.table import Cell, Column, Table, named
from lidarcfg.report.terminal import print_table, terminal
from lidarcfg.report.text import truncate
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict

PASS, FAIL = "PASS", "FAIL"


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
            Cell(one.passed, PASS, mark="pass") if one.passed else Cell(one.passed, FAIL, mark="fail"),
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
    caption = "Phases are quarters of the step between two firings, by sensor, where the fewest beams return"
    return Table(caption, columns, rows)


def print_verdict(found: Verdict, against: Verdict | None = None) -> None:
    """Print a line for each requirement, then what sampling cannot exclude, then the verdict.

    `against`: the verdict on another rig by the same requirements, whose margins are shown in place of some columns.
    """
    table = verdict_table(found, against)
    print_table(table.without("heading", "from body", "phases there") if against else table)
    for line in [*remarks(found), conclusion(found)]:
        terminal().print(line)


def conclusion(found: Verdict) -> str:
    """The verdict in a sentence."""
    failed = sum(not one.passed for one in found.requirements)
    count = len(found.requirements)
    if not failed:
        return f"{PASS}: the rig meets {'its requirement' if count == 1 else f'all {count} requirements'}"
    return f"{FAIL}: {failed} of {count} requirement{'s' * (count > 1)} {'is' if failed == 1 else 'are'} not met"


def remarks(found: Verdict) -> list[str]:
    """The notes on a requirement that its row of the table does not hold."""
    out = []
    for one in found.requirements:
        texts = list(one.notes)
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
    return ("+" if value >= 0 else "−") + quantity(abs(value), unit)


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


def junit(found: Verdict, name: str) -> str:
    """The verdict as JUnit XML, which CI servers read: a test case for each requirement."""
    failed = sum(not one.passed for one in found.requirements)
    counts = f'tests="{len(found.requirements)}" failures="{failed}" errors="0" skipped="0"'
    lines = ['<?xml version="1.0" encoding="utf-8"?>', "<testsuites>", f"  <testsuite name={_quoted(name)} {counts}>"]
    for one in found.requirements:
        said = f"demanded {'at most' if one.at_most else 'at least'} {quantity(one.demanded, one.unit)}"
        said += f", reached {quantity(one.reached, one.unit)}"
        details = [said, worst_place(one), f"sensors lost there: {', '.join(one.lost)}" if one.lost else ""]
        details += [f"fails without any one of {', '.join(one.breaking)}" if one.passed and one.breaking else ""]
        details += [*one.notes, one.sampling.text if one.sampling else "", one.not_achievable or ""]
        text = escape(xml_text("\n".join(line for line in details if line)))
        lines.append(f'    <testcase classname="requirements" name={_quoted(one.name)}>')
        if one.passed:
            lines.append(f"      <system-out>{text}</system-out>")
        else:
            lines.append(f'      <failure message={_quoted(said)} type="requirement">{text}</failure>')
        lines.append("    </testcase>")
    return "\n".join([*lines, "  </testsuite>", "</testsuites>", ""])


def _quoted(text: str) -> str:
    """A text as an attribute's value."""
    return quoteattr(xml_text(text))


def xml_text(text: str) -> str:
    """A text without the characters that XML 1.0 cannot hold."""
    return "".join(
        c if c in "\t\n\r" or " " <= c <= "\ud7ff" or "\ue000" <= c <= "\ufffd" or c > "\uffff" else "\ufffd"
        for c in text
    )


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
