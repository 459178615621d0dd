"""Files: those that come with the package, and writing: aside first, then renamed."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any


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


@contextmanager
def replacing(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """A file to write that takes the place of `path` only when whole: a killed run leaves the old one.

    Missing parent folders are made. Where `path` is a symbolic link, that stays, and what it leads to is replaced.
    Raises OSError.
    """
    path = _target(Path(path))
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a directory", str(path))
    if path.exists() and not path.is_file():  # a device or a pipe, which a rename would replace
        raise OSError(errno.EINVAL, "is not a regular file", str(path))
    make_parent(path)
    temporary = str(path.parent / f".{path.name}.{os.urandom(4).hex()}.part")
    try:  # from before it is there: an interrupt comes at any time
        with open(temporary, mode.replace("w", "x"), encoding=None if "b" in mode else "utf-8") as file:
            yield file
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            os.unlink(temporary)
        if isinstance(error, OSError) and error.filename in (None, temporary):  # a full disk names no file
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise


def make_parent(path: Path) -> None:
    """Make the folder that a path is to be in. Raises OSError, which names the path."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path)) from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _target(path: Path) -> Path:
    """What the path leads to, whether it is there yet or not. Raises OSError for links that lead in a circle."""
    if not path.is_symlink():
        return path
    with suppress(FileNotFoundError):  # a link may be there before its target
        path.stat()
    return Path(os.path.realpath(path))
