"""The report of a rig, as one HTML file: what was asked, what was found, how far to trust it, how to repeat it."""

import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from typing import Any

import numpy as np
import yaml

from lidarcfg import __version__
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.cones import rig_lidars
from lidarcfg.placement.coverage import coverage
from lidarcfg.placement.detection import DetectionObject, Rings, detection_by_distance
from lidarcfg.placement.evaluator import max_vsr
from lidarcfg.placement.optimize import Placement
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import COORDINATES, Evaluation, Study
from lidarcfg.report import drawings
from lidarcfg.report.markup import (
    Html,
    Section,
    code,
    facts,
    figure,
    folded,
    joined,
    page,
    paragraph,
    summary,
    table,
)
from lidarcfg.rig import Rig, rig_to_dict

CHEAP_CUBOIDS = 100_000  # up to so many a further evaluation takes a fraction of a second
PACKAGES = ("numpy", "scipy", "numba", "open3d", "matplotlib")
RINGS_MAX = 12
RING_M = (1, 2, 5)  # times a power of ten


@dataclass(frozen=True)
class Commands:
    """What was typed, and what gives the same on any machine."""

    typed: str
    again: str


def report(
    study: Study,
    rig: Rig,
    found: Evaluation,
    values: dict[str, Any],
    placement: Placement | None = None,
    commands: Commands | None = None,
) -> str:
    """The page of a rig; `values` is its result.json, and `placement` the search that found it, if one did.

    Raises ConfigError where SOURCE_DATE_EPOCH is no time.
    """
    what = "placed by lidarcfg" if placement else "judged by lidarcfg"
    about = f"{rig_in_words(rig)}, {what} {__version__} on {date()}"
    sections = [
        Section("asked", "What was asked", _asked(study, placement)),
        Section("rig", "The rig", _rig(study, rig)),
        Section("search", "The search", _search(study, placement)),
        Section("worst", "The worst subspaces", _worst(rig, found)),
        Section("sizes", "How large the subspaces are", _sizes(found)),
        Section("detection", "What is detected", _detection(study, rig, found)),
        Section("coverage", "Coverage", _coverage(found, rig)),
        Section("trust", "Error bars, and how far to trust this", _trust(study, found, placement)),
        Section("skipped", "What was skipped", _skipped(values, placement)),
        Section("repeat", "How to repeat it", _repeat(study, rig, values, commands)),
    ]
    return page(f"Report: {rig.name}", about, _summary(study, found, placement), sections)


def date() -> str:
    """Now, or what SOURCE_DATE_EPOCH says, in UTC."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    if not seconds:
        return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    try:
        return f"{datetime.fromtimestamp(int(seconds), UTC):%Y-%m-%d %H:%M} UTC"
    except (ValueError, OverflowError, OSError):
        raise ConfigError(f"SOURCE_DATE_EPOCH: {seconds[:40]!r} is not a number of seconds since 1970") from None


def versions() -> str:
    """Of all that a result may depend on."""
    found = [f"lidarcfg {__version__}", f"Python {platform.python_version()}"]
    for name in PACKAGES:
        for distribution in (name, f"{name}-cpu"):
            try:
                found.append(f"{distribution} {metadata.version(distribution)}")
            except metadata.PackageNotFoundError:
                continue
            break
    return ", ".join(found) + f"; {platform.system()} {platform.machine()}"


def rig_in_words(rig: Rig) -> str:
    """How many sensors of which models, and their beams."""
    models = [mount.sensor.name for mount in rig.mounts]
    kinds = ", ".join(f"{models.count(name)} × {name}" for name in dict.fromkeys(models))
    return f"{counted(len(models), 'sensor')} ({kinds}), {counted(beams(rig), 'beam')}"


def beams(rig: Rig) -> int:
    """Of all sensors."""
    return sum(mount.sensor.count for mount in rig.mounts)


def counted(number: int, what: str) -> str:
    """A number of things, in words."""
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"


def as_yaml(values: dict[str, Any]) -> str:
    """As it would stand in a file."""
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110).rstrip()


def vector(values: Sequence[float] | Array, form: str = "g") -> str:
    """Three numbers."""
    return ", ".join(f"{value:{form}}" for value in values)


def vehicle_m(study: Study) -> Array:
    """(2,) where the vehicle stands: the mean of the sensors' places in the middle of their bounds."""
    middle = study.poses(np.full((1, int(study.free.sum())), 0.5))[0]
    where: Array = middle[:, :2].mean(axis=0)
    return where


