"""The report of a rig as one HTML file: the task, the result, its accuracy, and how to repeat it."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lidarcfg import __version__
from lidarcfg.config.document import yaml_text
from lidarcfg.report import drawings
from lidarcfg.report.blind_spots import (
    draw_posts_by_height,
    draw_unseen,
    post_figure,
    posts_table,
    volumes_table,
)
from lidarcfg.report.describe import (
    beams_alone,
    counted,
    date,
    describe_constraints,
    describe_hiding,
    describe_limits,
    describe_object,
    describe_objective,
    describe_origin,
    describe_places,
    describe_rig,
    describe_skips,
    describe_solver,
    has_cones,
    region_rows,
    vector,
    versions,
)
from lidarcfg.report.evaluation import (
    bounds_table,
    detection_table,
    hiding_table,
    lost_table,
    mounts_table,
    rings_table,
    sensitivity_table,
    shape_table,
    worst_table,
    zones_table,
)
from lidarcfg.report.html import KeyFigure, render, with_baseline_figures
from lidarcfg.report.inputs import ReportInputs
from lidarcfg.report.misses import (
    SeenBy,
    compared_with,
    describe_interval,
    draw_misses,
    misses_lines,
    misses_table,
    percent,
    rigs_seen,
    worst_object,
)
from lidarcfg.report.mounts import draw_mounts, draw_surfaces
from lidarcfg.report.table import Table, with_baseline
from lidarcfg.report.text import truncate
from lidarcfg.report.verification import verdict_part
from lidarcfg.search.run import Believed, Placement, at_bounds
from lidarcfg.sensors.rig import Rig, rig_to_dict
from lidarcfg.study.evaluation import Evaluation, Worst
from lidarcfg.study.extrapolation import Extrapolated
from lidarcfg.study.objective_costs import rigs_of_trial, segments_of_trial
from lidarcfg.study.study import Study
from lidarcfg.vsr.subspaces import BLIND

FactRows = list[tuple[str, object]]


@dataclass(frozen=True)
class Commands:
    """The command as typed, and one that gives the same result on any machine."""

    typed: str
    again: str


@dataclass(frozen=True)
class ChoicePart:
    """The part on the combinations that were searched for the cheapest rig."""

    answer: str
    searched: str
    table: Table
    again: str | None  # the command that goes on, if none meets all


@dataclass(frozen=True)
class Baseline:
    """A rig to compare a result with, and its evaluation in the same study."""

    rig: Rig
    file: str
    details: ReportInputs


def report(
    study: Study,
    rig: Rig,
    details: ReportInputs,
    values: dict[str, Any],
    placement: Placement | None,
    commands: Commands | None,
    baseline: Baseline | None,
    choice: ChoicePart | None = None,
) -> str:
    """The report of a rig; `values` is its result.json, and `placement` the search that found it, if any.

    `choice` says which combinations of sensors were searched. Every table also shows the baseline, if there is one.
    Raises ConfigError if SOURCE_DATE_EPOCH is not a time.
    """
    found = details.evaluation
    own = _tables(study, rig, details)
    other = _tables(study, baseline.rig, baseline.details) if baseline else {}
    tables = {name: with_baseline(table, other.get(name)) for name, table in own.items()}
    summary = _summary(study, rig, details, placement)
    seen = rigs_seen(study, rig, found, placement, (baseline.rig, baseline.details.evaluation) if baseline else None)
    what = "optimised" if placement else "evaluated"
    return render(
        "report.html",
        title=f"Report: {rig.name}",
        choice=choice,
        about=f"{describe_rig(rig)}; {what} by lidarcfg {__version__} on {date()}",
        found=verdict_part(details.verification, rig, baseline.details.evaluation.verdict if baseline else None)
        if details.verification
        else None,
        summary=with_baseline_figures(summary, _of_baseline(study, baseline)) if baseline else summary,
        at_bounds=_at_bounds(study, rig),
        seen=_seen(study, seen, placement) if seen else None,
        believed=placement.believed if placement else None,
        baseline=baseline,
        baseline_yaml=yaml_text(rig_to_dict(baseline.rig)) if baseline else None,
        placement=placement,
        commands=commands,
        task=_task(study, placement),
        bounds=bounds_table(study),
        study_yaml=yaml_text(study.file) if study.file else None,
        rig_yaml=yaml_text(rig_to_dict(rig)),
        search=_search(placement),
        worst_is_outside=_is_outside(found.worst[0]),
        worst_is_blind=all(gap == BLIND for gap in found.worst[0].gap),
        quantiles=[f"{value:.4f}" for value in np.quantile(found.vsr_m, (0.5, 0.9, 0.99, 1.0))],
        limits=describe_limits(study),
        coverage=_coverage(details, rig),
        hides=describe_hiding(details.gap_fits, describe_origin(study)),
        origin=describe_origin(study),
        has_body=study.vehicle is not None,
        extrapolated=_extrapolated(found, found.extrapolated, baseline) if found.extrapolated else None,
        by_returns=any(item.returns for item in study.detection),
        exact_rates=any(not item.samples for item in study.detection),
        drawn_rates=any(item.samples for item in study.detection),
        skipped=_skipped(study, values, placement),
        skips=describe_skips(study),
        repeat=_repeat(values),
        drawn_objects=len(study.detection) > drawings.OBJECTS_MAX and drawings.OBJECTS_MAX,
        drawings=_drawings(study, rig, details, placement, baseline),
        **tables,
    )


def _seen(study: Study, rigs: tuple[SeenBy, ...], placement: Placement | None) -> dict[str, Any]:
    """What the first rig misses, beside the others."""
    other = compared_with(rigs)
    worst = worst_object(rigs[0].misses)
    return {
        "lines": misses_lines(study, rigs, placement),
        "table": misses_table(rigs),
        "map": draw_misses(study.body, [rigs[0], other] if other else [rigs[0]]),
        "worst": truncate(worst.name),
        "is_weighted": len(set(rigs[0].misses.weights.tolist())) > 1,
    }


def _at_bounds(study: Study, rig: Rig) -> tuple[str, ...]:
    """The coordinates that are at a bound; none of a rig whose sensors are not the study's."""
    if len(rig.mounts) != len(study.slots):
        return ()
    return at_bounds(study, np.array([(*mount.position_m, *mount.rpy_rad) for mount in rig.mounts]))


