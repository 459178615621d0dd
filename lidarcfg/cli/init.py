"""lidarcfg init: commented files to start from."""

from pathlib import Path

import click
import cloup

from lidarcfg.cli.options import FILE, quiet_option, warn
from lidarcfg.cli.progress import progress
from lidarcfg.errors import one_line

KINDS = ("study", "rig", "scene", "sensor")


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg init study --vehicle truck -o out/my-truck/study.yaml
      lidarcfg init study --vehicle 0.8x0.6x0.4 --model mid-360 -o out/robot.yaml
      lidarcfg init rig -o out/my-rig.yaml
    """
)
@cloup.argument("kind", type=click.Choice(KINDS), help="What to write.")
@cloup.option("-o", "--output", type=FILE, required=True, metavar="FILE", help="The file; it must not exist yet.")
@cloup.option(
    "--vehicle",
    metavar="NAME",
    help="For a study: a body from the package (bus, delivery-robot, sedan, shuttle, truck), a mesh file of your own, "
    "a URDF, whose sensors become a rig, or length, width and height of a box in metres, as 0.8x0.6x0.4.",
)
@cloup.option("--model", metavar="MODEL", help="For a study: its sensors' model, or a YAML file.  [default: vlp-16]")
@cloup.option(
    "--triangles",
    type=click.IntRange(min=100, max=10_000_000),
    metavar="N",
    help="Write a mesh of no more triangles than this beside the study, in place of --vehicle's.",
)
@quiet_option
def init(kind: str, output: Path, vehicle: str | None, model: str | None, triangles: int | None, quiet: bool) -> None:
    """Write a commented file to start from.

    The other commands accept the file as it is. Optional keys are in it as comments.
    """
    from lidarcfg.cli.templates import MODEL, write_simplified, write_template

    if vehicle and kind != "study":
        raise click.UsageError(f"--vehicle is for a study, not for a {kind}")
    if model and kind != "study":
        raise click.UsageError(f"--model is for a study, not for a {kind}")
    if triangles and not (vehicle and Path(vehicle).suffix):
        raise click.UsageError("--triangles is for a mesh file of your own; name it with --vehicle")
    if triangles and vehicle:
        with progress(quiet, keep=False) as on_progress:
            body, said = write_simplified(output, Path(vehicle), triangles, on_progress)
        vehicle = str(body)
        if not quiet:
            click.echo(one_line(f"{body}: {said}"))
    written = write_template(kind, output, vehicle, (lambda _: None) if quiet else warn, model or MODEL)
    if not quiet:
        click.echo(f"written: {' '.join(map(str, written))}")
