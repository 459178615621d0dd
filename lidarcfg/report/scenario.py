"""A scenario's outcome as a plot of returns over time, and its drives as files that `export` and `view` take."""

import os
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.config.document import yaml_text
from lidarcfg.files import replacing
from lidarcfg.report.plots import COLOURS, new_figure
from lidarcfg.requirements.scenarios.run import ScenarioCase, ScenarioResult, ScenarioRun
from lidarcfg.sensors.rig import Mount, Rig, save_rig
from lidarcfg.world.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
NONE = 0.5  # where the logarithmic axis has no returns


def draw_scenario(found: ScenarioResult) -> "Figure":
    """Returns in each frame over the time before the impact, an axes for each speed and impact.

    The worst run is a line with its frames, the other starts are thin. Vertical lines are the last moment to brake, the
    worst run's detection, and the earliest line of sight.
    """
    figure = new_figure(3.6 * min(len(found.cases), COLUMNS), 2.6 * scenario_rows(found) + 0.7)
    draw_scenario_on(figure, found)
    figure.suptitle(found.scenario.name, parse_math=False)
    figure.draw_without_rendering()  # a layout is whole the second time, with the sizes of all labels
    return figure


def scenario_rows(found: ScenarioResult) -> int:
    """The rows of axes in a plot."""
    return ceil(len(found.cases) / COLUMNS)


def draw_scenario_on(figure: "Figure", found: ScenarioResult) -> None:
    """The plot on a figure."""
    rows = scenario_rows(found)
    columns = min(len(found.cases), COLUMNS)
    most = max(run.returns.max(initial=found.rule.returns) for case in found.cases for run in case.runs)
    for number, case in enumerate(found.cases):
        axes = figure.add_subplot(rows, columns, number + 1)
        _draw_case(axes, found, case)
        _count_axis(axes, int(most))
        if number % COLUMNS == 0:
            axes.set_ylabel("returns in a frame")
        if number >= len(found.cases) - columns:
            axes.set_xlabel("seconds before the impact")
    lines = {str(line.get_label()): line for axes in figure.axes for line in axes.lines}
    shown = {name: line for name, line in lines.items() if not name.startswith("_")}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=3, fontsize=8)


def _count_axis(axes: "Axes", most: int) -> None:
    """The axis of returns, logarithmic, with a place for none; the same in all axes."""
    powers = [10**n for n in range(len(str(most)))]
    axes.set(yscale="log", ylim=(0.8 * NONE, 1.6 * most))
    axes.set_yticks([NONE, *powers], ["0", *(f"{power:,}" for power in powers)])


def _draw_case(axes: "Axes", found: ScenarioResult, case: ScenarioCase) -> None:
    worst = case.worst
    for run in case.runs:
        before_s = run.approach.lead_s - run.frame_end_s
        returns = np.maximum(run.returns, NONE)
        if run is worst:
            axes.plot(before_s, returns, color=COLOURS[0], marker="o", ms=3, label="worst run", zorder=3)
        else:
            axes.plot(before_s, returns, color="0.7", lw=0.6, label="other runs")
    axes.axhline(found.rule.returns, color=COLOURS[7], ls=":", label=f"{found.rule.returns} returns are a detection")
    axes.axvline(worst.needed_s, color=COLOURS[5], label="last moment to brake")
    if worst.detected_s is not None:
        axes.axvline(worst.needed_s + worst.margin_s, color=COLOURS[2], ls="--", label="detected")
    if case.sight_margin_s is not None:
        axes.axvline(worst.needed_s + case.sight_margin_s, color=COLOURS[1], ls="-.", label="earliest line of sight")
    left_s = max(2 * worst.needed_s, worst.needed_s + worst.margin_s, worst.needed_s + (case.sight_margin_s or 0.0))
    axes.set_xlim(min(1.1 * left_s, 1.02 * case.runs[0].approach.lead_s), 0.0)  # the first run is the longest
    margin_m = worst.approach.closing_m_s * worst.margin_s
    where = f", hit at {case.impact:.0%}\n" if len(found.scenario.file.impacts) > 1 else ": "  # too long for one line
    axes.set_title(f"{case.speed_km_h:g} km/h{where}{worst.margin_s:+.2f} s, {margin_m:+.1f} m", fontsize=9)
    axes.grid(alpha=0.3)


@dataclass(frozen=True)
class DriveFiles:
    """The files of a run, and when in it what happens."""

    rig: Path
    scene: Path
    trajectory: Path
    duration_s: float  # to the impact
    last_s: float  # the last moment to brake, since the start
    detected_s: float | None  # None: never


def save_drive(run: ScenarioRun, mounts: tuple[Mount, ...], vehicle: Vehicle, folder: Path) -> DriveFiles:
    """Write rig, scene and trajectory of a run: `export` of them has the same returns in each frame. Raises OSError."""
    found = DriveFiles(
        rig=folder / "rig.yaml",
        scene=folder / "scene.yaml",
        trajectory=folder / "trajectory.yaml",
        duration_s=run.approach.lead_s,
        last_s=run.last_s,
        detected_s=run.detected_s,
    )
    kept = tuple(mount for number, mount in enumerate(mounts) if number not in run.lost)
    save_rig(Rig(run.approach.scenario.name, kept, vehicle.section), found.rig)
    scene = run.approach.scene_file.model_dump(mode="json", exclude_defaults=True)
    for mesh in scene.get("meshes", ()):
        mesh["file"] = os.path.relpath(mesh["file"], os.path.realpath(folder))
    motion = run.approach.motion.model_dump(mode="json", exclude_defaults=True)
    for path, values in ((found.scene, scene), (found.trajectory, motion)):
        with replacing(path) as file:
            file.write(yaml_text(values))
    return found