def ring_edges_m(region: Region, middle_m: Array) -> Array:
    """Rings about a point that hold the whole region: at most RINGS_MAX, their width 1, 2 or 5 × a power of ten."""
    corners = [(x, y) for x in (region.min_m[0], region.max_m[0]) for y in (region.min_m[1], region.max_m[1])]
    far = max(float(np.hypot(*(corner - middle_m))) for corner in np.array(corners))
    power = 10.0 ** math.floor(math.log10(far / RINGS_MAX))
    width = next(step * power for step in (*RING_M, 10) if RINGS_MAX * step * power > far)
    return np.arange(math.floor(far / width) + 2) * np.float64(width)


def rings_by_object(study: Study, found: Evaluation) -> dict[str, Rings]:
    """The study's objects, by their distance from the vehicle."""
    middle = vehicle_m(study)
    edges = ring_edges_m(study.region, middle)
    return {item.name: detection_by_distance(found.subspaces, item, middle, edges) for item in study.detection}


def object_in_words(item: DetectionObject) -> str:
    """Its size, and when it counts as detected."""
    where = "on the ground" if item.on_ground else "at all heights"
    how = f"at {counted(item.samples, 'place')} and headings drawn" if item.samples else "at every place on the grid"
    size = " × ".join(f"{edge:g}" for edge in item.size_m)
    return f"{size} m, {where}, {how}; detected if in more than {counted(item.threshold, 'subspace')}"


def error_bar(found: Evaluation) -> tuple[str, str]:
    """The analytic max VSR with its bar, and a word on it."""
    if found.analytic is None:
        return "not computed", "evaluate --tolerance gives it"
    share = found.analytic.error_m / found.analytic.max_vsr_m
    return f"{found.analytic.max_vsr_m:.4f} ± {found.analytic.error_m:.4f} m", f"± {share:.1%}, of the cones themselves"


def _middle_m(study: Study, placement: Placement | None) -> float | None:
    """Max VSR of the study's sensors in the middle of their bounds, where that is known or soon found out."""
    if placement:
        return placement.middle_max_vsr_m
    if study.region.included.size > CHEAP_CUBOIDS:
        return None
    return max_vsr(study.region, study.lidars(study.poses(np.full((1, int(study.free.sum())), 0.5))[0]))


def _summary(study: Study, found: Evaluation, placement: Placement | None) -> Html:
    worst, at = found.worst[0], f"at {vector(found.worst[0].centroid_m, '.1f')} m"
    largest = f"the largest of {counted(len(found.subspaces), 'subspace')}"
    items: list[tuple[object, object, object]] = [("Max VSR, the paper's measure", f"{found.max_vsr_m:.6f} m", largest)]
    middle = _middle_m(study, placement)
    if middle is not None:
        share = found.max_vsr_m / middle - 1
        than = f"this rig's is {abs(share):.0%} {'larger' if share > 0 else 'smaller'}"
        items.append(("… with the study's sensors mid-bounds", f"{middle:.6f} m", than))
    items.append(("Analytic max VSR", *error_bar(found)))
    items.append(("Largest sphere in the worst subspace", f"{2 * worst.inscribed_radius_m:.2f} m across", at))
    for name, rate in found.detection.items():
        how = f"± {rate.half_width:.2%}, of {rate.places:,} places drawn" if rate.half_width else "of all places"
        items.append((f"Detection of {name}", f"{rate.rate:.2%}", how))
    below = [paragraph("The search was interrupted: this is the best rig found until then.")]
    return summary(items, *(below if placement and placement.interrupted else ()))


