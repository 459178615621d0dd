"""lidarcfg view: captures, clouds, rigs, studies and scenes to look at."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidarcfg.commands.options import (
    FILE,
    MODEL,
    from_option,
    quiet_option,
    sensor_option,
    to_option,
    warn,
    way,
)

if TYPE_CHECKING:
    from lidarcfg.view.page import Page
    from lidarcfg.view.stage import Stage

# as lidarcfg.view.colours and placement.study have them, which take a second to load
COLOURS = ("sensor", "intensity", "ring", "height", "time", "object")
SIDE_MIN, SIDE_MAX = 16, 16_384
WORST_MAX = 10


class Size(click.ParamType[tuple[int, int]]):
    """WxH in pixels."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """The width and height, or click's error."""
        sides = str(value).lower().replace("×", "x").split("x")
        if len(sides) == 2 and all(side.isascii() and side.isdigit() for side in sides):
            width, height = map(int, sides)
            if min(width, height) >= SIDE_MIN and max(width, height) <= SIDE_MAX:
                return width, height
        return self.fail(f"{value!r} is not WxH in pixels, each {SIDE_MIN} to {SIDE_MAX}", param, ctx)


class Place(click.ParamType[tuple[float, ...]]):
    """Where a camera stands, what it looks at, and how wide it sees."""

    name = "camera"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Six or seven finite numbers, or click's error."""
        try:
            numbers = tuple(map(float, str(value).split(",")))
        except ValueError:
            numbers = ()
        if len(numbers) not in (6, 7) or not all(map(math.isfinite, numbers)):
            self.fail(f"{value!r} is not EYEX,EYEY,EYEZ,X,Y,Z[,FIELD_DEG]", param, ctx)
        return numbers


@click.command()
@click.argument("files", type=FILE, nargs=-1, required=True)
@click.option("--rig", type=FILE, help="The rig that recorded the captures: merges them by its poses.")
@click.option("--model", type=MODEL, help="What a pcap's sensors are, whatever their packets say.")
@from_option
@to_option
@sensor_option
@click.option("--at", default="0,0,0", metavar="X,Y,YAW_DEG", help="Where the vehicle stands in the scenes.")
@click.option("--colour", type=click.Choice(COLOURS), default="sensor", show_default=True, help="What points show.")
@click.option("--worst", type=click.IntRange(0, WORST_MAX), default=3, show_default=True, help="Worst subspaces shown.")
@click.option("--camera", type=Place(), metavar="X,Y,Z,X,Y,Z[,DEG]", help="Its eye, its target, its field of view.")
@click.option("--html", type=FILE, help="Write the page as one file that needs no server.")
@click.option("--png", type=FILE, help="Draw a still; needs no screen.")
@click.option("--size", type=Size(), default="1920x1080", show_default=True, metavar="WxH", help="The still's pixels.")
@click.option("--window", is_flag=True, help="Open Open3D's window.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Where the page is served.  [default: any]")
@quiet_option
def view(
    files: tuple[Path, ...],
    rig: Path | None,
    model: str | None,
    from_s: float,
    to_s: float,
    sensors: tuple[str, ...],
    at: str,
    colour: Any,
    worst: int,
    camera: tuple[float, ...] | None,
    html: Path | None,
    png: Path | None,
    size: tuple[int, int],
    window: bool,
    port: int,
    quiet: bool,
) -> None:
    """Look at any mix of captures (.pcap), clouds (.ply, .pcd, .npz), rigs, a study and scenes (.yaml).

    Without --html, --png or --window an interactive page is served on this machine until Ctrl-C. With a study
    the rig can be moved in it by handles, and max VSR and the worst subspaces follow. The truth of a capture
    (.npz of export --truth) given beside it tells the objects. --from, --to and --sensor choose from captures.

    \b
    Example:
      lidarcfg view out/two.pcap out/two/rig.yaml data/studies/liu2018-2x16.yaml
      lidarcfg view out/two.pcap --rig out/two/rig.yaml --png out/two.png
    """
    import numpy as np

    from lidarcfg.capture.selection import Selection
    from lidarcfg.view.camera import Camera
    from lidarcfg.view.page import page_of, save_html
    from lidarcfg.view.stage import load_stage
    from lidarcfg.view.still import save_still
    from lidarcfg.view.window import show_window

    seen_from = Camera(np.array(camera[:3]), np.array(camera[3:6]), *camera[6:]) if camera else None
    stage = load_stage(files, rig, model, way(None, at, 0).T_world_start, warn, Selection(from_s, to_s, sensors))
    count = len(stage.cloud.xyz)
    if png:
        save_still(stage, png, size, seen_from, colour, worst)
        if not quiet:
            click.echo(f"{png}: {count:,} points")
    if window:
        show_window(stage, colour)
    if html or not (png or window):
        page = page_of(stage, colour, seen_from, worst)
        if html:
            save_html(page, html)
            if not quiet:
                click.echo(f"{html}: {count:,} points, {html.stat().st_size / 1e6:.1f} MB")
        else:
            _serve(stage, page, port, quiet)


def _serve(stage: "Stage", page: "Page", port: int, quiet: bool) -> None:
    """Serve the page until Ctrl-C, and open it where there is a browser with a screen."""
    import webbrowser

    from lidarcfg.view.server import Server
    from lidarcfg.view.window import has_screen

    with Server(stage, page, port) as server:
        if not quiet:
            click.echo(f"{server.url} shows {len(stage.cloud.xyz):,} points; Ctrl-C ends it")
        if has_screen():
            webbrowser.open(server.url)
        server.serve_forever()
