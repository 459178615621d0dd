"""The command: what it says of itself and how it ends.

Each module of `commands` reads inputs, makes one library call and prints one table.
"""

import gc
import os
import signal
import sys

import click

import lidarcfg
from lidarcfg.commands.capture import decode, export, replay
from lidarcfg.commands.compare import compare
from lidarcfg.commands.completion import completion
from lidarcfg.commands.convert import convert
from lidarcfg.commands.help import Tasks
from lidarcfg.commands.options import interrupt
from lidarcfg.commands.placement import evaluate, optimize
from lidarcfg.commands.sensors import sensors
from lidarcfg.commands.view import view
from lidarcfg.errors import LidarcfgError, one_line


def main() -> None:
    """Entry point: 0 when done, 2 with one line for the user's mistake, 130 after Ctrl-C, 1 for a bug."""
    gc.set_threshold(50_000)  # modules make many objects that stay: looked through less often, they load sooner
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # what was reached is kept, nothing half-written stays
        number = getattr(signal, name, None)
        if number and signal.getsignal(number) != signal.SIG_IGN:  # nohup's wish stands
            signal.signal(number, interrupt)
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # who read our output has gone: end quietly, as other tools do
    sys.stdout, sys.stderr = sys.stdout or open(os.devnull, "w"), sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    try:
        code = cli.main(standalone_mode=False)
    except click.ClickException as error:
        message = " ".join(error.format_message().split())
        _fail(f"{message} (see {_command_path(error)} --help)")
    except LidarcfgError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename}: {(error.strerror or str(error)).lower()}" if error.filename else str(error))
    except MemoryError:
        _fail("out of memory; a coarser grid, fewer samples or a shorter capture need less")
    except ImportError as error:
        if ".so" not in str(error):
            raise
        _fail(f"a system library is missing: {error} (Debian: apt-get install libegl1 libgl1 libusb-1.0-0)")
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.stdout.flush()
        os._exit(130)  # threads that still cast are not waited for
    sys.exit(code or 0)


def _command_path(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context else "lidarcfg"


def _fail(message: str) -> None:
    click.echo(f"lidarcfg: {one_line(message)}", err=True)
    sys.exit(2)


@click.group(
    cls=Tasks,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""
    \b
    From a study to a picture:
      lidarcfg optimize data/studies/liu2018-2x16.yaml -o out/two
      lidarcfg evaluate data/studies/liu2018-2x16.yaml out/two/rig.yaml
      lidarcfg export out/two/rig.yaml --scene data/scenes/street.yaml --at=-30,-10,0 --duration 1 -o out/two.pcap
      lidarcfg decode out/two.pcap --rig out/two/rig.yaml -o out/two.ply
      lidarcfg view out/two.ply out/two/rig.yaml --png out/two.png

    Each command explains itself and shows an example: lidarcfg optimize --help. The project's docs/ has a page for
    each task, its README.md the table of contents.
    """,
)
@click.version_option(lidarcfg.__version__, prog_name="lidarcfg")
@click.pass_context
def cli(context: click.Context) -> None:
    """Where should the LiDARs sit on this vehicle, and what will they hear?

    A study (which sensors may sit where) becomes a rig (where they sit best). A rig in a scene becomes a capture: the
    packets that the real sensors would send. A capture, this or a real one, becomes points to look at and to hand on.
    Studies, rigs, scenes and sensors are YAML files.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


cli.add_task("Place sensors on a vehicle", optimize, evaluate, compare)
cli.add_task("Hear what they send", export, decode, replay)
cli.add_task("Look at it", view)
cli.add_task("Hand it to other tools", convert)
cli.add_task("Know the sensors, help the shell", sensors, completion)
