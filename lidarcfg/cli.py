"""The commands: each reads its inputs, makes one library call and prints one table."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

import lidarcfg
from lidarcfg.errors import LidarcfgError

if TYPE_CHECKING:
    from lidarcfg.placement.study import Cycle, Solver

FILE = click.Path(path_type=Path)
quiet_option = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
THREADS = click.IntRange(1, 1024)


def main() -> None:
    """Entry point: exit 0 when done, 2 with one line for the user's mistake, 130 after Ctrl-C, 1 for a bug."""
    try:
        code = cli.main(standalone_mode=False)
    except click.ClickException as error:
        message = " ".join(error.format_message().split())
        _fail(f"{message} (see {_command_path(error)} --help)")
    except LidarcfgError as error:
        _fail(str(error))
    except BrokenPipeError:
        sys.stderr.close()  # who read our output has gone; nothing is left to say
        sys.exit(0)
    except OSError as error:
        _fail(f"{error.filename}: {(error.strerror or str(error)).lower()}" if error.filename else str(error))
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(130)
    sys.exit(code or 0)


def _command_path(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context else "lidarcfg"


def _fail(message: str) -> None:
    click.echo(f"lidarcfg: {message}", err=True)
    sys.exit(2)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(lidarcfg.__version__, prog_name="lidarcfg")
def cli() -> None:
    """Where should the LiDARs sit on this vehicle, and what will they hear?

    \b
    lidarcfg optimize data/studies/liu2018-2x16.yaml -o out/two        place two LiDARs
    lidarcfg evaluate data/studies/liu2018-2x16.yaml out/two/rig.yaml  how well do they see?
    lidarcfg export out/two/rig.yaml --scene data/scenes/street.yaml \\
        --at=-30,-10,0 --duration 1 -o out/two.pcap                    what do they send?
    lidarcfg decode out/two.pcap --rig out/two/rig.yaml -o out/two.ply merged points
    lidarcfg view out/two.ply --png out/two.png                        a picture
    """


@cli.command()
@click.argument("study", type=FILE)
@click.option("-o", "--output", type=FILE, help="Folder for the results.  [default: out/STUDY]")
@click.option("--seed", type=click.IntRange(0), help="Seed of the search.  [default: the study's]")
@click.option(
    "--threads", type=THREADS, help="Threads; the result is the same on any number.  [default: all]"
)
@click.option("--solver", type=click.Choice(["abc"]), help="How to search.  [default: the study's]")
@click.option("--cycles", type=click.IntRange(1), help="Budget: cycles of the swarm.")
@click.option("--evaluations", type=click.IntRange(1), help="Budget: trials.")
@click.option("--seconds", type=click.FloatRange(0, min_open=True), help="Budget: seconds.")
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
    quiet: bool,
) -> None:
    """Place the sensors of STUDY so that the largest subspace they cannot see is smallest.

    A budget given here replaces the study's. Ctrl-C ends the search and keeps the best so far.

    \b
    Example:
      lidarcfg optimize data/studies/liu2018-4x16.yaml -o out/four --seed 3 --seconds 60
    """
    from lidarcfg import report
    from lidarcfg.placement import study as placement

    loaded = placement.with_solver(
        placement.load_study(study),
        seed=seed,
        method=solver,
        cycles=cycles,
        evaluations=evaluations,
        seconds=seconds,
    )
    folder = output or Path("out") / loaded.name
    folder.mkdir(parents=True, exist_ok=True)
    with _search_progress(loaded.solver, quiet) as on_cycle:
        found = placement.optimize(loaded, threads=threads, on_cycle=on_cycle)
    report.save_placement(loaded, found, folder)
    if not quiet:
        report.print_placement(found)
        click.echo(f"written to {folder}/: rig.yaml result.json history.csv convergence.png rig.png")
    if found.interrupted:
        click.echo("interrupted; the best so far is kept", err=True)
        sys.exit(130)


@contextmanager
def _search_progress(solver: "Solver", quiet: bool) -> "Iterator[Callable[[Cycle], None] | None]":
    """A line on stderr that follows the search: best, mean, evaluations a second and the time left."""
    if quiet:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(30), TextColumn("{task.description}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("the first food sources", total=1.0)

        def on_cycle(cycle: "Cycle") -> None:
            budgets = (
                (cycle.cycle, solver.cycles),
                (cycle.evaluations, solver.evaluations),
                (cycle.seconds, solver.seconds),
            )
            progress.update(
                task,
                completed=max(spent / budget for spent, budget in budgets if budget),
                description=f"cycle {cycle.cycle}  best {cycle.best_m:.4f} m  mean {cycle.mean_m:.4f} m  "
                f"{cycle.evaluations / cycle.seconds:,.0f} evaluations/s",
            )

        yield on_cycle


@cli.command()
@click.argument("study", type=FILE)
@click.argument("rig", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
@click.option("-o", "--output", type=FILE, help="Folder for result.json and rig.png.")
@quiet_option
def evaluate(study: Path, rig: Path, as_json: bool, output: Path | None, quiet: bool) -> None:
    """How well RIG sees in the region of STUDY: max VSR, the worst subspaces, detection rates.

    The beams are the rig's; region and objects are the study's, whose bounds are not enforced.

    \b
    Example:
      lidarcfg evaluate data/studies/sedan.yaml data/rigs/roof.yaml --json
    """
    from lidarcfg import report
    from lidarcfg.placement import study as placement
    from lidarcfg.rig import load_rig

    loaded, mounted = placement.load_study(study), load_rig(rig)
    found = placement.evaluate(loaded, mounted)
    if output:
        report.save_evaluation(loaded, mounted, found, output)
    if as_json:
        click.echo(report.to_json(report.evaluation_dict(loaded, mounted, found)))
    elif not quiet:
        report.print_evaluation(mounted, found)


@cli.group(invoke_without_command=True)
@click.pass_context
def sensors(context: click.Context) -> None:
    """The catalogue of sensor models.

    \b
    Example:
      lidarcfg sensors show vlp-16
    """
    if context.invoked_subcommand is None:
        context.invoke(list_sensors)


@sensors.command("list")
@quiet_option
def list_sensors(quiet: bool = False) -> None:
    """List the models: name, beams, elevations, and what is known of them."""
    from lidarcfg import report
    from lidarcfg.sensor import catalogue, load_sensor

    if not quiet:
        report.print_sensors([load_sensor(name) for name in catalogue()])


@sensors.command("show")
@click.argument("name")
@quiet_option
def show_sensor(name: str, quiet: bool) -> None:
    """Show the model NAME: its beam table, timing and packet facts with their sources.

    \b
    Example:
      lidarcfg sensors show vlp-16
    """
    from lidarcfg import report
    from lidarcfg.sensor import load_sensor

    sensor = load_sensor(name)
    if not quiet:
        report.print_sensor(sensor)
