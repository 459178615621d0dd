"""Folders, and files that libraries write, made aside and moved into place when whole."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

from lidarcfg.errors import ConversionError
from lidarcfg.files import make_parent


@contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path`. Errors of the system inside it are reported for `path`."""
    whole = path.resolve()
    aside = whole.parent / f".{whole.name}.{os.urandom(4).hex()}.part"
    try:  # from before it exists: an interrupt can come at any time
        make_parent(whole)
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
    """Where to make the folder that becomes `path`; nothing of it remains if anything goes wrong.

    An existing folder is replaced if all its files have names like `contents`; otherwise ConversionError is raised.
    """
    whole = path.resolve()
    if whole.exists() and not whole.is_dir():
        raise ConversionError(f"{path}: is not a folder; give the name of a new one")
    for item in whole.iterdir() if whole.exists() else ():
        if not any(fnmatch(item.name, pattern) for pattern in contents):
            raise ConversionError(f"{path}: holds {item.name!r}; only a folder of {', '.join(contents)} is replaced")
    with beside(path) as aside:
        new, old = aside / whole.name, aside / f"{whole.name}.old"
        yield new
        try:
            if whole.exists():
                whole.rename(old)
            new.rename(whole)
        except BaseException:  # an interrupt too: the old folder stays
            if old.exists() and not whole.exists():
                old.rename(whole)
            raise
