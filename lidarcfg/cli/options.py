"""What the commands share: option types, options, warnings, and values parsed from text."""

import math
import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lidarcfg.cli.completion import complete_model, complete_mount
from lidarcfg.errors import one_line

if TYPE_CHECKING:
    from lidarcfg.world.vehicle import Vehicle

FILE = click.Path(path_type=Path)
UNITS_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "": 1.0}
SECONDS = re.compile(rf"(.*?)\s*({'|'.join(sorted(UNITS_S, key=len, reverse=True))})")
SAVE_EVERY_S = 5.0  # between two saves of a running search
START = "2026-01-01T00:00:00"
START_HELP = f"ISO 8601; UTC unless it names a zone.  [default: {START}]"


class Png(click.Path):
    """A file to draw into: its name ends in .png."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Raises click.BadParameter for another suffix."""
        if Path(value).suffix.lower() != ".png":
            self.fail(f"{str(value)!r} does not end in .png", param, ctx)
        return super().convert(value, param, ctx)


class PositiveNumber(click.FloatRange):
    """A number above zero; click's own range lets NaN pass."""

    def __init__(self, most: float) -> None:
        super().__init__(0, most, min_open=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or click's error."""
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value} is not a number", param, ctx)
        return number


class Factor(PositiveNumber):
    """A factor above zero: 2, 2x or 0.5×."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or click's error."""
        return super().convert(value.rstrip("xX×") if isinstance(value, str) else value, param, ctx)


class Seconds(click.types.FloatParamType):
    """A time in seconds, or with a unit: 1, 1s, 500 ms, 2 min."""

    name = "seconds"

    def __init__(self, most: float = math.inf, signed: bool = False) -> None:
        self._most = most
        self._signed = signed  # zero, negative and infinite ones too

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The seconds, or click's error."""
        if not isinstance(value, str):
            return float(value)
        found = SECONDS.fullmatch(value.strip().lower())
        try:
            seconds = float(found[1]) * UNITS_S[found[2]] if found else math.nan
        except ValueError:
            seconds = math.nan
        if math.isnan(seconds):
            units = " ".join(filter(None, UNITS_S))
            self.fail(f"{value!r} is not a time; allowed: seconds, or a number and a unit: {units}", param, ctx)
        if not self._signed and not 0 < seconds <= self._most:
            limit = f", at most {self._most:,.0f} seconds" if math.isfinite(self._most) else ""
            self.fail(f"{value!r} is not allowed; allowed: above zero{limit}", param, ctx)
        return seconds


class _Readable(click.types.StringParamType):
    """A text that is read later, and can be."""

    def read(self, text: str) -> object:
        """What the text says. Raises ConfigError."""
        raise NotImplementedError

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The text, or click's error."""
        from lidarcfg.errors import ConfigError

        try:
            self.read(value)
        except ConfigError as error:
            self.fail(str(error), param, ctx)
        return value


class StartPose(_Readable):
    """Where a vehicle starts: X,Y,YAW_DEG."""

    name = "pose"

    def read(self, text: str) -> object:
        from lidarcfg.capture.manifest import parse_pose

        return parse_pose(text)


class StartTime(_Readable):
    """When it starts: ISO 8601."""

    name = "time"

    def read(self, text: str) -> object:
        from lidarcfg.capture.manifest import parse_time_ns

        return parse_time_ns(text)


scene_option = cloup.option("--scene", type=FILE, required=True, help="The scene's YAML.")
at_option = cloup.option(
    "--at",
    type=StartPose(),
    default="0,0,0",
    metavar="X,Y,YAW_DEG",
    help="Pose of the vehicle in the scene.  [default: 0,0,0]",
)
trajectory_option = cloup.option(
    "--trajectory", type=FILE, help="The vehicle's motion from there: YAML, or timed poses as .tum."
)
vehicle_option = cloup.option(
    "--vehicle", type=FILE, metavar="FILE|none", help="The vehicle's body: YAML, or a mesh.  [default: the rig's]"
)
model_option = cloup.option(
    "--model",
    metavar="MODEL",
    shell_complete=complete_model,
    help="Use this sensor model, whatever the packets say: a name from the catalogue, or a YAML file.",
)
from_option = cloup.option(
    "--from",
    "from_s",
    type=Seconds(signed=True),
    default=0.0,
    metavar="SECONDS",
    help="Start this long after the first packet.  [default: 0]",
)
to_option = cloup.option(
    "--to",
    "to_s",
    type=Seconds(signed=True),
    default=math.inf,
    metavar="SECONDS",
    help="Stop this long after the first packet.  [default: the end]",
)
sensor_option = cloup.option(
    "--sensor",
    "sensors",
    multiple=True,
    metavar="NAME",
    shell_complete=complete_mount,
    help="Use only this mount, or host:port. May be repeated.",
)
sidecar_option = cloup.option(
    "--sidecar",
    "sidecars",
    type=FILE,
    multiple=True,
    help="Read this file of a sensor's, of any name: an Ouster's metadata, a Hesai's angles or firing times. May be "
    "repeated.  [default: those beside the capture]",
)
json_option = cloup.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
tolerance_option = cloup.option(
    "--tolerance",
    type=PositiveNumber(1),
    metavar="FRACTION",
    help="Also extrapolate max VSR to ever smaller cuboids, to this relative error.",
)
quiet_option = cloup.option("--quiet", is_flag=True, help="Print only errors.")


def command_line() -> str:
    """The command as it was typed, quoted for a shell."""
    return shlex.join(["lidarcfg", *sys.argv[1:]])


def warn(message: str) -> None:
    """Print a warning of one line to stderr."""
    click.echo(f"lidarcfg: warning: {one_line(message)}", err=True)


def warn_of(vehicle: "Vehicle | None") -> None:
    """Print the warnings about the meshes of a vehicle."""
    for message in vehicle.warnings if vehicle else ():
        warn(message)
