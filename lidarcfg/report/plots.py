"""Pictures in PNG: the course of a search, and the rig in its region."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidarcfg.files import replacing
from lidarcfg.report.describe import cost_label
from lidarcfg.report.text import DRAWN, summarize, truncate
from lidarcfg.sensors.rig import Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lidarcfg.search.run import Placement
    from lidarcfg.study.evaluation import Evaluation
    from lidarcfg.study.study import Study

# Okabe and Ito's colours, which colour-blind people can tell apart
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
DPI = 120
CUT_OFF = 4  # times the best found


def save_figure(figure: "Figure", path: str | Path) -> None:
    """Write a PNG, whole or not at all."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(DPI)
    canvas: Any = FigureCanvasAgg(figure)  # matplotlib has no types here
    with replacing(path, "wb") as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s)Glyph .* missing")  # of a name: a box stands for it
        canvas.print_png(file)  # `savefig` draws twice


def new_figure(width_in: float, height_in: float) -> "Figure":
    """An empty figure, in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def history_top(study: "Study", found: "Placement") -> float | None:
    """The top of the drawing of a search: rigs that break the constraints cost far more than any other."""
    shown = [value for cycle in found.history for value in (cycle.best, cycle.mean)]
    shown += [found.midpoint_max_vsr_m] if study.is_max_vsr else []
    if found.believed and study.is_misses:
        return max(min(1.05 * max(shown), CUT_OFF * found.history[-1].best), 1.2 * found.objective) or None
    return min(1.05 * max(shown), CUT_OFF * found.history[-1].best) or None


def search_view(axes: "Axes", study: "Study", found: "Placement") -> None:
    """Best and mean of a search over its evaluations (the paper's figure 4)."""
    evaluations = [cycle.evaluations for cycle in found.history]
    dot = "o" if len(evaluations) < 3 else ""
    axes.plot(evaluations, [cycle.mean for cycle in found.history], marker=dot, color=COLOURS[5], label="mean")
    axes.plot(evaluations, [cycle.best for cycle in found.history], marker=dot, color=COLOURS[0], label="best")
    top = history_top(study, found)
    if study.is_max_vsr:
        midpoint_m = found.midpoint_max_vsr_m
        beyond = f" (above: {midpoint_m:.3f} m)" if top is not None and midpoint_m > top else ""
        axes.axhline(midpoint_m, color="0.4", ls=":", lw=1, label=f"midpoint of the bounds{beyond}")
    if found.believed:
        axes.axhline(found.objective, color="0.4", ls=":", lw=1, label="the rig chosen, at fresh places")
    axes.set(xlabel="evaluations", ylabel=cost_label(study), ylim=(0, top))
    axes.grid(True)
    axes.legend(loc="best")


def draw_convergence(study: "Study", found: "Placement") -> "Figure":
    """The course of a search."""
    figure = new_figure(7, 4)
    axes = figure.subplots()
    search_view(axes, study, found)
    how = f"{study.solver.method}, seed {study.solver.seed}"
    misses = found.evaluation.misses
    value = f"misses {misses.mean:.2%}" if misses else f"max VSR {found.evaluation.max_vsr_m:.4f} m"
    axes.set_title(f"{truncate(study.name)}: {value}, {how}", parse_math=False)
    axes.grid(alpha=0.3)
    return figure


def draw_rig(study: "Study", rig: Rig, found: "Evaluation") -> "Figure":
    """The rig from top, side and front: region, exclusions, the worst subspace, each sensor and its axis."""
    from matplotlib.lines import Line2D

    region = study.region
    figure = new_figure(11, 7)
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 1))
    views = ((0, 1, grid[0, :]), (0, 2, grid[1, 0]), (1, 2, grid[1, 1]))
    for across, up, place in views:
        axes = figure.add_subplot(place)
        hidden = ({0, 1, 2} - {across, up}).pop()
        left = float(region.min_m[across])
        right = float(region.max_m[across])
        bottom = float(region.min_m[up])
        top = float(region.max_m[up])
        _draw_body(axes, study, across, up)
        excluded = region.excluded_lines[hidden] & (study.vehicle is None)  # a vehicle is drawn itself
        for mask, colour in (
            (excluded, (0.6, 0.6, 0.6)),
            (found.extents[0].lines[hidden] > 0, (0.84, 0.37, 0.0)),
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
    dots = figure.axes[0].lines[: len(rig.mounts)]
    named = summarize([truncate(mount.name, DRAWN) for mount in rig.mounts])
    rest = [Line2D([], [], ls="")] * (len(named) < len(dots))
    figure.axes[0].legend([*dots[: len(named) - len(rest)], *rest], named, loc="upper right")
    grey = "the vehicle" if study.vehicle else "excluded"
    misses = f"misses {found.misses.mean:.2%}, " if found.misses else ""
    title = f"{truncate(rig.name)}: {misses}max VSR {found.max_vsr_m:.4f} m; the worst subspace orange, {grey} grey"
    figure.suptitle(title, parse_math=False)
    return figure


def _draw_body(axes: "Axes", study: "Study", across: int, up: int) -> None:
    """The vehicle's bodies, from one side."""
    from matplotlib.collections import PolyCollection

    if study.vehicle:
        vertices, triangles = study.vehicle.scene.mesh()[:2]
        seen = vertices[triangles][:, :, [across, up]]
        axes.add_collection(PolyCollection(list(seen), facecolors="0.75", edgecolors="0.75", lw=0.3, rasterized=True))


def _draw_sensors(axes: "Axes", rig: Rig, across: int, up: int, length: float) -> None:
    from lidarcfg.vsr.cones import rig_lidars  # here, so that a list of sensors does not load the tracer

    for i, cones in enumerate(rig_lidars(rig)):
        colour = COLOURS[i % len(COLOURS)]
        at = cones.position_m
        axes.plot(at[across], at[up], "o", color=colour, ms=5, zorder=3)
        tip = at + cones.axis * length
        arrow = {"arrowstyle": "->", "color": colour, "lw": 1.5}
        axes.annotate("", xy=(tip[across], tip[up]), xytext=(at[across], at[up]), arrowprops=arrow, zorder=3)
