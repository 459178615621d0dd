"""Attacks on what is written: kill -9, signals, a full disk, what is read-only, two writers of one output."""

import os
import random
import signal
import time

from attack_commands import MARKS
from attack_outputs import clear, contents, leftovers, wrong
from attack_run import Row, small_files, wait
from attack_warm import Warm

LATEST = 1.1  # of the time that a run takes: the last moment of a kill
NOBODY = 65534  # to root no folder is read-only
MESSAGE = 400  # bytes that a command must be able to say, on a disk however full


def kills(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Kill -9 at random moments: what is there is all of one run; the next run works and leaves nothing else behind.

    One half of the moments are uniform over the whole run, the other half over the part of it that writes.
    """
    folder, command, known = warm.folder, warm.command, warm.known
    row, early, begun = Row(f"kill -9: {command.name}"), 0, 0
    first = min(known.writes_s / known.seconds, 1.0)
    for number in range(times):
        if command.once or command.resumes:
            clear(folder, command)
        mark = rng.choice(MARKS)
        at = rng.uniform(first * (number % 2), LATEST) * known.seconds
        began = time.monotonic()
        pid = warm.start(mark)
        time.sleep(max(at - (time.monotonic() - began), 0))
        os.kill(pid, signal.SIGKILL)
        killed = wait(pid, folder, began).code != 0
        early, begun = early + killed, begun + bool(leftovers(folder))
        odd = wrong(folder, command, known)
        if command.once:
            clear(folder, command, parts=False)
        mark = mark if command.resumes else rng.choice(MARKS)
        ended = warm.run(mark)
        known.seconds = known.seconds if command.resumes else ended.seconds  # the machine may be busier by now
        odd = odd or (f"{command.name}: the next run: {ended.errors[-200:]}" if ended.code else "")
        row.add(odd or wrong(folder, command, known, mark) or leftovers(folder))
    row.seen = f"{early} had not ended, {begun} of them had begun a file"
    return [row]


def signals(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """TERM, INT and HUP at random moments: exit 130, or done; nothing is left behind."""
    folder, command, known, rows = warm.folder, warm.command, warm.known, []
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        row = Row(f"{number.name} at random moments")
        for _ in range(times):
            if command.once or command.resumes:
                clear(folder, command)
            began = time.monotonic()
            pid = warm.start(rng.choice(MARKS))
            time.sleep(rng.uniform(0, known.seconds))
            os.kill(pid, number)
            code = wait(pid, folder, began).code
            early = code == -number  # before the command had set its handler
            odd = "" if code in (0, 130) or early else f"{command.name}: exit {code}"
            row.add(odd or wrong(folder, command, known) or leftovers(folder))
        rows.append(row)
    return rows


def full_disk(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Files that cannot grow beyond a size below what they need: one line, the old files whole."""
    folder, command, known, row = warm.folder, warm.command, warm.known, Row("a full disk")
    largest = max(map(len, known.files[1].values()))
    for _ in range(times if largest > MESSAGE else 0):
        if command.once or command.resumes:
            clear(folder, command)
        before = contents(folder, command)
        ended = warm.run(MARKS[1], small_files(rng.randrange(MESSAGE, largest)))
        some = (command.progress or command.resumes or not ended.code) and not wrong(folder, command, known)
        kept = some or contents(folder, command) == before
        odd = "" if kept else f"{command.name}: the old files are gone"
        row.add((ended.code and ended.not_refused) or odd or leftovers(folder))
    return [row]


def read_only(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Outputs that may not be written, and a folder: one line, everything as it was."""
    folder, command = warm.folder, warm.command
    files, folders = Row("read-only outputs"), Row("a read-only folder")
    one = folder / rng.choice([name for name in sorted(warm.known.files[0]) if "/runs/" not in name])
    one.chmod(0o444)
    before = contents(folder, command)
    ended = warm.run(MARKS[command.resumes - 1])
    same = contents(folder, command) == before
    files.add(ended.not_refused or ("" if same else f"{command.name}: replaced some of it") or leftovers(folder))
    one.chmod(0o644)
    clear(folder, command)
    folder.chmod(0o555)
    ended = warm.run(MARKS[1], lambda: None if os.getuid() else os.setuid(NOBODY))
    folder.chmod(0o755)
    made = contents(folder, command)
    folders.add(ended.not_refused or (f"{command.name}: wrote {sorted(made)}" if made else ""))
    return [files, folders]


def two_writers(warm: Warm, times: int, rng: random.Random) -> list[Row]:
    """Two runs of one output at once: both end well, and what is there is all of one of them."""
    folder, command, known, row = warm.folder, warm.command, warm.known, Row("two writers of one output")
    for _ in range(0 if command.once else times):
        if command.resumes:
            clear(folder, command)
        started = []
        for mark in MARKS:
            started.append((warm.start(mark), time.monotonic()))
            time.sleep(rng.uniform(0, 0.5 * known.seconds))
        codes = [wait(pid, folder, began).code for pid, began in started]
        odd = "" if codes == [0, 0] else f"{command.name}: exits {codes}: {(folder / '.errors').read_text()[-200:]}"
        row.add(odd or wrong(folder, command, known) or leftovers(folder))
    return [row]
