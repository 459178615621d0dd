"""Folders, and files that libraries write, made aside and moved into place when whole."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path

from lidarcfg.aside import exchange, hold, name_beside, old_name, opened, remove_leftovers
from lidarcfg.errors import ConversionError
from lidarcfg.files import check_not_read_only, make_parent


@contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path`. Errors of the system inside it are reported for `path`."""
    whole = path.resolve()
    aside, held = name_beside(whole), None
    try:  # from before it exists: an interrupt can come at any time
        make_parent(whole)
        remove_leftovers(whole)
        while held is None:
            aside.mkdir(0o700)
            with suppress(FileNotFoundError), opened(aside) as handle:
                held = hold(handle)
        yield aside
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(aside)):
            raise OSError(error.errno, error.strerror or str(error), str(path)) from None
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        if held is not None:
            os.close(held)


@contextmanager
def replacing_folder(path: Path, *contents: str) -> Iterator[Path]:
    """Where to make the folder that becomes `path`; nothing of it remains if anything goes wrong.

    An existing folder is replaced if all its files have names like `contents` and may be written; otherwise
    ConversionError or OSError is raised. It is replaced in one step on Linux; elsewhere there is a moment without it.
    """
    whole = path.resolve()
    if whole.exists() and not whole.is_dir():
        raise ConversionError(f"{path}: is not a folder; give the name of a new one")
    for item in whole.iterdir() if whole.exists() else ():
        if not any(fnmatch(item.name, pattern) for pattern in contents):
            raise ConversionError(f"{path}: holds {item.name!r}; only a folder of {', '.join(contents)} is replaced")
        check_not_read_only(item)
    with beside(path) as aside:
        new, old = aside / whole.name, aside / old_name(whole)
        yield new
        if whole.exists() and exchange(new, whole):
            return
        try:
            if whole.exists():
                whole.rename(old)
            new.rename(whole)
        except BaseException:  # an interrupt too: the old folder stays
            if old.exists() and not whole.exists():
                old.rename(whole)
            raise
