"""Ctrl-C, and the other signals that end a command."""

import os
import signal
from contextlib import suppress
from types import FrameType
from typing import NoReturn

from lidarcfg.cli.screen import Screen

SIGNALS = "SIGINT", "SIGTERM", "SIGHUP"  # not all of them exist on Windows
SHOW_CURSOR = b"\r\x1b[2K\x1b[?25h"  # on an empty line: bars hide it


class Interrupts:
    """The handler of the signals that end a command.

    The first signal raises KeyboardInterrupt, so that temporary files are removed and a search keeps what it found. A
    callback of a C library may swallow the exception; `check` then raises it at the next progress. Other code it may
    break, such as a lock that is being released; so whatever error follows, the command was interrupted. A second
    signal ends the process at once.
    """

    def __init__(self) -> None:
        self.screen = Screen()
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
        """Go on: a search was interrupted, and its result is there."""
        self._came = False
        self.raised = False

    def finish(self) -> None:
        """Ignore signals from now on: all is done."""
        self._done = True

    def end(self) -> NoReturn:
        """End the process at once, without its temporary files, and without waiting for threads that still work."""
        self._done = True
        from lidarcfg.files import remove_temporary

        remove_temporary()
        with suppress(OSError):  # not by the streams, which may be in use as the signal comes
            os.write(2, SHOW_CURSOR * os.isatty(2) + b"interrupted\n")
        os._exit(130)
