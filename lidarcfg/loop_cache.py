"""numba's cache of compiled loops, for several processes: what one of them compiles, the others wait for and load.

The process that compiles a loop holds a lock on an octet of a file beside the cache, by the loop's name. The lock ends
with the process. Where there are no such locks, each compiles for itself, as numba has it.
"""

import os
import time
import zlib
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from lidarcfg.aside import fcntl
from lidarcfg.compiling import compiling
from lidarcfg.linking import OutdatedError
from lidarcfg.loop_sources import digest

FunctionCache: Any = import_module("numba.core.caching").FunctionCache  # numba has no types
IndexDataCacheFile: Any = import_module("numba.core.caching").IndexDataCacheFile
rtsys: Any = import_module("numba.core.runtime").rtsys
AGAIN_S, PATIENCE_S = 0.02, 90.0
_files: dict[Path, int | None] = {}  # of locks, by folder: closing one would give up all locks in it


class LoopCache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """The cache of one loop."""

    on_missing: Callable[[], None] | None = None  # of all loops; is told once that one has to be compiled

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _Index(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())
        self._held = False
        self._octet = zlib.crc32(f"{function.__module__}.{function.__qualname__}".encode())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """As numba's, or what another process compiles, once it has; what is missing then this process may compile."""
        found = self._load(sig, target_context)
        if found is not None or not self._enabled:
            return found
        missing, LoopCache.on_missing = LoopCache.on_missing, None
        if missing:
            missing()
        self._take()
        found = self._load(sig, target_context)
        if found is not None:
            self.give_up()
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        """As numba's, without loading what it needs to compile: it does so itself when it compiles."""
        with compiling.loading(), suppress(OutdatedError):
            if not hasattr(self, "_load_overload"):
                return super().load_overload(sig, target_context)
            rtsys.initialize(target_context)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        return None

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """As numba's, which changes with the loop's own code, and for what it takes in."""
        return *super()._index_key(sig, codegen), digest(self._py_func)

    def save_overload(self, sig: Any, data: Any) -> None:
        """As numba's."""
        try:
            super().save_overload(sig, data)
        finally:
            self.give_up()

    def give_up(self) -> None:
        """Let others compile the loop."""
        if self._held:
            self._lock(fcntl.LOCK_UN)
            self._held = False

    def _take(self) -> None:
        """Wait until no other process compiles the loop, or for long: the other one may have been stopped."""
        if self._held or self._try():
            return
        until = time.monotonic() + PATIENCE_S
        with compiling.elsewhere():
            while time.monotonic() < until and not self._try():
                time.sleep(AGAIN_S)

    def _try(self) -> bool:
        """Whether no other process compiles the loop, as far as can be known."""
        try:
            self._held = fcntl is not None and self._lock(fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks; or two processes would wait for one another
            pass
        return True

    def _lock(self, kind: int) -> bool:
        """Lock or unlock the loop's octet. Returns False where there is no file for it."""
        file = _lock_file(Path(self._cache_path), self._impl.locator.ensure_cache_path)
        if file is not None:
            fcntl.lockf(file, kind, 1, self._octet)
        return file is not None


class _Index(IndexDataCacheFile):  # type: ignore[misc]  # numba has no types
    """What the cache has of a loop."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except (AttributeError, ImportError):  # of another version, which had a type of an argument elsewhere
            return {}


def _lock_file(folder: Path, make_folder: Callable[[], None]) -> int | None:
    if folder not in _files:
        try:
            make_folder()
            _files[folder] = os.open(folder / "lidarcfg-loops.lock", os.O_RDWR | os.O_CREAT, 0o666)  # until the end
        except OSError:
            _files[folder] = None
    return _files[folder]
