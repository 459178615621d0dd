"""The results of a sweep in a folder: a folder for each run, and all of them in one table and a plot."""

import json
from collections.abc import Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.report.canvas import dashes, label
from lidarcfg.report.plots import COLOURS, new_figure, save_figure
from lidarcfg.report.results import check_writable, to_json
from lidarcfg.report.table import Column, Table
from lidarcfg.search.sweep import CaseResult
from lidarcfg.search.sweep_plan import SweepCase, SweepPlan, shown
from lidarcfg.search.workers import versions
from lidarcfg.sensors.rig import save_rig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RunRow = dict[str, Any]  # of the table, by column
PLAN = "plan.json"
TABLES = ("table.csv", "table.parquet")
PLOT = "sweep.png"
SEED = "solver.seed"
LINES_MAX = 16  # more cannot be told apart
LAST = ("rig", "version", "error", "seconds")  # columns at the end; only seconds differ between sweeps


class SweepFolder:
    """The results of a plan's runs. A run is done once its result.json exists, which is written last."""

    def __init__(self, folder: Path, plan: SweepPlan) -> None:
        """Raises ConfigError if it holds the runs of another plan."""
        self.folder = folder
        self._plan = plan
        self._failed: dict[int, RunRow] = {}  # of runs that another attempt may complete
        known = folder / PLAN
        self._about = to_json({"study": plan.study, "varied": sorted(plan.varied)}) + "\n"
        if known.exists() and known.read_bytes() != self._about.encode():
            raise ConfigError(f"{known}: of another plan, with another study or other keys; give another folder")
        self._plain = {path for path in plan.varied if _is_plain([run.values[path] for run in plan.runs])}

    def start(self) -> None:
        """Make the folder. Raises OSError now, not after hours, if it cannot be written into."""
        check_writable(self.folder, (PLAN, *TABLES, PLOT))
        with replacing(self.folder / PLAN) as file:
            file.write(self._about)

    def row(self, run: SweepCase) -> RunRow | None:
        """A run's row of the table, or None if it is not done."""
        with suppress(OSError, ValueError):
            found = json.loads((self._at(run) / "result.json").read_text())
            if isinstance(found, dict):
                return self._row(run, found)
        return self._failed.get(run.number)

    def save(self, run: SweepCase, outcome: CaseResult) -> None:
        """Save the result of a run, unless another attempt may end otherwise."""
        found = outcome.figures | {"rig": None, "version": versions()["lidarcfg"], "error": outcome.error or None}
        if outcome.rig:
            found["rig"] = f"runs/{run.digest}/rig.yaml"
            save_rig(outcome.rig, self._at(run) / "rig.yaml")
        found["seconds"] = round(outcome.seconds, 3)
        if not outcome.lasting:
            self._failed[run.number] = self._row(run, found)
            return
        with replacing(self._at(run) / "result.json") as file:
            file.write(to_json(found) + "\n")

    def save_tables(self) -> list[str]:
        """Write the rows of all done runs to table.csv, with pyarrow also to table.parquet, and plot them.

        Returns the files' names.
        """
        rows = [row for run in self._plan.runs if (row := self.row(run))]
        if not rows:
            return []
        table = runs_table(rows)
        with replacing(self.folder / TABLES[0]) as file:
            table.write_csv(file, digits=None)
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError:
            return [TABLES[0], *self._save_plot(rows)]
        with replacing(self.folder / TABLES[1], "wb") as file:
            pyarrow.parquet.write_table(pyarrow.Table.from_pylist(table.records), file)
        return [*TABLES, *self._save_plot(rows)]

    def _save_plot(self, rows: list[RunRow]) -> list[str]:
        """Write sweep.png, if there is anything to plot."""
        found = {row["run"]: row.get("cost") for row in rows}
        is_max_vsr = all(row.get("cost") == row.get("max_vsr_m") for row in rows)
        figure = draw_sweep(self._plan, [found.get(run.number) for run in self._plan.runs], is_max_vsr)
        if figure is None:
            return []
        save_figure(figure, self.folder / PLOT)
        return [PLOT]

    def _at(self, run: SweepCase) -> Path:
        return self.folder / "runs" / run.digest

    def _row(self, run: SweepCase, found: RunRow) -> RunRow:
        values = {
            path: value if path in self._plain or value is None else json.dumps(value, ensure_ascii=False)
            for path, value in run.values.items()
        }
        return {"run": run.number, **values, **found}


def runs_table(rows: Sequence[RunRow]) -> Table:
    """A row for each run; what one of them has not is none."""
    keys = [*dict.fromkeys(key for row in rows for key in row if key not in LAST), *LAST]
    return Table("The runs of a sweep", list(map(Column, keys)), [[row.get(key) for key in keys] for row in rows])


def _is_plain(values: list[Any]) -> bool:
    """Whether values are all numbers, all texts or all booleans; others are JSON in the table."""
    kinds = {type(value) for value in values if value is not None}
    return kinds <= {int, float} or kinds in ({str}, {bool})


def draw_sweep(plan: SweepPlan, costs: Sequence[float | None], is_max_vsr: bool) -> "Figure | None":
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
