"""Folders, and files that libraries write, made aside and moved into place when whole."""

import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from lidarcfg.aside import hold, name_beside, old_name, opened, remove_leftovers
from lidarcfg.errors import ConversionError
from lidarcfg.files import Whole, alone, check_not_read_only, make_parent, place, target


@contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path`. Errors of the system inside it are reported for `path`."""
    whole = Path(os.path.realpath(target(path)))
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
    """A path at which to make the folder that will replace `path`; after an error nothing of it remains.

    An existing folder is replaced if what is in it is called like `contents` and all may be written; otherwise
    ConversionError or OSError is raised. It is replaced in one step on Linux; elsewhere there is a moment without it.
    Within `together` it is replaced at the end of that.
    """
    whole = Path(os.path.realpath(target(path)))
    if whole.exists() and not whole.is_dir():
        raise ConversionError(f"{path}: is not a folder; give the name of a new one")
    for item in whole.iterdir() if whole.exists() else ():
        if not any(fnmatch(item.name, pattern) for pattern in contents):
            raise ConversionError(f"{path}: holds {item.name!r}; only a folder of {', '.join(contents)} is replaced")
        for each in (item, *item.rglob("*")):
            check_not_read_only(each)
    with ExitStack() as rest:
        aside = rest.enter_context(beside(path))
        new = aside / whole.name
        with alone():
            yield new
        place(_WholeFolder(new, whole, rest.pop_all(), new.stat().st_ino))


@dataclass(frozen=True)
class _WholeFolder(Whole):
    """A finished folder under its temporary name, ready to be moved into place."""

    def check(self) -> None:
        pass  # it was checked before it was written

    def move(self) -> None:
        new, whole, old = self.temporary, self.path, self.temporary.with_name(old_name(self.path))
        try:
            if whole.exists():
                whole.rename(old)
            new.rename(whole)
        except BaseException:  # an interrupt too: the old folder stays
            if old.exists() and not whole.exists():
                old.rename(whole)
            raise
