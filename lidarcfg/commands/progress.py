"""What happens while a command works: the progress bar, and Ctrl-C."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Timer
from types import FrameType

import click

from lidarcfg.errors import one_line

AGAIN_S = 0.02


class Interrupts:
    """The handler of the signals that end a command: it raises KeyboardInterrupt, but never inside numba.

    numba crashes on an exception raised in it, so the signal is raised again until numba has finished. A callback
    of a C library may swallow the exception; `check` then raises it at the next progress.
    """

    def __init__(self) -> None:
        self._came = Event()

    def handle(self, number: int, frame: FrameType | None) -> None:
        """The signal handler."""
        self._came.set()
        if _within("numba", frame):
            again = Timer(AGAIN_S, signal.raise_signal, (number,))
            again.daemon = True
            again.start()
            return
        raise KeyboardInterrupt

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal came."""
        if self._came.is_set():
            raise KeyboardInterrupt


def _within(package: str, frame: FrameType | None) -> bool:
    """Whether a function of the package is running, or has called what is."""
    while frame and frame.f_globals.get("__name__", "").partition(".")[0] != package:
        frame = frame.f_back
    return frame is not None


@contextmanager
def progress(
    quiet: bool, interrupts: Interrupts | None = None, mean_over_s: float = 30.0
) -> Iterator[Callable[[float, str], None]]:
    """A bar on stderr, and the function that updates it with the fraction done and a text.

    The bar appears at the first update; its time left is by the updates of the last `mean_over_s` seconds. An update
    raises KeyboardInterrupt if an interrupt was lost; the interrupts are those of the running command unless given.
    """
    interrupts = interrupts or click.get_current_context().ensure_object(Interrupts)
    if quiet:
        yield lambda fraction, text: interrupts.check()
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(30), TextColumn("{task.description}"), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True), speed_estimate_period=mean_over_s)
    task = bar.add_task("", total=1.0)

    def on_progress(fraction: float, text: str) -> None:
        interrupts.check()
        bar.start()
        bar.update(task, completed=fraction, description=escape(one_line(text)))

    try:
        yield on_progress
    finally:
        if bar.live.is_started:
            bar.stop()
