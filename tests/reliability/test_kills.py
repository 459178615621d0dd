"""Kill -9, signals and a second writer: what is there is all of one run, and the next run works and cleans up."""

import os
import random
import signal
import time

import pytest

from tests.reliability.commands import (
    MARKS,
    STUDY,
    clear,
    contents,
    ended,
    leftovers,
    run,
    seconds_of,
    start,
    typed,
)

pytestmark = pytest.mark.slow


def both(folder, command):
    """What a command writes for each mark, how long it takes, and in how many steps; the first mark's files are left."""
    known = {}
    for mark in reversed(MARKS):
        clear(folder, command)
        seconds = seconds_of(typed(command, mark), folder, kill_at=0)
        steps = (folder / ".steps").stat().st_size
        known[mark] = contents(folder, command)
        assert known[mark]
    assert known[MARKS[0]] != known[MARKS[1]]
    return known, seconds, steps


def check_whole(found, known):
    """Each file is an old or a new one."""
    assert all(any(data == files.get(name) for files in known.values()) for name, data in found.items())


def test_a_kill_leaves_the_old_files_or_the_new_ones(folder, command, times):
    """Half of the kills come at a random time, half at a random step of the writing."""
    known, seconds, steps = both(folder, command)
    draw = random.Random(1)
    for number in range(times):
        at = draw.randint(1, steps) if number % 2 else None
        process = start(typed(command, MARKS[1]), folder, kill_at=at)
        if at is None:
            time.sleep(draw.uniform(0, seconds))
            process.kill()
        ended(process, folder)
        check_whole(contents(folder, command), known)
        assert run(typed(command, MARKS[0]), folder).code == 0
        assert contents(folder, command) == known[MARKS[0]]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_a_signal_leaves_the_old_files_or_the_new_ones(folder, command, times, number):
    """It ends with 130, or was done; a second signal changes nothing."""
    known, seconds, _ = both(folder, command)
    draw = random.Random(1)
    for again in range(times):
        process = start(typed(command, MARKS[1]), folder)
        while not _handles(process.pid, signal.SIGHUP) and process.exitcode is None:
            time.sleep(0.001)
        time.sleep(draw.uniform(0, seconds / 2))
        for _ in range(1 + again % 2):
            if process.exitcode is None:
                os.kill(process.pid, number)
        done = ended(process, folder)
        assert done.code in (0, 130), done.said
        check_whole(contents(folder, command), known)
        assert leftovers(folder) == []


def _handles(pid, number):
    """Whether a process has a handler of a signal."""
    try:
        with open(f"/proc/{pid}/status") as file:
            caught = next(int(line.split()[1], 16) for line in file if line.startswith("SigCgt"))
    except (OSError, StopIteration):
        return False
    return bool(caught >> (number - 1) & 1)


def test_two_writers_of_one_output_both_end_well(folder, command, times):
    known, seconds, _ = both(folder, command)
    for number in range(times):
        processes = []
        for mark in MARKS:
            processes.append(start(typed(command, mark), folder))
            time.sleep(seconds * 0.2 * (number % 3))
        assert [ended(process, folder).code for process in processes] == [0, 0]
        check_whole(contents(folder, command), known)
        assert leftovers(folder) == []


def test_a_killed_search_goes_on(tmp_path, times):
    """What its folder has can be read by the next run."""
    (tmp_path / "study.yaml").write_text(STUDY.format("roof", 1))
    words = ["optimize", "study.yaml", "-o", "o", "--quiet"]
    seconds = seconds_of(words, tmp_path)
    draw = random.Random(1)
    for _ in range(times):
        process = start(words, tmp_path)
        time.sleep(draw.uniform(0, seconds))
        process.kill()
        ended(process, tmp_path)
        if (tmp_path / "o/search.npz").exists():
            assert run(["optimize", "study.yaml", "--resume", "o", "--quiet"], tmp_path).code == 0
        else:
            assert run(words, tmp_path).code == 0
        assert run(["evaluate", "study.yaml", "o/rig.yaml", "--quiet"], tmp_path).code == 0
