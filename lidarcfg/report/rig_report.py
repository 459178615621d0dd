"""The report of a rig as one HTML file: what is missed, the verdict, the task, the result, and how to repeat it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidarcfg import __version__
from lidarcfg.report import drawings
from lidarcfg.report.blind_spots import draw_posts_by_height, draw_unseen, posts_table, volumes_table
from lidarcfg.report.describe import (
    date,
    describe_constraints,
    describe_limits,
    describe_object,
    describe_objective,
    describe_origin,
    describe_rig,
    describe_skips,
    describe_solver,
    region_rows,
)
from lidarcfg.report.evaluation import (
    bounds_table,
    coverage_table,
    detection_table,
    hiding_table,
    lost_table,
    sensitivity_table,
    worst_table,
    zones_table,
)
from lidarcfg.report.inputs import ReportInputs
from lidarcfg.report.key_figures import (
    KeyFigure,
    extrapolated_figure,
    figures_table,
    key_figures,
    max_vsr_figures,
    summary,
)
from lidarcfg.report.misses import (
    SeenBy,
    compared_with,
    draw_misses,
    misses_lines,
    misses_table,
    rigs_seen,
    worst_object,
)
from lidarcfg.report.mounts import draw_surfaces
from lidarcfg.report.overview import FIGURES_MAX, overview_figures, overview_parts, overview_verdict, rig_table
from lidarcfg.report.page import FactRows, PageSection, Part, bullets, code, facts, figure, page
from lidarcfg.report.repeat import repeat_section
from lidarcfg.report.table import Column, Table, with_baseline
from lidarcfg.report.text import truncate
from lidarcfg.report.verdict import remarks
from lidarcfg.report.verification import requirement_parts
from lidarcfg.requirements.verify import Verification
from lidarcfg.returns.missed_map import missed_map
from lidarcfg.search.run import Placement, at_bounds
from lidarcfg.sensors.rig import Rig, rig_to_dict
from lidarcfg.study.evaluation import Worst
from lidarcfg.study.objective_costs import rigs_of_trial
from lidarcfg.study.study import Study
from lidarcfg.vsr.subspaces import BLIND


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


@dataclass(frozen=True)
class _Reported:
    """The rig of a report, and what it stands beside."""

    study: Study
    rig: Rig
    details: ReportInputs
    placement: Placement | None  # the search that found it
    baseline: Baseline | None

    def both(self, table: Callable[[Rig, ReportInputs], Table | None]) -> Table | None:
        """A table of the rig, with the baseline's rows."""
        other = table(self.baseline.rig, self.baseline.details) if self.baseline else None
        return with_baseline(table(self.rig, self.details), other)

    @property
    def titled(self) -> list[tuple[str, Rig, ReportInputs]]:
        """The rig and the baseline, to draw."""
        if not self.baseline:
            return [("", self.rig, self.details)]
        return [("this rig", self.rig, self.details), ("baseline", self.baseline.rig, self.baseline.details)]


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
    it = _Reported(study, rig, details, placement, baseline)
    typed, again = (commands.typed, commands.again) if commands else (None, None)
    found = details.evaluation
    beside = (baseline.rig, baseline.details.evaluation) if baseline else None
    seen = rigs_seen(study, rig, found, placement, beside)
    sections = [
        _misses(it, seen) if seen else None,
        PageSection("requirements", "The requirements", _requirements(details.verification, rig))
        if details.verification
        else None,
        _choice(choice) if choice else None,
        PageSection("asked", "The task", _task(it)),
        PageSection("rig", "The rig", _rig(it)),
        PageSection("search", "The search", _search(it, values)),
        PageSection(
            "worst",
            "The paper's measure: max VSR and the worst subspaces" if seen else "The worst subspaces",
            _worst(it, bool(seen)),
        ),
        PageSection("robust", "Failures and mounting errors", _robust(it)),
        PageSection("blind", "Blind spots and shadow", _blind(it)),
        _detection(it, bool(seen)),
        PageSection("coverage", "Coverage", _coverage(it)),
        PageSection("trust", "Accuracy and limits", _trust(it)),
        repeat_section(
            "rig",
            {
                "The complete study, with defaults": study.file,
                "The rig as a file": rig_to_dict(rig),
                "The baseline as a file": rig_to_dict(baseline.rig) if baseline else None,
            },
            typed,
            again,
            values["seed"],
            values["seconds"],
        ),
    ]
    against = baseline.details.evaluation.verdict if baseline else None
    return page(
        f"Report: {rig.name}",
        f"{describe_rig(rig)}, in the study {truncate(study.name)}; "
        f"{'optimised' if placement else 'evaluated'} by lidarcfg {__version__} on {date()}",
        [section for section in sections if section],
        summary(
            [
                *overview_figures(study, rig, found, seen),
                *_minimised(study, placement),
                *key_figures(study, rig, found, None, details.midpoint_max_vsr_m),
            ],
            key_figures(study, baseline.rig, baseline.details.evaluation) if baseline else (),
        )[:FIGURES_MAX],
        [
            f"The baseline is {baseline.rig.name}, the rig in {baseline.file}; the study's bounds are not enforced on "
            "it. A difference is this rig's printed number minus the baseline's."
            if baseline
            else None,
            "The search was interrupted: this is the best rig found so far."
            if placement and placement.interrupted
            else None,
            *overview_parts(study, rig, found, seen),
        ],
        overview_verdict(found.verdict, against) if found.verdict else None,
        is_head_a_page=True,
    )


