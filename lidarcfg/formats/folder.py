"""What is made aside and takes its place only when whole: folders, and files that others write."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

from lidarcfg.errors import HandoverError


@contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A new folder beside `path`, for a while. What the system refuses in there is said of `path`."""
    whole = path.resolve()
    aside = whole.parent / f".{whole.name}.{os.urandom(4).hex()}.part"
    try:  # from before it is there: an interrupt comes at any time
        aside.mkdir(0o700)
        yield aside
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(aside)):
            raise OSError(error.errno, error.strerror or str(error), str(path)) from None
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def replacing_folder(path: Path, *contents: str) -> Iterator[Path]:
    """Where to make the folder that becomes `path`; nothing stays of it if anything goes wrong.

    A folder that is there is replaced if all that it holds has names like `contents`, else HandoverError is raised.
    """
    whole = path.resolve()
    if whole.exists() and not whole.is_dir():
        raise HandoverError(f"{path}: is not a folder; give the name of a new one")
    for item in whole.iterdir() if whole.exists() else ():
        if not any(fnmatch(item.name, pattern) for pattern in contents):
            raise HandoverError(f"{path}: holds {item.name!r}; only a folder of {', '.join(contents)} is replaced")
    with beside(path) as aside:
        new, old = aside / whole.name, aside / f"{whole.name}.old"
        yield new
        try:
            if whole.exists():
                whole.rename(old)
            new.rename(whole)
        except BaseException:  # an interrupt as well: what was there stays
            if old.exists() and not whole.exists():
                old.rename(whole)
            raise
