"""lidarcfg optimize: where the sensors should sit."""

import shlex
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    from lidarcfg.search.log import Log
    from lidarcfg.search.run import Cycle, Placement
    from lidarcfg.sensors.rig import Rig
    from lidarcfg.solvers.solver import Solver
    from lidarcfg.study.study import Study

QUIET_S = 0.5  # without a cycle's end, before the evaluations are counted on the screen


@dataclass(frozen=True)
class Options:
    """The options of the command."""

    study: Path
    solver: str | None
    seed: int | None
    threads: int | None
    scheduler: str | None
    resume: Path | None
    start: tuple[Path, ...]
    cycles: int | None
    evaluations: int | None
    seconds: float | None
    output: Path | None
    baseline: Path | None
    quiet: bool

    def load(self) -> "Study":
        """The study with these budgets, seed and solver. Raises ConfigError."""
        from lidarcfg.files import example
        from lidarcfg.study.loading import check_firing, load_study
        from lidarcfg.study.study import with_solver

        budget = {"cycles": self.cycles, "evaluations": self.evaluations, "seconds": self.seconds}
        study = load_study(self.study)
        check_firing(study, example(self.study))
        return with_solver(study, seed=self.seed, method=self.solver, **budget)

    def check(self, study: "Study") -> None:
        """Raises UsageError for options that do not go together, or not with a study."""
        if self.start and self.resume:
            raise click.UsageError("--start is for a search that begins, and --resume continues one")
        if self.scheduler and not (study.to_choose and study.requirements):
            raise click.UsageError(
                "--scheduler is for studies with requirements and models to choose; see sweep for others"
            )
        if self.baseline and study.to_choose:
            raise click.UsageError(
                "--baseline is for one rig, and this study has a front of them; compare these with it"
            )

    def folder(self, study: "Study") -> Path:
        """Where the results go."""
        return self.output or self.resume or Path("out") / study.name

    def rigs(self) -> "list[Rig]":
        """The rigs that the search begins with, called as their files."""
        from lidarcfg.sensors.rig import load_rig

        return [replace(load_rig(path), name=str(path)) for path in self.start]

    def again(self, study: "Study", *budget: object) -> str:
        """The command that gives the same result on any machine, however the search ended."""
        words = "lidarcfg", "optimize", self.study, "-o", self.folder(study)
        solver = "--solver", study.solver.method, "--seed", study.solver.seed
        starts = [word for path in self.start for word in ("--start", path)]
        return shlex.join(map(str, (*words, *solver, *budget, *starts)))


@dataclass(frozen=True)
class SearchEnd:
    """How a search ended."""

    interrupted: str  # what is kept; empty: it was not interrupted
    is_met: bool = True  # whether all requirements are met


class Saver:
    """Saves a search that goes on every few seconds."""

    def __init__(self) -> None:
        self._saved_s = time.monotonic()

    def save(self, save: Callable[[], None]) -> None:
        """Save it, if it is time."""
        if time.monotonic() - self._saved_s > SAVE_EVERY_S:
            save()
            self._saved_s = time.monotonic()


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
      lidarcfg optimize data/studies/sedan.yaml -o out/sedan \\
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
    cloup.option("--cycles", type=click.IntRange(1), metavar="N", help="Stop after N cycles of the solver."),
    cloup.option("--evaluations", type=click.IntRange(1), metavar="N", help="Stop after N evaluated rigs."),
    cloup.option("--seconds", type=Seconds(10**9), metavar="SECONDS", help="Stop after this time."),
    help="These replace the study's budget.",
)
@cloup.option("-o", "--output", type=FILE, metavar="DIR", help="Folder for the results.  [default: out/STUDY]")
@baseline_option
@quiet_option
def optimize(**values: Any) -> None:
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
    options = Options(**values)
    with progress(options.quiet, keep=False) as on_progress:
        on_progress(0.0, f"reading {options.study}")
        from lidarcfg.search.requirements_search import unachievable
        from lidarcfg.study.checks import study_warnings

        study = options.load()
        messages = list(study_warnings(options.study, study))
        messages += [f"{options.study}: {name}: not achievable: {why}" for name, why in unachievable(study).items()]
    warn_of(study.vehicle)
    for message in messages:
        warn(message)
    options.check(study)
    if not study.to_choose:
        outcome = _find_rig(study, options)
    elif study.requirements:
        outcome = _find_cheapest(study, options)
    else:
        outcome = _find_front(study, options)
    if outcome.interrupted:
        click.echo(f"interrupted; {outcome.interrupted} is kept", err=True)
        sys.exit(130)
    if not outcome.is_met:
        sys.exit(NOT_MET)