def _minimised(study: Study, placement: Placement | None) -> list[KeyFigure]:
    """What was minimised, where that is no figure of every rig."""
    if placement is None:
        return []
    if study.only_required:
        return [KeyFigure(Column("least margin", "+.2%"), placement.objective, "of what is demanded", is_main=True)]
    if study.is_max_vsr or study.is_misses:
        return []
    return [KeyFigure(Column("objective", ".6f"), placement.objective, describe_objective(study), is_main=True)]


def _requirements(found: Verification, rig: Rig) -> Iterator[Part]:
    yield bullets(remarks(found.verdict))
    yield from requirement_parts(found, rig)


def _misses(it: _Reported, rigs: tuple[SeenBy, ...]) -> PageSection:
    other = compared_with(rigs)
    weights = " by their weights" * (len(set(rigs[0].misses.weights.tolist())) > 1)
    side_m = missed_map(rigs[0].misses).side_m
    caption = (
        f"From above, the same places and colours for both: in each square of {side_m:g} m, the share of objects that "
        f"is missed, over all objects{weights}; white: no place. Dots: where a "
        f"{truncate(worst_object(rigs[0].misses).name)}, which this rig misses most, is missed in at least half of the "
        "sensors' phases. Grey: the vehicle; coloured: "
        "the sensors."
    )
    drawn = draw_misses(it.study.body, [rigs[0], other] if other else [rigs[0]])
    lines = misses_lines(it.study, rigs, it.placement)
    return PageSection("seen", "What is missed", [*lines, misses_table(rigs), figure(drawn, caption)])


def _choice(choice: ChoicePart) -> PageSection:
    """The combinations of sensors that were searched for the cheapest rig."""
    parts: list[Part] = [f"{choice.answer[0].upper()}{choice.answer[1:]}. {choice.searched}"]
    if choice.table.rows:
        parts.append(choice.table)
    if choice.again:
        parts += ["To go on with this search, for as long again or longer:", code(choice.again)]
    return PageSection("choice", "The combinations of sensors", parts)


def _task(it: _Reported) -> Iterator[Part]:
    study = it.study
    rows: list[tuple[str, object]] = [("study", study.name), *region_rows(study.region)]
    if it.placement:
        rows.append(("objective", describe_objective(study)))
        rows.append(("constraints", describe_constraints(study)))
        rows.append(("solver", describe_solver(study)))
    yield facts([*rows, *((f"object: {truncate(item.name)}", describe_object(item)) for item in study.detection)])
    if it.placement:
        yield bounds_table(study)


