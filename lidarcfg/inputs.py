"""Limits, checked before the work: the size of files that are read, and the memory and disk space that must be free."""

import errno
import math
import os
import shutil
import stat
import time
from contextlib import suppress
from pathlib import Path

from lidarcfg.errors import LidarcfgError
from lidarcfg.files import resolve

WRITER_S = 3.0  # how long a pipe that nobody opens to write is waited for
AGAIN_S = 0.02
PIPE_BYTES = 1 << 16
CGROUP = Path("/sys/fs/cgroup")
NO_MEMORY = ("can't start new thread", "failed to map segment", "annot allocate memory")  # what libraries say
LIBRARIES_BYTES = 600e6  # with less that can be reserved they do not load, or hang
LESS = "larger cuboids, fewer samples, fewer threads or a shorter capture need less"


def check_regular(path: str | Path, most: int | None = None) -> int:
    """The size of a file in bytes. Raises OSError for pipes, devices and folders, and for a size above `most`."""
    found = os.stat(path)
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "is not a regular file", str(path))
    if most is not None and found.st_size > most:
        raise OSError(errno.EFBIG, too_large(most), str(path))
    return found.st_size


def read_regular(path: str | Path, most: int) -> bytes:
    """The content of a regular file. Raises OSError as `check_regular` does."""
    check_regular(path, most)
    return Path(path).read_bytes()


def too_large(most: int) -> str:
    """The error message for an oversized file."""
    return f"larger than the {most // 10**6} million bytes that are read of such a file"


def read_any(path: str | Path, most: int) -> bytes:
    """The content of a file, a device or a pipe, and of one with more than `most` bytes one more than that.

    Raises OSError, for a pipe also if nobody writes to it.
    """
    with open(path, "rb", opener=_without_waiting) as file:
        first = _first(file.fileno(), path) if stat.S_ISFIFO(os.fstat(file.fileno()).st_mode) else b""
        if hasattr(os, "O_NONBLOCK"):
            os.set_blocking(file.fileno(), True)
        return first + file.read(most + 1 - len(first))


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _first(pipe: int, path: str | Path) -> bytes:
    """What a pipe has, once there is a writer: before, a read gives nothing; then it gives something, or would wait."""
    until = time.monotonic() + WRITER_S
    first = b""
    with suppress(BlockingIOError):
        while not (first := os.read(pipe, PIPE_BYTES)):
            if time.monotonic() > until:
                raise OSError(errno.EPIPE, "is a pipe to which nothing is written", str(path))
            time.sleep(AGAIN_S)
    return first


def address_bytes() -> float:
    """What `ulimit -v` leaves of the memory that this process may reserve, whether it is used or not."""
    with suppress(ImportError, OSError):
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            return limit - int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    return math.inf


def memory_bytes() -> float:
    """The memory that this process may still take: what the machine, its container and its limits leave."""
    left = [address_bytes()]
    with suppress(OSError, ValueError, AttributeError):
        left.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        left.append(1024 * float(next(line for line in lines if line.startswith("MemAvailable")).split()[1]))
    with suppress(OSError, ValueError):  # "max" is no number: no limit
        left.append(float((CGROUP / "memory.max").read_text()) - float((CGROUP / "memory.current").read_text()))
    return min(left)


def check_memory(what: str, needed: float, advice: str = "", reserved: float = 0.0) -> None:
    """Raises LidarcfgError unless `needed` bytes of memory are free and `reserved` can be reserved for `what`."""
    sizes = ""
    if reserved > (left := address_bytes()):
        sizes = f"to reserve {reserved / 1e9:,.1f} GB of memory; ulimit -v leaves {max(left, 0) / 1e9:,.1f} GB"
    elif needed > (left := memory_bytes()):
        sizes = f"{needed / 1e9:,.1f} GB of memory; {max(left, 0) / 1e9:,.1f} GB are free"
    if sizes:
        raise LidarcfgError(f"{what} needs {sizes}{'; ' * bool(advice)}{advice}")


def format_bytes(count: float) -> str:
    """Bytes, to a tenth of the unit."""
    return f"{count / 1e9:,.1f} GB" if count >= 1e9 else f"{count / 1e6:,.1f} MB"


def free_bytes(path: str | Path) -> float:
    """The room on the disk where a file would be written; infinite where that is not known."""
    folder = resolve(Path(path)).absolute().parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return math.inf


def check_room(path: str | Path, needed: float, advice: str) -> None:
    """Raises LidarcfgError if a file of this many bytes does not fit on its disk."""
    if needed > (free := free_bytes(path)):
        sizes = f"needs {format_bytes(needed)} on the disk; {format_bytes(free)} are free"
        raise LidarcfgError(f"{path}: {sizes}; {advice}")


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that the system had no memory left: for arrays, threads, libraries or files."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    said = str(error)
    if isinstance(error, RuntimeError | ImportError) and any(words in said for words in NO_MEMORY):
        return True
    return isinstance(error, ImportError | OSError) and "shared object" in said and address_bytes() < LIBRARIES_BYTES


def out_of_memory(error: BaseException, doing: str) -> LidarcfgError:
    """The error for a lack of memory: what was being done and, where known, how much was asked for."""
    shape = getattr(error, "shape", None)  # of numpy's error
    dtype = getattr(error, "dtype", None)
    asked = f"{math.prod(shape) * dtype.itemsize / 1e6:,.1f} MB more were asked for, " if shape and dtype else ""
    left = f"{max(memory_bytes(), 0) / 1e6:,.0f} MB are free"
    return LidarcfgError(f"out of memory at: {doing}; {asked}{left}; {LESS}")