def _tables(study: Study, rig: Rig, details: ReportInputs) -> dict[str, Table | None]:
    """The tables of a rig by their names in the template."""
    found = details.evaluation
    robust = details.evaluation.robustness
    return {
        "mounts": mounts_table(rig),
        "worst": worst_table(found),
        "hiding": hiding_table(details) if details.gap_fits else None,
        "detection": detection_table(study, found),
        "rings": rings_table(details.rings),
        "zones": zones_table(found.zones) if found.zones else None,
        "lost": lost_table(robust, study) if robust and robust.without else None,
        "sensitivity": sensitivity_table(rig, robust) if robust else None,
        "posts": posts_table(found.posts) if found.posts else None,
        "volumes": volumes_table(found.seen_by_m3),
        "shape": shape_table(details),
    }


def _drawings(
    study: Study, rig: Rig, details: ReportInputs, placement: Placement | None, baseline: Baseline | None
) -> dict[str, Any]:
    found = details.evaluation
    region = study.region
    both = [("this rig", details), ("baseline", baseline.details)] if baseline else [("", details)]
    robust = [(name, one.evaluation.robustness) for name, one in both if one.evaluation.robustness]
    shown = drawings.least_detected([one.evaluation for _, one in both])
    rings: list[tuple[str, Any]] = [("", {name: details.rings[name] for name in shown})]
    if baseline:
        rings = [(item, {name: one.rings[item] for name, one in both}) for item in shown]
    places = {name: details.detection_maps[name] for name in shown if name in details.detection_maps}
    return {
        "mounts": draw_mounts(study, rig),
        "surfaces": draw_surfaces(study, rig) if any(slot.surface for slot in study.slots) else None,
        "history": drawings.draw_history(study, placement) if placement else None,
        "worst": drawings.draw_worst(study, rig, found),
        "lost": drawings.draw_lost(robust) if robust else None,
        "sizes": drawings.draw_sizes(both),
        "rings": drawings.draw_rings(rings) if details.rings else None,
        "places": drawings.draw_places(region, rig, places) if places else None,
        "posts": draw_posts_by_height(study.body, rig, found.posts) if found.posts and study.body else None,
        "unseen": draw_unseen(found.subspaces, rig) if study.visibility else None,
        "coverage": drawings.draw_coverage(region, rig, details.coverage),
    }


