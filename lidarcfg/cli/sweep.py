"""lidarcfg sweep: many searches, on many processors or machines."""

import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.options import FILE, quiet_option, warn
from lidarcfg.cli.progress import duration, progress
from lidarcfg.errors import ConfigError

if TYPE_CHECKING:
    from lidarcfg.report.sweep import SweepFolder
    from lidarcfg.search.sweep import CaseResult
    from lidarcfg.search.sweep_plan import SweepCase, SweepPlan
    from lidarcfg.search.workers import Workers


@dataclass(frozen=True)
class WorkerOptions:
    """Local processes, or the workers of a cluster."""

    scheduler: str | None  # of a cluster
    processes: int  # where there is none

    def workers(self) -> "Workers":
        """Start local ones, or connect to a cluster's. Raises ConfigError."""
        from lidarcfg.search.workers import Cluster, Processes

        return Cluster(self.scheduler) if self.scheduler else Processes(self.processes)


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg sweep data/studies/trend.yaml -o out/trend --dry-run
    """
)
@cloup.argument("plan", type=FILE, help="YAML: a study, and the values to try for some of its keys.")
@cloup.option_group(
    "Workers",
    cloup.option(
        "--workers", type=click.IntRange(1, 1024), metavar="N", help="Local processes.  [default: one per core]"
    ),
    cloup.option("--scheduler", metavar="ADDRESS", help="The Dask scheduler of a cluster: tcp://HOST:PORT."),
)
@cloup.option("--dry-run", is_flag=True, help="Only print the number of runs and an estimate of their time.")
@cloup.option("-o", "--output", type=FILE, metavar="DIR", help="Folder for the results.  [default: out/PLAN]")
@quiet_option
def sweep(
    plan: Path, output: Path | None, workers: int | None, scheduler: str | None, dry_run: bool, quiet: bool
) -> None:
    """Search once for every combination of values of a study's keys.

    Writes a table with one row per run, a plot, and the rig of each run. If the command is interrupted, run it again:
    it does only the missing runs. The result depends neither on the number of workers nor on where they run.
    """
    from lidarcfg.report.sweep import SweepFolder
    from lidarcfg.search.sweep_plan import load_plan

    if scheduler and workers:
        raise click.UsageError("--workers are local; a cluster has as many as its scheduler knows")
    with progress(quiet) as on_progress:
        loaded = load_plan(plan, lambda n, count: on_progress(n / count, f"checked {n} of {count} runs"))
    folder = output or Path("out") / loaded.path.stem
    kept = SweepFolder(folder, loaded)
    missing = [run for run in loaded.runs if not kept.row(run)]
    if not quiet:
        click.echo(f"{len(loaded.runs)} runs, {len(loaded.runs) - len(missing)} of them done")
    options = WorkerOptions(scheduler, min(workers or _processors(), max(len(missing), 1)))
    if dry_run:
        _estimate(loaded, missing, options, quiet)
        return
    kept.start()
    failed = 0
    try:
        if missing:
            failed = _run_missing(loaded, missing, kept, options, quiet)
    finally:
        written = kept.save_tables()
    if failed:
        warn(f"{failed} runs have no rig; the column error of the table says why")
    if not quiet:
        click.echo(f"written to {folder}/: {' '.join(written)} runs/")
        if "table.parquet" not in written:
            click.echo("there is no table.parquet without pyarrow; pip install 'lidarcfg[sweep]'")


def _processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _run_missing(
    plan: "SweepPlan", runs: list["SweepCase"], kept: "SweepFolder", options: WorkerOptions, quiet: bool
) -> int:
    """Do the missing runs and save their results; returns how many found no rig."""
    from lidarcfg.search.sweep import sweep

    failed = 0
    finished = len(plan.runs) - len(runs)
    with progress(quiet, mean_over_s=math.inf) as on_progress:

        def show() -> None:
            what = f"{finished} of {len(plan.runs)} runs" + (f", {failed} without a rig" if failed else "")
            on_progress(finished / len(plan.runs), what)

        def done(run: "SweepCase", outcome: "CaseResult") -> None:
            nonlocal failed, finished
            kept.save(run, outcome)
            failed += outcome.rig is None
            finished += 1
            show()

        show()
        workers = options.workers()
        try:
            sweep(plan, runs, workers, done)
        finally:
            workers.close()
    return failed


def _estimate(plan: "SweepPlan", runs: list["SweepCase"], options: WorkerOptions, quiet: bool) -> None:
    """Print an estimate of how long some runs of a plan take."""
    from lidarcfg.search.sweep import Pace, pace, size

    workers = options.workers()
    count = workers.count
    workers.close()
    paces: dict[str, Pace | None] = {}
    seconds = [0.0]
    with progress(quiet) as on_progress:
        for n, run in enumerate(runs):
            key = size(run.file)
            if key not in paces:
                on_progress(n / len(runs), f"timing run {run.number} of {len(plan.runs)}")
                try:
                    paces[key] = pace(plan.studies.of(run.file))
                except ConfigError:
                    paces[key] = None
            if found := paces[key]:
                seconds.append(found.seconds(run.file.solver))
    took = duration(max(sum(seconds) / count, *seconds))
    click.echo(f"about {took} with {count} workers, estimated by a short search of each of {len(paces)} sizes")
    if unknown := len(runs) - len(seconds) + 1:
        click.echo(f"{unknown} runs are not counted: their short search found no rig")
