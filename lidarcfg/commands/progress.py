"""What happens while a command works: the progress bar, and Ctrl-C."""

import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, RLock, Timer
from types import FrameType
from typing import TYPE_CHECKING

import click

from lidarcfg.compiling import compiling
from lidarcfg.errors import one_line

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

AGAIN_S = 0.02
LINE_S = 10.0  # between two lines of a log
LONG_S = 2.0  # of compiling, before a log is told of it
KNOWN_S = 5.0  # of work, before its rate says how long the rest takes
THIN_S = 0.5  # between two updates that the rate is made of


class Interrupts:
    """The handler of the signals that end a command: it raises KeyboardInterrupt, but never inside numba.

    numba crashes on an exception raised in it, so the signal is raised again until numba has finished. A callback
    of a C library may swallow the exception; `check` then raises it at the next progress.
    """

    def __init__(self) -> None:
        self._came, self.screen = Event(), Screen()
        self.doing = ""  # by the latest progress

    def handle(self, number: int, frame: FrameType | None) -> None:
        """The signal handler."""
        self._came.set()
        if _within("numba", frame) and not compiling.may_be_left:
            again = Timer(AGAIN_S, signal.raise_signal, (number,))
            again.daemon = True
            again.start()
            return
        raise KeyboardInterrupt

    def check(self, doing: str) -> None:
        """Raise KeyboardInterrupt if a signal came before this is being done."""
        self.doing = doing
        if self._came.is_set():
            raise KeyboardInterrupt


def _within(package: str, frame: FrameType | None) -> bool:
    """Whether a function of the package is running, or has called what is."""
    while frame and frame.f_globals.get("__name__", "").partition(".")[0] != package:
        frame = frame.f_back
    return frame is not None


class Screen:
    """One bar on stderr for all that a command does, with a line for what is being compiled meanwhile."""

    def __init__(self) -> None:
        self.quiet = False
        self._bar: Progress | None = None
        self._compiling: TaskID | None = None
        self._told, self._lock = False, RLock()  # loops may be compiled by any thread

    def bar(self) -> "Progress":
        """The bar, on the screen."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        with self._lock:
            if self._bar is None:
                left = TextColumn("{task.fields[left]}")
                columns = (BarColumn(30), TextColumn("{task.description}"), TimeElapsedColumn(), left)
                self._bar = Progress(*columns, console=Console(stderr=True))
                self._bar.start()
            return self._bar

    def close(self, clear: bool = False) -> None:
        """Leave the last state of the bar, and go on below it, or leave nothing."""
        with self._lock:
            bar, self._bar = self._bar, None
            if bar:
                self._hide(bar)
                bar.live.transient = clear
                bar.stop()

    def work(self) -> None:
        """Show no longer what was compiled."""
        with self._lock:
            if self._bar:
                self._hide(self._bar)

    def _hide(self, bar: "Progress") -> None:
        if self._compiling is not None:
            bar.remove_task(self._compiling)
            self._compiling = None

    def compile(self) -> None:
        """Show what is being compiled; where nobody watches, one line once that takes long."""
        loops = compiling.loops  # which other threads may change
        if self.quiet or not loops:
            return
        with self._lock:
            if not sys.stderr.isatty():
                if not self._told and compiling.seconds > LONG_S:
                    click.echo(f"compiling {loops[0]} and others, once: later runs start at once", err=True)
                    self._told = True
                return
            bar = self.bar()
            if self._compiling is None:
                self._compiling = bar.add_task("", left="")
            text = f"compiling, once: {loops[0]}"
            bar.update(self._compiling, completed=compiling.compiled, total=compiling.expected, description=text)


@contextmanager
def shown(screen: Screen) -> Iterator[None]:
    """Show what is being compiled, for the rest of a command."""
    before, compiling.on_change = compiling.on_change, screen.compile
    try:
        yield
    finally:
        screen.close()
        compiling.on_change = before


def duration(seconds: float) -> str:
    """A duration in words, to two figures or so."""
    if seconds < 100:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 100 * 60 else f"{seconds / 3600:.1f} h"


@contextmanager
def progress(
    quiet: bool, interrupts: Interrupts | None = None, mean_over_s: float = 30.0, keep: bool = True
) -> Iterator[Callable[[float, str], None]]:
    """A bar on stderr, and the function that updates it with the fraction done and a text.

    The bar appears at the first update, and its last state stays on the screen if it is to `keep`. In a log it is a
    line from time to time. The time left is by the updates of the last `mean_over_s` seconds. An update raises
    KeyboardInterrupt if an interrupt was lost; the interrupts are those of the running command unless given.
    """
    interrupts = interrupts or click.get_current_context().ensure_object(Interrupts)
    if quiet:
        yield lambda fraction, text: interrupts.check(text)
    elif sys.stderr.isatty():
        yield from _bar(interrupts, mean_over_s, keep)
    else:
        yield from _lines(interrupts, mean_over_s, keep)


def _bar(interrupts: Interrupts, mean_over_s: float, keep: bool) -> Iterator[Callable[[float, str], None]]:
    from rich.markup import escape

    screen, task, pace = interrupts.screen, None, Pace(mean_over_s)

    def on_progress(fraction: float, text: str) -> None:
        nonlocal task
        interrupts.check(text)
        bar = screen.bar()
        screen.work()
        if task is None:
            task = bar.add_task("", total=1.0, left="")
        left = _left(pace, fraction)
        bar.update(task, completed=fraction, description=escape(one_line(text)), left=left)

    try:
        yield on_progress
    except BaseException:
        screen.close(clear=True)  # what went wrong is all that is left to say
        raise
    screen.close(clear=not keep)


class Pace:
    """How fast work proceeds, by its updates of the last `mean_over_s` seconds, compiling aside."""

    def __init__(self, mean_over_s: float) -> None:
        self._mean_over_s = mean_over_s
        self._updates = deque[tuple[float, float]]()  # seconds of work, and the fraction done by then

    def left_s(self, worked_s: float, fraction: float) -> float | None:
        """What the rest takes after this update; None: that cannot be known yet."""
        updates = self._updates
        if not updates or worked_s - updates[-1][0] >= THIN_S:
            updates.append((worked_s, fraction))
        while len(updates) > 1 and updates[1][0] <= worked_s - self._mean_over_s:
            updates.popleft()
        took_s, done = worked_s - updates[0][0], fraction - updates[0][1]
        return took_s * (1 - fraction) / done if took_s >= KNOWN_S and done > 0 and fraction < 1 else None


def _left(pace: Pace, fraction: float) -> str:
    """The time left after an update, as far as it can be known."""
    left_s = pace.left_s(time.monotonic() - compiling.seconds, fraction)
    return "" if left_s is None else f"about {duration(left_s)} left"


def _lines(interrupts: Interrupts, mean_over_s: float, keep: bool) -> Iterator[Callable[[float, str], None]]:
    last, told, pace = "", time.monotonic(), Pace(mean_over_s)

    def on_progress(fraction: float, text: str) -> None:
        nonlocal last, told
        interrupts.check(text)
        last, now = f"{fraction:4.0%}  {one_line(text)}", time.monotonic()
        left = _left(pace, fraction)
        if now - told > LINE_S:
            click.echo(f"{last}  {left}".rstrip(), err=True)
            last, told = "", now

    yield on_progress
    if last and keep:
        click.echo(last, err=True)