def _of_baseline(study: Study, baseline: Baseline) -> list[KeyFigure]:
    """The baseline's figures in a summary; the midpoint of the bounds is the study's, whatever the rig."""
    return _summary(study, baseline.rig, replace(baseline.details, midpoint_max_vsr_m=None))


def _summary(study: Study, rig: Rig, details: ReportInputs, placement: Placement | None = None) -> list[KeyFigure]:
    """Key figures; that which was minimised comes first."""
    found = details.evaluation
    figures = []
    if found.misses:
        what = f"places where an object gets fewer than {found.misses.returns} returns"
        detail = f"{what}; {describe_interval(found.misses.interval)}"
        figures.append(KeyFigure("Misses", percent(found.misses.mean), detail))
    if placement and study.only_required:
        figures.append(KeyFigure("Least margin", f"{placement.objective:+.0%}", "of what is demanded"))
    elif placement and not (study.is_max_vsr or study.is_misses):
        figures.append(KeyFigure("Objective", f"{placement.objective:.6f}", describe_objective(study)))
    figures += _max_vsr_figures(rig, details) if has_cones(rig) else []
    if study.visibility:
        volume = float(found.seen_by_m3[0])
        part = volume / float(found.seen_by_m3.sum())
        what = "Shadow: seen by no sensor, whatever its beams"
        figures.append(KeyFigure(what, f"{volume:.2f} m³", f"{part:.2%} of the region"))
    figures += [post_figure(posts) for posts in found.posts]
    for item in study.detection:
        if found.misses and not item.returns:
            continue  # the paper's rates stand in the paper's part
        name = item.name
        rate = found.detection[name]
        figures.append(
            KeyFigure(f"Detection of {truncate(name)}", f"{rate.rate:.2%}", describe_places(study, item, rate))
        )
    return figures


def _max_vsr_figures(rig: Rig, details: ReportInputs) -> list[KeyFigure]:
    found = details.evaluation
    midpoint = details.midpoint_max_vsr_m
    worst = found.worst[0]
    at = f"at {vector(worst.centroid_m, '.1f')} m"
    alone = beams_alone(rig)
    largest = alone or f"the largest of {counted(len(found.subspaces), 'subspace')}"
    figures = [KeyFigure("Max VSR, the paper's measure", f"{found.max_vsr_m:.6f} m", largest)]
    if midpoint is not None:
        more = found.max_vsr_m / midpoint - 1
        than = f"this rig's max VSR is {abs(more):.0%} {'larger' if more > 0 else 'smaller'}"
        figures.append(KeyFigure("Max VSR at the midpoint of the bounds", f"{midpoint:.6f} m", than))
    if bar := found.extrapolated:
        value = f"{bar.max_vsr_m:.4f} ± {bar.error_m:.4f} m"
        figures.append(
            KeyFigure("Max VSR, extrapolated", value, f"± {bar.error_m / bar.max_vsr_m:.1%}, for ever smaller cuboids")
        )
    elif not alone:
        figures.append(KeyFigure("Max VSR, extrapolated", "not computed", "evaluate --tolerance computes it"))
    figures.append(
        KeyFigure("Largest sphere in the worst subspace", f"{2 * worst.inscribed_radius_m:.2f} m across", at)
    )
    return figures


def _task(study: Study, placement: Placement | None) -> FactRows:
    rows: FactRows = [("study", study.name), *region_rows(study.region)]
    if placement:
        rows += [
            ("objective", describe_objective(study)),
            ("constraints", describe_constraints(study)),
            ("solver", describe_solver(study)),
        ]
    return rows + [(f"object: {truncate(item.name)}", describe_object(item)) for item in study.detection]


