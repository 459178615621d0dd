"""Attacks on what is written: kill -9, signals, a full disk, what is read-only, two writers of one output."""

import os
import random
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from attack_commands import MARKS
from attack_outputs import clear, contents, leftovers, strangers, wrong
from attack_run import Ended, Row, small_files, wait
from attack_warm import Warm

LATEST = 1.1  # of the time that a run takes: the last moment of a kill
NOBODY = 65534  # to root no folder is read-only
MESSAGE = 400  # bytes that a command must be able to say, on a disk however full
AGAIN_S = 0.02  # within which somebody impatient presses Ctrl-C once more
ENDS_S = 10.0  # for the workers of a command that was killed
LOOK_S = 0.001
TRIES = 10


def kills(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Kill -9 at random moments: what is there is all of one run; the next run works and leaves nothing else behind.

    One half of the moments are uniform over the time of a run, the other half over the steps of its writing: so some of
    these lie between two files that take their places together, which is promised to no more than microseconds.
    """
    folder, command, known = warm.folder, warm.command, warm.known
    row, early, begun, between = Row(f"kill -9: {command.name}"), 0, 0, 0
    for number in range(times):
        _afresh(warm)
        mark = rng.choice(MARKS)
        pid, killed = (_kill_at_step if number % 2 else _kill_at_time)(warm, mark, rng)
        early, begun = early + killed, begun + bool(leftovers(folder))
        odd, swapping = wrong(folder, command, known), bool(number % 2) and warm.steps.swapping
        if odd and swapping and "other" not in odd:  # each file is whole, and the next run replaces them all
            odd, between = "", between + 1
        odd = odd or strangers(folder, command, known) or _survivors(pid)
        if command.once:
            clear(folder, command, parts=False)
        mark = mark if command.fixed else rng.choice(MARKS)
        ended = warm.run(mark)
        known.seconds = known.seconds if command.resumes else ended.seconds  # the machine may be busier by now
        row.add(odd or _not_done(warm, ended) or _after(warm, mark))
    row.add(_in_place(warm))
    row.seen = f"{early} had not ended, {begun} had begun a file, {between} of them were between two"
    return [row, *([_worker_kills(warm, max(times // 3, 1), rng)] if command.resumes else [])]


def _in_place(warm: Warm) -> str:
    """Which outputs a run writes in their place, and not aside: a kill seldom falls into so short a moment."""
    log = warm.folder / ".opened"

    def watch() -> None:
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)

        def hook(event: str, given: tuple[Any, ...]) -> None:
            if event == "open" and isinstance(given[0], str | Path) and given[2] & (os.O_WRONLY | os.O_RDWR):
                path = Path(os.path.abspath(given[0]))
                if path.is_relative_to(warm.folder) and ".part" not in path.as_posix() and not path.is_dir():
                    os.write(handle, f"{path.name} ".encode())

        sys.addaudithook(hook)

    _afresh(warm)
    ended = warm.run(MARKS[0], watch)
    found = log.read_text()
    log.unlink()
    return _not_done(warm, ended) or (f"{warm.command.name}: writes in place: {found}" if found else "")


def _afresh(warm: Warm) -> None:
    """Begin without outputs where one that is there is refused, or gone on with."""
    if warm.command.fixed:
        clear(warm.folder, warm.command)


def _not_done(warm: Warm, ended: Ended) -> str:
    return f"{warm.command.name}: exit {ended.code}: {ended.errors[-200:]}" if ended.code else ""


def _after(warm: Warm, mark: str = "") -> str:
    """What is wrong after a run that was not killed."""
    folder, command, known = warm.folder, warm.command, warm.known
    return wrong(folder, command, known, mark) or leftovers(folder) or strangers(folder, command, known)


def _kill_at_time(warm: Warm, mark: str, rng: random.Random) -> tuple[int, bool]:
    """Its id, and whether it had not ended."""
    at, began = rng.uniform(0, LATEST) * warm.known.seconds, time.monotonic()
    pid = warm.start(mark)
    time.sleep(max(at - (time.monotonic() - began), 0))
    os.kill(pid, signal.SIGKILL)
    return pid, wait(pid, warm.folder, began).code != 0


def _kill_at_step(warm: Warm, mark: str, rng: random.Random) -> tuple[int, bool]:
    """Its id, and whether it had not ended."""
    warm.steps.forget()
    began, at = time.monotonic(), rng.randint(1, warm.known.steps)
    pid = warm.start(mark, warm.steps.watch(at))
    return pid, wait(pid, warm.folder, began).code != 0


def _worker_kills(warm: Warm, times: int, rng: random.Random) -> Row:
    """Kill -9 of a command's worker at random moments: the command ends as ever, and so does every process of it."""
    row, killed = Row(f"kill -9: {warm.command.name}, a worker of it"), 0
    for _ in range(times):
        _afresh(warm)
        mark, began = rng.choice(MARKS), time.monotonic()
        pid = warm.start(mark)
        time.sleep(rng.uniform(0, warm.known.seconds))
        for worker in _group(pid) - {pid}:
            with suppress(ProcessLookupError):
                os.kill(worker, signal.SIGKILL)
                killed += 1
        ended = wait(pid, warm.folder, began)
        row.add(_not_done(warm, ended) or _survivors(pid) or _after(warm, mark))
    row.seen = f"{killed} were there"
    return row


def _group(pid: int) -> set[int]:
    """The processes that a command has started, and itself: it leads a group of its own."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
            if int(group) == pid and state != "Z":
                found.add(int(path.parent.name))
    return found


def _survivors(pid: int) -> str:
    """The processes of a command that do not end once it has."""
    until = time.monotonic() + ENDS_S
    while (left := _group(pid)) and time.monotonic() < until:
        time.sleep(LOOK_S)
    return f"{len(left)} processes outlive it" if left else ""


def signals(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """TERM, INT and HUP at random moments, and INT twice: exit 130, or done; nothing is left behind."""
    rows = []
    for number, again in ((signal.SIGTERM, 0), (signal.SIGINT, 0), (signal.SIGHUP, 0), (signal.SIGINT, 1)):
        row, met = Row(f"{number.name} at random moments{', and once more' * again}"), 0
        for _ in range(times):
            _afresh(warm)
            began = time.monotonic()
            pid = warm.start(rng.choice(MARKS))
            caught = _catches(pid, signal.SIGHUP)  # the last that it takes care of
            time.sleep(rng.uniform(0, warm.known.seconds))
            os.kill(pid, number)
            if again:
                time.sleep(rng.uniform(0, AGAIN_S))
                os.kill(pid, number)
            ended = wait(pid, warm.folder, began)
            met += caught
            odd = (
                "" if ended.code == 0 or (caught and ended.code == 130) else f"exit {ended.code}, {ended.said[-300:]!r}"
            )
            row.add((odd and f"{warm.command.name}: {odd}") or _survivors(pid) or _after(warm))
        for _ in range(0 if met else TRIES):  # all had ended before that was seen
            _afresh(warm)
            pid, began = warm.start(MARKS[0]), time.monotonic()
            met += _catches(pid, number)
            wait(pid, warm.folder, began)
        row.add("" if met else f"{warm.command.name}: has no handler")
        rows.append(row)
    return rows


def _catches(pid: int, number: int) -> bool:
    """Wait until a process has a handler of a signal; False if it ends without."""
    while (found := _handled(pid)) is not None:
        if found >> (number - 1) & 1:
            return True
        time.sleep(LOOK_S)
    return False


def _handled(pid: int) -> int | None:
    """The signals that a process handles, a bit each; None if it has ended."""
    lines = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return None if lines["State"].split()[0] == "Z" else int(lines["SigCgt"], 16)


def full_disk(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Files that cannot grow beyond a size below what they need: one line, the old files whole."""
    folder, command, known, row = warm.folder, warm.command, warm.known, Row("a full disk")
    largest = max(map(len, known.files[1].values()))
    for _ in range(times if largest > MESSAGE else 0):
        _afresh(warm)
        before = contents(folder, command)
        ended = warm.run(MARKS[1], small_files(rng.randrange(MESSAGE, largest)))
        if not ended.code:  # all of it fitted
            row.add(_after(warm, MARKS[1]))
            continue
        kept = command.stops or contents(folder, command) == before
        odd = ended.not_refused or ("" if kept else "the old files are gone")
        row.add((odd and f"{command.name}: {odd}") or _after(warm))
    return [row]


def read_only(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Outputs that may not be written, and a folder: one line, everything as it was."""
    folder, command = warm.folder, warm.command
    files, folders = Row("read-only outputs"), Row("a read-only folder")
    names = [name for name in sorted(warm.known.files[0]) if "/runs/" not in name]
    for name in rng.sample(names, min(times, len(names))):
        clear(folder, command)
        warm.run(MARKS[0])
        (folder / name).chmod(0o444)
        before = contents(folder, command)
        ended = warm.run(MARKS[not command.fixed])
        same = contents(folder, command) == before
        odd = ended.not_refused or ("" if same else "replaced some of it")
        files.add((odd and f"{command.name}, {name}: {odd}") or _after(warm))
        (folder / name).chmod(0o644)
    clear(folder, command)
    folder.chmod(0o555)
    ended = warm.run(MARKS[1], lambda: None if os.getuid() else os.setuid(NOBODY))
    folder.chmod(0o755)
    made = contents(folder, command)
    odd = ended.not_refused or (f"wrote {sorted(made)}" if made else "")
    folders.add((odd and f"{command.name}: {odd}") or _after(warm))
    return [files, folders]


def two_writers(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Two runs of one output at once: both end well, and what is there is all of one of them.

    Every other time the first pauses at a step of its writing while the second begins. Where an output that is
    there is refused, so is the later run.
    """
    command, row = warm.command, Row("two writers of one output")
    for number in range(times):
        _afresh(warm)
        started = []
        marks = (MARKS[number % 2],) * 2 if command.fixed else MARKS
        for mark in marks:
            stops = number % 2 and not started
            pause = warm.steps.watch(rng.randint(1, warm.known.steps), signal.SIGSTOP) if stops else lambda: None
            started.append((warm.start(mark, pause), time.monotonic()))
            if stops:
                os.waitid(os.P_PID, started[0][0], os.WEXITED | os.WSTOPPED | os.WNOWAIT)
            time.sleep(rng.uniform(0, (1.0 if number % 2 else 0.5) * warm.known.seconds) * (not stops))
        with suppress(ProcessLookupError):
            os.kill(started[0][0], signal.SIGCONT)
        codes = [wait(pid, warm.folder, began).code for pid, began in started]
        fits = codes == [0, 0] or (command.once and sorted(codes) == [0, 2])
        odd = "" if fits else f"{command.name}: exits {codes}: {(warm.folder / '.errors').read_text()[-200:]}"
        row.add(odd or _after(warm, marks[0] if command.fixed else ""))
    return [row]
