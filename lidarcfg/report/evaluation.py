"""The tables of a study, a rig and its evaluation, as reports and the terminal show them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lidarcfg.report.describe import describe_object, describe_places, describe_returns
from lidarcfg.report.inputs import ReportInputs
from lidarcfg.report.table import COUNT, Cell, Column, Row, Table, named
from lidarcfg.report.text import summarize
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.detection import GapFit
from lidarcfg.study.evaluation import OFFSETS, STEP_DEG, STEP_M, DegradedRig, Evaluation, Robustness, Worst
from lidarcfg.study.file import COORDINATES
from lidarcfg.study.study import Study
from lidarcfg.study.zones import ZoneVsr
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.subspaces import BLIND

WHOLE = "none"
UNITS = f"{100 * STEP_M:g} cm", f"{STEP_DEG:g}°"
FAR = f"{100 * STEP_M * OFFSETS[-1]:g} cm", f"{STEP_DEG * OFFSETS[-1]:g}°"


def bounds_table(study: Study) -> Table:
    """The range of each coordinate of each sensor."""
    rows: list[Row] = []
    space = study.space
    for slot, low, high, mirror in zip(study.slots, space.lower, space.upper, space.mirror, strict=True):
        if not math.isnan(mirror):
            rows.append([named(slot.name), slot.sensor.name, f"image in y = {mirror:g} m", *[None] * 5])
            continue
        angles = np.degrees([low[3:], high[3:]])
        pairs = [*zip(low[:3], high[:3], strict=True), *zip(*angles, strict=True)]
        cells: list[Any] = [Cell((a, b), f"{a:.5g}" if a == b else f"{a:.5g} … {b:.5g}") for a, b in pairs]
        if slot.surface:
            cells[slot.surface.axis] = f"on {named(slot.surface.body.name).text}, from {slot.surface.side}"
            cells[3:5] = cells[3:5] if slot.surface.upright else ["normal"] * 2
        rows.append([named(slot.name), slot.sensor.name, *cells])
    coordinates = [Column(name, ".5g", "m" if axis < 3 else "°") for axis, name in enumerate(COORDINATES)]
    columns = [Column("sensor"), Column("model"), *coordinates]
    return Table("Bounds of each sensor; a single number is fixed", columns, rows)


def mounts_table(rig: Rig) -> Table:
    """The poses, and each axis's angle from the vertical."""
    rows = []
    for i, (mount, lidar) in enumerate(zip(rig.mounts, rig_lidars(rig), strict=True), 1):
        tilt_rad = math.acos(min(max(float(lidar.axis[2]), -1.0), 1.0))
        low, high = mount.sensor.elevation_span_deg
        rows.append(
            [
                Cell(mount.name, f"{i} {named(mount.name).text}"),
                mount.sensor.name,
                mount.sensor.count,
                Cell((low, high), f"{low:g} … {high:g}"),
                *mount.position_m,
                *np.degrees(mount.rpy_rad).tolist(),
                math.degrees(tilt_rad),
            ]
        )
    columns = [
        Column("sensor"),
        Column("model"),
        Column("beams", COUNT),
        Column("elevation", "g", "°"),
        *(Column(name, ".3f", "m") for name in COORDINATES[:3]),
        *(Column(name, ".2f", "°") for name in COORDINATES[3:]),
        Column("tilt", ".2f", "°"),
    ]
    caption = "Poses in the vehicle frame: x forward, y left, z up. The tilt is the axis's angle from the vertical."
    return Table(caption, columns, rows)


def worst_table(found: Evaluation) -> Table:
    """The worst subspaces, and the beams that each lies between."""
    columns = [
        Column("", COUNT),
        Column("VSR", ".4f", "m"),
        Column("volume", ".2f", "m³"),
        Column("surface", ".2f", "m²"),
        Column("inner radius", ".3f", "m"),
        Column("centroid", ".2f", "m"),
        Column("between the beams, by sensor"),
    ]
    rows = [
        [
            rank,
            worst.vsr_m,
            worst.volume_m3,
            worst.surface_m2,
            worst.inscribed_radius_m,
            worst.centroid_m,
            Cell(worst.between_deg, "; ".join(summarize(_gaps(worst)))),
        ]
        for rank, worst in enumerate(found.worst, 1)
    ]
    return Table("The worst subspaces; the inner radius is that of the largest sphere inside", columns, rows)


def _gaps(worst: Worst) -> list[str]:
    """Between which beams of each sensor a subspace lies."""
    pairs = zip(worst.gap, worst.between_deg, strict=True)
    return [f"{n}: {_between(gap, *pair)}" for n, (gap, pair) in enumerate(pairs, 1)]


