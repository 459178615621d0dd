"""lidarcfg view: captures, clouds, rigs, studies and scenes to look at."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lidarcfg.cli.options import (
    FILE,
    START,
    Png,
    StartPose,
    StartTime,
    from_option,
    model_option,
    quiet_option,
    sensor_option,
    to_option,
    warn,
)

if TYPE_CHECKING:
    from lidarcfg.viewer.contents import Contents
    from lidarcfg.viewer.page import Page

# as lidarcfg.viewer.colours and placement.evaluation have them, which take a second to load
COLOURS = ("sensor", "intensity", "ring", "height", "time", "object")
SIDE_MIN = 16
SIDE_MAX = 8192
PIXELS_MAX = 36_000_000
WORST_MAX = 10


def size(text: str) -> tuple[int, int]:
    """The width and height of WxH, or click's error."""
    sides = text.lower().replace("×", "x").split("x")
    if len(sides) == 2 and all(side.isascii() and side.isdigit() for side in sides):
        width, height = map(int, sides)
        if min(width, height) >= SIDE_MIN and max(width, height) <= SIDE_MAX and width * height <= PIXELS_MAX:
            return width, height
    raise click.BadParameter(
        f"{text!r} is not WxH in pixels, each {SIDE_MIN} to {SIDE_MAX} and {PIXELS_MAX:,} in all at most"
    )


def camera_numbers(text: str) -> tuple[float, ...]:
    """Six or seven finite numbers: eye, target and perhaps the field of view; or click's error."""
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        numbers = ()
    if len(numbers) not in (6, 7) or not all(map(math.isfinite, numbers)):
        raise click.BadParameter(f"{text!r} is not EYEX,EYEY,EYEZ,X,Y,Z[,FIELD_DEG]")
    return numbers


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg view out/sedan.pcap out/sedan/rig.yaml data/studies/sedan.yaml
      lidarcfg view out/sedan.pcap --rig out/sedan/rig.yaml --png out/sedan.png
    """
)
@cloup.argument(
    "files",
    type=FILE,
    nargs=-1,
    required=True,
    help="Any mix of captures (.pcap), clouds (.ply .pcd .npz), ground truth (.npz), rigs, a study, scenes (.yaml).",
)
@cloup.option_group(
    "Captures",
    cloup.option("--rig", type=FILE, help="The rig that recorded the captures.  [default: from the export's manifest]"),
    model_option,
    from_option,
    to_option,
    sensor_option,
)
@cloup.option_group(
    "Motion",
    cloup.option(
        "--trajectory", type=FILE, help="The vehicle's motion; deskews the points.  [default: from the manifest]"
    ),
    cloup.option(
        "--at",
        type=StartPose(),
        metavar="X,Y,YAW_DEG",
        help="Pose of the vehicle in the scenes.  [default: from the manifest, or 0,0,0]",
    ),
    cloup.option(
        "--start",
        type=StartTime(),
        metavar="TIME",
        help=f"When the motion starts; ISO 8601.  [default: from the manifest, or {START}]",
    ),
)
@cloup.option_group(
    "Display",
    cloup.option(
        "--colour",
        type=click.Choice(COLOURS),
        metavar="BY",
        default="sensor",
        help=f"Colour of the points: {', '.join(COLOURS)}.  [default: sensor]",
    ),
    cloup.option(
        "--worst",
        type=click.IntRange(0, WORST_MAX),
        metavar="N",
        help="Show the N worst subspaces, at most 10.  [default: 3, or none beside points or what is missed]",
    ),
    cloup.option(
        "--camera",
        type=camera_numbers,
        metavar="X,Y,Z,X,Y,Z[,DEG]",
        help="Eye, target, field of view of a still or the page.",
    ),
)
@cloup.option_group(
    "Output",
    cloup.option("--html", type=FILE, help="Write the page as one file that needs no server."),
    cloup.option("--png", type=Png(), help="Draw a still picture; needs no screen."),
    cloup.option(
        "--size",
        type=size,
        default="1920x1080",
        metavar="WxH",
        help="Size of the still in pixels.  [default: 1920x1080]",
    ),
    cloup.option("--window", is_flag=True, help="Open Open3D's window."),
    cloup.option(
        "--port", type=click.IntRange(0, 65535), metavar="PORT", default=0, help="Port of the page.  [default: any]"
    ),
    quiet_option,
)
def view(
    files: tuple[Path, ...],
    rig: Path | None,
    model: str | None,
    from_s: float,
    to_s: float,
    sensors: tuple[str, ...],
    trajectory: Path | None,
    at: str | None,
    start: str | None,
    colour: Any,
    worst: int | None,
    camera: tuple[float, ...] | None,
    html: Path | None,
    png: Path | None,
    size: tuple[int, int],
    window: bool,
    port: int,
    quiet: bool,
) -> None:
    """View captures, clouds, rigs, studies and scenes.

    Without --html, --png or --window an interactive page is served on this machine until Ctrl-C. With a study, the
    rig's sensors can be dragged; max VSR and the worst subspaces are updated. Ground truth (export --truth) given
    beside its capture names the object that each point lies on. Rig, scene, vehicle and trajectory of an exported
    capture are taken from its manifest, the .pcap.yaml beside it.
    """
    import numpy as np

    from lidarcfg.capture.manifest import DriveInputs
    from lidarcfg.capture.selection import Selection
    from lidarcfg.report.describe import counted
    from lidarcfg.viewer.camera import Camera
    from lidarcfg.viewer.contents import complete_inputs, load_contents
    from lidarcfg.viewer.page import page_of, save_html
    from lidarcfg.viewer.still import save_still
    from lidarcfg.viewer.window import show_window

    seen_from = Camera(np.array(camera[:3]), np.array(camera[3:6]), *camera[6:]) if camera else None
    given = DriveInputs(rig, trajectory=trajectory, at=at, start=start)
    paths, known = complete_inputs(files, given, warn)
    selection = Selection(from_s, to_s, sensors)
    contents = load_contents(paths, known.rig, model, known.motion(), warn, selection, known.vehicle)
    if start and contents.trajectory.path.is_static and not contents.scenes:
        raise click.UsageError(
            "--start is the time at which a --trajectory or a scene's motion starts; there is neither"
        )
    count = len(contents.cloud.xyz)
    if png:
        save_still(contents, png, size, seen_from, colour, worst)
        if not quiet:
            click.echo(f"{png}: {counted(count, 'point')}")
    if window:
        show_window(contents, colour)
    if html or not (png or window):
        page = page_of(contents, colour, seen_from, worst, served=html is None)
        if html:
            save_html(page, html)
            if not quiet:
                click.echo(f"{html}: {counted(count, 'point')}, {html.stat().st_size / 1e6:.1f} MB")
        else:
            _serve(contents, page, port, quiet)


def _serve(contents: "Contents", page: "Page", port: int, quiet: bool) -> None:
    """Serve the page until Ctrl-C, and open it where there is a browser with a screen."""
    import webbrowser

    from lidarcfg.report.describe import counted
    from lidarcfg.viewer.server import Server
    from lidarcfg.viewer.window import has_screen

    with Server(contents, page, port) as server:
        if not quiet:
            click.echo(f"{server.url} shows {counted(len(contents.cloud.xyz), 'point')}; Ctrl-C ends it")
        if has_screen():
            webbrowser.open(server.url)
        server.serve_forever()
