"""Ctrl-C, and the other signals that end a command."""

import os
import signal
from contextlib import suppress
from threading import Event, Timer, main_thread
from types import FrameType
from typing import NoReturn

from lidarcfg.commands.screen import Screen

SIGNALS = "SIGINT", "SIGTERM", "SIGHUP"  # not all of them exist on Windows
AGAIN_S = 0.02
SHOW_CURSOR = b"\r\x1b[2K\x1b[?25h"  # on an empty line: bars hide it


class Interrupts:
    """The handler of the signals that end a command.

    The first signal raises KeyboardInterrupt, so that temporary files are removed and a search keeps what it found. A
    callback of a C library may swallow the exception; `check` then raises it at the next progress. Other code it may
    break, such as a lock that is being released; so whatever error follows, the command was interrupted. A second
    signal ends the process at once, but not between two files that take their places together.
    """

    def __init__(self) -> None:
        self._came, self.screen = Event(), Screen()
        self.raised = False  # KeyboardInterrupt was, and the command has not gone on
        self.doing = ""  # by the latest progress
        self._done = False
        self._waits = False  # for files

    def listen(self) -> None:
        """Handle the signals from now on, but for those that the caller ignores, as nohup has it."""
        for number in _numbers():
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self.handle)

    def handle(self, number: int, frame: FrameType | None) -> None:
        """The signal handler."""
        if self._done:
            return
        self._came.set()
        self._waits = False
        if self.raised and not _within("lidarcfg.files", "together", frame):
            self.end()
        if self.raised:
            self._waits = True
            again = Timer(AGAIN_S, self._raise_again, (number,))
            again.daemon = True
            again.start()
            return
        self.raised = True
        raise KeyboardInterrupt

    def _raise_again(self, number: int) -> None:
        if not self._waits:  # a check has raised it
            return
        if hasattr(signal, "pthread_kill"):  # or a main thread that sleeps would sleep on
            signal.pthread_kill(main_thread().ident or 0, number)
        else:
            signal.raise_signal(number)

    def check(self, doing: str) -> None:
        """Raise KeyboardInterrupt if a signal came before this is being done."""
        self.doing = doing
        if self._came.is_set():
            self.raised, self._waits = True, False
            raise KeyboardInterrupt

    def take(self) -> None:
        """Go on: a search was interrupted, and its result is there."""
        self._came.clear()
        self.raised = False

    def finish(self) -> None:
        """Ignore signals from now on: all is done."""
        self._done = True

    def end(self) -> NoReturn:
        """End the process at once, without its temporary files, and without waiting for threads that still work."""
        self._done = True
        from lidarcfg.aside import remove_own

        remove_own()
        with suppress(OSError):  # not by the streams, which may be in use as the signal comes
            os.write(2, SHOW_CURSOR * os.isatty(2) + b"interrupted\n")
        os._exit(130)


def _numbers() -> list[signal.Signals]:
    return [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]


def _within(package: str, function: str | None, frame: FrameType | None) -> bool:
    """Whether a function of the package or module, or this one, is running, or has called what is."""
    while frame:
        name = frame.f_globals.get("__name__", "")
        if (name == package or name.startswith(f"{package}.")) and function in (None, frame.f_code.co_name):
            return True
        frame = frame.f_back
    return False