def _between(gap: int, low: float | None, high: float | None) -> str:
    if gap == BLIND:
        return "blind"
    if low is None:
        return "no cones" if high is None else f"below {high:g}°"
    return f"above {low:g}°" if high is None else f"{low:g}…{high:g}°"


def hiding_table(fits: Mapping[str, GapFit], origin: str) -> Table:
    """Which objects fit into a subspace; `origin` of distances."""
    columns = [
        Column("object"),
        Column("fits into the worst gap"),
        Column("gaps it fits into", COUNT),
        Column("largest of these, VSR", ".4f", "m"),
        Column("nearest", ".2f", "m"),
        Column("at x, y", ".1f", "m"),
    ]
    rows = [
        [
            named(name),
            "yes" if found.in_worst else "no",
            found.subspaces,
            *([found.largest_vsr_m, found.nearest_m, found.nearest_at_m] if found.nearest_at_m else [None] * 3),
        ]
        for name, found in fits.items()
    ]
    what = "Objects that fit wholly into a gap, that is a subspace, with their edges parallel to the axes"
    return Table(f"{what}; the nearest place is the nearest to {origin}", columns, rows)


def coverage_table(details: ReportInputs) -> Table:
    """Beams across upright poles."""
    known = details.coverage
    values = [
        ("beams across an upright pole, median", known.median_beams, "g"),
        ("positions of poles with no beam", known.by_none, ".2%"),
        ("positions with one sensor's beams", known.by_one_sensor, ".2%"),
    ]
    rows = [[name, Cell(value, form=form)] for name, value, form in values]
    return Table("Beams across upright poles", [Column(""), Column("value", ".4f")], rows)


def detection_table(study: Study, found: Evaluation) -> Table | None:
    """The rate of each object, and the places that it was counted at; None without objects."""
    columns = [Column("object"), Column("rate", ".4f"), Column("places"), Column("what it is")]
    rows = [
        [
            named(item.name),
            rate.rate,
            describe_places(study, item, rate),
            describe_object(item) + (f"; {describe_returns(rate.returns)}" if rate.returns else ""),
        ]
        for item, rate in ((item, found.detection[item.name]) for item in study.detection)
    ]
    paper = found.misses and not any(item.returns for item in study.detection)
    whose = "The paper's detection rate" if paper else "Detection rate"
    caption = f"{whose} of each object at the places that were tried; ± is of the 95 % interval over all places"
    return Table(caption, columns, rows) if rows else None


def zones_table(zones: Sequence[ZoneVsr]) -> Table:
    """Max VSR of each zone."""
    columns = [
        Column("zone"),
        Column("weight", "g"),
        Column("max VSR", ".6f", "m"),
        Column("weighted", ".6f", "m"),
    ]
    rows = [[named(one.name), one.weight, one.max_vsr_m, one.weight * one.max_vsr_m] for one in zones]
    return Table("Max VSR by zone", columns, rows)


def lost_table(found: Robustness, study: Study) -> Table:
    """Max VSR with each LiDAR lost, in all and by zone, and the study's objective if it is another."""
    with_objective = bool(study.zones) or not study.objective.is_max_vsr

    def row(left: DegradedRig) -> Row:
        more = left.max_vsr_m / found.whole.max_vsr_m - 1
        values = [left.max_vsr_m, more if left.lost is not None else Cell(None, "")]
        return [
            named(left.lost or WHOLE),
            *values,
            *(zone.max_vsr_m for zone in left.zones),
            *([left.objective] if with_objective else []),
        ]

    columns = [
        Column("LiDAR that fails"),
        Column("max VSR", ".6f", "m"),
        Column("change", "+.1%"),
        *(Column(f"in {named(zone.name).text}", ".6f", "m") for zone in found.whole.zones),
        *([Column("objective", ".6f")] if with_objective else []),
    ]
    return Table("What is left if one LiDAR fails", columns, [row(left) for left in (found.whole, *found.without)])


def sensitivity_table(rig: Rig, found: Robustness) -> Table:
    """How max VSR changes with each coordinate of each mount."""
    rows = []
    for mount, slopes, largest in zip(rig.mounts, 1e3 * found.slope_m, 1e3 * found.increase_m, strict=True):
        pairs = zip(slopes.tolist(), largest.tolist(), strict=True)
        cells = [Cell(slope, f"{slope:+.2f} ({most:.1f})" if slope or most else "0") for slope, most in pairs]
        rows.append([named(mount.name), *cells])
    coordinates = [Column(name, "+.2f", f"per {UNITS[axis > 2]}") for axis, name in enumerate(COORDINATES)]
    caption = (
        f"How max VSR changes when one coordinate of one mount is off: mm per {UNITS[0]} or {UNITS[1]}, fitted up to "
        f"{FAR[0]} or {FAR[1]}. In brackets: the largest increase within that range (mm)."
    )
    return Table(caption, [Column("mount"), *coordinates], rows)
