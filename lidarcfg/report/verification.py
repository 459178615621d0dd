"""The verdict on a rig as a page of its own, and as the beginning of other reports."""

import math
from collections.abc import Iterator

from markupsafe import Markup

from lidarcfg import __version__
from lidarcfg.report.describe import date, describe_rig
from lidarcfg.report.evaluation import mounts_table
from lidarcfg.report.evidence import draw_frames, draw_map, draw_views, map_caption
from lidarcfg.report.mounts import MOUNTS_CAPTION, draw_mounts
from lidarcfg.report.page import PageSection, Part, figure, heading, page, verdict_box
from lidarcfg.report.repeat import repeat_section
from lidarcfg.report.table import Cell, Column, Row, Table, named
from lidarcfg.report.text import truncate
from lidarcfg.report.verdict import (
    FAIL,
    PASS,
    conclusion,
    demanded,
    number,
    quantity,
    remarks,
    signed,
    speeds_table,
    verdict_table,
    worst_place,
)
from lidarcfg.requirements.evidence import OFF_M, OFF_RAD, MountMargins
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict
from lidarcfg.requirements.verify import Verification
from lidarcfg.sensors.rig import Rig, rig_to_dict
from lidarcfg.study.file import COORDINATES
from lidarcfg.study.study import Study


def verdict_of(found: Verdict, against: Verdict | None = None) -> Markup:
    """The verdict at the top of a page; `against`: the verdict on another rig, shown beside it."""
    return verdict_box(found.passed, conclusion(found), verdict_table(found, against), remarks(found, against))


def requirement_parts(found: Verification, rig: Rig, against: Verdict | None = None) -> Iterator[Part]:
    """What is demanded and reached, requirement by requirement, with the evidence.

    `against`: the verdict on another rig, whose margins by speed stand beside.
    """
    for n, one in enumerate(found.evidence, 1):
        yield heading(f"{PASS if one.verdict.passed else FAIL}: {truncate(one.verdict.name)}")
        yield sentence(one.verdict)
        if one.verdict.speeds:
            yield speeds_table(one.verdict, against.requirements[n - 1] if against else None)
        yield figure(draw_map(one, rig, n), map_caption(one))
        yield figure(
            draw_frames(one, n),
            "Returns in each frame before the impact, by speed. The target is detected at the first frame from which "
            "the rule holds until the last moment to brake.",
        )
        yield figure(
            draw_views(one, n),
            "The worst place as each sensor sees it, in the phase of its fewest returns; beside its name, its returns. "
            "Grey: the object's silhouette. Azimuths are counter-clockwise from ahead, as on the map; left is left.",
        )
        yield from (margins_table(margins, rig) for margins in one.margins)


def margins_table(found: MountMargins, rig: Rig) -> Table:
    """What is reached with each sensor lost, and with each coordinate of its mount off."""
    rows: list[Row] = []
    for mount, without, off in zip(rig.mounts, found.without.tolist(), found.off.tolist(), strict=True):
        rows.append([named(mount.name), *(_margin(value, found) for value in (without, *off))])
    units = f"{100 * OFF_M:g} cm", f"{math.degrees(OFF_RAD):g}°"
    names = ["lost", *(f"{name} {units[axis > 2]} off" for axis, name in enumerate(COORDINATES))]
    columns = [Column("mount"), *(Column(name, ".6g") for name in names)]
    limit = f"at {'most' if found.at_most else 'least'} {number(found.demanded, found.unit)} demanded"
    lost = ", ".join(filter(None, ["with a sensor lost", found.where_lost]))
    off = ", ".join(filter(None, ["with one coordinate of its mount off, either way", found.where_off]))
    caption = f"{found.what}: {limit}, {_margin(found.whole, found).text} with all mounts in place; {lost}; {off}"
    return Table(caption, columns, rows)


def _margin(value: float, found: MountMargins) -> Cell:
    text = f"≥ {number(found.cap, found.unit)}" if found.cap <= value < math.inf else number(value, found.unit)
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
    counts = (
        "Counts are the simulator's, without noise: beams of one revolution, each sensor in its worst phase, also with "
        "sensors lost where the requirement asks for it."
    )
    parts = requirement_parts(found, rig, against)
    drawn = figure(draw_mounts(study, rig), MOUNTS_CAPTION)
    files = {"The complete study, with defaults": study.file, "The rig as a file": rig_to_dict(rig)}
    return page(
        f"Verdict: {rig.name}",
        f"{describe_rig(rig)} in the study {study.name}; verified by lidarcfg {__version__} on {date()}",
        [
            PageSection("requirements", "Requirement by requirement", [counts, *parts]),
            PageSection("rig", "The rig", [mounts_table(rig), drawn]),
            repeat_section("verdict", files, command),
        ],
        verdict=verdict_of(found.verdict, against),
    )
