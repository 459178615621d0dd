"""lidarcfg optimize: where the sensors should sit."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.evaluate import OnProgress, baseline_of, baseline_option
from lidarcfg.cli.options import (
    FILE,
    SAVE_EVERY_S,
    Seconds,
    command_line,
    quiet_option,
    warn,
    warn_of,
)
from lidarcfg.cli.progress import Interrupts, duration, progress
from lidarcfg.cli.verify import NOT_MET
from lidarcfg.solvers import GONE, SOLVERS

if TYPE_CHECKING:
    from lidarcfg.report.inputs import ReportInputs
    from lidarcfg.search.cheapest import CheapestRun
    from lidarcfg.search.front import FrontRun, Point
    from lidarcfg.search.run import Cycle, Log, Placement
    from lidarcfg.sensors.rig import Rig
    from lidarcfg.solvers.solver import Solver
    from lidarcfg.study.study import Study

QUIET_S = 0.5  # without a cycle's end, before the evaluations are counted on the screen


class Method(click.Choice):  # type: ignore[type-arg]  # the oldest click's is not generic
    """The method of a solver."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The method; of one that is gone, the error says what to use."""
        if value in GONE:
            self.fail(f"{value!r} {GONE[value]}.", param, ctx)
        method: str = super().convert(value, param, ctx)
        return method


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg optimize data/studies/liu2018-4x16.yaml -o out/four \\
          --seed 3 --seconds 60
    """
)
@cloup.argument("study", type=FILE, help="YAML: the region, the sensors and their bounds.")
@cloup.option_group(
    "Search",
    cloup.option(
        "--solver",
        type=Method(tuple(SOLVERS)),
        help="Search method.  [default: the study's]",
    ),
    cloup.option("--seed", type=click.IntRange(0, 2**63 - 1), metavar="N", help="Random seed.  [default: the study's]"),
    cloup.option(
        "--threads",
        type=click.IntRange(1, 1024),
        metavar="N",
        help="Threads; the result is the same.  [default: all cores]",
    ),
    cloup.option(
        "--scheduler",
        metavar="ADDRESS",
        help="The Dask scheduler of a cluster, tcp://HOST:PORT, on which to search for the cheapest rig.",
    ),
    cloup.option("--resume", type=FILE, metavar="DIR", help="Continue the search whose results are in DIR."),
    cloup.option(
        "--start",
        type=FILE,
        metavar="RIG",
        multiple=True,
        help="Begin with this rig, which the result is not worse than; may be given several times.",
    ),
)
@cloup.option_group(
    "Budget",
    cloup.option("--cycles", type=click.IntRange(1), metavar="N", help="Stop after N cycles of the swarm."),
    cloup.option("--evaluations", type=click.IntRange(1), metavar="N", help="Stop after N evaluated rigs."),
    cloup.option("--seconds", type=Seconds(10**9), metavar="SECONDS", help="Stop after this time."),
    help="These replace the study's budget.",
)
@cloup.option("-o", "--output", type=FILE, metavar="DIR", help="Folder for the results.  [default: out/STUDY]")
@baseline_option
@quiet_option
def optimize(
    study: Path,
    output: Path | None,
    seed: int | None,
    threads: int | None,
    solver: str | None,
    cycles: int | None,
    evaluations: int | None,
    seconds: float | None,
    scheduler: str | None,
    resume: Path | None,
    start: tuple[Path, ...],
    baseline: Path | None,
    quiet: bool,
) -> None:
    """Find the poses that meet requirements, or miss least.

    If the study has requirements, the search first looks for a rig that meets them, and verifies the first one that
    seems to. Among those that do, it minimises the objective. Without requirements it minimises the objective from
    the start: by default misses around the vehicle, or max VSR without one. It begins with the plain rigs that an
    engineer would try. If a requirement is not met, the rig that comes closest is still written, and the command exits
    with 3.

    Ctrl-C ends the search and keeps the best rig found. rig.yaml and search.npz are updated every few seconds, so
    --resume can continue even a search that was killed.

    If the study lets sensors be chosen (`choose`), the result is a front: the rigs that no other rig beats in both
    price and objective. front.html shows them, and points/ has a folder for each. All combinations share the budget.
    With requirements, the result is instead the cheapest rig that meets all of them; combinations.csv lists all
    combinations: by how much the best rig of each falls short, or why none of its rigs can meet all.

    --start names a rig of your own within the bounds: the search begins with it, and never ends with a worse one.
    """
    with progress(quiet, keep=False) as on_progress:
        on_progress(0.0, f"reading {study}")
        from lidarcfg.report.comparison import print_comparison, with_baseline
        from lidarcfg.report.document import Commands
        from lidarcfg.report.results import RESULTS, check_writable, load_log, save_placement
        from lidarcfg.report.tables import print_placement
        from lidarcfg.search.achievable import unachievable
        from lidarcfg.study.checks import study_warnings
        from lidarcfg.study.loading import load_study
        from lidarcfg.study.study import with_solver

        budget = {"cycles": cycles, "evaluations": evaluations, "seconds": seconds}
        loaded = with_solver(load_study(study), seed=seed, method=solver, **budget)
        messages = list(study_warnings(study, loaded))
        messages += [f"{study}: {name}: not achievable: {why}" for name, why in unachievable(loaded).items()]
    warn_of(loaded.vehicle)
    for message in messages:
        warn(message)
    folder = output or resume or Path("out") / loaded.name
    if start and resume:
        raise click.UsageError("--start is for a search that begins, and --resume continues one")
    if scheduler and not (loaded.to_choose and loaded.requirements):
        raise click.UsageError(
            "--scheduler is for studies with requirements and models to choose; see sweep for others"
        )
    if loaded.to_choose:
        if baseline:
            raise click.UsageError(
                "--baseline is for one rig, and this study has a front of them; compare these with it"
            )
        if loaded.requirements:
            _find_cheapest(loaded, study, folder, resume, scheduler, threads, quiet, start)
            return
        _find_front(loaded, study, folder, resume, threads, quiet, start)
        return
    log = load_log(loaded, resume) if resume else None
    check_writable(folder, RESULTS)
    with progress(quiet, keep=False) as on_progress:
        beside = baseline_of(loaded, baseline, on_progress)
    with progress(quiet) as on_progress:
        found, shown = _search(loaded, threads, log, folder, on_progress, _rigs(start))
        on_progress(1.0, f"writing {folder}")
        again = _repeat_command(study, folder, loaded.solver, found, start)
        save_placement(loaded, found, shown, folder, Commands(command_line(), again), beside)
    if not quiet:
        print_placement(loaded, found, shown.evaluation)
        if beside:
            print_comparison(loaded, with_baseline(found.rig, folder / "rig.yaml", shown, beside))
        files = "report.html rig.yaml result.json history.csv convergence.png rig.png search.npz"
        click.echo(f"written to {folder}/: {files}")
    if found.interrupted:
        click.echo("interrupted; the best rig found is kept", err=True)
        sys.exit(130)
    if found.verdict and not found.verdict.passed:
        sys.exit(NOT_MET)


def _search(
    study: "Study",
    threads: int | None,
    log: "Log | None",
    folder: Path,
    on_progress: OnProgress,
    starts: "Sequence[Rig]",
) -> "tuple[Placement, ReportInputs]":
    """The best rig, with progress; what is found so far is saved every few seconds."""
    import time

    from lidarcfg.report.inputs import report_inputs
    from lidarcfg.report.results import save_progress
    from lidarcfg.search.optimize import optimize as search
    from lidarcfg.search.run import Budget

    saved_s = time.monotonic()
    shown_s = saved_s
    fraction = 0.0

    def on_cycle(cycle: "Cycle", rig: "Rig", log: "Log") -> None:
        nonlocal saved_s, shown_s, fraction
        fraction = min(budget.fraction(cycle.evaluations, cycle.cycle), 1.0)
        on_progress(fraction, _search_line(cycle))
        shown_s = time.monotonic()
        if shown_s - saved_s > SAVE_EVERY_S:
            save_progress(study, rig, log, folder)
            saved_s = time.monotonic()

    def on_evaluations(count: int) -> None:
        nonlocal shown_s
        if time.monotonic() - shown_s > QUIET_S:  # a cycle takes long
            on_progress(max(fraction, min(budget.fraction(count, 0), 1.0)), f"{count:,} rigs evaluated")
            shown_s = time.monotonic()

    seconds = study.solver.seconds
    on_progress(0.0, "searching" if seconds is None else f"searching for {seconds:g} s; the report comes then")
    budget = Budget.of(study.solver)
    found = search(study, threads, on_cycle, log, on_evaluations=on_evaluations, starts=starts)
    if found.interrupted:
        click.get_current_context().ensure_object(Interrupts).take()
    on_progress(1.0, "evaluating the best rig")
    return found, report_inputs(study, found.rig, found.evaluation, found.midpoint_max_vsr_m)


def _rigs(paths: Sequence[Path]) -> "list[Rig]":
    """The rigs that a search begins with, called as their files."""
    from lidarcfg.sensors.rig import load_rig

    return [replace(load_rig(path), name=str(path)) for path in paths]


def _started(paths: Sequence[Path]) -> list[str | Path]:
    """The words of a command that name these rigs."""
    return [word for path in paths for word in ("--start", path)]


def _repeat_command(study: Path, folder: Path, solver: "Solver", found: "Placement", start: Sequence[Path]) -> str:
    """The command that gives the same rig on any machine, however the search ended."""
    budget = ("--evaluations", max(found.evaluations, 1))
    if solver.cycles is not None and found.history[-1].cycle >= solver.cycles:
        budget = ("--cycles", solver.cycles)
    words = ("lidarcfg", "optimize", study, "-o", folder, "--solver", solver.method, "--seed", solver.seed, *budget)
    return shlex.join(map(str, (*words, *_started(start))))


def _search_line(cycle: "Cycle") -> str:
    """The state of the search."""
    state = f"cycle {cycle.cycle}  best {cycle.best:.4f}  mean {cycle.mean:.4f}"
    if (short := getattr(cycle, "shortfall", 0.0)) > 0:
        state = f"cycle {cycle.cycle}  short by {short:.4f}"
    return f"{state}  {cycle.evaluations / cycle.seconds:,.0f} evaluations/s"


def _plan(run: "CheapestRun", solver: "Solver") -> str:
    """What the search for the cheapest rig will do, and how long it may take."""
    screening = "the plain rigs of each first"
    if run.sweep_s is not None:
        screening += f", about {duration(run.sweep_s)}, and longer where one seems to pass and is verified"
    budget = f"{solver.evaluations:,} evaluations" if solver.evaluations is not None else "its budget"
    if solver.seconds is not None:
        budget = f"{solver.seconds:g} s"
    return f"{len(run.options):,} combinations: {screening}; the search ends after {budget}, and the report comes then"


def _find_cheapest(
    study: "Study",
    path: Path,
    folder: Path,
    resume: Path | None,
    scheduler: str | None,
    threads: int | None,
    quiet: bool,
    start: Sequence[Path],
) -> None:
    """Search for the cheapest rig that meets all requirements, write the folder, print the verdict and the table.

    Exits with 130 after Ctrl-C, and with 3 where a requirement is not met.
    """
    import time

    from lidarcfg.report.cheapest import (
        COMBINATIONS,
        choice_part,
        load_cheapest_log,
        print_cheapest,
        save_cheapest_log,
        save_cheapest_progress,
        save_combinations,
    )
    from lidarcfg.report.document import Commands
    from lidarcfg.report.inputs import report_inputs
    from lidarcfg.report.results import RESULTS, check_writable, save_placement
    from lidarcfg.report.tables import print_placement
    from lidarcfg.search.cheapest import cheapest
    from lidarcfg.search.workers import Cluster

    log = load_cheapest_log(study, resume) if resume else None
    check_writable(folder, (*RESULTS, COMBINATIONS))
    saved_s = time.monotonic()
    said = False  # how long it will take
    with progress(quiet) as on_progress:

        def on_effort(run: "CheapestRun", what: str) -> None:
            nonlocal saved_s, said
            if not (said or quiet):
                click.echo(_plan(run, study.solver), err=True)
                said = True
            best = "none meets all yet" if run.found is None else f"{run.options[run.found].name} meets all"
            on_progress(run.spent or run.done, f"{what}; {best}")
            if time.monotonic() - saved_s > SAVE_EVERY_S:
                save_cheapest_progress(study, run.log(), folder)
                saved_s = time.monotonic()

        workers = Cluster(scheduler) if scheduler else None
        try:
            found = cheapest(study, threads, on_effort, workers, rigs=_rigs(start), log=log)
        finally:
            if workers:
                workers.close()
        if found.interrupted:
            click.get_current_context().ensure_object(Interrupts).take()
        on_progress(1.0, f"writing {folder}")
        chosen = found.combination.study
        placed = found.placement
        shown = report_inputs(chosen, placed.rig, placed.evaluation, placed.midpoint_max_vsr_m)
        words = ("--solver", study.solver.method, "--seed", study.solver.seed)
        budget = ("--evaluations", max(found.evaluations, 1))
        again = shlex.join(map(str, ("lidarcfg", "optimize", path, "-o", folder, *words, *budget, *_started(start))))
        go_on = shlex.join(("lidarcfg", "optimize", str(path), "--resume", str(folder)))
        save_placement(chosen, placed, shown, folder, Commands(command_line(), again), choice=choice_part(found, go_on))
        save_combinations(found, folder)
        save_cheapest_log(study, found.log, folder)
    if not quiet:
        print_placement(chosen, placed, shown.evaluation)
        print_cheapest(found)
        if not found.meets:
            click.echo(f"to go on: {go_on}")
        click.echo(f"written to {folder}/: report.html rig.yaml result.json {COMBINATIONS}")
    if found.interrupted:
        click.echo("interrupted; the best rig so far is kept", err=True)
        sys.exit(130)
    if not found.meets:
        sys.exit(NOT_MET)


def _find_front(
    study: "Study",
    path: Path,
    folder: Path,
    resume: Path | None,
    threads: int | None,
    quiet: bool,
    start: Sequence[Path],
) -> None:
    """Search the study read from `path`, write the folder, print the table. Exits with 130 after Ctrl-C."""
    import time

    from lidarcfg.report.document import Commands
    from lidarcfg.report.front import load_front_logs, print_front, save_front, save_front_log
    from lidarcfg.report.results import FRONT, check_writable
    from lidarcfg.search.combinations import combinations
    from lidarcfg.search.front import front

    logs = load_front_logs(study, resume, len(combinations(study))) if resume else []
    check_writable(folder, FRONT)
    saved = time.monotonic()
    with progress(quiet) as on_progress:

        def on_part(search: "FrontRun") -> None:
            nonlocal saved
            on_progress(search.spent, _front_line(search))
            if time.monotonic() - saved > SAVE_EVERY_S:
                save_front_log(study, search.logs(), folder)
                saved = time.monotonic()

        found = front(study, threads, on_part, logs, rigs=_rigs(start))
    if found.interrupted:
        click.get_current_context().ensure_object(Interrupts).take()
    words = ("--solver", study.solver.method, "--seed", study.solver.seed, "--evaluations", max(found.evaluations, 1))
    again = shlex.join(map(str, ("lidarcfg", "optimize", path, "-o", folder, *words, *_started(start))))
    untried = sum(not one.evaluations for one in found.candidates)
    if untried:
        warn(f"the budget was spent before {untried} of {len(found.candidates)} combinations were tried")
    with progress(quiet) as on_progress:

        def on_point(number: int, point: "Point") -> None:
            on_progress(number / len(found.points), f"report of {point.combination.name}")

        save_front(study, found, folder, Commands(command_line(), again), on_point)
    if not quiet:
        print_front(study, found)
        click.echo(f"written to {folder}/: front.html front.json front.png history.csv search.npz points/")
    if found.interrupted:
        click.echo("interrupted; the front so far is kept", err=True)
        sys.exit(130)


def _front_line(search: "FrontRun") -> str:
    """One line on the state of the search."""
    on_front = search.on_front()
    rate = search.evaluations / max(search.seconds, 1e-9)
    tried = sum(one.evaluations > 0 for one in search.searches)
    state = f"{sum(on_front)} on the front, {tried} of {len(on_front)} combinations tried"
    return f"{state}  {rate:,.0f} evaluations/s"
