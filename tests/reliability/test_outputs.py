"""Outputs that cannot be written: one line, exit 2, and everything as it was."""

import os
import random

import pytest

from tests.reliability.commands import MARKS, clear, contents, leftovers, run, typed

pytestmark = pytest.mark.slow

MESSAGE = 400  # bytes that a command must be able to say, on a disk however full


def made(folder, command):
    """The files of the first mark."""
    clear(folder, command)
    assert run(typed(command, MARKS[0]), folder).code == 0
    return contents(folder, command)


def test_a_full_disk(folder, command, times):
    """No file can grow beyond a size below what the largest needs: each file is an old one or a new one, and whole."""
    assert run(typed(command, MARKS[1]), folder).code == 0
    after = contents(folder, command)
    before = made(folder, command)
    largest = max(map(len, before.values()))
    draw = random.Random(1)
    for _ in range(times if largest > MESSAGE else 0):
        done = run(typed(command, MARKS[1]), folder, file_bytes=draw.randrange(MESSAGE, largest))
        assert done.code == 0 or done.refused, done
        found = contents(folder, command)
        assert all(data in (before.get(name), after.get(name)) for name, data in found.items())
        assert leftovers(folder) == []


def test_a_read_only_file_is_not_replaced(folder, command):
    before = made(folder, command)
    path = folder / sorted(before)[-1]
    path.chmod(0o444)
    try:
        done = run(typed(command, MARKS[1]), folder)
        assert done.refused, done
        assert contents(folder, command) == before
    finally:
        path.chmod(0o644)
    assert leftovers(folder) == []


@pytest.mark.parametrize("place", ["/sys", "/proc"])
def test_a_folder_that_takes_no_files(folder, place):
    """Not even from root."""
    done = run(["convert", f"{MARKS[0]}-rig.yaml", "-o", f"{place}/x.urdf", "--quiet"], folder)
    assert done.refused, done


@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "links in a circle"])
def test_what_is_no_file_is_not_replaced(folder, kind):
    path = folder / "x.urdf"
    {
        "folder": path.mkdir,
        "pipe": lambda: os.mkfifo(path),
        "device": lambda: path.symlink_to("/dev/full"),
        "links in a circle": lambda: path.symlink_to(path.name),
    }[kind]()
    before = os.lstat(path)
    try:
        done = run(["convert", f"{MARKS[0]}-rig.yaml", "-o", "x.urdf", "--quiet"], folder)
        assert done.refused, done
        assert os.lstat(path).st_ino == before.st_ino
    finally:
        path.rmdir() if path.is_dir() else path.unlink()
