"""The front of price against objective: files, one page, a folder for each point, and the log to resume from."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lidarcfg import __version__
from lidarcfg.clouds.cloud import read_arrays
from lidarcfg.config.document import yaml_text
from lidarcfg.errors import CloudError, ConfigError
from lidarcfg.files import remove_outdated, replacing
from lidarcfg.placement.front import Candidate, Front, Point
from lidarcfg.placement.report_inputs import report_inputs
from lidarcfg.placement.search_run import Log
from lidarcfg.placement.study import Study
from lidarcfg.report.document import Commands
from lidarcfg.report.front_plot import draw_front, front_svg
from lidarcfg.report.html import Figure, Table, render
from lidarcfg.report.plots import save_figure
from lidarcfg.report.results import FRONT, RESULTS, fingerprint, save_placement, to_json, write_history, write_text
from lidarcfg.report.words import counted, date, describe_objective, describe_solver, price, versions

STUDY = "study.yaml"
POINT = (STUDY, *RESULTS)  # the files of a point
# the arrays of search.npz: kind and dimensions
LOG = {"cost": ("f", 1), "told": ("i", 1), "owner": ("i", 1), "seconds": ("f", 1), "asked": ("U", 0)}


def front_dict(study: Study, found: Front) -> dict[str, Any]:
    """What `optimize` writes as front.json where there are sensors to choose."""
    points = {point.combination.name: point for point in found.points}
    return {
        "objective": describe_objective(study),
        "points": [_point(point) for point in found.points],
        "combinations": [
            {
                "name": one.combination.name,
                "price": one.combination.price,
                "objective": one.objective if math.isfinite(one.objective) else None,
                "sensors": one.combination.sensors,
                "evaluations": one.evaluations,
                "on_front": one.combination.name in points,
            }
            for one in found.candidates
        ],
        "evaluations": found.evaluations,
        "dominated_evaluations": found.dominated_evaluations,
        "seconds": found.seconds,
        "interrupted": found.interrupted,
        "seed": study.solver.seed,
        "solver": study.solver.method,
        "version": __version__,
        "study": study.file,
    }


def _point(point: Point) -> dict[str, Any]:
    placement = point.placement
    return {
        "name": point.combination.name,
        "folder": f"points/{point.combination.name}",
        "price": point.combination.price,
        "objective": placement.objective,
        "sensors": point.combination.sensors,
        "max_vsr_m": placement.evaluation.max_vsr_m,
        "detection": {name: detection.rate for name, detection in placement.evaluation.detection.items()},
        "evaluations": placement.evaluations,
    }


def save_front(
    study: Study, found: Front, folder: Path, commands: Commands, on_point: Callable[[int, Point], None]
) -> None:
    """Write front.html, front.json, front.png, history.csv, search.npz, and points/ with a folder for each point.

    `on_point` is called before each point's folder is written.
    """
    save_front_log(study, found.logs, folder)
    values = front_dict(study, found)
    names = {point.combination.name for point in found.points}
    remove_outdated(path for path in _points(folder) if path.parent.name not in names)
    for number, point in enumerate(found.points):
        on_point(number, point)
        _save_point(point, folder / "points" / point.combination.name, commands)
    write_text(to_json(values) + "\n", folder / "front.json")
    write_history(found.history, folder)
    save_figure(draw_front(study, found), folder / "front.png")
    write_text(front_page(study, found, values, commands), folder / "front.html")
    for other in (folder / "points").glob("*"):
        with suppress(OSError):  # one that holds files stays
            other.rmdir()


def _save_point(point: Point, folder: Path, commands: Commands) -> None:
    """Write the study of a combination, and the results of its search as `optimize` writes them."""
    study = point.combination.study
    found = point.placement
    shown = report_inputs(study, found.rig, found.evaluation, found.midpoint_max_vsr_m)
    write_text(yaml_text(study.file), folder / STUDY)
    save_placement(study, found, shown, folder, commands)


def _points(folder: Path) -> Iterator[Path]:
    """The files that an earlier search may have written of its points."""
    return (point / name for point in (folder / "points").glob("*") for name in POINT)


def save_front_log(study: Study, logs: Sequence[Sequence[Log]], folder: Path) -> None:
    """Write search.npz, from which the search of a front can resume.

    The other results of an earlier search are removed: a folder holds those of one search.
    """
    every = [(owner, log) for owner, of_one in enumerate(logs) for log in of_one]
    remove_outdated(chain((folder / name for name in {*FRONT, *RESULTS} if name != "search.npz"), _points(folder)))
    with replacing(folder / "search.npz", "wb") as file:
        np.savez_compressed(
            file,
            cost=np.concatenate([log.cost for _, log in every]),
            told=np.array([len(log.cost) for _, log in every], np.int64),
            owner=np.array([owner for owner, _ in every], np.int64),
            seconds=np.array([log.seconds for _, log in every]),
            asked=fingerprint(study),
        )


def load_front_logs(study: Study, folder: Path, combinations: int) -> list[list[Log]]:
    """The logs in a folder's search.npz. Raises ConfigError if it is not one, or belongs to another search."""
    path = folder / "search.npz"
    try:
        arrays = read_arrays(path, tuple(LOG))
    except CloudError as error:
        raise ConfigError(str(error)) from None
    if not _is_log(arrays):
        raise ConfigError(f"{path}: is not the log of a search for a front")
    cost, told, owner, seconds = (arrays[key] for key in ("cost", "told", "owner", "seconds"))
    if str(arrays["asked"]) != fingerprint(study) or set(owner.tolist()) != set(range(combinations)):
        raise ConfigError(f"{path}: is of another search; study, solver and seed must be the same, but for the budget")
    logs: list[list[Log]] = [[] for _ in range(combinations)]
    parts = np.split(cost.astype(np.float64), np.cumsum(told)[:-1])
    for number, part, spent in zip(owner.tolist(), parts, seconds.tolist(), strict=True):
        logs[number].append(Log(part, spent))
    return logs


