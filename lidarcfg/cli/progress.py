"""The progress of a command: a bar on a terminal, or lines in a log; and the signals that end it, such as Ctrl-C."""

import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

import click

from lidarcfg.errors import one_line

if TYPE_CHECKING:
    from rich.progress import Progress

LINE_S = 10.0  # between two lines of a log
KNOWN_S = 5.0  # of work, before its rate says how long the rest takes
THIN_S = 0.5  # between two updates that the rate is made of
SIGNALS = "SIGINT", "SIGTERM", "SIGHUP"  # not all of them exist on Windows
SHOW_CURSOR = b"\r\x1b[2K\x1b[?25h"  # on an empty line: bars hide it


class ProgressBar:
    """One bar on stderr for all that a command does."""

    def __init__(self) -> None:
        self._bar: Progress | None = None

    def bar(self) -> "Progress":
        """The bar, on the screen."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        if self._bar is None:
            left = TextColumn("{task.fields[left]}")
            columns = (BarColumn(30), TextColumn("{task.description}"), TimeElapsedColumn(), left)
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._bar.start()
        return self._bar

    def close(self, clear: bool = False) -> None:
        """Leave the last state of the bar, and go on below it, or leave nothing."""
        bar = self._bar
        self._bar = None
        if bar:
            bar.live.transient = clear
            bar.stop()


class Interrupts:
    """The handler of the signals that end a command.

    The first signal raises KeyboardInterrupt, so that temporary files are removed and a search keeps what it found. A
    callback of a C library may swallow the exception; `check` then raises it at the next progress. Other code it may
    break, such as a lock that is being released; so whatever error follows, the command was interrupted. A second
    signal ends the process at once.
    """

    def __init__(self) -> None:
        self.progress_bar = ProgressBar()
        self.raised = False  # KeyboardInterrupt was, and the command has not gone on
        self.doing = ""  # by the latest progress
        self._came = False
        self._done = False

    def listen(self) -> None:
        """Handle the signals from now on, but for those that the caller ignores, as nohup has it."""
        for name in SIGNALS:
            number = getattr(signal, name, None)
            if number and signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self.handle)

    def handle(self, number: int, frame: FrameType | None) -> None:
        """The signal handler."""
        if self._done:
            return
        if self.raised:
            self.end()
        self._came = True
        self.raised = True
        raise KeyboardInterrupt

    def check(self, doing: str) -> None:
        """Raise KeyboardInterrupt if a signal came before this is being done."""
        self.doing = doing
        if self._came:
            self.raised = True
            raise KeyboardInterrupt

    def take(self) -> None:
        """Continue after an interrupt that ended a search: its result is there."""
        self._came = False
        self.raised = False

    def finish(self) -> None:
        """Ignore signals from now on: the work is done."""
        self._done = True

    def end(self) -> NoReturn:
        """End the process at once, without its temporary files, and without waiting for threads that still work."""
        self._done = True
        from lidarcfg.files import remove_temporary

        remove_temporary()
        with suppress(OSError):  # not by the streams, which may be in use as the signal comes
            os.write(2, SHOW_CURSOR * os.isatty(2) + b"interrupted\n")
        os._exit(130)


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

    screen = interrupts.progress_bar
    task = None
    pace = WorkPace(mean_over_s)

    def on_progress(fraction: float, text: str) -> None:
        nonlocal task
        interrupts.check(text)
        fraction = min(fraction, 1.0)  # a budget of time is overrun by what is under way
        bar = screen.bar()
        if task is None:
            task = bar.add_task("", total=1.0, left="")
        left = _left(pace, fraction)
        bar.update(task, completed=fraction, description=escape(one_line(text)), left=left)

    try:
        yield on_progress
    except BaseException:  # an interrupt, too
        screen.close(clear=True)  # what went wrong is all that is left to say
        raise
    screen.close(clear=not keep)


class WorkPace:
    """How fast work proceeds, by its updates of the last `mean_over_s` seconds."""

    def __init__(self, mean_over_s: float) -> None:
        self._mean_over_s = mean_over_s
        self._updates = deque[tuple[float, float]]()  # seconds of work, and the fraction done by then

    def left_s(self, worked_s: float, fraction: float) -> float | None:
        """The time left after this update, in seconds; None: not known yet."""
        updates = self._updates
        if not updates or worked_s - updates[-1][0] >= THIN_S:
            updates.append((worked_s, fraction))
        while len(updates) > 1 and updates[1][0] <= worked_s - self._mean_over_s:
            updates.popleft()
        took_s = worked_s - updates[0][0]
        done = fraction - updates[0][1]
        return took_s * (1 - fraction) / done if took_s >= KNOWN_S and done > 0 and fraction < 1 else None


def _left(pace: WorkPace, fraction: float) -> str:
    """The time left after an update, as far as it can be known."""
    left_s = pace.left_s(time.monotonic(), fraction)
    return "" if left_s is None else f"about {duration(left_s)} left"


def _lines(interrupts: Interrupts, mean_over_s: float, keep: bool) -> Iterator[Callable[[float, str], None]]:
    last = ""
    shown_s = time.monotonic()
    pace = WorkPace(mean_over_s)

    def on_progress(fraction: float, text: str) -> None:
        nonlocal last, shown_s
        interrupts.check(text)
        fraction = min(fraction, 1.0)
        last = f"{fraction:4.0%}  {one_line(text)}"
        now = time.monotonic()
        left = _left(pace, fraction)
        if now - shown_s > LINE_S:
            click.echo(f"{last}  {left}".rstrip(), err=True)
            last = ""
            shown_s = now

    yield on_progress
    if last and keep:
        click.echo(last, err=True)
