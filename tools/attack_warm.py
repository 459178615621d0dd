"""A process that has run a command already, and starts it again by forks: libraries, compiled loops and drawings ready.

A kill then falls into the work and its writing, and not into the seconds that a start takes.
"""

import gc
import io
import os
import pickle
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from attack_commands import MARKS, Command
from attack_outputs import Known, clear, contents
from attack_run import Ended, Row, start, wait

FIRST = ".first"  # when a command began its first file


class Drawings:
    """What each name's run draws: matplotlib takes nine tenths of some commands, and gives the same again."""

    def __init__(self) -> None:
        from matplotlib.figure import Figure

        self._draw = Figure.savefig
        self._drawn: dict[str, list[Any]] = {mark: [] for mark in MARKS}
        self._mark, self._next, self._ready = "", 0, False
        Figure.savefig = lambda figure, target, **options: self._save(figure, target, options)

    def use(self, mark: str, ready: bool) -> None:
        """From now on the drawings of this name, either to keep them or as they were kept."""
        self._mark, self._next, self._ready = mark, 0, ready

    def _save(self, figure: Any, target: Any, options: dict[str, Any]) -> None:
        drawn = self._drawn[self._mark]
        if not self._ready:
            file: Any = io.StringIO() if isinstance(target, io.StringIO) else io.BytesIO()
            self._draw(figure, file, **options)
            drawn.append(file.getvalue())
            target.write(drawn[-1])
        elif self._next < len(drawn):
            target.write(drawn[self._next])
            self._next += 1
        else:
            self._draw(figure, target, **options)


class Warm:
    """Runs of one command in this process, and in forks of it."""

    def __init__(self, folder: Path, command: Command) -> None:
        self.folder, self.command, self._drawings = folder, command, Drawings()
        for mark in MARKS:
            clear(folder, command)
            self._drawings.use(mark, ready=False)
            self._run_here(mark)
        gc.freeze()  # forks share what is there by now
        self.known = self._learn()

    def start(self, mark: str, limit: Callable[[], None] = lambda: None) -> int:
        """Start it in a fork, and return that one's id."""
        self._drawings.use(mark, ready=True)
        return start(self.command.typed(mark), self.folder, limit)

    def run(self, mark: str, limit: Callable[[], None] = lambda: None) -> Ended:
        """A run to its end."""
        began = time.monotonic()
        return wait(self.start(mark, limit), self.folder, began)

    def _run_here(self, mark: str) -> None:
        from lidarcfg.cli import main

        sys.argv = ["lidarcfg", *self.command.typed(mark)]
        with suppress(SystemExit):
            main()

    def _learn(self) -> Known:
        """What runs write, and when they begin to; the first name's outputs stay."""
        files, seconds, writes_s = [], 0.0, 0.0
        for mark in (*MARKS, MARKS[0]):
            clear(self.folder, self.command)
            began = time.monotonic()
            ended = self.run(mark, self._note_first)
            if ended.code:
                raise SystemExit(f"{self.command.name}: {ended.errors}")
            files.append(contents(self.folder, self.command))
            seconds, writes_s = ended.seconds, float((self.folder / FIRST).read_text()) - began
        return Known((files[0], files[1]), seconds, writes_s)

    def _note_first(self) -> None:
        seen = False

        def hook(event: str, given: tuple[Any, ...]) -> None:
            nonlocal seen
            if not seen and event in ("open", "os.mkdir") and str(given[0]).endswith(".part"):
                seen = True
                (self.folder / FIRST).write_text(str(time.monotonic()))

        sys.addaudithook(hook)


def attacked(folder: Path, command: Command, attack: Callable[[Warm], list[Row]]) -> list[Row]:
    """The rows of an attack on a command, made in a process of its own, which runs the command beforehand."""
    reader, writer = os.pipe()
    sys.stdout.flush()
    if not os.fork():
        try:  # the child
            os.close(reader)
            for number in (1, 2):
                os.dup2(os.open(os.devnull, os.O_WRONLY), number)
            os.chdir(folder)
            said = pickle.dumps(attack(Warm(folder, command)))
        except BaseException:  # of whatever kind, it is the parent that reports it
            said = pickle.dumps(f"{command.name}: {traceback.format_exc()}")
        finally:  # nothing of the parent is to be ended here
            with os.fdopen(writer, "wb") as file:
                file.write(said)
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as file:
        found = pickle.loads(file.read())
    os.wait()
    if isinstance(found, str):
        raise SystemExit(found)
    return list(found)
