"""Results as JSON and as a folder of files, with the task, seed and version."""

import json
import math
import re
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from lidarcfg import __version__
from lidarcfg.files import check_replaceable, remove_outdated, replacing
from lidarcfg.geometry import Array
from lidarcfg.report.drawings import draw_rig
from lidarcfg.report.inputs import ReportInputs
from lidarcfg.report.plots import draw_convergence, save_figure
from lidarcfg.report.rig_report import Baseline, ChoicePart, Commands, report
from lidarcfg.report.search_log import SEARCH_LOG, save_log
from lidarcfg.report.table import Column, Table
from lidarcfg.report.verification import verdict_page
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.requirements.verify import Verification
from lidarcfg.returns.post_visibility import PostVisibility
from lidarcfg.search.log import SearchLog
from lidarcfg.search.run import Believed, Placement
from lidarcfg.sensors.rig import Rig, rig_to_dict, save_rig
from lidarcfg.study.evaluation import OFFSETS, STEP_DEG, STEP_M, Evaluation, Robustness
from lidarcfg.study.file import COORDINATES
from lidarcfg.study.objective_costs import rigs_of_trial, segments_of_trial
from lidarcfg.study.return_counts import STEP_M as STEP_M_OF_RETURNS
from lidarcfg.study.study import Study
from lidarcfg.vsr.detection import DetectionObject


def evaluation_dict(study: Study, rig: Rig, found: Evaluation) -> dict[str, Any]:
    """The values that `evaluate --json` prints and every result.json contains."""
    return {
        **({"verdict": found.verdict.to_dict()} if found.verdict else {}),
        "max_vsr_m": found.max_vsr_m,
        "extrapolated": found.extrapolated and asdict(found.extrapolated) | {"reached": found.extrapolated.reached},
        "subspaces": len(found.subspaces),
        "evaluations": 1,
        "seconds": found.seconds,
        "seed": None,
        "version": __version__,
        "solver": None,
        "misses": found.misses and found.misses.to_dict(),
        "misses_without": found.misses_without,
        "detection": {name: detection.rate for name, detection in found.detection.items()},
        "detection_half_width": {name: detection.half_width for name, detection in found.detection.items()},
        "detection_returns": {
            name: asdict(detection.returns) for name, detection in found.detection.items() if detection.returns
        },
        "detection_spacing_m": {item.name: _spacing_m(study, item) for item in study.detection},
        "detection_places": {name: detection.places for name, detection in found.detection.items()},
        "seen_by_m3": found.seen_by_m3.tolist(),
        "shadow_volume_m3": float(found.seen_by_m3[0]),
        "blind_spots": [_posts(posts) for posts in found.posts],
        "zones": [asdict(zone) for zone in found.zones],
        "robustness": found.robustness and _robustness(rig, found.robustness),
        "worst": [asdict(worst) for worst in found.worst],
        "skipped": {"rigs": 1, "full_evaluations": 0, "cuboids": 0, "segments": 0},
        "rig": rig_to_dict(rig),
        "study": study.file,
    }


def _robustness(rig: Rig, found: Robustness) -> dict[str, Any]:
    """Each LiDAR lost, and by mount and axis the changes of max VSR with it off."""
    change = zip(rig.mounts, found.change_m.tolist(), strict=True)
    return {
        "whole": asdict(found.whole),
        "without": [asdict(left) for left in found.without],
        "off_m": [STEP_M * off for off in OFFSETS],
        "off_deg": [STEP_DEG * off for off in OFFSETS],
        "max_vsr_change_m": {mount.name: dict(zip(COORDINATES, by_axis, strict=True)) for mount, by_axis in change},
    }


def _spacing_m(study: Study, item: DetectionObject) -> list[float] | None:
    """The spacing of the places where a rate was counted, along x and y, and z where it matters; null where drawn."""
    if item.samples:
        return None
    if item.returns:
        return [item.step_m or STEP_M_OF_RETURNS] * 2
    steps: list[float] = study.region.cuboid_m[: 2 if item.on_ground else 3].tolist()
    return steps


def _posts(posts: PostVisibility) -> dict[str, Any]:
    """Where a post is seen, by azimuth; null where it stands nowhere, or where it is never seen."""

    def column(values: Array) -> list[float | None]:
        return [value if math.isfinite(value) else None for value in values.tolist()]

    return {
        "post_height_m": posts.height_m,
        "limit_m": posts.limit_m,
        "gap_share": posts.gap_share,
        "azimuth_deg": posts.azimuth_deg.tolist(),
        "first_seen_m": column(posts.first_seen_m),
        "longest_gap_m": column(posts.longest_gap_m),
        "seen_without_gaps_to_m": column(posts.seen_to_m),
    }


def placement_dict(study: Study, found: Placement, evaluation: Evaluation) -> dict[str, Any]:
    """The values of result.json that `optimize` writes."""
    rigs = found.evaluated * rigs_of_trial(study)
    cut = study.objective.cuts(study.detection)
    return evaluation_dict(study, found.rig, evaluation) | {
        "objective": found.objective if math.isfinite(found.objective) else None,
        "at_bounds": list(found.at_bounds),
        **({"remarks": list(found.remarks)} if found.remarks else {}),
        "believed": found.believed and _believed(found.believed),
        "midpoint_max_vsr_m": found.midpoint_max_vsr_m,
        "evaluations": found.evaluations,
        "first_evaluations": found.first_evaluations,
        "scout_evaluations": found.scout_evaluations,
        "interrupted": found.interrupted,
        "seconds": found.seconds,
        "seed": study.solver.seed,
        "solver": study.solver.method,
        "skipped": {
            "rigs": rigs,
            "full_evaluations": rigs - found.full_evaluations,
            "cuboids": max(cut * rigs * study.region.included.size - found.cuboids, 0),
            "segments": max(cut * found.evaluated * segments_of_trial(study) - found.segments, 0),
        },
    }


