"""The verdict on a rig as a page of its own, and as the beginning of other reports."""

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from lidarcfg import __version__
from lidarcfg.config.document import yaml_text
from lidarcfg.placement.study import Study
from lidarcfg.placement.study_file import COORDINATES
from lidarcfg.report.describe import date, describe_rig, mounts_table, versions
from lidarcfg.report.evidence import draw_frames, draw_map, draw_views, map_caption
from lidarcfg.report.html import FailCell, PassCell, Table, render
from lidarcfg.report.mounts import draw_mounts
from lidarcfg.report.text import truncate
from lidarcfg.report.verdict import (
    FAIL,
    PASS,
    compared,
    conclusion,
    demanded,
    lost_sensors,
    phases,
    quantity,
    remarks,
    signed,
    worst_place,
)
from lidarcfg.requirements.evidence import OFF_M, OFF_RAD, Verification
from lidarcfg.requirements.objects import MountMargins
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict
from lidarcfg.sensors.rig import Rig, rig_to_dict


@dataclass(frozen=True)
class RequirementPart:
    """A requirement in a report."""

    title: str
    sentence: str
    map: Markup | None
    map_caption: str
    views: Markup | None
    margins: Table | None
    frames: Markup | None


@dataclass(frozen=True)
class VerdictPart:
    """The verdict in a report."""

    passed: bool
    conclusion: str
    table: Table
    remarks: list[str]
    parts: list[RequirementPart]


def verdict_part(found: Verification, rig: Rig, against: Verdict | None = None) -> VerdictPart:
    """What a report says of a verification; `against`: the verdict on another rig, which is put beside."""
    parts = [
        RequirementPart(
            title=f"{PASS if one.verdict.passed else FAIL}: {truncate(one.verdict.name)}",
            sentence=sentence(one.verdict),
            map=draw_map(one, rig, number),
            map_caption=map_caption(one) if one.has_map else "",
            views=draw_views(one, number),
            margins=margins_table(one.margins, rig) if one.margins else None,
            frames=draw_frames(one, number),
        )
        for number, one in enumerate(found.evidence, 1)
    ]
    verdict = found.verdict
    return VerdictPart(verdict.passed, conclusion(verdict), verdict_table(verdict, against), remarks(verdict), parts)


def verdict_table(found: Verdict, against: Verdict | None = None) -> Table:
    """A row for each requirement."""
    rows = []
    for n, one in enumerate(found.requirements):
        rows.append(
            [
                truncate(one.name),
                PassCell(PASS) if one.passed else FailCell(FAIL),
                demanded(one),
                quantity(one.reached, one.unit),
                signed(one.margin, one.unit),
                *(compared(one, against.requirements[n]) if against else []),
                worst_place(one),
                phases(one),
                lost_sensors(one),
            ]
        )
    beside = ("margin of the other", "change") if against else ()
    head = (
        "requirement",
        "verdict",
        "demanded",
        "reached",
        "margin",
        *beside,
        "worst place",
        "phases there",
        "sensors lost there; whose loss breaks it",
    )
    last = len(head) - 1
    caption = "Phases are quarters of the step between two firings, by sensor, where the fewest beams return"
    return Table(caption, head, rows, texts=(1, last - 2, last - 1, last))


def margins_table(found: MountMargins, rig: Rig) -> Table:
    """The returns in the worst place with each sensor lost, and with each coordinate of its mount off."""
    rows = []
    for mount, without, off in zip(rig.mounts, found.without.tolist(), found.off.tolist(), strict=True):
        cells = [_judged(value, found.demanded) for value in (without, *off)]
        rows.append([truncate(mount.name), *(cells if len(rig.mounts) > 1 else ["–", *cells[1:]])])
    units = f"{100 * OFF_M:g} cm", f"{np.degrees(OFF_RAD):g}°"
    head = ("mount", "lost", *(f"{name} {units[axis > 2]} off" for axis, name in enumerate(COORDINATES)))
    caption = (
        f"Returns in the worst place, of {found.demanded} demanded and {found.whole} with nothing wrong: with a sensor "
        "lost, over the base grid; with one coordinate of its mount off, either way, over the grid's lowest places"
    )
    return Table(caption, head, rows)


def _judged(value: int, demanded: int) -> str:
    return FailCell(f"{value}") if value < demanded else f"{value}"


def sentence(one: RequirementVerdict) -> str:
    """What is demanded, reached and missing."""
    said = f"Demanded {demanded(one)}, reached {quantity(one.reached, one.unit)}: margin {signed(one.margin, one.unit)}"
    if one.worst:
        said += f", at {worst_place(one)}"
    if one.lost:
        said += f", with {', '.join(map(truncate, one.lost))} lost"
    breaking = ", ".join(map(truncate, one.breaking))
    return f"{said}. The loss of any of these alone breaks it: {breaking}." if one.passed and breaking else f"{said}."


def verdict_page(
    study: Study, rig: Rig, found: Verification, command: str | None, against: Verdict | None = None
) -> str:
    """The page of `lidarcfg verify`. Raises ConfigError if SOURCE_DATE_EPOCH is not a time."""
    return render(
        "verdict.html",
        title=f"Verdict: {rig.name}",
        about=f"{describe_rig(rig)} in the study {study.name}; verified by lidarcfg {__version__} on {date()}",
        summary=[],
        found=verdict_part(found, rig, against),
        mounts=mounts_table(rig),
        drawing=draw_mounts(study, rig),
        command=command,
        study_yaml=yaml_text(study.file) if study.file else None,
        rig_yaml=yaml_text(rig_to_dict(rig)),
        repeat=[("versions", versions()), ("date", date())],
    )
