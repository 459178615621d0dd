"""lidarcfg evaluate: how well a rig sees."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.options import FILE, command_line, json_option, quiet_option, tolerance_option, warn, warn_of
from lidarcfg.cli.progress import progress

if TYPE_CHECKING:
    from lidarcfg.report.rig_report import Baseline
    from lidarcfg.sensors.rig import Rig
    from lidarcfg.study.study import Study

baseline_option = cloup.option("--baseline", type=FILE, metavar="RIG", help="Compare the result with this rig.")
OnProgress = Callable[[float, str], None]


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg evaluate data/studies/sedan.yaml data/rigs/roof.yaml --json
    """
)
@cloup.argument("study", type=FILE, help="YAML: the region and the objects.")
@cloup.argument("rig", type=FILE, help="YAML: the sensors and their poses.")
@tolerance_option
@cloup.option("-o", "--output", type=FILE, metavar="DIR", help="Folder for report.html, result.json and rig.png.")
@baseline_option
@json_option
@quiet_option
def evaluate(
    study: Path,
    rig: Path,
    as_json: bool,
    output: Path | None,
    tolerance: float | None,
    baseline: Path | None,
    quiet: bool,
) -> None:
    """Evaluate a rig: misses, max VSR, worst subspaces.

    The study's bounds on the poses are not enforced. Max VSR depends on the size of the cuboids:
    --tolerance halves their edges until what it would be for ever smaller ones is known to this relative error.
    """
    with progress(quiet or as_json, keep=False) as on_progress:
        on_progress(0.0, f"reading {study}")
        from lidarcfg.report.comparison import print_comparison, with_baseline
        from lidarcfg.report.inputs import report_inputs
        from lidarcfg.report.printing import print_evaluation
        from lidarcfg.report.results import (
            EVALUATED,
            baseline_dict,
            check_writable,
            evaluation_dict,
            save_evaluation,
            to_json,
        )
        from lidarcfg.report.rig_report import Commands
        from lidarcfg.sensors.rig import load_rig
        from lidarcfg.study import evaluation
        from lidarcfg.study.loading import load_study

        loaded = load_study(study)
        mounted = load_rig(rig)
    warn_of(loaded.vehicle)
    check_rig(loaded, rig, mounted)
    if output:
        check_writable(output, EVALUATED)
    with progress(quiet or as_json, keep=False) as on_progress:
        beside = baseline_of(loaded, baseline, on_progress)
        on_progress(0.0, f"evaluating {rig}")

        def on_fraction(done: float) -> None:
            on_progress(done, f"evaluating {rig}")

        found = evaluation.evaluate(loaded, mounted, tolerance, on_progress=on_fraction)
        shown = report_inputs(loaded, mounted, found) if output or beside else None
        found = shown.evaluation if shown else evaluation.with_failures(loaded, mounted, found)
        if output and shown:
            commands = Commands(command_line(), command_line())
            save_evaluation(loaded, mounted, shown, output, commands, beside)
    if as_json:
        values = evaluation_dict(loaded, mounted, found)
        values |= {"baseline": baseline_dict(loaded, beside)} if beside else {}
        click.echo(to_json(values))
    elif not quiet:
        print_evaluation(loaded, mounted, found)
        if shown and beside:
            print_comparison(loaded, with_baseline(mounted, rig, shown, beside))


def baseline_of(study: "Study", path: Path | None, on_progress: OnProgress) -> "Baseline | None":
    """The rig to compare with, evaluated. Raises ConfigError if it cannot be evaluated in the study."""
    from lidarcfg.report.inputs import report_inputs
    from lidarcfg.report.rig_report import Baseline
    from lidarcfg.sensors.rig import load_rig
    from lidarcfg.study.evaluation import evaluate

    if path is None:
        return None
    on_progress(0.0, f"evaluating {path}")
    rig = load_rig(path)
    check_rig(study, path, rig)
    return Baseline(rig, str(path), report_inputs(study, rig, evaluate(study, rig)).without_cuboids())


def check_rig(study: "Study", path: Path, rig: "Rig") -> None:
    """Print what looks wrong with a rig. Raises ConfigError if it cannot be evaluated in a study."""
    from lidarcfg.study.checks import rig_warnings
    from lidarcfg.world.vehicle import check_outside

    ground_m = study.requirements.site.ground_m if study.requirements else 0.0
    for message in rig_warnings(path, ground_m, study.vehicle):
        warn(message)
    if study.vehicle:
        check_outside(study.vehicle, rig.mounts, path)
