"""lidarcfg optimize for a study that lets sensors be chosen: the front of price against objective."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidarcfg.cli.interrupts import Interrupts
from lidarcfg.cli.options import SAVE_EVERY_S, command_line, warn
from lidarcfg.cli.progress import progress

if TYPE_CHECKING:
    from lidarcfg.placement.front import FrontRun, Point
    from lidarcfg.placement.study import Study


def find_front(study: "Study", path: Path, folder: Path, resume: Path | None, threads: int | None, quiet: bool) -> None:
    """Search the study read from `path`, write the folder, print the table. Exits with 130 after Ctrl-C."""
    import time

    from lidarcfg import report
    from lidarcfg.placement.combinations import combinations
    from lidarcfg.placement.front import front

    logs = report.load_front_logs(study, resume, len(combinations(study))) if resume else []
    report.check_writable(folder, report.FRONT)
    saved = time.monotonic()
    with progress(quiet) as on_progress:

        def on_part(search: "FrontRun") -> None:
            nonlocal saved
            on_progress(search.spent, _line(search))
            if time.monotonic() - saved > SAVE_EVERY_S:
                report.save_front_log(study, search.logs(), folder)
                saved = time.monotonic()

        found = front(study, threads, on_part, logs)
    if found.interrupted:
        click.get_current_context().ensure_object(Interrupts).take()
    words = ("--solver", study.solver.method, "--seed", study.solver.seed, "--evaluations", max(found.evaluations, 1))
    again = shlex.join(map(str, ("lidarcfg", "optimize", path, "-o", folder, *words)))
    untried = sum(not one.evaluations for one in found.candidates)
    if untried:
        warn(f"the budget was spent before {untried} of {len(found.candidates)} combinations were tried")
    with progress(quiet) as on_progress:

        def on_point(number: int, point: "Point") -> None:
            on_progress(number / len(found.points), f"report of {point.combination.name}")

        report.save_front(study, found, folder, report.Commands(command_line(), again), on_point)
    if not quiet:
        report.print_front(study, found)
        click.echo(f"written to {folder}/: front.html front.json front.png history.csv search.npz points/")
    if found.interrupted:
        click.echo("interrupted; the front so far is kept", err=True)
        sys.exit(130)


def _line(search: "FrontRun") -> str:
    """One line on the state of the search."""
    on_front = search.on_front()
    rate = search.evaluations / max(search.seconds, 1e-9)
    tried = sum(one.evaluations > 0 for one in search.searches)
    state = f"{sum(on_front)} on the front, {tried} of {len(on_front)} combinations tried"
    return f"{state}  {rate:,.0f} evaluations/s"
