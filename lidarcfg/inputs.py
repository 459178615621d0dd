"""Files that are read: regular ones, of a size that memory holds. What is not is refused before it is read."""

import errno
import os
import stat
import time
from contextlib import suppress
from pathlib import Path

from lidarcfg.errors import LidarcfgError

WRITER_S, AGAIN_S = 3.0, 0.02  # a pipe that nobody opens to write is waited for
PIPE_BYTES = 1 << 16
CGROUP = Path("/sys/fs/cgroup")


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
    """What is said of a file that is larger than the bytes that are read of one."""
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
    until, first = time.monotonic() + WRITER_S, b""
    with suppress(BlockingIOError):
        while not (first := os.read(pipe, PIPE_BYTES)):
            if time.monotonic() > until:
                raise OSError(errno.EPIPE, "is a pipe to which nothing is written", str(path))
            time.sleep(AGAIN_S)
    return first


def memory_bytes() -> float:
    """The memory that this process may still take: what the machine, its container and its limits leave."""
    left = [float("inf")]
    with suppress(OSError, ValueError, AttributeError):
        left.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        left.append(1024 * float(next(line for line in lines if line.startswith("MemAvailable")).split()[1]))
    with suppress(OSError, ValueError):  # "max" is no number: no limit
        left.append(float((CGROUP / "memory.max").read_text()) - float((CGROUP / "memory.current").read_text()))
    with suppress(ImportError, OSError):
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            left.append(limit - pages * resource.getpagesize())
    return min(left)


def check_memory(what: str, needed: float, advice: str = "") -> None:
    """Raises LidarcfgError if what needs so many bytes of memory cannot have them."""
    if needed > (left := memory_bytes()):
        sizes = f"{needed / 1e9:,.1f} GB of memory; {max(left, 0) / 1e9:,.1f} GB are free"
        raise LidarcfgError(f"{what} needs {sizes}{'; ' * bool(advice)}{advice}")
