"""The results of a sweep in a folder: a folder for each run, and all of them in one table and a plot."""

import csv
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.placement.plan import Plan, SweepCase, versions
from lidarcfg.placement.sweep import Outcome
from lidarcfg.report.plots import save_figure
from lidarcfg.report.results import check_writable, to_json
from lidarcfg.report.sweep_plot import draw_sweep
from lidarcfg.sensors.rig import save_rig

Row = dict[str, Any]  # of the table, by column
PLAN = "plan.json"
TABLES = ("table.csv", "table.parquet")
PLOT = "sweep.png"
LAST = ("rig", "version", "error", "seconds")  # columns at the end; only seconds differ between sweeps


class SweepFolder:
    """The results of a plan's runs. A run is done once its result.json exists, which is written last."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        """Raises ConfigError if it holds the runs of another plan."""
        self.folder = folder
        self._plan = plan
        self._failed: dict[int, Row] = {}  # of runs that another attempt may complete
        known = folder / PLAN
        self._about = to_json({"study": plan.study, "varied": sorted(plan.varied)}) + "\n"
        if known.exists() and known.read_bytes() != self._about.encode():
            raise ConfigError(f"{known}: of another plan, with another study or other keys; give another folder")
        self._plain = {path for path in plan.varied if _is_plain([run.values[path] for run in plan.runs])}

    def start(self) -> None:
        """Make the folder. Raises OSError at once, not after hours, if it cannot be written into."""
        check_writable(self.folder, (PLAN, *TABLES, PLOT))
        with replacing(self.folder / PLAN) as file:
            file.write(self._about)

    def row(self, run: SweepCase) -> Row | None:
        """A run's row of the table, or None if it is not done."""
        with suppress(OSError, ValueError):
            found = json.loads((self._at(run) / "result.json").read_text())
            if isinstance(found, dict):
                return self._row(run, found)
        return self._failed.get(run.number)

    def save(self, run: SweepCase, outcome: Outcome) -> None:
        """Save the result of a run, unless another attempt may end otherwise."""
        found = outcome.found | {"rig": None, "version": versions()["lidarcfg"], "error": outcome.error or None}
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
        columns = [*dict.fromkeys(key for row in rows for key in row if key not in LAST), *LAST]
        with replacing(self.folder / TABLES[0]) as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError:
            return [TABLES[0], *self._save_plot(rows)]
        table = pyarrow.table({key: [row.get(key) for row in rows] for key in columns})
        with replacing(self.folder / TABLES[1], "wb") as file:
            pyarrow.parquet.write_table(table, file)
        return [*TABLES, *self._save_plot(rows)]

    def _save_plot(self, rows: list[Row]) -> list[str]:
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

    def _row(self, run: SweepCase, found: Row) -> Row:
        values = {
            path: value if path in self._plain or value is None else json.dumps(value, ensure_ascii=False)
            for path, value in run.values.items()
        }
        return {"run": run.number, **values, **found}


def _is_plain(values: list[Any]) -> bool:
    """Whether values are all numbers, all texts or all booleans; others are JSON in the table."""
    kinds = {type(value) for value in values if value is not None}
    return kinds <= {int, float} or kinds in ({str}, {bool})
