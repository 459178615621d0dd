"""Writing files: aside first, then renamed, so that a killed run leaves the old one whole."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any


@contextmanager
def replacing(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """A file to write that takes the place of `path` only when whole: a killed run leaves the old one."""
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a directory", str(path))
    if path.exists() and not path.is_file():  # a device or a pipe, which a rename would replace
        raise OSError(errno.EINVAL, "is not a regular file", str(path))
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