def _find_rig(study: "Study", options: Options) -> SearchEnd:
    """Search for the best rig, write the folder, print the result."""
    from lidarcfg.report.comparison import print_comparison, with_baseline
    from lidarcfg.report.printing import print_placement
    from lidarcfg.report.results import RESULTS, check_writable, save_placement
    from lidarcfg.report.rig_report import Commands
    from lidarcfg.report.search_log import load_log

    folder = options.folder(study)
    log = load_log(study, options.resume).only if options.resume else None
    check_writable(folder, RESULTS)
    with progress(options.quiet, keep=False) as on_progress:
        beside = baseline_of(study, options.baseline, on_progress)
    with progress(options.quiet) as on_progress:
        found, shown = _search(study, options, log, on_progress)
        on_progress(1.0, f"writing {folder}")
        budget: tuple[str, int] = ("--evaluations", max(found.evaluations, 1))
        if study.solver.cycles is not None and found.history[-1].cycle >= study.solver.cycles:
            budget = ("--cycles", study.solver.cycles)
        save_placement(study, found, shown, folder, Commands(command_line(), options.again(study, *budget)), beside)
    if not options.quiet:
        print_placement(study, found, shown.evaluation)
        if beside:
            print_comparison(study, with_baseline(found.rig, folder / "rig.yaml", shown, beside))
        files = "report.html rig.yaml result.json history.csv convergence.png rig.png search.npz"
        click.echo(f"written to {folder}/: {files}")
    is_met = found.verdict is None or found.verdict.passed
    return SearchEnd("the best rig found" if found.interrupted else "", is_met)


def _search(
    study: "Study", options: Options, log: "Log | None", on_progress: OnProgress
) -> "tuple[Placement, ReportInputs]":
    """The best rig, with progress; what is found so far is saved every few seconds."""
    from lidarcfg.report.inputs import report_inputs
    from lidarcfg.report.results import save_progress
    from lidarcfg.search.log import SearchLog
    from lidarcfg.search.optimize import optimize as search
    from lidarcfg.search.run import Budget

    saver = Saver()
    shown_s = time.monotonic()
    fraction = 0.0

    def on_cycle(cycle: "Cycle", rig: "Rig", log: "Log") -> None:
        nonlocal shown_s, fraction
        fraction = min(budget.fraction(cycle.evaluations, cycle.cycle), 1.0)
        on_progress(fraction, _search_line(cycle))
        shown_s = time.monotonic()
        saver.save(lambda: save_progress(study, SearchLog.of(log), options.folder(study), rig))

    def on_evaluations(count: int) -> None:
        nonlocal shown_s
        if time.monotonic() - shown_s > QUIET_S:  # a cycle takes long
            on_progress(max(fraction, min(budget.fraction(count, 0), 1.0)), f"{count:,} rigs evaluated")
            shown_s = time.monotonic()

    seconds = study.solver.seconds
    on_progress(0.0, "searching" if seconds is None else f"searching for {seconds:g} s; the report comes then")
    budget = Budget.of(study.solver)
    found = search(study, options.threads, on_cycle, log, on_evaluations=on_evaluations, starts=options.rigs())
    _take_interrupt(found.interrupted)
    on_progress(1.0, "evaluating the best rig")
    return found, report_inputs(study, found.rig, found.evaluation, found.midpoint_max_vsr_m)


def _take_interrupt(was_interrupted: bool) -> None:
    """A search that ended by Ctrl-C has dealt with it; the command goes on."""
    if was_interrupted:
        click.get_current_context().ensure_object(Interrupts).take()


def _search_line(cycle: "Cycle") -> str:
    """The state of the search."""
    state = f"cycle {cycle.cycle}  best {cycle.best:.4f}  mean {cycle.mean:.4f}"
    if (short := getattr(cycle, "shortfall", 0.0)) > 0:
        state = f"cycle {cycle.cycle}  short by {short:.4f}"
    return f"{state}  {cycle.evaluations / cycle.seconds:,.0f} evaluations/s"


def _cheapest_outlook(run: "CheapestRun", solver: "Solver") -> str:
    """What the search for the cheapest rig will do, and how long it may take."""
    screening = "the plain rigs of each first"
    if run.screening_s is not None:
        screening += f", about {duration(run.screening_s)}, and longer where one seems to pass and is verified"
    budget = f"{solver.evaluations:,} evaluations" if solver.evaluations is not None else "its budget"
    if solver.seconds is not None:
        budget = f"{solver.seconds:g} s"
    count = len(run.combinations)
    return f"{count:,} combinations: {screening}; the search ends after {budget}, and the report comes then"


