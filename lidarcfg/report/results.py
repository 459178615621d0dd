"""Results as JSON and as a folder of files, with the task, seed and version."""

import csv
import json
import math
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg import __version__
from lidarcfg.clouds.cloud import read_arrays
from lidarcfg.errors import CloudError, ConfigError
from lidarcfg.files import check_replaceable, remove_outdated, replacing
from lidarcfg.geometry import Array
from lidarcfg.report.document import Baseline, ChoicePart, Commands, report
from lidarcfg.report.inputs import ReportInputs
from lidarcfg.report.plots import draw_convergence, draw_rig, save_figure
from lidarcfg.report.verification import verdict_page
from lidarcfg.requirements.post_visibility import PostVisibility
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.requirements.verify import Verification
from lidarcfg.search.run import Believed, Check, Log, Placement
from lidarcfg.sensors.rig import Rig, rig_to_dict, save_rig
from lidarcfg.solvers.solver import BUDGETS
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
    _write_progress(study, found.rig, found.log, folder)
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
    with replacing(folder / "history.csv") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(asdict(history[0]))
        writer.writerows(asdict(line).values() for line in history)


UNPRINTED = re.compile(r"[\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")  # controls and directions of text
PROGRESS = ("search.npz", "rig.yaml")  # the files of a search that is running
EVALUATED = ("result.json", "rig.png", "report.html")  # the files of an evaluation
VERIFIED = ("verdict.json", "verdict.html")  # the files of a verification
FRONT = ("search.npz", "front.json", "history.csv", "front.png", "front.html")  # the files of a front
# The files of a search.
RESULTS = (*PROGRESS, "result.json", "history.csv", "convergence.png", "rig.png", "report.html")
LOG = {  # kind and dimensions of the arrays of search.npz
    "cost": ("f", 2),
    "seconds": ("f", 0),
    "points": ("f", 2),
    "given": ("i", 0),
    "checked": ("i", 2),
    "places": ("f", 2),
    "asked": ("U", 0),
}
PAIR = 2  # a cost: shortfall and objective
CHECK = 3  # how many costs were told, whether the rig passed, whether places were drawn
PLACE = 6  # the number of a check, that of a requirement, and x, y, z and heading


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


def save_progress(study: Study, rig: Rig, log: Log, folder: Path) -> None:
    """Write the best rig so far to rig.yaml, and search.npz, from which a search can resume.

    The other results of an earlier search are removed: a folder holds those of one search.
    """
    remove_outdated(folder / name for name in {*RESULTS, *FRONT} if name not in PROGRESS)
    _write_progress(study, rig, log, folder)


def _write_progress(study: Study, rig: Rig, log: Log, folder: Path) -> None:
    with replacing(folder / "search.npz", "wb") as file:
        np.savez_compressed(file, **log_arrays(log), asked=fingerprint(study))
    save_rig(rig, folder / "rig.yaml")


def log_arrays(log: Log) -> dict[str, Any]:
    """The arrays of search.npz."""
    places = [
        np.column_stack([np.full((len(some), 2), (n, number)), some])
        for n, check in enumerate(log.checks)
        for number, some in check.places.items()
    ]
    return {
        "cost": log.cost,
        "seconds": log.seconds,
        "points": np.empty((0, 0)) if log.points is None else log.points,
        "given": log.given,
        "checked": np.array([(one.told, one.passed, one.drawn) for one in log.checks], np.int64).reshape(-1, CHECK),
        "places": np.concatenate([np.empty((0, PLACE)), *places]),
    }


def log_of(arrays: Mapping[str, Any]) -> Log | None:
    """The log in the arrays of search.npz; None if they are none."""
    columns = {"cost": PAIR, "checked": CHECK, "places": PLACE}
    if {key: (array.dtype.kind, array.ndim) for key, array in arrays.items()} != LOG:
        return None
    if any(arrays[key].shape[1] != count for key, count in columns.items()):
        return None
    cost, seconds, points, given, checked, places = (arrays[key] for key in LOG if key != "asked")
    if not 0 <= given <= len(points):
        return None
    if np.isnan(cost).any() or not 0 <= seconds < np.inf or not np.isfinite(points).all():
        return None
    if not np.isfinite(places).all() or not np.isin(places[:, 0], range(len(checked))).all():
        return None
    checks = []
    for n, (told, passed, drawn) in enumerate(checked.tolist()):
        own = places[places[:, 0] == n]
        of = {int(number): own[own[:, 1] == number, 2:] for number in dict.fromkeys(own[:, 1].tolist())}
        checks.append(Check(told, bool(passed), of, bool(drawn)))
    begun = points if points.size else None
    return Log(cost.astype(np.float64), float(seconds), begun, int(given), tuple(checks))


def load_log(study: Study, folder: Path) -> Log:
    """The log in a folder's search.npz. Raises ConfigError if it is not one, or belongs to another search."""
    path = folder / "search.npz"
    try:
        arrays = read_arrays(path, tuple(LOG))
    except CloudError as error:
        raise ConfigError(str(error)) from None
    log = log_of(arrays)
    if log is None:
        raise ConfigError(f"{path}: is not the log of a search")
    asked = str(arrays["asked"])
    if asked != fingerprint(study):
        raise ConfigError(f"{path}: is of another search; study, solver and seed must be the same, but for the budget")
    if log.points is not None and log.points.shape[1] != study.space.free.sum():
        raise ConfigError(f"{path}: is not the log of a search")
    return log


def fingerprint(study: Study) -> str:
    """Everything that determines the course of a search, as one text: the study without its budgets."""
    solver = {key: value for key, value in study.file["solver"].items() if key not in BUDGETS}
    return json.dumps(study.file | {"solver": solver}, sort_keys=True)


def write_text(text: str, path: Path) -> None:
    """Write a text, whole or not at all."""
    with replacing(path) as file:
        file.write(text)
