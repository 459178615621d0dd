"""lidarcfg init, validate and schema: files to start from, and checks of your own."""

import sys
from pathlib import Path

import click
import cloup

from lidarcfg.cli.options import FILE, quiet_option, warn
from lidarcfg.errors import LidarcfgError, one_line

TEMPLATES = ("study", "rig", "scene", "sensor")
SCHEMAS = (*TEMPLATES, "requirements", "scenario", "vehicle", "trajectory", "plan")


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg init study --vehicle truck -o out/my-truck/study.yaml
      lidarcfg init rig -o out/my-rig.yaml
    """
)
@cloup.argument("kind", type=click.Choice(TEMPLATES), help="What to write.")
@cloup.option("-o", "--output", type=FILE, required=True, metavar="FILE", help="The file; it must not exist yet.")
@cloup.option(
    "--vehicle",
    metavar="NAME",
    help="For a study: a body from the package (bus, sedan, shuttle, truck), or a mesh file of your own.",
)
@quiet_option
def init(kind: str, output: Path, vehicle: str | None, quiet: bool) -> None:
    """Write a commented file to start from.

    The other commands accept the file as it is. Optional keys are in it as comments.
    """
    from lidarcfg.cli.templates import write_template

    if vehicle and kind != "study":
        raise click.UsageError(f"--vehicle is for a study, not for a {kind}")
    written = write_template(kind, output, vehicle)
    if not quiet:
        click.echo(f"written: {' '.join(map(str, written))}")


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

    Studies, requirements, scenarios, rigs, scenes, sensors, vehicles, trajectories and plans are told apart by their
    keys. Anything that is allowed but looks wrong is a warning. Exits with 2 if a file has an error.
    """
    from lidarcfg.report.summaries import summary

    failed = False
    for file in files:
        try:
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


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg schema study -o out/study.schema.json
    """
)
@cloup.argument("kind", type=click.Choice(SCHEMAS), metavar="KIND", help=f"The kind: {', '.join(SCHEMAS)}.")
@cloup.option("-o", "--output", type=FILE, metavar="FILE", help="Where to write it.  [default: standard output]")
def schema(kind: str, output: Path | None) -> None:
    """Print the JSON Schema of a kind of file.

    With it, editors complete keys and mark mistakes; docs/files.md shows how.
    """
    import json

    from lidarcfg.cli import schemas
    from lidarcfg.files import replacing

    text = json.dumps(schemas.schema(kind), indent=2, ensure_ascii=False)
    if output is None:
        click.echo(text)
        return
    with replacing(output) as file:
        file.write(text + "\n")
