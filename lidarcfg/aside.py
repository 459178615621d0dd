"""Temporary files and folders beside an output: each has a unique name and is locked while its writer lives.

A killed run leaves its temporary file unlocked. The next run that writes the same output sees that, and removes it.
"""

import ctypes
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

# Windows has none: nothing is locked there, and what a killed run has left stays.
fcntl: Any = import_module("fcntl") if os.name == "posix" else None
SUFFIX = ".part"
DIGITS = 8  # hexadecimal, in the name
_HEXADECIMAL = set("0123456789abcdef")
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux's fcntl.h and fs.h
COMMIT_S, AGAIN_S = 5.0, 0.01  # another run's renames take microseconds
_OWN: dict[Path, Path] = {}  # the temporary names of this process, and the outputs that they belong to


def name_beside(path: Path) -> Path:
    """A new hidden name in the folder of `path`; `remove_leftovers` recognises it."""
    aside = path.with_name(f".{path.name}.{os.urandom(DIGITS // 2).hex()}{SUFFIX}")
    _OWN[aside] = path
    return aside


def remove_own() -> None:
    """Remove the temporary files of this process at its end: an interrupt may come before a `with` can clean up."""
    for aside, path in list(_OWN.items()):
        with suppress(OSError):
            _remove(aside, path)


def hold(handle: int) -> int | None:
    """Lock an open file or folder until the returned handle is closed, at the latest when the process ends.

    Returns None if another process removed it as a leftover before it was locked.
    """
    if fcntl is None:  # Windows, where a file is not renamed while a handle of it is open
        return os.open(os.devnull, os.O_RDONLY)
    _lock(handle, wait=True)
    return os.dup(handle) if os.fstat(handle).st_nlink else None


def remove_leftovers(path: Path) -> None:
    """Remove the temporary files that killed runs have left beside `path`; those of running ones are locked."""
    with suppress(OSError):  # folders that may not be listed
        for entry in os.listdir(path.parent):
            number = entry.removeprefix(f".{path.name}.").removesuffix(SUFFIX)
            if entry == f".{path.name}.{number}{SUFFIX}" and len(number) == DIGITS and set(number) <= _HEXADECIMAL:
                _remove_if_left(path.with_name(entry), path)


def _remove_if_left(aside: Path, path: Path) -> None:
    with suppress(OSError), opened(aside) as handle:
        if _lock(handle, wait=False):
            _remove(aside, path)


def _remove(aside: Path, path: Path) -> None:
    if not aside.is_dir():
        aside.unlink()
        return
    old = aside / old_name(path)
    if old.exists() and not path.exists():  # killed between the two renames of a folder
        old.rename(path)
    shutil.rmtree(aside, ignore_errors=True)


def old_name(path: Path) -> str:
    """The name of the folder that is being replaced, until it is removed."""
    return f"{path.name}.old"


@contextmanager
def opened(path: Path) -> Iterator[int]:
    """A handle to lock a file or folder by. Does not wait for a pipe, nor follow a link. Raises OSError."""
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0))
    try:
        yield handle
    finally:
        os.close(handle)


def exchange(one: Path, other: Path) -> bool:
    """Swap two files or folders in one step; returns False where that is impossible: not on Linux, or one is missing.

    A swap takes microseconds. A rename that replaces a file takes milliseconds, as it frees the old one's blocks.
    """
    swap = _renameat2()
    return bool(swap and swap(AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), RENAME_EXCHANGE) == 0)


@cache
def _renameat2() -> Any:
    """The system call, or None if there is none."""
    try:
        return ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):
        return None


@contextmanager
def locked(folders: Iterable[Path]) -> Iterator[None]:
    """Keep other runs from renaming groups of files in these folders meanwhile; waits for them COMMIT_S at most."""
    with ExitStack() as stack:
        for folder in sorted({os.path.realpath(folder) for folder in folders}):  # each once, whatever it is called
            with suppress(OSError):  # of a folder that may not be read, or of Windows
                handle = stack.enter_context(opened(Path(folder)))
                until = time.monotonic() + COMMIT_S
                while not _lock(handle, wait=False) and time.monotonic() < until:
                    time.sleep(AGAIN_S)
        yield


def _lock(handle: int, wait: bool) -> bool:
    """Lock; returns False if another process holds the lock, or if locks are not supported there."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        return False
    return True
