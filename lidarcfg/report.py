"""A result as JSON, table and plots. Every run's folder says what was asked, with seed and version."""

import csv
import json
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from lidarcfg import __version__
from lidarcfg.config import replacing
from lidarcfg.errors import ConfigError
from lidarcfg.placement.analytic import Analytic
from lidarcfg.placement.lidar import rig_lidars
from lidarcfg.placement.optimize import Log, Placement
from lidarcfg.placement.study import BUDGETS, Evaluation, Study
from lidarcfg.rig import Rig, rig_to_dict, save_rig
from lidarcfg.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TABLE_KEYS = {"elevation_deg", "azimuth_offset_deg", "vertical_offset_mm", "offset_ns"}
# Okabe and Ito's colours, told apart by colour-blind people
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")


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


def save_evaluation(study: Study, rig: Rig, found: Evaluation, folder: Path) -> None:
    """Write result.json and rig.png into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_json(evaluation_dict(study, rig, found), folder / "result.json")
    save_figure(draw_rig(study, rig, found), folder / "rig.png")


def save_placement(study: Study, found: Placement, folder: Path) -> None:
    """Write rig.yaml, search.npz, result.json, history.csv, convergence.png and rig.png into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    save_progress(study, found.rig, found.log, folder)
    _write_json(placement_dict(study, found), folder / "result.json")
    with replacing(folder / "history.csv") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(asdict(found.history[0]))
        writer.writerows(asdict(cycle).values() for cycle in found.history)
    save_figure(draw_convergence(study, found), folder / "convergence.png")
    save_figure(draw_rig(study, found.rig, found.evaluation), folder / "rig.png")


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


def _write_json(values: dict[str, Any], path: Path) -> None:
    with replacing(path) as file:
        file.write(to_json(values) + "\n")


def save_figure(figure: "Figure", path: Path) -> None:
    """As a PNG, whole or not at all."""
    with replacing(path, "wb") as file:
        figure.savefig(file, format="png", dpi=120)


def new_figure(width_in: float, height_in: float) -> "Figure":
    """An empty figure, in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def draw_convergence(study: Study, found: Placement) -> "Figure":
    """Best and mean max VSR of the food sources over the evaluations (the paper's figure 4)."""
    figure = new_figure(7, 4)
    axes = figure.subplots()
    evaluations = [cycle.evaluations for cycle in found.history]
    axes.plot(evaluations, [cycle.best for cycle in found.history], color=COLOURS[0], label="best")
    axes.plot(evaluations, [cycle.mean for cycle in found.history], color=COLOURS[5], label="mean of the swarm")
    if study.objective.is_max_vsr:
        axes.axhline(found.middle_max_vsr_m, color="0.5", ls=":", label="middle of the bounds")
    label = "max VSR (m)" if study.objective.is_max_vsr else "objective"
    axes.set(xlabel="evaluations", ylabel=label, ylim=(0, None))
    axes.set_title(
        f"{study.name}: {found.evaluation.max_vsr_m:.4f} m, {study.solver.method}, seed {study.solver.seed}",
        parse_math=False,
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def draw_rig(study: Study, rig: Rig, found: Evaluation) -> "Figure":
    """The rig from top, side and front: region, exclusions, the worst subspace, each sensor and its axis."""
    region = study.region
    figure = new_figure(11, 7)
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 1))
    views = ((0, 1, grid[0, :]), (0, 2, grid[1, 0]), (1, 2, grid[1, 1]))
    worst = int(found.vsr_m.argmax())
    for across, up, place in views:
        axes = figure.add_subplot(place)
        hidden = ({0, 1, 2} - {across, up}).pop()
        left, right = float(region.min_m[across]), float(region.max_m[across])
        bottom, top = float(region.min_m[up]), float(region.max_m[up])
        for mask, colour in (
            ((~region.included).any(axis=hidden), (0.6, 0.6, 0.6)),
            ((found.subspaces.label == worst).any(axis=hidden), (0.84, 0.37, 0.0)),
        ):
            picture = np.zeros((*mask.T.shape, 4))
            picture[..., :3] = colour
            picture[..., 3] = 0.45 * mask.T
            axes.imshow(
                picture,
                extent=(left, right, bottom, top),
                origin="lower",
                aspect="auto",
                interpolation="nearest",
            )
        _draw_sensors(axes, rig, across, up, 0.12 * (top - bottom))
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
        axes.set_title({2: "top", 1: "side", 0: "front"}[hidden] + ("" if hidden == 2 else " (height stretched)"))
    figure.axes[0].legend(loc="upper right")
    title = f"{rig.name}: max VSR {found.max_vsr_m:.4f} m; its subspace orange, left out grey"
    figure.suptitle(title, parse_math=False)
    return figure


def _draw_sensors(axes: "Axes", rig: Rig, across: int, up: int, length: float) -> None:
    for i, (mount, cones) in enumerate(zip(rig.mounts, rig_lidars(rig), strict=True)):
        colour, at = COLOURS[i % len(COLOURS)], cones.position_m
        axes.plot(at[across], at[up], "o", color=colour, ms=5, label=mount.name, zorder=3)
        tip = at + cones.axis * length
        arrow = {"arrowstyle": "->", "color": colour, "lw": 1.5}
        axes.annotate("", xy=(tip[across], tip[up]), xytext=(at[across], at[up]), arrowprops=arrow, zorder=3)


