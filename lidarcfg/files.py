"""Files that come with the package; and output files, each written under a temporary name, flushed, then renamed.

So an output is there whole, old or new, whenever the process is killed.
"""

import errno
import os
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import IO, Any, TypeVar

from lidarcfg.errors import ConversionError, LidarcfgError, a_thing

T = TypeVar("T")

_TEMPORARY: set[Path] = set()  # the temporary files and folders of this process


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


def checked_path(given: Any, what: str) -> Path:
    """A path that a user gives. Raises LidarcfgError for anything else, such as an array."""
    if isinstance(given, str | os.PathLike):
        return Path(os.fspath(given))
    raise LidarcfgError(f"{what} is {a_thing(given)}; allowed: a path")


@contextmanager
def system_errors(path: str | Path) -> Iterator[None]:
    """Raise what the system refuses as LidarcfgError, which names the file that it refused, or else `path`."""
    try:
        yield
    except OSError as error:
        raise LidarcfgError.from_os(error.filename or path, error) from None


def loaded(given: Any, load: Callable[[Any], T], kind: type[T]) -> T:
    """The argument if it is of a kind; else what `load` makes of it, which raises for what it does not know."""
    return given if isinstance(given, kind) else load(given)


@contextmanager
def replacing(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a temporary file that replaces `path` when the block ends without error.

    Missing parent folders are made. If `path` is a symbolic link, its target is replaced. Raises OSError, also for a
    read-only file.
    """
    place = resolve(Path(path))
    check_replaceable(place)
    make_parent(place)
    encoding, errors = (None, None) if "b" in mode else ("utf-8", "backslashreplace")  # of paths that are no UTF-8
    with _temporary(place, place) as temporary:
        with open(temporary, mode.replace("w", "x"), encoding=encoding, errors=errors) as file:
            yield file
        commit(temporary, place)


@contextmanager
def replacing_folder(path: Path, *contents: str) -> Iterator[Path]:
    """A path at which to make the folder that will replace `path`; after an error nothing of it remains.

    An existing folder is replaced if the names of all items in it match `contents` and all may be written; otherwise
    ConversionError or OSError is raised. For a moment, between two renames, there is no folder.
    """
    place = Path(os.path.realpath(resolve(path)))
    if place.exists() and not place.is_dir():
        raise ConversionError(f"{path}: is not a folder; give the name of a new one")
    for item in place.iterdir() if place.exists() else ():
        if not any(fnmatch(item.name, pattern) for pattern in contents):
            raise ConversionError(f"{path}: holds {item.name!r}; only a folder of {', '.join(contents)} is replaced")
        for each in (item, *item.rglob("*")):
            check_not_read_only(each)
    with temporary_folder(path) as folder:
        new = folder / place.name
        yield new
        for file in new.rglob("*"):
            if file.is_file():
                _flush(file)
        old = temp_path(place)  # kept if this process ends between the renames
        try:
            if place.exists():
                place.rename(old)
            new.rename(place)
        except BaseException:  # an interrupt too
            if old.exists() and not place.exists():
                old.rename(place)
            raise
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """A folder beside `path`, for libraries that write files by name. The system's errors in it are those of `path`."""
    place = Path(os.path.realpath(resolve(path)))
    make_parent(place)
    with _temporary(place, path) as folder:
        folder.mkdir(0o700)
        yield folder


def commit(temporary: Path, place: Path) -> None:
    """Flush a finished file to the disk and rename it. Raises OSError."""
    _flush(temporary)
    os.replace(temporary, place)


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def temp_path(path: Path) -> Path:
    """A new hidden name in the folder of `path`."""
    return path.with_name(f".{path.name}.{os.urandom(4).hex()}.part")


@contextmanager
def _temporary(place: Path, named: Path) -> Iterator[Path]:
    """A temporary path beside `place`; what is there at the end is removed. Errors of the system name `named`."""
    temporary = temp_path(place)
    _TEMPORARY.add(temporary)  # before it exists, as an interrupt may come at any time
    try:
        yield temporary
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(temporary)):  # a full disk names no file
            raise OSError(error.errno, error.strerror or str(error), str(named)) from None
        raise
    finally:
        _remove(temporary)


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink()
    _TEMPORARY.discard(temporary)


def remove_temporary() -> None:
    """Remove the temporary files of this process, which ends before its `with` blocks could."""
    for temporary in list(_TEMPORARY):
        _remove(temporary)


def remove_outdated(paths: Iterable[Path]) -> None:
    """Remove the files of an earlier run, where they are. Raises OSError for what may not be removed."""
    for path in paths:
        check_replaceable(path)
        path.unlink(missing_ok=True)


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


def resolve(path: Path) -> Path:
    """The target of symbolic links, whether it exists or not; else the path. Raises OSError for a circle of links."""
    if not path.is_symlink():
        return path
    with suppress(FileNotFoundError):  # a link may be there before its target
        path.stat()
    return Path(os.path.realpath(path))