def _rig(it: _Reported) -> Iterator[Part]:
    study = it.study
    rig = it.rig
    yield it.both(lambda rig, details: rig_table(study, rig, details.evaluation))
    if len(rig.mounts) == len(study.slots):
        poses = np.array([(*mount.position_m, *mount.rpy_rad) for mount in rig.mounts])
        if ends := at_bounds(study, poses):
            yield "These coordinates are at their bounds; a wider bound may give a better rig:"
            yield bullets(ends)
    if any(slot.surface for slot in study.slots):
        yield figure(
            draw_surfaces(study, rig),
            "Where sensors may sit, and where the bases of this rig's sensors are: the vehicle from each side that has "
            "sensors. Green: the middle of a base may be here, to half its radius. Dashed: the study's bounds.",
        )


def search_facts(study: Study, placement: Placement) -> FactRows:
    """What a search spent and found."""
    others = [(placement.first_evaluations, "the first rigs"), (placement.scout_evaluations, "scouts")]
    beside = "".join(f", and {count:,} of {whose}" for count, whose in others if count)
    rows: list[tuple[str, object]] = [
        ("evaluations", f"{placement.evaluations:,}{beside}, in {placement.history[-1].cycle:,} cycles"),
        ("seconds", f"{placement.seconds:.1f}"),
    ]
    if study.only_required:
        rows.append(("least margin", f"{placement.objective:+.2%} of what is demanded"))
    else:
        fresh = ", at fresh places" if placement.believed else ""
        rows.append((f"objective of the best rig{fresh}", f"{placement.objective:.6f}"))
    if told := placement.believed:
        said = f"{told.objective:.6f}, at {told.places:,} places of each object"
        rows.append(("objective that the search believed", said))
    if placement.interrupted:
        rows.append(("ended by", "an interrupt"))
    return rows


def skipped_facts(study: Study, skipped: Mapping[str, int]) -> FactRows:
    """How many rigs a search settled without computing all of their subspaces; none where that is no share of them."""
    rigs = skipped["rigs"]
    settled = skipped["full_evaluations"]
    if not study.objective.cuts(study.detection) or not 0 < settled < rigs:
        return []
    what = "rigs" if rigs_of_trial(study) > 1 else "trials"
    return [(f"{what} settled without a full evaluation", f"{settled:,} of {rigs:,} ({settled / rigs:.1%})")]


def _search(it: _Reported, values: Mapping[str, Any]) -> Iterator[Part]:
    study = it.study
    placement = it.placement
    if placement is None:
        yield "No search was run: the rig was given."
        return
    yield facts([*search_facts(study, placement), *skipped_facts(study, values["skipped"])])
    yield f"{describe_skips(study)} The same search without skipping gives the same rig, bit for bit."
    caption = (
        "The best rig so far, and the mean of the rigs that the solver works with. Values far above the best are cut "
        "off. If the best still falls at the end, search longer: --resume continues this search."
    )
    if placement.believed:
        caption += (
            " This is what the search believed, from few places, which its rigs come to suit too well; it steps up "
            "where the places are doubled. Dotted: the rig that was chosen, at fresh places."
        )
    yield figure(drawings.draw_history(study, placement), caption)
    yield (
        "A search does not prove an optimum: another seed may find a rig that is a few per cent better or worse. "
        "Compare several with lidarcfg compare."
    )