def _believed(told: Believed) -> dict[str, Any]:
    """What a search believed, and the rigs that its result is compared with at fresh places."""
    plain = told.plain
    return {
        "objective": told.objective,
        "places_per_object": told.places,
        "best_plain": plain
        and {"objective": plain.objective, "misses": plain.misses.to_dict(), "rig": rig_to_dict(plain.rig)},
        "midpoint": {"misses": told.midpoint.to_dict()},
    }


def to_json(values: dict[str, Any]) -> str:
    """One JSON document. Raises ValueError on NaN and infinity, which would be a bug."""
    text = json.dumps(values, indent=1, allow_nan=False, ensure_ascii=False)
    return UNPRINTED.sub(lambda found: json.dumps(found[0])[1:-1], text)


def baseline_dict(study: Study, baseline: Baseline) -> dict[str, Any]:
    """The values of a baseline in result.json."""
    values = evaluation_dict(study, baseline.rig, baseline.details.evaluation)
    return {"file": baseline.file} | {key: value for key, value in values.items() if key not in ("study", "version")}


def save_evaluation(
    study: Study,
    rig: Rig,
    details: ReportInputs,
    folder: Path,
    commands: Commands | None = None,
    baseline: Baseline | None = None,
) -> None:
    """Write result.json, rig.png and report.html into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    found = details.evaluation
    values = evaluation_dict(study, rig, found)
    if baseline:
        values["baseline"] = baseline_dict(study, baseline)
    figure = draw_rig(study, rig, found)
    page = report(study, rig, details, values, None, commands, baseline)
    write_text(to_json(values) + "\n", folder / "result.json")
    save_figure(figure, folder / "rig.png")
    write_text(page, folder / "report.html")


def save_placement(
    study: Study,
    found: Placement,
    details: ReportInputs,
    folder: Path,
    commands: Commands | None = None,
    baseline: Baseline | None = None,
    choice: ChoicePart | None = None,
) -> None:
    """Write the result of a search into `folder`; `details` are those of its rig.

    The files are rig.yaml, search.npz, result.json, history.csv, convergence.png, rig.png and report.html.
    """
    folder.mkdir(parents=True, exist_ok=True)
    values = placement_dict(study, found, details.evaluation)
    if baseline:
        values["baseline"] = baseline_dict(study, baseline)
    convergence = draw_convergence(study, found)
    figure = draw_rig(study, found.rig, details.evaluation)
    page = report(study, found.rig, details, values, found, commands, baseline, choice)
    save_log(study, SearchLog.of(found.log), folder)
    save_rig(found.rig, folder / "rig.yaml")
    write_text(to_json(values) + "\n", folder / "result.json")
    write_history(found.history, folder)
    save_figure(convergence, folder / "convergence.png")
    save_figure(figure, folder / "rig.png")
    write_text(page, folder / "report.html")


def save_verdict(
    study: Study,
    rig: Rig,
    found: Verification,
    values: dict[str, Any],
    folder: Path,
    command: str | None = None,
    against: Verdict | None = None,
) -> None:
    """Write verdict.html and verdict.json, which holds `values`, into `folder`; `against`: see `verdict_part`."""
    folder.mkdir(parents=True, exist_ok=True)
    page = verdict_page(study, rig, found, command, against)
    write_text(to_json(values) + "\n", folder / "verdict.json")
    write_text(page, folder / "verdict.html")


def write_history(history: Sequence[Any], folder: Path) -> None:
    """Write the lines of a search's history, dataclasses of one kind, into history.csv."""
    columns = [Column(field.name) for field in fields(history[0])]
    table = Table("", columns, [list(asdict(line).values()) for line in history])
    with replacing(folder / "history.csv") as file:
        table.write_csv(file, digits=None)


UNPRINTED = re.compile(r"[\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")  # controls and directions of text
EVALUATED = ("result.json", "rig.png", "report.html")  # the files of an evaluation
VERIFIED = ("verdict.json", "verdict.html")  # the files of a verification
FRONT = (SEARCH_LOG, "front.json", "history.csv", "front.png", "front.html")  # the files of a front
# The files of a search.
RESULTS = (SEARCH_LOG, "rig.yaml", "result.json", "history.csv", "convergence.png", "rig.png", "report.html")
COMBINATIONS = "combinations.csv"  # which a search for the cheapest rig writes, too


def check_writable(folder: Path, names: Iterable[str]) -> None:
    """Make the folder. Raises OSError now, not after hours, if the files cannot be written into it."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None
    for name in names:
        check_replaceable(folder / name)


def save_progress(study: Study, log: SearchLog, folder: Path, rig: Rig | None = None) -> None:
    """Write search.npz, from which a search can resume, and the best rig so far to rig.yaml, if there is one.

    The other results of an earlier search are removed: a folder holds those of one search.
    """
    kept = (SEARCH_LOG, "rig.yaml") if rig else (SEARCH_LOG,)
    remove_outdated(folder / name for name in {*RESULTS, *FRONT, COMBINATIONS} if name not in kept)
    save_log(study, log, folder)
    if rig:
        save_rig(rig, folder / "rig.yaml")


def write_text(text: str, path: Path) -> None:
    """Write a text, whole or not at all."""
    with replacing(path) as file:
        file.write(text)
