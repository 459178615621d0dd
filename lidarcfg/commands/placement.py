"""lidarcfg optimize and evaluate: where the sensors should sit, and how well they see from there."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidarcfg.commands.options import FILE, Seconds, Share, progress, quiet_option, typed

if TYPE_CHECKING:
    from lidarcfg.placement.optimize import Cycle, Log, Placement
    from lidarcfg.placement.study import Solver
    from lidarcfg.rig import Rig

SAVE_EVERY_S = 5.0
THREADS = click.IntRange(1, 1024)


@click.command()
@click.argument("study", type=FILE)
@click.option("-o", "--output", type=FILE, help="Folder for the results.  [default: out/STUDY]")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Seed of the search.  [default: the study's]")
@click.option("--threads", type=THREADS, help="Threads; the result is the same on any number.  [default: all]")
@click.option(
    "--solver", type=click.Choice(["auto", "abc", "cmaes", "de"]), help="How to search.  [default: the study's]"
)
@click.option("--cycles", type=click.IntRange(1), help="Budget: cycles of the swarm.")
@click.option("--evaluations", type=click.IntRange(1), help="Budget: trials.")
@click.option("--seconds", type=Seconds(1e9), help="Budget: seconds.")
@click.option("--resume", type=FILE, metavar="DIR", help="Go on with the search whose results are in DIR.")
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
    resume: Path | None,
    quiet: bool,
) -> None:
    """Place the sensors of STUDY so that the largest subspace they cannot see is smallest.

    A budget given here replaces the study's. Ctrl-C ends the search and keeps the best so far; every few seconds
    rig.yaml and search.npz are brought up to date, so that even a killed search can go on with --resume.

    \b
    Example:
      lidarcfg optimize data/studies/liu2018-4x16.yaml -o out/four --seed 3 --seconds 60
    """
    import time

    from lidarcfg import report
    from lidarcfg.placement.optimize import optimize as search
    from lidarcfg.placement.study import load_study, with_solver

    loaded = with_solver(
        load_study(study),
        seed=seed,
        method=solver,
        cycles=cycles,
        evaluations=evaluations,
        seconds=seconds,
    )
    folder = output or resume or Path("out") / loaded.name
    log = report.load_log(loaded, resume) if resume else None
    report.check_writable(folder)
    saved = time.monotonic()
    with progress(quiet) as on_share:

        def on_cycle(cycle: "Cycle", rig: "Rig", log: "Log") -> None:
            nonlocal saved
            on_share(*_search_line(loaded.solver, cycle))
            if time.monotonic() - saved > SAVE_EVERY_S:
                report.save_progress(loaded, rig, log, folder)
                saved = time.monotonic()

        found = search(loaded, threads, on_cycle, log)
    found = report.save_placement(
        loaded, found, folder, report.Commands(typed(), _again(study, folder, loaded.solver, found))
    )
    if not quiet:
        report.print_placement(found)
        files = "report.html rig.yaml result.json history.csv convergence.png rig.png search.npz"
        click.echo(f"written to {folder}/: {files}")
    if found.interrupted:
        click.echo("interrupted; the best so far is kept", err=True)
        sys.exit(130)


def _again(study: Path, folder: Path, solver: "Solver", found: "Placement") -> str:
    """The command that gives the same rig wherever it runs, however the search ended."""
    budget = ("--evaluations", max(found.evaluations, 1))
    if solver.cycles is not None and found.history[-1].cycle >= solver.cycles:
        budget = ("--cycles", solver.cycles)
    words = ("lidarcfg", "optimize", study, "-o", folder, "--solver", solver.method, "--seed", solver.seed, *budget)
    return shlex.join(map(str, words))


def _search_line(solver: "Solver", cycle: "Cycle") -> tuple[float, str]:
    """How much of the budget is spent, and how the search stands."""
    budgets = (
        (cycle.cycle, solver.cycles),
        (cycle.evaluations, solver.evaluations),
        (cycle.seconds, solver.seconds),
    )
    rate = cycle.evaluations / cycle.seconds
    stand = f"cycle {cycle.cycle}  best {cycle.best:.4f}  mean {cycle.mean:.4f}"
    return max(spent / budget for spent, budget in budgets if budget), f"{stand}  {rate:,.0f} evaluations/s"


@click.command()
@click.argument("study", type=FILE)
@click.argument("rig", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
@click.option("-o", "--output", type=FILE, help="Folder for report.html, result.json and rig.png.")
@click.option("--tolerance", type=Share(1), help="Also the analytic max VSR, to this relative error.")
@quiet_option
def evaluate(study: Path, rig: Path, as_json: bool, output: Path | None, tolerance: float | None, quiet: bool) -> None:
    """How well RIG sees in the region of STUDY: max VSR, the worst subspaces, detection rates.

    The beams are the rig's; region and objects are the study's, whose bounds are not enforced. With --tolerance
    the cuboids are halved until the max VSR of the subspaces themselves, which the cuboids' faces overrate the
    surface of, is known to it.

    \b
    Example:
      lidarcfg evaluate data/studies/sedan.yaml data/rigs/roof.yaml --json
    """
    from lidarcfg import report
    from lidarcfg.placement.study import evaluate as judge
    from lidarcfg.placement.study import load_study
    from lidarcfg.rig import load_rig

    loaded, mounted = load_study(study), load_rig(rig)
    found = judge(loaded, mounted, tolerance)
    if output:
        found = report.save_evaluation(loaded, mounted, found, output, report.Commands(typed(), typed()))
    if as_json:
        click.echo(report.to_json(report.evaluation_dict(loaded, mounted, found)))
    elif not quiet:
        report.print_evaluation(mounted, found)
