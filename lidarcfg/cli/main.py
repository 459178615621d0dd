"""The command line: its help page and its exit codes."""

import gc
import io
import os
import signal
import sys

import click
import cloup

import lidarcfg
from lidarcfg.cli.compare import compare
from lidarcfg.cli.completion import completion
from lidarcfg.cli.convert import convert
from lidarcfg.cli.decode import decode
from lidarcfg.cli.evaluate import evaluate
from lidarcfg.cli.export import export
from lidarcfg.cli.init import init
from lidarcfg.cli.live import live
from lidarcfg.cli.optimize import optimize
from lidarcfg.cli.progress import Interrupts
from lidarcfg.cli.replay import replay
from lidarcfg.cli.schema import schema
from lidarcfg.cli.sensors import sensors
from lidarcfg.cli.sweep import sweep
from lidarcfg.cli.validate import validate
from lidarcfg.cli.verify import verify
from lidarcfg.cli.view import view
from lidarcfg.errors import ConfigError, LidarcfgError, one_line, reason
from lidarcfg.inputs import LIBRARIES_BYTES, check_memory, is_out_of_memory, out_of_memory

OBJECTS_BETWEEN_COLLECTIONS = 200_000  # at 700, a tenth of a start is spent on collections that find little garbage
MEANT = {  # what other programs call our options
    "--time": ("--seconds", "--duration"),
    "--timeout": ("--seconds",),
    "--budget": ("--seconds", "--evaluations"),
    "--length": ("--duration",),
    "--out": ("--output",),
    "--rate": ("--speed",),
    "--format": ("--to",),
    "--jobs": ("--threads", "--workers"),
    "--cores": ("--threads", "--workers"),
}
EPOCH_DIGITS = 11  # of the seconds since 1970, to the year 5138


def main() -> None:
    """Entry point.

    Exits with 0 when done, 2 after a mistake of the user's, 3 if a requirement is not met, 130 after Ctrl-C, 1 after a
    bug.
    """
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    interrupts = Interrupts()
    interrupts.listen()
    try:
        code = _run(interrupts)
    except KeyboardInterrupt:
        interrupts.end()
    finally:
        interrupts.finish()
    sys.exit(code)


def _run(interrupts: Interrupts) -> int:
    """Run the command and print its error, if any; returns the exit code."""
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end quietly if the reader of our output is gone
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):  # print ? for characters that the terminal's encoding lacks
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        _check_environment()
        return int(cli.main(standalone_mode=False, obj=interrupts) or 0)
    except click.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        if interrupts.raised:  # which broke something
            raise KeyboardInterrupt from None
        return _fail(_format_error(error, interrupts.doing))


def _fail(message: str) -> int:
    for line in message.split("\n"):
        click.echo(f"lidarcfg: {one_line(line)}", err=True)
    return 2


def _format_error(error: Exception, doing: str) -> str:
    """Formats an error for the terminal; re-raises bugs."""
    if isinstance(error, click.NoSuchOption) and (meant := _meant(error)):
        error = click.UsageError(f"No such option {error.option_name!r}. Did you mean {' or '.join(meant)}?", error.ctx)
    if isinstance(error, click.ClickException):
        return f"{' '.join(error.format_message().split())} (see {_command_path(error)} --help)"
    if isinstance(error, LidarcfgError):
        return str(error)
    if is_out_of_memory(error):
        return str(out_of_memory(error, doing or " ".join(sys.argv[1:2])))
    if isinstance(error, OSError):
        return f"{error.filename}: {reason(error)}" if error.filename else str(error)
    if isinstance(error, ImportError) and ".so" in str(error):
        return f"a system library is missing: {error} (Debian: apt-get install libegl1 libgl1 libusb-1.0-0)"
    raise error


def _meant(error: click.NoSuchOption) -> list[str]:
    """The command's options that other programs call by this name."""
    known = {option for one in error.ctx.command.params for option in one.opts} if error.ctx else set[str]()
    return [one for one in MEANT.get(error.option_name, ()) if one in known]


def _check_environment() -> None:
    """Raises LidarcfgError for an environment in which libraries would fail or hang on import."""
    if not {"-h", "--help", "--version"} & set(sys.argv):
        check_memory("any command", 0.0, reserved=LIBRARIES_BYTES)
    os.environ["MPLBACKEND"] = "agg"  # for all commands; matplotlib would reject an unknown backend
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not epoch.isdecimal() or len(epoch) > EPOCH_DIGITS:
        raise ConfigError(f"SOURCE_DATE_EPOCH: {epoch[:40]!r} is not a number of seconds since 1970")


def _command_path(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context else "lidarcfg"


@cloup.group(
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    sections=[
        cloup.Section("Place sensors on a vehicle", [optimize, evaluate, verify, compare, sweep]),
        cloup.Section("Simulate and read captures", [export, decode, replay, live]),
        cloup.Section("Look at the results", [view]),
        cloup.Section("Use them in other tools", [convert]),
        cloup.Section("Write and check files", [init, validate, schema]),
        cloup.Section("Sensor models and the shell", [sensors, completion]),
    ],
    epilog="""
    \b
    From a study to a picture:
      lidarcfg optimize data/studies/sedan.yaml -o out/sedan --seconds 30
      lidarcfg evaluate data/studies/sedan.yaml out/sedan/rig.yaml
      lidarcfg export out/sedan/rig.yaml --scene data/scenes/street.yaml \\
          --at=0,-1.8,0 --duration 1 -o out/sedan.pcap
      lidarcfg decode out/sedan.pcap --rig out/sedan/rig.yaml -o out/sedan.ply
      lidarcfg view out/sedan.ply out/sedan/rig.yaml --png out/sedan.png

    The files under data/ come with the package. `lidarcfg COMMAND --help` explains a command and shows an example;
    docs/ has a page for each task.
    """,
)
@click.version_option(lidarcfg.__version__, prog_name="lidarcfg")
@click.pass_context
def cli(context: click.Context) -> None:
    """Where should the LiDARs sit on this vehicle, and what will they see?

    A study says which sensors may sit where; `optimize` finds the rig: the poses from which they see best.
    `export` simulates a rig in a scene and writes the packets that the real sensors would send. `decode` turns such
    a capture, or a recorded one, into a point cloud. Studies, rigs, scenes and sensors are YAML files.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())
