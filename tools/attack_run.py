"""How the attacks run a command, and what they make of its end."""

import os
import resource
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parent.parent
SECONDS, MEGABYTES = 10.0, 1000.0  # of a processor and of memory: a bad input is refused, or used, within these
HANGS_S, BUSY_S = 600, 60  # by the clock and of a processor: one that takes longer is ended
LIBRARIES = "numba scipy.ndimage scipy.spatial.transform matplotlib.figure open3d jinja2 lidarcfg.cli lidarcfg.report "
LIBRARIES += (
    "lidarcfg.view.page lidarcfg.view.still lidarcfg.simulate.export lidarcfg.formats.bag lidarcfg.placement.details"
)


@dataclass
class Row:
    """A line of the table: an attack, how often it was made, and what went wrong."""

    what: str
    cases: int = 0
    failures: list[str] = field(default_factory=list)
    seen: str = ""
    group: str = ""
    command: str = ""  # of the commands that write, this one

    def add(self, wrong: str) -> None:
        """One more case; empty if all was well."""
        self.cases += 1
        if wrong:
            self.failures.append(wrong)
            print(f"  {self.what}: {wrong}", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int  # negative: by this signal
    errors: str
    seconds: float
    busy_s: float  # of processors
    megabytes: float  # resident, at most

    @property
    def said(self) -> str:
        """What it said on stderr, warnings aside."""
        lines = [line for line in self.errors.splitlines() if not line.startswith("lidarcfg: warning: ")]
        return "\n".join(lines)

    @property
    def not_refused(self) -> str:
        """Empty if it ended with exit 2 and one line, in time and memory; else what it did instead."""
        one_line = self.said.startswith("lidarcfg: ") and "\n" not in self.said
        return self.unfit if self.code == 2 and one_line else f"exit {self.code}, {self.said[-200:]!r}"

    @property
    def unfit(self) -> str:
        """Empty if it ended in time and memory."""
        what = f"{self.busy_s:.1f} s of processors, {self.megabytes:.0f} MB"
        return "" if self.busy_s <= SECONDS and self.megabytes <= MEGABYTES else what


def load_libraries() -> None:
    """Import what commands import, so that a forked one starts with its work."""
    import importlib

    for name in LIBRARIES.split():
        importlib.import_module(name)


@contextmanager
def handlers_kept() -> Iterator[None]:
    """Have the handlers of signals afterwards that there were before: `main` sets its own."""
    handled = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE
    handlers = [signal.getsignal(number) for number in handled]
    try:
        yield
    finally:
        for number, handler in zip(handled, handlers, strict=True):
            signal.signal(number, handler)


def warm_up(commands: Sequence[str], folder: Path) -> None:
    """Run commands in this process, so that its forks have their compiled loops, too."""
    from lidarcfg.cli import main

    here, words = os.getcwd(), sys.argv
    os.chdir(folder)
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere), handlers_kept():
        for command in commands:
            sys.argv = ["lidarcfg", *command.split()]
            with suppress(SystemExit):
                main()
    os.chdir(here)
    sys.argv = words


def start(
    words: Sequence[object], folder: Path, limit: Callable[[], None] = lambda: None, encoding: str | None = None
) -> int:
    """Start a `lidarcfg` command in a process of its own, and return its id; one that hangs is killed."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:  # the child
        os.setsid()  # so that its own processes are known by their group
        os.chdir(folder)
        for number, name in enumerate((os.devnull, ".out", ".errors")):
            os.dup2(os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
        sys.argv = ["lidarcfg", *map(str, words)]
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
            signal.signal(number, signal.SIG_DFL)
        signal.alarm(HANGS_S)
        resource.setrlimit(resource.RLIMIT_CPU, (BUSY_S, BUSY_S))
        limit()
        sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False, encoding=encoding) for number in (1, 2))
        from lidarcfg.cli import main

        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except KeyboardInterrupt:  # before the command set its handlers, or after it was done, as Python ends then
        code = 130
    except BaseException:  # a child reports whatever ends it
        traceback.print_exc()
    finally:  # nothing of the parent is to be ended here
        while True:  # a signal comes at any time
            with suppress(OSError, KeyboardInterrupt):
                _leave(code)


def _leave(code: int) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def wait(pid: int, folder: Path, began: float) -> Ended:
    """Until the process has ended."""
    _, status, usage = os.wait4(pid, 0)
    code, seconds = os.waitstatus_to_exitcode(status), time.monotonic() - began
    said = (folder / ".errors").read_text(errors="replace")
    return Ended(code, said, seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def run(
    words: Sequence[object], folder: Path, limit: Callable[[], None] = lambda: None, encoding: str | None = None
) -> Ended:
    """A command to its end."""
    began = time.monotonic()
    return wait(start(words, folder, limit, encoding), folder, began)


def run_in_terminal(words: Sequence[object], folder: Path, encoding: str) -> Ended:
    """A command to its end, in a terminal; what it writes there is in .out."""
    leader, follower = os.openpty()
    said = bytearray()

    def attach() -> None:
        os.environ["TERM"] = "xterm-256color"
        for number in (1, 2):
            os.dup2(follower, number)

    def read() -> None:
        with suppress(OSError):  # at its end
            while part := os.read(leader, 1 << 16):
                said.extend(part)

    began = time.monotonic()
    pid = start(words, folder, attach, encoding)
    os.close(follower)
    reader = threading.Thread(target=read)
    reader.start()
    ended = wait(pid, folder, began)
    reader.join()
    os.close(leader)
    (folder / ".out").write_bytes(said)
    return ended


def small_files(most: int) -> Callable[[], None]:
    """No file may become larger: a write fails, as on a full disk."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    return limit