def _asked(study: Study, placement: Placement | None) -> Html:
    region = study.region
    left_out = region.included.size - int(region.included.sum())
    rows: list[tuple[object, object]] = [
        ("study", study.name),
        ("region", f"from {vector(region.min_m)} to {vector(region.max_m)} m"),
        ("cuboids", f"{' × '.join(map(str, region.shape))} of {' × '.join(f'{e:g}' for e in region.cuboid_m)} m"),
        ("left out", f"{left_out:,} of {region.included.size:,} cuboids"),
    ]
    if placement:
        rows += [("minimised", _objective(study)), ("kept", _constraints(study)), ("solver", _solver(study))]
    rows += [(f"object: {item.name}", object_in_words(item)) for item in study.detection]
    parts = [facts(rows)]
    if placement:
        parts.append(_bounds(study))
    if study.file:
        parts.append(folded("The study in full, with its defaults filled in", code(as_yaml(study.file))))
    return joined(*parts)


def _objective(study: Study) -> str:
    wanted = study.objective
    if wanted.is_max_vsr:
        return "max VSR, the largest volume-to-surface ratio of all subspaces"
    terms = [] if wanted.max_vsr is None else [f"{wanted.max_vsr:g} × max VSR in metres"]
    if wanted.inscribed_radius is not None:
        terms.append(f"{wanted.inscribed_radius:g} × the radius of the largest sphere in a subspace, in metres")
    terms += [f"{weight:g} × (1 − detection rate of {name})" for name, weight in wanted.detection.items()]
    return "the weighted mean of " + ", ".join(terms)


def _constraints(study: Study) -> str:
    kept = study.constraints
    terms = [] if kept.max_tilt_deg == 180 else [f"every sensor's tilt at most {kept.max_tilt_deg:g}°"]
    terms += [] if not kept.min_distance_m else [f"sensors at least {kept.min_distance_m:g} m apart"]
    return "the bounds below" + "".join(f"; {term}" for term in terms)


def _solver(study: Study) -> str:
    solver = study.solver
    budgets = [("cycles", solver.cycles), ("evaluations", solver.evaluations), ("seconds", solver.seconds)]
    budget = " or ".join(f"{value:,} {name}" for name, value in budgets if value is not None)
    bees = f", {solver.bees} bees" if solver.method == "abc" else ""
    return f"{solver.method}{bees}, seed {solver.seed}, for {budget}"


def _bounds(study: Study) -> Html:
    """What each coordinate of each sensor may be."""
    rows = []
    for slot, low, high, mirror in zip(study.slots, study.lower, study.upper, study.mirror, strict=True):
        if not math.isnan(mirror):
            rows.append([slot.name, slot.sensor.name, *[f"image in y = {mirror:g} m"], *["–"] * 5])
            continue
        angles = np.degrees([low[3:], high[3:]])
        pairs = [*zip(low[:3], high[:3], strict=True), *zip(*angles, strict=True)]
        rows.append([slot.name, slot.sensor.name, *(f"{a:.5g}" if a == b else f"{a:.5g} … {b:.5g}" for a, b in pairs)])
    head = ("sensor", "model", *(f"{c} ({'m' if i < 3 else '°'})" for i, c in enumerate(COORDINATES)))
    return table("Where each sensor may sit; a single number is fixed", head, rows, texts=(1,))