def _search(placement: Placement | None) -> FactRows:
    if placement is None:
        return []
    return [
        ("evaluations", f"{placement.evaluations:,}"),
        ("evaluations of the initial rigs, not counted above", f"{placement.first_evaluations:,}"),
        ("evaluations by scouts, not counted above", f"{placement.scout_evaluations:,}"),
        ("cycles", f"{placement.history[-1].cycle:,}"),
        ("seconds", f"{placement.seconds:.1f}"),
        (f"objective of the best rig{', at fresh places' * bool(placement.believed)}", f"{placement.objective:.6f}"),
        *([("objective that the search believed", _believed(placement.believed))] if placement.believed else []),
        ("ended by", "an interrupt" if placement.interrupted else "its budget"),
    ]


def _believed(told: Believed) -> str:
    return f"{told.objective:.6f}, at {told.places:,} places of each object"


def _is_outside(worst: Worst) -> bool:
    """Whether a subspace lies above or below all beams of every sensor that sees it."""
    seen = [pair for pair in worst.between_deg if pair != [None, None]]
    return bool(seen) and all(None in pair for pair in seen)


def _coverage(details: ReportInputs, rig: Rig) -> dict[str, str | None]:
    known = details.coverage
    return {
        "beams": f"{known.median_beams:g}",
        "none": f"{known.by_none:.1%}",
        "one": f"{known.by_one_sensor:.1%}" if len(rig.mounts) > 1 else None,
    }


def _extrapolated(found: Evaluation, bar: Extrapolated, baseline: Baseline | None) -> dict[str, Any]:
    more = found.max_vsr_m / bar.max_vsr_m - 1
    edges = " × ".join(f"{edge:g}" for edge in bar.cuboid_m)
    reached = f"within the tolerance of {bar.tolerance:.3g}" if bar.reached else "not the tolerance asked for"
    if bar.tolerance >= 1:
        reached = "after two halvings of the edges; evaluate --tolerance makes it smaller"
    rows = [
        ("max VSR on the study's cuboids", f"{found.max_vsr_m:.6f} m"),
        ("max VSR, extrapolated to ever smaller cuboids", f"{bar.max_vsr_m:.6f} ± {bar.error_m:.6f} m"),
        ("error bar", f"{bar.error_m / bar.max_vsr_m:.2%}, {reached}"),
        ("finest cuboids", f"{bar.cuboids:,} of {edges} m"),
    ]
    if baseline and (other := baseline.details.evaluation.extrapolated):
        rows.append(("extrapolated max VSR of the baseline", f"{other.max_vsr_m:.6f} ± {other.error_m:.6f} m"))
    return {"rows": rows, "difference": f"{abs(more):.1%} {'higher' if more >= 0 else 'lower'}"}


def _skipped(study: Study, values: dict[str, Any], placement: Placement | None) -> FactRows:
    if placement is None:
        return []
    skipped = values["skipped"]
    trials = placement.evaluated
    all_trials = placement.evaluations + placement.first_evaluations + placement.scout_evaluations
    facts: FactRows = [("trials evaluated in this run", f"{trials:,} of {all_trials:,}")] if trials < all_trials else []
    if rigs_of_trial(study) > 1:
        facts.append(("rigs that these stand for", f"{skipped['rigs']:,}, {rigs_of_trial(study):,} a trial"))
    if not study.objective.cuts(study.detection):
        if study.objective.misses:
            facts.append(("trials", f"{trials:,}, each until it could no longer be better"))
        return [*facts, ("subspaces of trials", "not computed, as the objective does not need them")]
    what = "rigs" if rigs_of_trial(study) > 1 else "trials"
    facts.append((f"{what} settled without a full evaluation", _of(skipped["full_evaluations"], skipped["rigs"])))
    cuboids = skipped["rigs"] * study.region.included.size
    facts.append(("cuboids that were not evaluated", _of(skipped["cuboids"], cuboids)))
    if segments := trials * segments_of_trial(study):
        facts.append(("segments from sensors to cuboids that were not cast", _of(skipped["segments"], segments)))
    return facts


def _of(part: int, whole: int) -> str:
    return f"{part:,} of {whole:,} ({part / max(whole, 1):.1%})"


def _repeat(values: dict[str, Any]) -> FactRows:
    return [
        ("seed", "not needed" if values["seed"] is None else values["seed"]),
        ("versions", versions()),
        ("seconds", f"{values['seconds']:.2f}"),
        ("date", date()),
    ]