def _console() -> Console:
    """Standard output; as wide as the terminal, or wide enough for the tables where there is none."""
    return Console(width=None if sys.stdout.isatty() else 110, highlight=False, markup=False, emoji=False)


def print_placement(found: Placement) -> None:
    """The search in short, then the rig and what it is worth."""
    search = Table(box=SIMPLE, show_header=False)
    search.add_row("max VSR, middle of the bounds", f"{found.middle_max_vsr_m:.4f} m")
    search.add_row("max VSR, optimised", f"{found.evaluation.max_vsr_m:.4f} m")
    search.add_row("evaluations", f"{found.evaluations:,}")
    search.add_row("seconds", f"{found.seconds:.1f}")
    _console().print(search)
    print_evaluation(found.rig, found.evaluation)


def print_evaluation(rig: Rig, found: Evaluation) -> None:
    """The rig, its max VSR and detection rates, and the worst subspaces."""
    console = _console()
    poses = Table("sensor", "x (m)", "y (m)", "z (m)", "roll (°)", "pitch (°)", "yaw (°)", box=SIMPLE)
    for mount in rig.mounts:
        angles = np.degrees(mount.rpy_rad)
        poses.add_row(mount.name, *(f"{v:.3f}" for v in mount.position_m), *(f"{v:.2f}" for v in angles))
    console.print(poses)
    console.print(f"max VSR {found.max_vsr_m:.6f} m in {len(found.subspaces):,} subspaces")
    if found.analytic:
        console.print(analytic_line(found.analytic))
    for name, detection in found.detection.items():
        how = f"± {detection.half_width:.4f}, {detection.places:,} places drawn"
        if not detection.half_width:
            how = f"all {detection.places:,} places counted"
        console.print(f"detection rate of {name}: {detection.rate:.4f} ({how})")
    worst = Table(
        "VSR (m)", "volume (m³)", "inner radius (m)", "centroid (m)", "between the beams at (°), by sensor", box=SIMPLE
    )
    for space in found.worst:
        worst.add_row(
            f"{space.vsr_m:.4f}",
            f"{space.volume_m3:.2f}",
            f"{space.inscribed_radius_m:.3f}",
            ", ".join(f"{v:.2f}" for v in space.centroid_m),
            "  ".join(f"{_degrees(low)}…{_degrees(high)}" for low, high in space.between_deg),
        )
    console.print("the worst subspaces:")
    console.print(worst)


def analytic_line(found: Analytic) -> str:
    """The analytic max VSR, its error bar, and whether that is what was asked for."""
    edges = " × ".join(f"{edge:g}" for edge in found.cuboid_m)
    reached = f"within the tolerance of {found.tolerance:.3g}"
    if not found.reached:
        share = found.error_m / found.max_vsr_m
        reached = f"NOT within the tolerance of {found.tolerance:.3g}, but of {share:.2g}: no finer grid is tried"
    return (
        f"analytic max VSR {found.max_vsr_m:.6f} ± {found.error_m:.6f} m, {reached} "
        f"({found.cuboids:,} cuboids of {edges} m, {found.seconds:.2f} s)"
    )


def _degrees(angle: float | None) -> str:
    return "" if angle is None else f"{angle:g}"


def print_sensors(sensors: Sequence[Sensor]) -> None:
    """One line a model."""
    table = Table("name", "beams", "elevation (°)", "range (m)", "simulated", "description", box=SIMPLE)
    for sensor in sensors:
        low, high = min(sensor.beams.elevation_deg), max(sensor.beams.elevation_deg)
        table.add_row(
            sensor.name,
            str(sensor.count),
            f"{low:g} to {high:g}",
            f"{sensor.range.min_m:g} to {sensor.range.max_m:g}" if sensor.range else "–",
            "yes" if sensor.packet else "no",
            sensor.description,
        )
    _console().print(table)


def print_sensor(sensor: Sensor) -> None:
    """All that is known of a model: the beam table, then every fact with its source."""
    console = _console()
    console.print(f"{sensor.name}  {sensor.maker}  {sensor.description}", style="bold")
    table = Table("laser", "ring", "elevation (°)", "azimuth (°)", "height (mm)", "fires at (ns)", box=SIMPLE)
    for laser in range(sensor.count):
        table.add_row(
            str(laser),
            str(sensor.ring[laser]),
            f"{sensor.beams.elevation_deg[laser]:g}",
            f"{sensor.beams.azimuth_offset_deg[laser]:g}" if sensor.beams.azimuth_offset_deg else "0",
            f"{sensor.beams.vertical_offset_mm[laser]:g}" if sensor.beams.vertical_offset_mm else "0",
            str(sensor.firing.offset_ns[laser]) if sensor.firing else "–",
        )
    console.print(table)
    facts = sensor.model_dump(mode="json", exclude_none=True)
    for part in ("beams", "firing", "rotation", "range", "optics", "packet", "position_packet"):
        values = facts.get(part, {})
        source = values.pop("source", "")
        shown = {key: value for key, value in values.items() if key not in TABLE_KEYS}
        if values:
            console.print(f"{part}  " + "  ".join(f"{k}: {v}" for k, v in shown.items()))
            console.print(f"  source: {source.strip()}", style="dim")