def mounts_table(rig: Rig) -> Html:
    """The poses, and how far each axis is from the vertical."""
    rows = []
    for i, (mount, lidar) in enumerate(zip(rig.mounts, rig_lidars(rig), strict=True)):
        tilt = math.degrees(math.acos(min(max(float(lidar.axis[2]), -1.0), 1.0)))
        angles = np.degrees(mount.rpy_rad)
        low, high = min(mount.sensor.beams.elevation_deg), max(mount.sensor.beams.elevation_deg)
        rows.append(
            [
                f"{i + 1} {mount.name}",
                mount.sensor.name,
                f"{mount.sensor.count}",
                f"{low:g} … {high:g}",
                *(f"{v:.3f}" for v in mount.position_m),
                *(f"{v:.2f}" for v in angles),
                f"{tilt:.2f}",
            ]
        )
    head = ("sensor", "model", "beams", "elevation (°)", "x (m)", "y (m)", "z (m)", "roll (°)", "pitch (°)", "yaw (°)")
    return table(
        "Sensors in the vehicle's frame: x forward, y left, z up. Tilt is the axis's angle from the vertical.",
        (*head, "tilt (°)"),
        rows,
        texts=(1,),
    )


def _rig(study: Study, rig: Rig) -> Html:
    caption = (
        "The sensors by their number, arrows along their axes (which way is up for the sensor). Dashed: what the "
        "study's bounds allow. Grey: what the region leaves out."
    )
    return joined(mounts_table(rig), figure(drawings.draw_mounts(study, rig), caption))


def _search(study: Study, placement: Placement | None) -> Html:
    if placement is None:
        return paragraph("No search was run: the rig was given, and judged as it is.")
    last = placement.history[-1]
    rows = [
        ("evaluations", f"{placement.evaluations:,}"),
        ("first rigs and scouts, besides", f"{placement.first_evaluations:,} and {placement.scout_evaluations:,}"),
        ("cycles", f"{last.cycle:,}"),
        ("seconds", f"{placement.seconds:.1f}"),
        ("objective of the best", f"{placement.objective:.6f}"),
        ("ended by", "an interrupt" if placement.interrupted else "its budget"),
    ]
    caption = (
        "The best rig so far, and the mean of those that the solver works with. Where the best still falls at the end, "
        "a longer search finds a better rig; --resume goes on with this one. What is far above the best is cut off."
    )
    return joined(facts(rows), figure(drawings.draw_history(study, placement), caption))


def _worst(rig: Rig, found: Evaluation) -> Html:
    rows = []
    for i, worst in enumerate(found.worst, 1):
        between = "; ".join(f"{n}: {_between(low, high)}" for n, (low, high) in enumerate(worst.between_deg, 1))
        rows.append(
            [
                f"{i}",
                f"{worst.vsr_m:.4f}",
                f"{worst.volume_m3:.2f}",
                f"{worst.surface_m2:.2f}",
                f"{worst.inscribed_radius_m:.3f}",
                vector(worst.centroid_m, ".1f"),
                between,
            ]
        )
    head = (
        "",
        "VSR (m)",
        "volume (m³)",
        "surface (m²)",
        "inner radius (m)",
        "centroid (m)",
        "between the beams, by sensor",
    )
    parts = [
        paragraph("A subspace is a part of the region that no beam enters: what lies in one alone goes unseen."),
        table("The worst subspaces; the inner radius is that of the largest sphere inside", head, rows, texts=(6,)),
        figure(
            drawings.draw_worst(rig, found),
            "The worst subspaces in place, by their number in the table; the worst of all is filled. Dots are the "
            "sensors, grey is left out. A number stands at the centroid, which may lie outside its subspace.",
        ),
    ]
    if all(None in pair for pair in found.worst[0].between_deg):
        parts.insert(
            1,
            paragraph(
                "The worst one lies above the top beam, or below the lowest, of every sensor: further beams in between "
                "cannot make it smaller, only tilt, place or a wider fan can."
            ),
        )
    return joined(*parts)


def _between(low: float | None, high: float | None) -> str:
    if low is None:
        return f"below {high:g}°"
    return f"above {low:g}°" if high is None else f"{low:g}…{high:g}°"


