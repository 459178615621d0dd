"""lidarcfg compare: rigs side by side."""

from pathlib import Path

import click
import cloup

from lidarcfg.cli.evaluate import check_rig
from lidarcfg.cli.options import FILE, command_line, json_option, quiet_option, tolerance_option, warn_of
from lidarcfg.cli.progress import progress


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg compare out/sedan/rig.yaml data/rigs/roof.yaml \\
          --study data/studies/sedan.yaml -o out/compared
    """
)
@cloup.argument(
    "rigs", type=FILE, nargs=-1, metavar="RIG RIG...", help="2 to 10 rigs; the same one may be given twice."
)
@cloup.option("--study", type=FILE, required=True, metavar="STUDY", help="The region and the objects.")
@tolerance_option
@cloup.option("-o", "--output", type=FILE, metavar="DIR", help="Folder for compare.html and compare.json.")
@json_option
@quiet_option
def compare(
    rigs: tuple[Path, ...], study: Path, as_json: bool, output: Path | None, tolerance: float | None, quiet: bool
) -> None:
    """Evaluate rigs side by side in one study.

    Compares misses, where the study has a vehicle, then max VSR, the worst subspaces, detection, blind spots and
    coverage, and marks the best of each row. The study's bounds on the poses are not enforced.
    """
    from lidarcfg.report.comparison import COMPARED, check_count, print_comparison, save_comparison
    from lidarcfg.report.comparison import compare as comparison
    from lidarcfg.report.results import check_writable, to_json
    from lidarcfg.report.rig_report import Commands
    from lidarcfg.sensors.rig import load_rig
    from lidarcfg.study.loading import load_study

    check_count(len(rigs))
    loaded = load_study(study)
    mounted = [load_rig(rig) for rig in rigs]
    warn_of(loaded.vehicle)
    for path, rig in zip(rigs, mounted, strict=True):
        check_rig(loaded, path, rig)
    if output:
        check_writable(output, COMPARED)
    with progress(quiet or as_json) as on_progress:
        compared = comparison(loaded, rigs, tolerance, on_progress)
    if output:
        save_comparison(loaded, compared.rigs, output, Commands(command_line(), command_line()))
    if as_json:
        click.echo(to_json(compared.to_dict()))
    elif not quiet:
        print_comparison(loaded, compared.rigs)
        if output:
            click.echo(f"written to {output}/: compare.html compare.json")
