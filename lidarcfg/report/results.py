"""A result as JSON and as a folder of files. Every run's folder says what was asked, with seed and version."""

import csv
import json
import tempfile
import zipfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg import __version__
from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.placement.analytic import analytic
from lidarcfg.placement.cones import rig_lidars
from lidarcfg.placement.optimize import Log, Placement
from lidarcfg.placement.study import BUDGETS, Evaluation, Study
from lidarcfg.report.document import CHEAP_CUBOIDS, Commands, report
from lidarcfg.report.plots import draw_convergence, draw_rig, save_figure
from lidarcfg.rig import Rig, rig_to_dict, save_rig

HALVED_ONCE = 1.0  # a tolerance that the first halving reaches


def evaluation_dict(study: Study, rig: Rig, found: Evaluation) -> dict[str, Any]:
    """What `evaluate --json` prints and every result.json carries."""
    return {
        "measure": "faces",
        "max_vsr_m": found.max_vsr_m,
        "analytic": found.analytic and asdict(found.analytic) | {"reached": found.analytic.reached},
        "subspaces": len(found.subspaces),
        "evaluations": 1,
        "seconds": found.seconds,
        "seed": None,
        "version": __version__,
        "solver": None,
        "detection": {name: detection.rate for name, detection in found.detection.items()},
        "detection_half_width": {name: detection.half_width for name, detection in found.detection.items()},
        "detection_places": {name: detection.places for name, detection in found.detection.items()},
        "worst": [asdict(worst) for worst in found.worst],
        "skipped": {"full_evaluations": 0, "cuboids": 0},
        "rig": rig_to_dict(rig),
        "study": study.file,
    }


def placement_dict(study: Study, found: Placement) -> dict[str, Any]:
    """What `optimize` writes as result.json."""
    return evaluation_dict(study, found.rig, found.evaluation) | {
        "objective": found.objective,
        "middle_max_vsr_m": found.middle_max_vsr_m,
        "evaluations": found.evaluations,
        "first_evaluations": found.first_evaluations,
        "scout_evaluations": found.scout_evaluations,
        "interrupted": found.interrupted,
        "seconds": found.seconds,
        "seed": study.solver.seed,
        "solver": study.solver.method,
        "skipped": {
            "full_evaluations": found.evaluations
            + found.first_evaluations
            + found.scout_evaluations
            - found.full_evaluations,
            "cuboids": (found.evaluations + found.first_evaluations + found.scout_evaluations)
            * study.region.included.size
            - found.cuboids,
        },
    }


def to_json(values: dict[str, Any]) -> str:
    """As one JSON document; a NaN or infinity is our own mistake and raises ValueError."""
    return json.dumps(values, indent=1, allow_nan=False, ensure_ascii=False)


def with_error_bar(study: Study, rig: Rig, found: Evaluation) -> Evaluation:
    """The evaluation with its analytic max VSR from one halving of the cuboids, where there are few of them."""
    if found.analytic or study.region.included.size > CHEAP_CUBOIDS:
        return found
    return replace(found, analytic=analytic(study.region, rig_lidars(rig), HALVED_ONCE))


def save_evaluation(
    study: Study, rig: Rig, found: Evaluation, folder: Path, commands: Commands | None = None
) -> Evaluation:
    """Write result.json, rig.png and report.html into `folder`; what they say, with its error bar where it is cheap."""
    folder.mkdir(parents=True, exist_ok=True)
    found = with_error_bar(study, rig, found)
    values = evaluation_dict(study, rig, found)
    _write_text(to_json(values) + "\n", folder / "result.json")
    save_figure(draw_rig(study, rig, found), folder / "rig.png")
    _write_text(report(study, rig, found, values, None, commands), folder / "report.html")
    return found


def save_placement(study: Study, found: Placement, folder: Path, commands: Commands | None = None) -> Placement:
    """Write rig.yaml, search.npz, result.json, history.csv, convergence.png, rig.png and report.html into `folder`.

    Returns what they say: with an error bar, where it is cheap.
    """
    folder.mkdir(parents=True, exist_ok=True)
    save_progress(study, found.rig, found.log, folder)
    found = replace(found, evaluation=with_error_bar(study, found.rig, found.evaluation))
    values = placement_dict(study, found)
    _write_text(to_json(values) + "\n", folder / "result.json")
    with replacing(folder / "history.csv") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(asdict(found.history[0]))
        writer.writerows(asdict(cycle).values() for cycle in found.history)
    save_figure(draw_convergence(study, found), folder / "convergence.png")
    save_figure(draw_rig(study, found.rig, found.evaluation), folder / "rig.png")
    _write_text(report(study, found.rig, found.evaluation, values, found, commands), folder / "report.html")
    return found


def check_writable(folder: Path) -> None:
    """Make the folder, and raise OSError now, not after hours, where nothing can be written into it."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None


def save_progress(study: Study, rig: Rig, log: Log, folder: Path) -> None:
    """Write the best rig so far, rig.yaml, and search.npz, from which a search can go on."""
    save_rig(rig, folder / "rig.yaml")
    with replacing(folder / "search.npz", "wb") as file:
        np.savez_compressed(file, cost=log.cost, seconds=log.seconds, asked=_asked(study))


def load_log(study: Study, folder: Path) -> Log:
    """The log in a folder's search.npz. Raises ConfigError where it is none, or of another search."""
    path = folder / "search.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            log, asked = Log(np.asarray(file["cost"], np.float64), float(file["seconds"])), str(file["asked"])
    except OSError as error:
        raise ConfigError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    except (KeyError, ValueError, zipfile.BadZipFile):
        raise ConfigError(f"{path}: is not the log of a search") from None
    if asked != _asked(study):
        raise ConfigError(f"{path}: is of another search; study, solver and seed must be the same, but for the budget")
    return log


def _asked(study: Study) -> str:
    """All that decides how a search goes, as one text: the study but for its budgets."""
    solver = {key: value for key, value in study.file["solver"].items() if key not in BUDGETS}
    return json.dumps(study.file | {"solver": solver}, sort_keys=True)


def _write_text(text: str, path: Path) -> None:
    with replacing(path) as file:
        file.write(text)