def _sizes(found: Evaluation) -> Html:
    caption = (
        "Above, how many subspaces have which VSR; below, what share of the region's volume they hold. Ticks at the "
        "foot mark the worst ones."
    )
    quantiles = np.quantile(found.vsr_m, (0.5, 0.9, 0.99))
    words = f"Half of the subspaces are below {quantiles[0]:.4f} m, 90 % below {quantiles[1]:.4f} m, 99 % below "
    return joined(
        paragraph(f"{words}{quantiles[2]:.4f} m; the largest is {found.max_vsr_m:.4f} m."),
        figure(drawings.draw_distribution([("", found)]), caption),
    )


def _detection(study: Study, rig: Rig, found: Evaluation) -> Html:
    if not study.detection:
        return paragraph("The study names no objects, so nothing is said of what is detected.")
    rings = rings_by_object(study, found)
    rows = [
        [
            item.name,
            f"{found.detection[item.name].rate:.4f}",
            f"± {found.detection[item.name].half_width:.4f}" if found.detection[item.name].half_width else "exact",
            f"{found.detection[item.name].places:,}",
            object_in_words(item),
        ]
        for item in study.detection
    ]
    x, y = vehicle_m(study)
    parts = [
        table("Detection rate of each object", ("object", "rate", "95 %", "places", "what it is"), rows, texts=(4,)),
        figure(
            drawings.draw_rings([("", list(rings.items()))]),
            f"Detection rate by the horizontal distance of the object's middle from the vehicle, at x = {x:.2f} m, "
            f"y = {y:.2f} m: the middle of the sensors' bounds.",
        ),
        folded("The same in numbers", rings_table(rings)),
    ]
    objects = [item for item in study.detection if not item.samples]
    if objects:
        parts.append(
            figure(
                drawings.draw_blind_spots(found.subspaces, rig, objects),
                "Where each object is detected, by the place of its middle; over all heights, if it is not on the "
                "ground. Grey: it has no place there.",
            )
        )
    return joined(*parts)


def rings_table(rings: dict[str, Rings]) -> Html:
    """Rates and places, ring by ring."""
    edges = next(iter(rings.values())).edges_m
    rows = [
        [
            f"{edges[i]:g} … {edges[i + 1]:g}",
            *(f"{r.rate[i]:.4f} of {r.places[i]:,}" if r.places[i] else "–" for r in rings.values()),
        ]
        for i in range(len(edges) - 1)
    ]
    return table("Detection rate, and of how many places, by distance", ("distance (m)", *rings), rows)


def _coverage(found: Evaluation, rig: Rig) -> Html:
    known = coverage(found.subspaces)
    one = f", {known.by_one_sensor:.1%} by one sensor's alone" if len(rig.mounts) > 1 else ""
    return joined(
        paragraph(
            "How many beams would hit a thin pole in a line of cuboids, from end to end of the region? Seen from above "
            "the pole stands; seen from the side or the front it lies across the region. A beam counts once, if the "
            "cuboids' centres along the pole lie on both sides of its cone. Range, occlusion and the vehicle's body "
            "are ignored."
        ),
        paragraph(
            f"A standing pole is crossed by {known.median_beams:g} beams in the median; {known.by_none:.1%} of its "
            f"places are crossed by none{one}."
        ),
        figure(
            drawings.draw_coverage(found.subspaces, rig),
            "Beams by place from top, side and front, and from above the number of sensors whose beams they are. "
            "Grey: left out. Heights are stretched.",
        ),
    )