def _worst(it: _Reported, beside_misses: bool) -> Iterator[Part]:
    study = it.study
    worst = it.details.evaluation.worst[0]
    if beside_misses:
        yield "From here on: the paper's measures, of how large the gaps between beams are, not of what is missed."
        yield figures_table(list(max_vsr_figures(it.rig, it.details.evaluation, it.details.midpoint_max_vsr_m)))
    yield "A subspace is a part of the region that no beam enters: an object that lies inside one is not seen."
    if _is_outside(worst):
        seen = " that sees it" if study.visibility else ""
        yield (
            f"The worst subspace lies above the top beam or below the lowest beam of every sensor{seen}. More beams in "
            "between cannot make it smaller; tilting or moving a sensor, or a wider vertical field of view, can."
        )
    if all(gap == BLIND for gap in worst.gap):
        yield "No sensor sees the worst subspace, whatever its beams: only moving a sensor, or one more, helps."
    yield it.both(lambda _, details: worst_table(details.evaluation))
    if it.details.gap_fits:
        yield it.both(lambda _, details: hiding_table(details.gap_fits, describe_origin(study)))
        yield "An object that fits into no gap may still be touched by a single beam only. Cuboids count whole."
    if study.zones:
        yield it.both(lambda _, details: zones_table(details.evaluation.zones))
        yield "No point of a zone lies in a subspace of a larger VSR than the zone's max VSR."
    yield figure(
        drawings.draw_worst(study, it.rig, it.details.evaluation),
        "The worst subspaces, numbered as in the table; the worst is filled. Dots: sensors. Grey: excluded. A number "
        f"marks the centroid, which may lie outside its subspace.{' Dashed: the zones.' if study.zones else ''}",
    )


def _is_outside(worst: Worst) -> bool:
    """Whether a subspace lies above or below all beams of every sensor that sees it."""
    seen = [pair for pair in worst.between_deg if pair != [None, None]]
    return bool(seen) and all(None in pair for pair in seen)


def _robust(it: _Reported) -> Iterator[Part]:
    robust = it.details.evaluation.robustness
    if robust is None:
        yield "Not computed, because the region has many cuboids: more than 1,000,000."
        return
    if robust.without:
        yield it.both(lambda _, details: _lost(it.study, details))
        yield figure(
            drawings.draw_lost([(title, details.evaluation) for title, _, details in it.titled]),
            "Max VSR of the whole rig, and of what is left without each LiDAR. Losing one can even lower max VSR: "
            "fewer beams can divide the region into more compact subspaces.",
        )
    yield it.both(_sensitivity)
    yield (
        "Mount a sensor precisely along the axes with a large increase. Errors of several mounts together can do more "
        "than each alone. A study's robust key makes the search find a rig that withstands them."
    )


def _lost(study: Study, details: ReportInputs) -> Table | None:
    robust = details.evaluation.robustness
    return lost_table(robust, study) if robust and robust.without else None


def _sensitivity(rig: Rig, details: ReportInputs) -> Table | None:
    robust = details.evaluation.robustness
    return sensitivity_table(rig, robust) if robust else None


def _blind(it: _Reported) -> Iterator[Part]:
    study = it.study
    found = it.details.evaluation
    if found.posts and study.body:
        yield it.both(lambda _, details: posts_table(details.evaluation.posts) if details.evaluation.posts else None)
        yield (
            "First seen: where, going away from the body, the first half metre without a gap begins. Gaps are beyond "
            "it. 0° is ahead, 90° to the left. Nothing is known of what lies between these places."
        )
        yield figure(
            draw_posts_by_height(study.body, it.rig, found.posts),
            "Red: not seen yet. Blue: seen. Orange: a gap. Grey: the vehicle; dots: sensors.",
        )
    limits = describe_limits(study)
    if not limits:
        yield (
            "Nothing limits the sight of the sensors in this study: they miss only what lies between their beams. A "
            "study can name a vehicle, surroundings and ranges that limit it."
        )
        return
    yield (
        f"Besides the beams, these limit what the sensors see: {limits}. A place is in shadow if no sensor sees it for "
        "one of these reasons. Places between two beams, or above or below all of them, are in no shadow."
    )
    yield it.both(lambda _, details: volumes_table(details.evaluation.seen_by_m3))
    yield figure(
        draw_unseen(found.subspaces, it.rig),
        "The unseen height at each place, from above: the part of an upright line that no sensor sees. Grey: excluded; "
        "dots: sensors.",
    )


def _detection(it: _Reported, beside_misses: bool) -> PageSection:
    by_returns = any(item.returns for item in it.study.detection)
    title = "The paper's detection rates" if beside_misses and not by_returns else "Detection"
    return PageSection("detection", title, _detection_parts(it, beside_misses, by_returns))


