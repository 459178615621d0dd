"""The files that come with the package, and output files: written aside, then renamed into place."""

import errno
import math
import os
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Any, TypeVar

from lidarcfg.aside import exchange, hold, locked, name_beside, remove_leftovers
from lidarcfg.errors import LidarcfgError

T = TypeVar("T")


def shipped(folder: str) -> Path:
    """Where `sensors` or `data` are: beside the package in the repository, inside it once it is installed."""
    package = Path(__file__).parent
    installed = package / f"_{folder}"
    return installed if installed.is_dir() else package.parent / folder


def example(path: str | Path) -> Path:
    """The path; if there is no such file and it begins with `data/`, the package's own copy of that example."""
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
    """A finished file under its temporary name, ready to be moved into place."""

    temporary: Path
    path: Path
    rest: ExitStack  # cleans up afterwards, whether it was moved or not
    inode: int  # identifies the file under either name

    def check(self) -> None:
        """Raises OSError unless `path` may be replaced."""
        check_replaceable(self.path)

    def take_place(self) -> None:
        """Swap places with the old file, if there is one. Calling it again does nothing."""
        there = self.path.exists()
        if there and self.path.stat().st_ino == self.inode:
            return
        if not (there and exchange(self.temporary, self.path)):
            self.move()

    def move(self) -> None:
        """Rename into place, where the system cannot swap or there is no old file."""
        os.replace(self.temporary, self.path)


@dataclass(frozen=True)
class _Old:
    """A file to remove: it is first moved aside, which is quick."""

    temporary: Path
    path: Path

    def take_place(self) -> None:
        with suppress(FileNotFoundError):
            os.replace(self.path, self.temporary)


@dataclass(frozen=True)
class _Group:
    """Files that are moved into place together, and files that are removed before that."""

    waiting: list[Whole]
    gone: list[Iterable[Path]]


_TOGETHER: ContextVar[_Group | None] = ContextVar("together", default=None)


def place(whole: Whole) -> None:
    """Move the file into place: now, or, within `together`, at the end of that block. Raises OSError."""
    if group := _TOGETHER.get():
        group.waiting.append(whole)
        return
    with whole.rest:
        whole.take_place()


@contextmanager
def alone() -> Iterator[None]:
    """Files written inside are moved into place at once, even within a `together` block."""
    token = _TOGETHER.set(None)
    try:
        yield
    finally:
        _TOGETHER.reset(token)


@contextmanager
def replacing(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a temporary file that replaces `path` when the block ends without error; a killed run leaves the old file.

    Missing parent folders are made. If `path` is a symbolic link, its target is replaced. Temporary files that killed
    runs have left for the same output are removed. Within `together` the file is moved into place at the end of that
    block. Raises OSError, also for a read-only file.
    """
    path = target(Path(path))
    check_replaceable(path)
    make_parent(path)
    remove_leftovers(path)
    temporary = name_beside(path)
    try:  # begins before the file exists, as an interrupt may come at any time
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
    """Move all files written inside into place together, when the block ends; after an error, none of them.

    This holds for `replacing` and `replacing_folder`. Files are moved in the order of writing, so write last what
    readers open first. The files in `gone` are removed before that. A lock on the folder keeps two runs from mixing
    their files. A block within another one is finished at the end of the outer one. Raises OSError.
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
    """Raises OSError for a file or folder that this user may not write, or that is read-only for its owner."""
    if not path.stat().st_mode & 0o222 or not os.access(path, os.W_OK):
        raise PermissionError(
            errno.EACCES, "is read-only; to have it replaced, make it writable (chmod u+w)", str(path)
        )


def make_parent(path: Path) -> None:
    """Make the parent folder of `path`. Raises OSError, which names the path."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path)) from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def size_in_words(octets: float) -> str:
    """Bytes, to a tenth of the unit."""
    return f"{octets / 1e9:,.1f} GB" if octets >= 1e9 else f"{octets / 1e6:,.1f} MB"


def free_bytes(path: str | Path) -> float:
    """The room on the disk where a file would be written; infinite where that is not known."""
    folder = target(Path(path)).absolute().parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return math.inf


def check_room(path: str | Path, needed: float, advice: str) -> None:
    """Raises LidarcfgError if a file of so many bytes does not fit on its disk."""
    if needed > (free := free_bytes(path)):
        sizes = f"needs {size_in_words(needed)} on the disk; {size_in_words(free)} are free"
        raise LidarcfgError(f"{path}: {sizes}; {advice}")


def target(path: Path) -> Path:
    """The target of symbolic links, whether it exists or not; else the path. Raises OSError for a circle of links."""
    if not path.is_symlink():
        return path
    with suppress(FileNotFoundError):  # a link may be there before its target
        path.stat()
    return Path(os.path.realpath(path))
