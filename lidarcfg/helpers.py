"""A process that compiles, beside a command, what it is about to need, into the cache that all processes share.

It is started when the first loop is missing, so that later runs have none. It ends with its work, and at once when the
command does, however that ends: it reads a pipe that nobody writes to. How much it compiles it prints, for the screen.
Where it cannot run, the command compiles everything itself.
"""

import atexit
import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Thread

from lidarcfg.compiling import compiling


def prepare(*rehearsals: str, meanwhile: tuple[str, ...] = ()) -> None:
    """Have a helper compile for some rehearsals, one after the other, if any loop is missing.

    rehearsals: names of functions in lidarcfg.commands.rehearsals. Where a budget would have to wait for the helper,
    the command compiles for others, `meanwhile`.
    """
    from lidarcfg.loop_cache import LoopCache

    if _processors() > 1:
        LoopCache.on_missing = lambda: _start(rehearsals, meanwhile)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _start(rehearsals: tuple[str, ...], meanwhile: tuple[str, ...]) -> None:
    with suppress(OSError, RuntimeError):  # no memory, or too many processes or threads
        helper = Helper(*rehearsals)
        compiling.others = lambda: _wait(helper, meanwhile)


def _wait(helper: "Helper", meanwhile: tuple[str, ...]) -> None:
    for rehearsal in meanwhile:
        _rehearse(rehearsal)
    with compiling.elsewhere():
        helper.process.wait()


def _rehearse(name: str) -> None:
    from importlib import import_module

    rehearsal: Callable[[], None] = getattr(import_module("lidarcfg.commands.rehearsals"), name)
    rehearsal()


class Helper:
    """A process that runs rehearsals."""

    def __init__(self, *rehearsals: str) -> None:
        words = [sys.executable, "-m", "lidarcfg.helpers", *rehearsals]
        paths = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
        pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
        self.process = subprocess.Popen(words, bufsize=0, env=environment, stdin=pipe, stdout=pipe, stderr=nowhere)
        atexit.register(self.end)
        Thread(target=self._follow, daemon=True).start()

    def _follow(self) -> None:
        """Count what it says: how many loops it expects to compile, and how many it has."""
        before = 0, 0
        for line in self.process.stdout or ():
            expected, compiled = map(int, line.split())
            compiling.count(expected - before[0], compiled - before[1])
            before = expected, compiled

    def end(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()


def _end_with_the_command() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


def main() -> None:
    """Run rehearsals: `python -m lidarcfg.helpers NAME…`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command may go on after Ctrl-C, and needs what is compiled
    Thread(target=_end_with_the_command, daemon=True).start()
    gc.disable()
    compiling.on_change = _tell
    for name in sys.argv[1:]:
        _rehearse(name)
    os._exit(0)


def _tell() -> None:
    with suppress(OSError):  # nobody reads any longer
        os.write(1, f"{compiling.expected} {compiling.compiled}\n".encode())


if __name__ == "__main__":
    main()
