"""Files: those that come with the package, and writing: aside first, then renamed."""

import errno
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Any, TypeVar

from lidarcfg.aside import exchange, hold, locked, name_beside, remove_leftovers

T = TypeVar("T")


def shipped(folder: str) -> Path:
    """Where `sensors` or `data` are: beside the package in the repository, inside it once it is installed."""
    package = Path(__file__).parent
    installed = package / f"_{folder}"
    return installed if installed.is_dir() else package.parent / folder


def example(path: str | Path) -> Path:
    """The path; or, where no file has it and it begins with `data/`, the example that comes with the package."""
    path = Path(path)
    if path.parts[:1] == ("data",) and ".." not in path.parts and not path.exists():
        found = shipped("data").joinpath(*path.parts[1:])
        if found.is_file():
            return found
    return path


def loaded(given: T | str | Path, load: Callable[[str | Path], T]) -> T:
    """What is given; where that is the path of a file, what is in it."""
    return load(given) if isinstance(given, str | Path) else given


@dataclass(frozen=True)
class Whole:
    """What is written and waits to take its place."""

    temporary: Path
    path: Path
    rest: ExitStack  # removes what is left of it after it took its place, or did not
    inode: int  # its own, by which it is known wherever it is

    def check(self) -> None:
        """Raises OSError unless it may take that place."""
        check_replaceable(self.path)

    def take_place(self) -> None:
        """What was there is in its place then. Does nothing a second time."""
        there = self.path.exists()
        if there and self.path.stat().st_ino == self.inode:
            return
        if not (there and exchange(self.temporary, self.path)):
            self.move()

    def move(self) -> None:
        """Take the place where the system cannot swap, or nothing is there."""
        os.replace(self.temporary, self.path)


@dataclass(frozen=True)
class _Old:
    """What is removed: first moved aside, which is quick."""

    temporary: Path
    path: Path

    def take_place(self) -> None:
        with suppress(FileNotFoundError):
            os.replace(self.path, self.temporary)


@dataclass(frozen=True)
class _Group:
    """What takes its place together, and what is removed before."""

    waiting: list[Whole]
    gone: list[Iterable[Path]]


_TOGETHER: ContextVar[_Group | None] = ContextVar("together", default=None)


def place(whole: Whole) -> None:
    """Let it take its place: now, or within `together` at the end of that. Raises OSError."""
    if group := _TOGETHER.get():
        group.waiting.append(whole)
        return
    with whole.rest:
        whole.take_place()


@contextmanager
def alone() -> Iterator[None]:
    """What is written inside takes its place at once, whatever `together` is around."""
    token = _TOGETHER.set(None)
    try:
        yield
    finally:
        _TOGETHER.reset(token)


@contextmanager
def replacing(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """A file to write that takes the place of `path` only when whole: a killed run leaves the old one.

    Missing parent folders are made. Where `path` is a symbolic link, that stays, and what it leads to is replaced.
    What killed runs have left of the same output is removed. Within `together` the file takes its place at the end of
    that. Raises OSError, also for a file that is read-only.
    """
    path = target(Path(path))
    check_replaceable(path)
    make_parent(path)
    remove_leftovers(path)
    temporary = name_beside(path)
    try:  # from before it is there: an interrupt comes at any time
        with ExitStack() as rest:
            file, held = _created(temporary, mode)
            rest.callback(os.close, held)
            rest.callback(_remove, temporary)
            with file:
                yield file
            place(Whole(temporary, path, rest.pop_all(), temporary.stat().st_ino))
    except BaseException as error:
        _remove(temporary)
        if isinstance(error, OSError) and error.filename in (None, str(temporary)):  # a full disk names no file
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _created(temporary: Path, mode: str) -> tuple[IO[Any], int]:
    """The new file, and the handle that keeps it locked."""
    encoding, errors = (None, None) if "b" in mode else ("utf-8", "backslashreplace")  # of paths that are no UTF-8
    while True:
        file = open(temporary, mode.replace("w", "x"), encoding=encoding, errors=errors)  # noqa: SIM115
        held = hold(file.fileno())
        if held is not None:
            return file, held
        file.close()


@contextmanager
def together(gone: Iterable[Path] = ()) -> Iterator[None]:
    """What `replacing` writes inside takes its place at the end, file by file with nothing between; on an error none.

    Folders of `replacing_folder`, too. The order is that of writing: what readers open first comes last. Files that are
    `gone` are removed before. No two runs do so in a folder at the same time, so that what is there is of one of them.
    Within another `together` all that is done at the end of that. Raises OSError.
    """
    if larger := _TOGETHER.get():
        larger.gone.append(gone)
        yield
        return
    group = _Group([], [gone])
    waiting, token = group.waiting, _TOGETHER.set(group)
    try:
        yield
        for whole in waiting:
            whole.check()
        with locked(whole.path.parent for whole in waiting):
            old = [_Old(name_beside(path), path) for path in chain.from_iterable(group.gone)]
            for one in old:
                check_replaceable(one.path)
                remove_leftovers(one.path)
            steps: list[_Old | Whole] = [*old, *waiting]
            try:
                for step in steps:
                    step.take_place()
            except KeyboardInterrupt:  # not between two files
                for step in steps:
                    step.take_place()
                raise
            finally:
                for one in old:
                    _remove(one.temporary)
    finally:
        _TOGETHER.reset(token)
        for whole in waiting:
            whole.rest.close()


def check_replaceable(path: Path) -> None:
    """Raises OSError unless a file may take this place."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "is a directory", str(path))
    if not stat.S_ISREG(mode):  # a device or a pipe, which a rename would replace
        raise OSError(errno.EINVAL, "is not a regular file", str(path))
    check_not_read_only(path)


def check_not_read_only(path: Path) -> None:
    """Raises OSError for a file or folder that nobody may write, not even its owner, or not this user."""
    if not path.stat().st_mode & 0o222 or not os.access(path, os.W_OK):
        raise PermissionError(
            errno.EACCES, "is read-only; to have it replaced, make it writable (chmod u+w)", str(path)
        )


def make_parent(path: Path) -> None:
    """Make the folder that a path is to be in. Raises OSError, which names the path."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path)) from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def target(path: Path) -> Path:
    """What the path leads to, whether it is there yet or not. Raises OSError for links that lead in a circle."""
    if not path.is_symlink():
        return path
    with suppress(FileNotFoundError):  # a link may be there before its target
        path.stat()
    return Path(os.path.realpath(path))
