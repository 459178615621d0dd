"""lidarcfg validate: what files are, and what is wrong with them."""

import sys
from pathlib import Path

import click
import cloup

from lidarcfg.cli.options import FILE, quiet_option, warn
from lidarcfg.cli.progress import progress
from lidarcfg.errors import LidarcfgError, one_line


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg validate data/studies/truck.yaml data/rigs/roof.yaml
    """
)
@cloup.argument("files", type=FILE, nargs=-1, required=True, metavar="FILE...", help="Files of any kind.")
@quiet_option
def validate(files: tuple[Path, ...], quiet: bool) -> None:
    """Check files, and print what each is and what it would do.

    Studies, requirements, scenarios, rigs, scenes, sensors, vehicles, trajectories, plans and faults are told apart by
    their keys. Anything that is allowed but looks wrong is a warning. Exits with 2 if a file has an error.
    """
    from lidarcfg.report.summaries import summary

    failed = False
    for number, file in enumerate(files):
        try:
            with progress(quiet, keep=False) as on_progress:
                on_progress(number / len(files), f"reading {file}")
                found = summary(file)
        except LidarcfgError as error:
            for line in str(error).split("\n"):
                click.echo(f"lidarcfg: {line}", err=True)
            failed = True
            continue
        for message in found.warnings:
            warn(message)
        if not quiet:
            click.echo(one_line(f"{file}: {found.kind}: {found.text}"))
    if failed:
        sys.exit(2)
