"""lidarcfg init: commented files to start from."""

from pathlib import Path

import click
import cloup

from lidarcfg.cli.options import FILE, quiet_option, warn

KINDS = ("study", "rig", "scene", "sensor")


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg init study --vehicle truck -o out/my-truck/study.yaml
      lidarcfg init rig -o out/my-rig.yaml
    """
)
@cloup.argument("kind", type=click.Choice(KINDS), help="What to write.")
@cloup.option("-o", "--output", type=FILE, required=True, metavar="FILE", help="The file; it must not exist yet.")
@cloup.option(
    "--vehicle",
    metavar="NAME",
    help="For a study: a body from the package (bus, delivery-robot, sedan, shuttle, truck), a mesh file of your own, "
    "or a URDF, whose sensors become a rig.",
)
@quiet_option
def init(kind: str, output: Path, vehicle: str | None, quiet: bool) -> None:
    """Write a commented file to start from.

    The other commands accept the file as it is. Optional keys are in it as comments.
    """
    from lidarcfg.cli.templates import write_template

    if vehicle and kind != "study":
        raise click.UsageError(f"--vehicle is for a study, not for a {kind}")
    written = write_template(kind, output, vehicle, (lambda _: None) if quiet else warn)
    if not quiet:
        click.echo(f"written: {' '.join(map(str, written))}")
