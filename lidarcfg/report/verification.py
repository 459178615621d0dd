"""The verdict on a rig as a page of its own, and as the beginning of other reports."""

import math
from dataclasses import dataclass

from markupsafe import Markup

from lidarcfg import __version__
from lidarcfg.config.document import yaml_text
from lidarcfg.report.describe import date, describe_rig, versions
from lidarcfg.report.evaluation import mounts_table
from lidarcfg.report.evidence import draw_frames, draw_map, draw_views, map_caption
from lidarcfg.report.html import render
from lidarcfg.report.mounts import draw_mounts
from lidarcfg.report.table import Cell, Column, Row, Table, named
from lidarcfg.report.text import truncate
from lidarcfg.report.verdict import (
    FAIL,
    PASS,
    conclusion,
    demanded,
    figure,
    quantity,
    remarks,
    signed,
    verdict_table,
    worst_place,
)
from lidarcfg.requirements.evidence import OFF_M, OFF_RAD, MountMargins
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict
from lidarcfg.requirements.verify import Verification
from lidarcfg.sensors.rig import Rig, rig_to_dict
from lidarcfg.study.file import COORDINATES
from lidarcfg.study.study import Study


@dataclass(frozen=True)
class RequirementPart:
    """A requirement in a report."""

    title: str
    sentence: str
    map: Markup | None
    map_caption: str
    views: Markup | None
    margins: list[Table]
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
    """A verification as a report shows it; `against`: the verdict on another rig, shown beside it."""
    parts = [
        RequirementPart(
            title=f"{PASS if one.verdict.passed else FAIL}: {truncate(one.verdict.name)}",
            sentence=sentence(one.verdict),
            map=draw_map(one, rig, number),
            map_caption=map_caption(one),
            views=draw_views(one, number),
            margins=[margins_table(margins, rig) for margins in one.margins],
            frames=draw_frames(one, number),
        )
        for number, one in enumerate(found.evidence, 1)
    ]
    verdict = found.verdict
    return VerdictPart(verdict.passed, conclusion(verdict), verdict_table(verdict, against), remarks(verdict), parts)


def margins_table(found: MountMargins, rig: Rig) -> Table:
    """What is reached with each sensor lost, and with each coordinate of its mount off."""
    rows: list[Row] = []
    for mount, without, off in zip(rig.mounts, found.without.tolist(), found.off.tolist(), strict=True):
        rows.append([named(mount.name), *(_margin(value, found) for value in (without, *off))])
    units = f"{100 * OFF_M:g} cm", f"{math.degrees(OFF_RAD):g}°"
    names = ["lost", *(f"{name} {units[axis > 2]} off" for axis, name in enumerate(COORDINATES))]
    columns = [Column("mount"), *(Column(name, ".6g") for name in names)]
    limit = f"at {'most' if found.at_most else 'least'} {figure(found.demanded, found.unit)} demanded"
    lost = ", ".join(filter(None, ["with a sensor lost", found.where_lost]))
    off = ", ".join(filter(None, ["with one coordinate of its mount off, either way", found.where_off]))
    caption = f"{found.what}: {limit}, {_margin(found.whole, found).text} with all mounts in place; {lost}; {off}"
    return Table(caption, columns, rows)


def _margin(value: float, found: MountMargins) -> Cell:
    text = f"≥ {figure(found.cap, found.unit)}" if found.cap <= value < math.inf else figure(value, found.unit)
    return Cell(value, text, mark="" if found.meets(value) else "fail")


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
