"""What commands share: kinds of values, times and places from text, warnings and progress."""

import math
import shlex
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Timer
from types import FrameType
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from lidarcfg.errors import one_line
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.geometry import Array
    from lidarcfg.world.motion import Trajectory

FILE = click.Path(path_type=Path)
AGAIN_S = 0.02
_interrupted = Event()
START_HELP = "ISO 8601, UTC unless it says.  [default: 2026-01-01T00:00:00]"


class Seconds(click.FloatRange):
    """A number above zero, of seconds if nothing else is said; click's own range lets NaN pass."""

    name = "seconds"

    def __init__(self, most: float) -> None:
        super().__init__(0, most, min_open=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or click's error."""
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value} is not a number", param, ctx)
        return number


class Share(Seconds):
    """A relative error: above zero, at most one."""

    name = "share"


class SensorModel(click.ParamType[str]):
    """A sensor by its name in the catalogue, or by the path of its YAML."""

    name = "model"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """The names that begin so; where none does, files."""
        from lidarcfg.sensor import catalogue

        names = [CompletionItem(name) for name in catalogue() if name.startswith(incomplete)]
        return names or [CompletionItem(incomplete, type="file")]


class MountName(click.ParamType[str]):
    """A sensor by its name in the rig that is given, or host:port."""

    name = "name"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """The names that begin so, if the rig can be read."""
        from lidarcfg.errors import LidarcfgError
        from lidarcfg.rig import load_rig

        try:
            names = [mount.name for mount in load_rig(ctx.params["rig"]).mounts] if ctx.params.get("rig") else []
        except LidarcfgError:
            names = []
        return [CompletionItem(name) for name in names if name.startswith(incomplete)]


MODEL = SensorModel()
from_option = click.option(
    "--from", "from_s", type=float, default=0.0, metavar="S", help="Seconds after the first packet.  [default: 0]"
)
to_option = click.option(
    "--to", "to_s", type=float, default=math.inf, metavar="S", help="Up to here.  [default: the end]"
)
sensor_option = click.option(
    "--sensor", "sensors", type=MountName(), multiple=True, help="Only this mount, or host:port; may be given again."
)
quiet_option = click.option("--quiet", is_flag=True, help="Print nothing but errors.")


def typed() -> str:
    """The command line, as a shell takes it."""
    return shlex.join(["lidarcfg", *sys.argv[1:]])


def warn(message: str) -> None:
    """Print one line to stderr; the command goes on."""
    click.echo(f"lidarcfg: warning: {one_line(message)}", err=True)


def way(trajectory: Path | None, at: str, start_ns: int) -> "Trajectory":
    """How the vehicle moves from X,Y,YAW_DEG on; without a file it stands there."""
    from lidarcfg.world.motion import STANDING, Trajectory, load_motion, prepared

    return Trajectory(_vehicle_pose(at), prepared(load_motion(trajectory) if trajectory else STANDING), start_ns)


def _vehicle_pose(at: str) -> "Array":
    """T_world_vehicle (4, 4) from X,Y,YAW_DEG."""
    from lidarcfg.geometry import pose

    try:
        x, y, yaw_deg = map(float, at.split(","))
        if not all(map(math.isfinite, (x, y, yaw_deg))):
            raise ValueError
    except ValueError:
        raise click.BadParameter(f"{at!r} is not three numbers X,Y,YAW_DEG", param_hint="--at") from None
    return pose((x, y, 0.0), (0.0, 0.0, math.radians(yaw_deg)))


def nanoseconds(start: str) -> int:
    """Since 1970 in UTC."""
    from datetime import UTC, datetime

    try:
        time = datetime.fromisoformat(start)
    except ValueError:
        what = f"{start!r} is not a time such as 2026-01-01T00:00:00"
        raise click.BadParameter(what, param_hint="--start") from None
    if time.tzinfo is None:
        time = time.replace(tzinfo=UTC)
    since = time - datetime(1970, 1, 1, tzinfo=UTC)
    if not 0 <= since.total_seconds() < 2**32:
        raise click.BadParameter(f"{start!r} is outside a pcap's 1970 to 2106", param_hint="--start")
    return (since.days * 86_400 + since.seconds) * SECOND_NS + since.microseconds * 1000


def interrupt(number: int, frame: FrameType | None) -> None:
    """What signals that end a command do. Where numba is at work it waits: numba crashes on what is raised in it."""
    _interrupted.set()
    if _within("numba", frame):
        again = Timer(AGAIN_S, signal.raise_signal, (number,))
        again.daemon = True
        again.start()
        return
    raise KeyboardInterrupt


def _within(package: str, frame: FrameType | None) -> bool:
    """Whether a function of the package is at work, or has called what is."""
    while frame and frame.f_globals.get("__name__", "").partition(".")[0] != package:
        frame = frame.f_back
    return frame is not None


def _check_interrupted() -> None:
    if _interrupted.is_set():
        raise KeyboardInterrupt


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[float, str], None]]:
    """A bar on stderr that is told the share that is done and a text; it shows from the first share on.

    Being told raises KeyboardInterrupt if there was an interrupt that got lost, as in a callback of a library in C.
    """
    if quiet:
        yield lambda share, text: _check_interrupted()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(30), TextColumn("{task.description}"), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task("", total=1.0)

    def on_share(share: float, text: str) -> None:
        _check_interrupted()
        bar.start()
        bar.update(task, completed=share, description=text)

    try:
        yield on_share
    finally:
        if bar.live.is_started:
            bar.stop()
