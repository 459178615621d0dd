"""lidarcfg init, validate and schema: commented files to start from, and checks of your own."""

import math
import os
import sys
from pathlib import Path

import click
import cloup
from jinja2 import Environment, StrictUndefined

from lidarcfg.cli.options import FILE, quiet_option, warn
from lidarcfg.config.document import inline
from lidarcfg.errors import ConfigError, LidarcfgError, SceneError, one_line
from lidarcfg.files import replacing, shipped

KINDS = ("study", "rig", "scene", "sensor")
CAR = (-2.4, -0.95, 0.0), (2.4, 0.95, 1.5)  # the bounds of a vehicle without a mesh
TEMPLATES = ("study", "rig", "scene", "sensor")
SCHEMAS = (*TEMPLATES, "requirements", "scenario", "vehicle", "trajectory", "plan")


def vehicles() -> dict[str, Path]:
    """The bodies that come with the package, by name."""
    return {path.stem: path for path in sorted(shipped("data").glob("vehicles/*.ply"))}


def write_template(kind: str, path: Path, vehicle: str | None = None) -> list[Path]:
    """Write one of the `KINDS` of files to start from. Returns what was written.

    A study is made around a vehicle: one of `vehicles`, whose mesh is copied beside the study, or a mesh file. Raises
    ConfigError if a file exists already, or if the vehicle is unknown or cannot be read.
    """
    known = vehicles()
    body = None if vehicle is None else known.get(vehicle, Path(vehicle))
    if body and vehicle not in known and not body.suffix:
        raise ConfigError(f"no vehicle is called {vehicle!r}; allowed: {', '.join(known)}, or a mesh file")
    copied = path.parent / f"{vehicle}.ply" if vehicle in known else None
    low, high, scale, unit = _bounds(body) if body else (*CAR, 1.0, "metre")
    template = Environment(undefined=StrictUndefined, keep_trailing_newline=True).from_string(
        (shipped("data") / "templates" / f"{kind}.yaml.j2").read_text("utf-8")
    )
    name = None if body is None else copied.name if copied else os.path.relpath(body, path.parent)
    text = template.render(file=path, body=name and inline(name), scale=scale, unit=unit, **_study(low, high))
    for file in (path, copied):
        if file and file.exists() and not (file == copied and body and file.read_bytes() == body.read_bytes()):
            raise ConfigError(f"{file}: exists already; name another file, or remove it")
    if copied and body and not copied.exists():
        with replacing(copied, "wb") as mesh:
            mesh.write(body.read_bytes())
    with replacing(path) as out:
        out.write(text)
    return [path, copied] if copied else [path]


def _bounds(body: Path) -> tuple[tuple[float, ...], tuple[float, ...], float, str]:
    """The bounds of a mesh in metres, the scale that makes them so, and the unit of the file by its size."""
    import numpy as np

    from lidarcfg.world.meshes import read_mesh
    from lidarcfg.world.vehicle import UNITS, likely_scale

    try:
        vertices = read_mesh(body)[0]
    except SceneError as error:
        raise ConfigError(str(error)) from None
    scale = likely_scale(np.ptp(vertices, axis=0))
    low, high = (tuple((scale * corner).tolist()) for corner in (vertices.min(axis=0), vertices.max(axis=0)))
    return low, high, scale, UNITS[scale]


def _study(low: tuple[float, ...], high: tuple[float, ...]) -> dict[str, list[float]]:
    """A study's region and the bounds of its sensors, around a vehicle's bounds."""
    x = 10 * math.ceil((25 + max(abs(low[0]), abs(high[0]))) / 10)
    y = 5 * math.ceil((8 + max(abs(low[1]), abs(high[1]))) / 5)
    side = (high[1] - low[1]) / 2
    length = high[0] - low[0]
    middle_m = (low[0] + high[0]) / 2
    floor_m = min(math.floor(low[2]), 0)
    top_m = max(math.ceil(high[2]), 4)
    boxes = {
        "low": (-x, -y, floor_m),
        "high": (x, y, top_m),
        "roof_low": (middle_m - length / 8, low[1] + side + side / 4, high[2] + 0.1),
        "roof_high": (middle_m + length / 8, low[1] + side + side / 2, high[2] + 0.4),
        "front_low": (high[0] + 0.05, -side * 0.7, max(low[2], 0) + 0.4),
        "front_high": (high[0] + 0.05, side * 0.7, max(low[2], 0) + 0.8),
        "rear_low": (low[0] - 0.05, -side * 0.7, max(low[2], 0) + 0.4),
        "rear_high": (low[0] - 0.05, side * 0.7, max(low[2], 0) + 0.8),
        "top_low": (middle_m - length / 8, low[1] + side / 2, (low[2] + high[2]) / 2),
        "top_high": (middle_m + length / 8, high[1] - side / 2, high[2] + 0.1),
        "ahead_low": (0, -3, floor_m),
        "ahead_high": (x, 3, floor_m + 2),
        "ahead_top": (x, 3, floor_m + 3),
    }
    return {key: [round(value, 2) for value in corner] for key, corner in boxes.items()}


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
    from lidarcfg.cli.files import write_template

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
