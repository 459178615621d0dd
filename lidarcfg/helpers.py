"""Processes that compile, beside a command, what it is about to need, into the cache that all processes share.

They are started when the first loop is missing, so that later runs have none. Each ends with its work, and at once when
the command does, however that ends: it reads a pipe that nobody writes to. What it compiles it prints, for the screen.
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

LATER = 10  # how much nicer each helper is than the one before: what the command needs first comes first


def prepare(*rehearsals: str) -> None:
    """Have helpers compile for some rehearsals, the most important first, if any loop is missing.

    rehearsals: names of functions in lidarcfg.commands.rehearsals.
    """
    from lidarcfg.loop_cache import LoopCache

    if _processors() > 1:
        LoopCache.on_missing = lambda: _start(rehearsals)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _start(rehearsals: tuple[str, ...]) -> None:
    helpers = []
    for number, name in enumerate(rehearsals):
        with suppress(OSError, RuntimeError):  # no memory, or too many processes or threads
            helpers.append(Helper(name, number * LATER))
    compiling.others = lambda: _wait(helpers)


def _wait(helpers: "list[Helper]") -> None:
    for helper in helpers:
        with compiling.elsewhere(helper.loop):
            helper.process.wait()


class Helper:
    """A process that runs a rehearsal."""

    def __init__(self, rehearsal: str, nice: int) -> None:
        words = [sys.executable, "-m", "lidarcfg.helpers", rehearsal, str(nice)]
        paths = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
        pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
        self.process = subprocess.Popen(words, bufsize=0, env=environment, stdin=pipe, stdout=pipe, stderr=nowhere)
        self.loop = "other loops"
        atexit.register(self.end)
        Thread(target=self._follow, daemon=True).start()

    def _follow(self) -> None:
        """Count what it says: how many loops it expects to compile, how many it has, and which one it is at."""
        before = 0, 0
        for line in self.process.stdout or ():
            expected, compiled, loop = line.decode().strip().split(maxsplit=2)
            now = int(expected), int(compiled)
            self.loop = loop
            compiling.count(now[0] - before[0], now[1] - before[1])
            before = now

    def end(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()


def _end_with_the_command() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


def main() -> None:
    """Run a rehearsal: `python -m lidarcfg.helpers NAME NICE`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command may go on after Ctrl-C, and needs what is compiled
    Thread(target=_end_with_the_command, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(int(sys.argv[2]))
    gc.disable()
    from importlib import import_module

    compiling.on_change = _tell
    rehearse: Callable[[], None] = getattr(import_module("lidarcfg.commands.rehearsals"), sys.argv[1])
    rehearse()
    os._exit(0)


def _tell() -> None:
    with suppress(OSError):  # nobody reads any longer
        os.write(1, f"{compiling.expected} {compiling.compiled} {(*compiling.loops, 'other loops')[0]}\n".encode())


if __name__ == "__main__":
    main()
