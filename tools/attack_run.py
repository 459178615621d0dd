"""How the attacks run a command, and what they make of its end."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
SECONDS, MEGABYTES = 10.0, 1000.0  # a bad input is refused, or used, within these
HANGS_S = 25.0
TRACEBACK = "Traceback (most recent call last)"


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int  # negative: by this signal
    out: str
    errors: str
    seconds: float
    megabytes: float  # resident, at most

    @property
    def refused(self) -> bool:
        """With exit 2 and one line, warnings aside."""
        lines = [line for line in self.errors.splitlines() if not line.startswith("lidarcfg: warning: ")]
        return self.code == 2 and len(lines) == 1 and lines[0].startswith("lidarcfg: ")


def command(words: Sequence[object]) -> list[str]:
    """The words of a `lidarcfg` command of this project."""
    return [sys.executable, "-m", "lidarcfg", *map(str, words)]


def environment(**more: str) -> dict[str, str]:
    """That of a user, with a screen of a usual width and no display."""
    kept = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return kept | {"PYTHONPATH": str(ROOT), "COLUMNS": "100"} | more


def run(words: Sequence[object], cwd: Path = ROOT, file_bytes: int | None = None, **more: str) -> Ended:
    """Run a command to its end; one that hangs is killed. With `file_bytes` no file may become larger."""

    def limits() -> None:
        if file_bytes is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write fails instead, as on a full disk
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))

    began = time.monotonic()
    process = subprocess.Popen(
        command(words),
        cwd=cwd,
        env=environment(**more),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=limits,
    )
    out, errors, usage = b"", b"", None
    try:
        out, errors, usage = _communicate(process)
    finally:
        if process.returncode is None:
            process.kill()
            process.wait()
    megabytes = usage.ru_maxrss / 1024 if usage else 0.0
    texts = (one.decode(errors="replace") for one in (out, errors))
    return Ended(process.returncode, *texts, time.monotonic() - began, megabytes)


def _communicate(process: "subprocess.Popen[bytes]") -> tuple[bytes, bytes, resource.struct_rusage]:
    """What it prints, and what it used: `wait4` tells of this process alone."""
    import threading

    texts: list[bytes] = [b"", b""]

    def read(index: int) -> None:
        stream = process.stderr if index else process.stdout
        assert stream is not None
        texts[index] = stream.read()

    readers = [threading.Thread(target=read, args=(index,), daemon=True) for index in range(2)]
    late = threading.Timer(HANGS_S, process.kill)
    for one in (*readers, late):
        one.start()
    _, status, usage = os.wait4(process.pid, 0)
    late.cancel()
    for reader in readers:
        reader.join(5)
    process.returncode = os.waitstatus_to_exitcode(status)
    return texts[0], texts[1], usage