def _is_log(arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Whether these are the arrays of a search for a front, of their kinds and lengths."""
    if {key: (array.dtype.kind, array.ndim) for key, array in arrays.items()} != LOG:
        return False
    cost, told, owner, seconds = (arrays[key] for key in ("cost", "told", "owner", "seconds"))
    lengths = len(told) == len(owner) == len(seconds) > 0 and told.sum() == len(cost)
    return bool(
        lengths and (told >= 0).all() and not np.isnan(cost).any() and ((seconds >= 0) & (seconds < np.inf)).all()
    )


def front_page(study: Study, found: Front, values: dict[str, Any], commands: Commands) -> str:
    """The front as one HTML file beside the folder points/. Raises ConfigError if SOURCE_DATE_EPOCH is not a time."""
    cheapest = found.points[0]
    best = found.points[-1]
    tried = [one for one in found.candidates if one.evaluations]
    return render(
        "front.html",
        title=f"Front: {study.name}",
        about=f"{counted(len(found.points), 'rig')} on the front of price and objective, of "
        f"{counted(len(found.candidates), 'combination')} of sensors; by lidarcfg {__version__} on {date()}",
        summary=[
            Figure("The cheapest rig", price(cheapest.combination.price), _what(cheapest)),
            Figure("The best rig", price(best.combination.price), _what(best)),
            Figure("Evaluations", f"{found.evaluations:,}", f"{_spent(found)} on the front's combinations"),
        ],
        objective=describe_objective(study),
        plot=front_svg(study, found),
        points=_points_table(study, found),
        candidates=_candidates_table(found),
        untried=len(found.candidates) - len(tried),
        search=[
            ("solver", describe_solver(study)),
            ("evaluations", f"{found.evaluations:,}"),
            ("… of combinations that are not on the front", f"{found.dominated_evaluations:,}"),
        ],
        commands=commands,
        interrupted=found.interrupted,
        repeat=[
            ("seed", values["seed"]),
            ("versions", versions()),
            ("seconds", f"{found.seconds:.2f}"),
            ("date", date()),
        ],
        study_yaml=yaml_text(study.file),
    )


def _what(point: Point) -> str:
    return f"{point.combination.sensors}: objective {point.placement.objective:.4f}"


def _spent(found: Front) -> str:
    return f"{1 - found.dominated_evaluations / max(found.evaluations, 1):.0%}"


def _points_table(study: Study, found: Front) -> Table:
    rows = []
    for point in found.points:
        name = point.combination.name
        evaluation = point.placement.evaluation
        link = Markup('<a href="points/{}/report.html">{}</a>').format(quote(name), name)
        rows.append(
            [
                price(point.combination.price),
                f"{point.placement.objective:.6f}",
                point.combination.sensors,
                f"{evaluation.max_vsr_m:.6f}",
                *(f"{evaluation.detection[item.name].rate:.4f}" for item in study.detection),
                link,
            ]
        )
    head = ("price", "objective", "sensors", "max VSR (m)", *(f"detection of {i.name}" for i in study.detection))
    caption = "The rigs that no other is both cheaper and better than; each has a report of its own."
    return Table(caption, (*head, "report"), rows, texts=(2, len(head)))


def _candidates_table(found: Front) -> Table:
    rows = [
        [
            price(one.combination.price),
            one.combination.sensors,
            f"{one.objective:.6f}" if math.isfinite(one.objective) else "–",
            f"{one.evaluations:,}",
            _standing(found, one),
        ]
        for one in found.candidates
    ]
    head = ("price", "sensors", "objective", "evaluations", "standing")
    return Table("All combinations; of those not on the front few rigs were evaluated.", head, rows, texts=(1, 4))


def _standing(found: Front, one: Candidate) -> str:
    """Whether it is on the front, or which point dominates it."""
    if one.on_front:
        return "on the front"
    if not math.isfinite(one.objective):
        return "no rig keeps the constraints" if one.evaluations else "not tried"
    better = [point for point in found.points if point.combination.price <= one.combination.price][-1]
    return f"dominated by {better.combination.sensors}, {price(better.combination.price)}"
