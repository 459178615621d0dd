"""A process that has run a command already, and starts it again by forks: libraries, compiled loops and drawings ready.

A kill then falls into the work and its writing, and not into the seconds that a start takes.
"""

import gc
import io
import mmap
import multiprocessing
import os
import pickle
import signal
import struct
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from attack_commands import MARKS, Command
from attack_outputs import Files, Known, clear, contents
from attack_run import Ended, Row, handlers_kept, start, wait

SEEN = "dqq"  # when a command began its first file, its steps since, and whether it died in `together`
WRITERS = ("lidarcfg/files.py", "lidarcfg/aside.py", "lidarcfg/formats/folder.py")


class Drawings:
    """What each name's run draws: matplotlib takes nine tenths of some commands, and gives the same again."""

    def __init__(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        self._drawn: dict[str, list[Any]] = {mark: [] for mark in MARKS}
        self._mark, self._next, self._ready = "", 0, False
        for kind, name in ((FigureCanvasAgg, "print_png"), (FigureCanvasSVG, "print_svg")):
            setattr(kind, name, self._kept(getattr(kind, name)))

    def use(self, mark: str, ready: bool) -> None:
        """From now on the drawings of this name, either to keep them or as they were kept."""
        self._mark, self._next, self._ready = mark, 0, ready

    def _kept(self, draw: Callable[..., None]) -> Callable[..., None]:
        def save(canvas: Any, target: Any, **options: Any) -> None:
            drawn = self._drawn[self._mark]
            if not self._ready:
                file: Any = io.StringIO() if isinstance(target, io.StringIO) else io.BytesIO()
                draw(canvas, file, **options)
                drawn.append(file.getvalue())
                target.write(drawn[-1])
            elif self._next < len(drawn):
                target.write(drawn[self._next])
                self._next += 1
            else:
                draw(canvas, target, **options)

        return save


class Steps:
    """The steps of a command's writing: calls in what puts files aside and in place, and their returns.

    They are counted from the first file that is begun on, in memory that the process shares with its forks.
    """

    def __init__(self) -> None:
        self._seen = mmap.mmap(-1, struct.calcsize(SEEN))
        self.forget()

    @property
    def first_s(self) -> float:
        """When the first file was begun, by the clock of `time.monotonic`; 0 without any."""
        return float(struct.unpack_from(SEEN, self._seen)[0])

    @property
    def count(self) -> int:
        """How many there were."""
        return int(struct.unpack_from(SEEN, self._seen)[1])

    @property
    def swapping(self) -> bool:
        """Whether it died as files took their places together."""
        return bool(struct.unpack_from(SEEN, self._seen)[2])

    def forget(self) -> None:
        """None so far."""
        struct.pack_into(SEEN, self._seen, 0, 0.0, 0, 0)

    def watch(self, last: int = 0, number: int = signal.SIGKILL) -> Callable[[], None]:
        """For a fork: count them; die at the last, if there is to be one, or pause."""

        def step(frame: FrameType, event: str, of: object) -> None:
            if frame.f_code.co_filename.endswith(WRITERS):
                first_s, count, _ = struct.unpack_from(SEEN, self._seen)
                struct.pack_into(SEEN, self._seen, 0, first_s, count + 1, count + 1 == last and _is_within(frame))
                if count + 1 == last:
                    os.kill(os.getpid(), number)

        def hook(event: str, given: tuple[Any, ...]) -> None:
            if event in ("open", "os.mkdir") and not self.first_s and str(given[0]).endswith(".part"):
                struct.pack_into(SEEN, self._seen, 0, time.monotonic(), 0, 0)
                sys.setprofile(step)

        return lambda: sys.addaudithook(hook)


def _is_within(frame: FrameType | None, name: str = "together") -> bool:
    while frame and frame.f_code.co_name != name:
        frame = frame.f_back
    return frame is not None


class _Here:
    """In place of a worker: this process."""

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        return function(*arguments)

    def kill(self) -> None:
        pass


@contextmanager
def _here() -> Iterator[None]:
    """What workers do is done in this process, so that its forks are as ready for that."""
    from lidarcfg.placement import workers

    process, workers._Process = workers._Process, _Here  # type: ignore[assignment,misc]  # put in its place
    try:
        yield
    finally:
        workers._Process = process  # type: ignore[misc]


class Warm:
    """Runs of one command in this process, and in forks of it."""

    def __init__(self, folder: Path, command: Command) -> None:
        clear(folder, command)
        beside = frozenset(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
        self.folder, self.command, self.steps, self._drawings = folder, command, Steps(), Drawings()
        with _here():
            for mark in MARKS:
                clear(folder, command)
                self._drawings.use(mark, ready=False)
                self._run_here(mark)
        fork = multiprocessing.get_context("fork")  # of workers, too: they are not started afresh for seconds
        multiprocessing.get_context = lambda method=None: fork  # type: ignore[assignment]
        gc.freeze()  # forks share what is there by now
        self.known = self._learn(beside)

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
        with handlers_kept(), suppress(SystemExit):  # by its handlers a fork is known to be ready
            main()

    def _learn(self, beside: frozenset[str]) -> Known:
        """What runs write, and when they begin to; the first name's outputs stay."""
        files, seconds, writes_s = list[Files](), 0.0, 0.0
        for mark in (*MARKS, MARKS[0]):
            clear(self.folder, self.command)
            self.steps.forget()
            began = time.monotonic()
            ended = self.run(mark, self.steps.watch())
            if ended.code:
                raise SystemExit(f"{self.command.name}: {ended.errors}")
            files.append(contents(self.folder, self.command))
            seconds, writes_s = ended.seconds, self.steps.first_s - began
        if odd := sorted(name for name in {*files[0], *files[2]} if files[0].get(name) != files[2].get(name)):
            raise SystemExit(f"{self.command.name}: differ from run to run: {odd}")
        return Known((files[0], files[1]), seconds, writes_s, self.steps.count, beside)


def attacked(folder: Path, command: Command, attack: Callable[[Warm], list[Row]]) -> list[Row]:
    """The rows of an attack on a command, made in a process of its own, which runs the command beforehand."""
    reader, writer = os.pipe()
    sys.stdout.flush()
    if not os.fork():
        own = os.getpid()
        try:  # the child
            os.close(reader)
            for number in (1, 2):
                os.dup2(os.open(os.devnull, os.O_WRONLY), number)
            os.chdir(folder)
            said = pickle.dumps(attack(Warm(folder, command)))
        except BaseException:  # of whatever kind, it is the parent that reports it
            said = pickle.dumps(f"{command.name}: {traceback.format_exc()}")
        finally:  # nothing of the parent is to be ended here
            if os.getpid() != own:  # a fork that was to be a command
                os._exit(1)
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