def _trust(study: Study, found: Evaluation, placement: Placement | None) -> Html:
    parts = []
    if found.analytic:
        bar = found.analytic
        less = 1 - found.max_vsr_m / bar.max_vsr_m
        edges = " × ".join(f"{edge:g}" for edge in bar.cuboid_m)
        reached = f"within the tolerance of {bar.tolerance:.3g}" if bar.reached else "not the tolerance asked for"
        if bar.tolerance >= 1:
            reached = "at the first halving of the cuboids; evaluate --tolerance makes it smaller"
        rows = [
            ("max VSR by the cuboids' faces, as in the paper", f"{found.max_vsr_m:.6f} m"),
            ("analytic max VSR, of the cones themselves", f"{bar.max_vsr_m:.6f} ± {bar.error_m:.6f} m"),
            ("the error bar", f"{bar.error_m / bar.max_vsr_m:.2%}, {reached}"),
            ("finest cuboids", f"{bar.cuboids:,} of {edges} m"),
        ]
        parts += [
            facts(rows),
            paragraph(
                "The faces of cuboids make slanted surfaces larger than they are, and know where a cone is to half a "
                f"cuboid: here the paper's measure is {abs(less):.1%} {'lower' if less >= 0 else 'higher'} than the "
                "analytic one. Compare it only with its like on the same grid. The bar holds in 95 of 100 cases."
            ),
        ]
    else:
        parts.append(
            paragraph(
                "The analytic max VSR and its error bar were not computed, for the region has many cuboids. "
                "evaluate --tolerance 0.01 -o computes them."
            )
        )
    exact = [item.name for item in study.detection if not item.samples]
    if exact:
        parts.append(paragraph("Detection rates without an interval are exact on the grid: every place was counted."))
    if len(exact) < len(study.detection):
        parts.append(
            paragraph("Detection rates with ± are of places drawn quasi-randomly; 95 of 100 intervals hold the truth.")
        )
    if placement:
        parts.append(
            paragraph(
                "A search proves no optimum: another seed may find a rig a few per cent better or worse. "
                "Compare several with lidarcfg compare."
            )
        )
    parts.append(
        paragraph(
            "Every beam is a full cone of any range: occlusion, the vehicle's body and the sensor's range are not in "
            "this, unless the study leaves them out of the region. A lower max VSR does not always mean a higher "
            "detection rate of small objects; look at both."
        )
    )
    return joined(*parts)


def _skipped(values: dict[str, Any], placement: Placement | None) -> Html:
    if placement is None:
        return paragraph("Nothing: the rig was evaluated once, in full.")
    trials = placement.evaluations + placement.first_evaluations + placement.scout_evaluations
    full, cuboids = values["skipped"]["full_evaluations"], values["skipped"]["cuboids"]
    every = max(full + placement.full_evaluations, 1)
    all_cuboids = max(cuboids + placement.cuboids, 1)
    rows = [
        ("trials settled without a full evaluation", f"{full:,} of {trials:,} ({full / every:.1%})"),
        ("cuboids not looked at", f"{cuboids:,} of {all_cuboids:,} ({cuboids / all_cuboids:.1%})"),
    ]
    return joined(
        facts(rows),
        paragraph(
            "Work that cannot change the answer is left undone: a trial is settled as soon as one of its subspaces is "
            "no better than what it has to beat. The same search without skipping gives the same rig, bit for bit."
        ),
    )


def _repeat(study: Study, rig: Rig, values: dict[str, Any], commands: Commands | None) -> Html:
    parts = []
    if commands:
        parts += [paragraph("This was typed:"), code(commands.typed)]
        if commands.again != commands.typed:
            parts += [
                paragraph("This gives the same rig on any machine and any number of threads:"),
                code(commands.again),
            ]
    else:
        parts.append(paragraph("This was written from Python; the study above and the rig below are all it was given."))
    rows = [
        ("seed", "none is needed" if values["seed"] is None else values["seed"]),
        ("versions", versions()),
        ("seconds", f"{values['seconds']:.2f}"),
        ("date", date()),
    ]
    return joined(*parts, facts(rows), folded("The rig as a file", code(as_yaml(rig_to_dict(rig)))))
