"""Pictures in PNG, and the course of a search."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lidarcfg.files import replacing
from lidarcfg.report.describe import cost_label
from lidarcfg.report.text import truncate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lidarcfg.search.run import Placement
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
