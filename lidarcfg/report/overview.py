"""The overview of a rig, the first page of its report in print: what to decide by, and what the figures are not."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup

from lidarcfg.report.describe import counted, describe_rig, price
from lidarcfg.report.evaluation import mounts_table
from lidarcfg.report.key_figures import KeyFigure
from lidarcfg.report.misses import MIDPOINT, SeenBy, cell, compared_with, percent
from lidarcfg.report.mounts import MOUNTS_CAPTION, draw_mounts
from lidarcfg.report.page import Part, beside, figure, verdict_box
from lidarcfg.report.table import NOTHING, Cell, Column, Row, Table, named
from lidarcfg.report.text import summarize, truncate
from lidarcfg.report.verdict import conclusion, demanded, quantity, verdict_table
from lidarcfg.requirements.allowed_rigs import total_price
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict, WorstPlace
from lidarcfg.returns.misses import ObjectMisses
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation
from lidarcfg.study.study import Study

REQUIREMENTS_MAX = 8  # on the page; the closest
OBJECTS_MAX = 7  # those missed most
SENSORS_MAX = 10
FIGURES_MAX = 12
REMARKS_MAX = 3
LIKELY = 0.5  # from this probability on, an object counts as missed at a place
NOT_MEASURED = (
    "These figures are simulated from the sensors' data sheets: without noise, dirt, rain, damage or other road users. "
    "They do not say whether your perception detects an object from the returns that it gets."
)


def overview_verdict(found: Verdict, against: Verdict | None = None) -> Markup:
    """PASS or FAIL, and the requirements, the closest to being missed if there are many."""
    order = sorted(range(len(found.requirements)), key=lambda n: found.requirements[n].relative_margin)
    shown = sorted(order[:REQUIREMENTS_MAX])
    few, other = (one and Verdict(tuple(one.requirements[n] for n in shown)) for one in (found, against))
    table = verdict_table(few or found, other).without("heading", "phases there")
    caption = "Margin: below 0, so much is missing"
    if len(shown) < len(order):
        caption = f"The {len(shown)} closest of {counted(len(order), 'requirement')}. {caption}"
    remarks = [
        f"{truncate(one.name)}: not achievable: {one.not_achievable}"
        for one in found.requirements
        if one.not_achievable
    ]
    return verdict_box(
        found.passed, conclusion(found), replace(table, caption=caption), summarize(remarks, REMARKS_MAX)
    )


def rig_table(study: Study, rig: Rig, found: Evaluation) -> Table:
    """Where each sensor sits, what it costs, and what is missed without it."""
    poses = mounts_table(rig).without("beams", "elevation", "tilt")
    prices = _prices(study, rig)
    breaking = _breaking(found.verdict)
    columns: list[Column] = [*poses.columns]
    if prices:
        columns.append(Column("price", ",.15g"))
    if found.misses_without:
        columns.append(Column("misses if lost", ".2%"))
    if breaking:
        columns.append(Column("its loss breaks"))
    rows: list[Row] = []
    for n, (row, mount) in enumerate(zip(poses.rows, rig.mounts, strict=True)):
        more: list[Any] = [prices[n]] if prices else []
        if found.misses_without:
            share = found.misses_without[mount.name]
            more.append(Cell(share, percent(share)))
        if breaking:
            broken = breaking.get(mount.name, [])
            more.append(Cell(broken, _first(broken) if broken else NOTHING))
        rows.append([*row, *more])
    whole = f"; with all of them {percent(found.misses.mean)}" if found.misses and found.misses_without else ""
    lost = f" Misses if lost: of the others together{whole}." if found.misses_without else ""
    return Table(f"The sensors, in the vehicle frame: x forward, y left, z up.{lost}", columns, rows)


def overview_figures(study: Study, rig: Rig, found: Evaluation, rigs: Sequence[SeenBy]) -> Iterator[KeyFigure]:
    """What it costs, the worst place, and the sensor whose loss costs most."""
    if prices := _prices(study, rig):
        yield KeyFigure(Column("price"), price(total_price(prices)), describe_rig(rig), is_main=True)
    else:
        yield KeyFigure(Column("sensors"), str(len(rig.mounts)), describe_rig(rig), is_main=True)
    if found.verdict and (closest := _closest(found.verdict)):
        one, place = closest
        detail = f"{truncate(one.name)}: {quantity(one.reached, one.unit)}, demanded {demanded(one)}"
        if place.distance_m is not None:
            detail += f"; {place.distance_m:.2f} m from the body"
        yield _place(place.x_m, place.y_m, detail)
    elif rigs and (nearest := _nearest(study, rigs[0])):
        missed, (x_m, y_m), from_body_m = nearest
        yield _place(
            x_m, y_m, f"the nearest to the body, {from_body_m:.2f} m, where a {truncate(missed.name)} is missed"
        )
    if found.misses and found.misses_without:
        name, share = max(found.misses_without.items(), key=lambda item: item[1])
        detail = f"misses without {truncate(name)}, which costs most; with it {percent(found.misses.mean)}"
        yield KeyFigure(Column("worst loss of a sensor"), percent(share), detail, is_main=True)


def _place(x_m: float, y_m: float, detail: str) -> KeyFigure:
    return KeyFigure(Column("worst place, x and y"), f"{x_m:.1f}, {y_m:.1f} m", detail, is_main=True)


def overview_parts(study: Study, rig: Rig, found: Evaluation, rigs: Sequence[SeenBy]) -> Iterator[Part]:
    """The rig and what it misses, with its drawing, and what the figures are not."""
    drawn = figure(draw_mounts(study, rig), MOUNTS_CAPTION)
    yield beside(_missed_table(study, rigs) if rigs else None, drawn)
    table = rig_table(study, rig, found)
    if (more := len(rig.mounts) - SENSORS_MAX) > 0:
        table = replace(table, rows=table.rows[:SENSORS_MAX], caption=f"{table.caption} {more:,} more are below.")
    yield table
    yield NOT_MEASURED


def _missed_table(study: Study, rigs: Sequence[SeenBy]) -> Table:
    """What this rig misses by object, beside the rig that it is compared with, and where."""
    own = rigs[0].misses
    other = compared_with([one for one in rigs if one.title != MIDPOINT])
    order = sorted(range(len(own.objects)), key=lambda n: -own.objects[n].share)[:OBJECTS_MAX]
    columns = [Column("misses"), Column("this rig", ".2%"), Column("nearest", ".1f", "m")]
    if other:
        columns.insert(2, Column(other.title, ".2%"))
    rows: list[Row] = []
    for n in sorted(order):
        one = own.objects[n]
        near = _nearest_of(study, one)
        beside_it = [_percent(other.misses.objects[n].share)] if other else []
        rows.append([named(one.name), Cell(one.share, cell(one.share, one.interval)), *beside_it, near and near[1]])
    totals = [Cell(own.mean, cell(own.mean, own.interval), mark="total")]
    if other:
        totals.append(Cell(other.misses.mean, percent(other.misses.mean), mark="total"))
    rows.append(["mean of all", *totals, Cell(None, "")])
    caption = (
        f"Share of places with fewer than {own.returns} returns (95 % interval); nearest: such a place, from the body"
    )
    return Table(caption, columns, rows)


def _percent(share: float) -> Cell:
    return Cell(share, percent(share))


def _nearest(study: Study, rig: SeenBy) -> tuple[ObjectMisses, Any, float] | None:
    """The object that is missed nearest to the body, the place, and its distance from the body."""
    found = [(one, near) for one in rig.misses.objects if (near := _nearest_of(study, one))]
    if not found:
        return None
    one, (at, from_body_m) = min(found, key=lambda item: item[1][1])
    return one, at, from_body_m


def _nearest_of(study: Study, one: ObjectMisses) -> tuple[Any, float] | None:
    """The nearest place where an object is missed, and its distance from the body; None if there is none."""
    missed = one.places[one.probability >= LIKELY]
    known = next((item for item in study.misses.objects if item.name == one.name), None) if study.misses else None
    if known is None or not len(missed):
        return None
    distance_m = known.stand.distance_m(missed)
    n = int(np.argmin(distance_m))
    return missed[n, :2], float(distance_m[n])


def _closest(found: Verdict) -> tuple[RequirementVerdict, WorstPlace] | None:
    """The requirement that has a worst place and the least margin, and that place."""
    placed = [(one, one.worst) for one in found.requirements if one.worst]
    return min(placed, key=lambda pair: pair[0].relative_margin, default=None)


def _breaking(found: Verdict | None) -> dict[str, list[str]]:
    """Which requirements that are met the loss of each sensor breaks."""
    broken: dict[str, list[str]] = {}
    for one in found.requirements if found else ():
        for name in one.breaking if one.passed else ():
            broken.setdefault(name, []).append(one.name)
    return broken


def _first(names: Sequence[str]) -> str:
    """The first name, and how many others there are."""
    return truncate(names[0]) + f" and {len(names) - 1} more" * (len(names) > 1)


def _prices(study: Study, rig: Rig) -> list[float]:
    """The price of each sensor, by the study; none if it does not say that of each."""
    prices: Mapping[str | None, float] = study.file.get("prices") or {}
    each = [prices[mount.model] for mount in rig.mounts if mount.model in prices]
    return each if len(each) == len(rig.mounts) else []