def _find_cheapest(study: "Study", options: Options) -> SearchEnd:
    """Search for the cheapest rig that meets all requirements, write the folder, print the verdict and the table."""
    from lidarcfg.report.cheapest import choice_part, print_cheapest, save_combinations
    from lidarcfg.report.inputs import report_inputs
    from lidarcfg.report.printing import print_placement
    from lidarcfg.report.results import COMBINATIONS, RESULTS, check_writable, save_placement, save_progress
    from lidarcfg.report.rig_report import Commands
    from lidarcfg.report.search_log import load_log, save_log
    from lidarcfg.search.cheapest import cheapest
    from lidarcfg.search.workers import Cluster

    folder = options.folder(study)
    log = load_log(study, options.resume) if options.resume else None
    check_writable(folder, (*RESULTS, COMBINATIONS))
    saver = Saver()
    said = options.quiet  # how long it will take
    with progress(options.quiet) as on_progress:

        def on_turn(run: "CheapestRun") -> None:
            nonlocal said
            if not said:
                click.echo(_cheapest_outlook(run, study.solver), err=True)
                said = True
            best = "none meets all yet" if run.found is None else f"{run.combinations[run.found].name} meets all"
            on_progress(run.spent or run.done, f"{run.doing}; {best}")
            saver.save(lambda: save_progress(study, run.log(), folder))

        workers = Cluster(options.scheduler) if options.scheduler else None
        try:
            found = cheapest(study, options.threads, on_turn, workers, rigs=options.rigs(), log=log)
        finally:
            if workers:
                workers.close()
        _take_interrupt(found.interrupted)
        on_progress(1.0, f"writing {folder}")
        chosen = found.combination.study
        placed = found.placement
        shown = report_inputs(chosen, placed.rig, placed.evaluation, placed.midpoint_max_vsr_m)
        commands = Commands(command_line(), options.again(study, "--evaluations", max(found.evaluations, 1)))
        is_open = not (found.meets or found.cannot)
        go_on = shlex.join(("lidarcfg", "optimize", str(options.study), "--resume", str(folder)))
        save_placement(chosen, placed, shown, folder, commands, choice=choice_part(found, go_on if is_open else None))
        save_combinations(found, folder)
        save_log(study, found.log, folder)
    if not options.quiet:
        print_placement(chosen, placed, shown.evaluation)
        print_cheapest(found)
        if is_open:
            click.echo(f"to go on: {go_on}")
        click.echo(f"written to {folder}/: report.html rig.yaml result.json {COMBINATIONS}")
    return SearchEnd("the best rig so far" if found.interrupted else "", found.meets)


def _find_front(study: "Study", options: Options) -> SearchEnd:
    """Search for the best rig of each price, write the folder, print the table."""
    from lidarcfg.report.front import print_front, save_front, save_front_progress
    from lidarcfg.report.results import FRONT, check_writable
    from lidarcfg.report.rig_report import Commands
    from lidarcfg.report.search_log import load_log
    from lidarcfg.search.front import front

    folder = options.folder(study)
    log = load_log(study, options.resume) if options.resume else None
    check_writable(folder, FRONT)
    saver = Saver()
    with progress(options.quiet) as on_progress:

        def on_turn(run: "FrontRun") -> None:
            on_progress(run.spent, _front_line(run))
            saver.save(lambda: save_front_progress(study, run.log(), folder))

        found = front(study, options.threads, on_turn, log, rigs=options.rigs())
    _take_interrupt(found.interrupted)
    untried = sum(not one.evaluations for one in found.candidates)
    if untried:
        go_on = shlex.join(("lidarcfg", "optimize", str(options.study), "--resume", str(folder)))
        warn(f"{untried} of {len(found.candidates)} combinations were not tried within the budget; to go on: {go_on}")
    commands = Commands(command_line(), options.again(study, "--evaluations", max(found.evaluations, 1)))
    with progress(options.quiet) as on_progress:

        def on_point(number: int, point: "Point") -> None:
            on_progress(number / len(found.points), f"report of {point.combination.name}")

        save_front(study, found, folder, commands, on_point)
    if not options.quiet:
        print_front(study, found)
        click.echo(f"written to {folder}/: front.html front.json front.png history.csv search.npz points/")
    return SearchEnd("the front so far" if found.interrupted else "")


def _front_line(run: "FrontRun") -> str:
    """One line on the state of the search."""
    on_front = run.on_front()
    tried = sum(one.evaluations > 0 for one in run.searches)
    state = f"{tried} of {len(on_front)} combinations tried, {sum(on_front)} on the front"
    return f"{state}; {run.evaluations:,} rigs evaluated"
