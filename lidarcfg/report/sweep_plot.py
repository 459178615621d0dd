"""A sweep as a plot: the cost against one key, a line for each combination of the others."""

from collections.abc import Sequence
from itertools import product
from statistics import median
from typing import TYPE_CHECKING, Any

from lidarcfg.placement.plan import Plan, shown
from lidarcfg.report.canvas import dashes, label
from lidarcfg.report.plots import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEED = "solver.seed"
LINES_MAX = 16  # more cannot be told apart


def draw_sweep(plan: Plan, costs: Sequence[float | None], is_max_vsr: bool) -> "Figure | None":
    """The costs of a plan's runs against its last key with numbers: medians over seeds, least to greatest shaded.

    None if there is nothing to draw: no such key, no cost, or too many lines.
    """
    values = {path: _distinct([run.values[path] for run in plan.runs]) for path in plan.varied if path != SEED}
    values = {path: found for path, found in values.items() if len(found) > 1}
    numbers = [path for path, found in values.items() if all(type(value) in (int, float) for value in found)]
    if not numbers or all(cost is None for cost in costs):
        return None
    across = numbers[-1]
    others = [path for path in values if path != numbers[-1]]
    lines = list(product(*(values[path] for path in others)))
    if len(lines) > LINES_MAX:
        return None
    drawn = sum(cost is not None for cost in costs)
    figure = new_figure(7, 4.2)
    axes = figure.subplots()
    for line in lines:
        at: dict[float, list[float]] = {}
        for run, cost in zip(plan.runs, costs, strict=True):
            if cost is not None and all(run.values[path] == value for path, value in zip(others, line, strict=True)):
                at.setdefault(run.values[across], []).append(cost)
        x = sorted(at)
        place = [values[path].index(value) for path, value in zip(others, line, strict=True)]
        colour = COLOURS[place[-1] % len(COLOURS)] if place else COLOURS[0]
        ls = dashes(sum(place[:-1]))
        name = ", ".join(_name(path, value, values[path]) for path, value in zip(others, line, strict=True))
        axes.plot(x, [median(at[v]) for v in x], marker="o", ms=4, color=colour, ls=ls, label=label(name, 40))
        axes.fill_between(x, [min(at[v]) for v in x], [max(at[v]) for v in x], color=colour, alpha=0.15, lw=0)
    ticks = {"xticks": values[across]} if len(values[across]) <= 12 else {}
    axes.set(xlabel=across, ylabel="max VSR (m)" if is_max_vsr else "cost", ylim=(0, None), **ticks)
    axes.set_title(f"{plan.path.stem}: {drawn} runs; median, least to greatest", parse_math=False)
    axes.grid(alpha=0.3)
    if others:
        axes.legend(fontsize=8, handlelength=3.5, loc="upper left", bbox_to_anchor=(1.0, 1.0))  # beside all lines
    return figure


def _distinct(values: Sequence[Any]) -> list[Any]:
    """Each value once, in the order of the first; maps have no hashes."""
    found: list[Any] = []
    for value in values:
        if value not in found:
            found.append(value)
    return found


def _name(path: str, value: Any, values: list[Any]) -> str:
    """A value in the legend: numbers and texts as they are, others by their number."""
    key = path.rpartition(".")[2]
    if value is None:
        return f"no {key}"
    if isinstance(value, dict | tuple):
        rest = [one for one in values if one is not None]
        return key if len(rest) == 1 else f"{key} {rest.index(value) + 1}"
    return shown(value) if isinstance(value, str) else f"{key} {shown(value)}"
