"""How far a command is: on a terminal a bar, in a log a line from time to time."""

import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

from lidarcfg.cli.interrupts import Interrupts
from lidarcfg.errors import one_line

LINE_S = 10.0  # between two lines of a log
KNOWN_S = 5.0  # of work, before its rate says how long the rest takes
THIN_S = 0.5  # between two updates that the rate is made of


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

    screen = interrupts.screen
    task = None
    pace = Pace(mean_over_s)

    def on_progress(fraction: float, text: str) -> None:
        nonlocal task
        interrupts.check(text)
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


class Pace:
    """How fast work proceeds, by its updates of the last `mean_over_s` seconds."""

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
        took_s = worked_s - updates[0][0]
        done = fraction - updates[0][1]
        return took_s * (1 - fraction) / done if took_s >= KNOWN_S and done > 0 and fraction < 1 else None


def _left(pace: Pace, fraction: float) -> str:
    """The time left after an update, as far as it can be known."""
    left_s = pace.left_s(time.monotonic(), fraction)
    return "" if left_s is None else f"about {duration(left_s)} left"


def _lines(interrupts: Interrupts, mean_over_s: float, keep: bool) -> Iterator[Callable[[float, str], None]]:
    last = ""
    told = time.monotonic()
    pace = Pace(mean_over_s)

    def on_progress(fraction: float, text: str) -> None:
        nonlocal last, told
        interrupts.check(text)
        last = f"{fraction:4.0%}  {one_line(text)}"
        now = time.monotonic()
        left = _left(pace, fraction)
        if now - told > LINE_S:
            click.echo(f"{last}  {left}".rstrip(), err=True)
            last = ""
            told = now

    yield on_progress
    if last and keep:
        click.echo(last, err=True)