def _detection_parts(it: _Reported, beside_misses: bool, by_returns: bool) -> Iterator[Part]:
    study = it.study
    if not study.detection:
        yield "The study names no objects, so detection was not evaluated."
        return
    if beside_misses:
        yield (
            "By the paper's rule an object counts as detected if it lies in more subspaces than its threshold, however "
            f"few returns it gets{'; objects with returns are counted by these' if by_returns else ''}."
        )
    yield it.both(lambda _, details: detection_table(study, details.evaluation))
    yield rings_figure(study, it.titled)
    shown = drawings.least_detected([it.details.evaluation])
    places = {name: it.details.detection_maps[name] for name in shown if name in it.details.detection_maps}
    if places:
        yield figure(
            drawings.draw_places(study.region, it.rig, places),
            "Where each object is detected, by the position of its centre, over all its heights. Grey: it has no free "
            "position there.",
        )


def rings_figure(study: Study, rigs: list[tuple[str, Rig, ReportInputs]]) -> Part:
    """Detection rates by distance: a line for each object of one rig, or an object's lines of several rigs."""
    shown = drawings.least_detected([details.evaluation for _, _, details in rigs])
    panels = [(item, {title: details.rings[item] for title, _, details in rigs}) for item in shown]
    if len(rigs) == 1:
        panels = [("", {item: rings for item, by_rig in panels for rings in by_rig.values()})]
    whose = "of the object" if study.vehicle else "of the object's middle"
    few = ""
    if len(study.detection) > len(shown):
        few = f" Only the {len(shown)} objects that are detected least are drawn."
    caption = f"Detection rate by the horizontal distance {whose} from {describe_origin(study)}.{few}"
    return figure(drawings.draw_rings(panels), caption)


def _coverage(it: _Reported) -> Iterator[Part]:
    counted = ", among those that its sensor sees"
    ignored = ". Range, occlusion and the vehicle's body are ignored"
    yield (
        "How many beams would hit a thin pole along a line of cuboids, from end to end of the region? In the view from "
        "above the pole is upright; in those from the side and the front it lies across the region. A beam counts once "
        "if the centres of the cuboids along the pole lie on both sides of its cone"
        f"{counted if it.study.visibility else ignored}."
    )
    yield it.both(lambda _, details: coverage_table(details))
    yield figure(
        drawings.draw_coverage(it.study.region, it.rig, it.details.coverage),
        "Beams by position from top, side and front; and, from above, the number of sensors that they belong to. Grey: "
        "excluded. Heights are stretched.",
    )


def _trust(it: _Reported) -> Iterator[Part]:
    found = it.details.evaluation
    objects = it.study.detection
    if bar := found.extrapolated:
        one = extrapolated_figure(bar)
        more = found.max_vsr_m / bar.max_vsr_m - 1
        yield f"{one.title}: {one.text}, {one.detail}."
        yield (
            f"Cuboids place a cone only to half a cuboid: here max VSR is {abs(more):.1%} "
            f"{'higher' if more >= 0 else 'lower'} on the study's cuboids than on ever smaller ones. Compare it only "
            "with values from the same grid; the extrapolated one also across grids. The error bar holds in 95 of 100 "
            "cases; evaluate --tolerance makes it smaller. On any grid the faces of cuboids overestimate slanted "
            "surfaces, by up to a factor of 1.73."
        )
    else:
        yield (
            "Max VSR was not extrapolated to ever smaller cuboids, because the region has many. "
            "evaluate --tolerance 0.05 -o does so."
        )
    if objects:
        yield (
            "Detection rates with ± come from drawn places; the interval contains the true rate in 95 of 100 cases, "
            "also of a rate of exactly 1 or 0. Others are counted at the places of a grid; other places may be worse."
        )
    yield (
        "Whether a sensor sees a cuboid is judged at the cuboid's centre."
        if it.study.visibility
        else "Every beam is a full cone of unlimited range: occlusion, the vehicle's body and the sensors' ranges are "
        "not modelled, except where the study excludes them from the region."
    ) + " A lower max VSR does not always mean a higher detection rate of small objects; look at both."
