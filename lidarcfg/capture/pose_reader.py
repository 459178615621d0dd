"""Poses as text lines, from stdin or by UDP: NAME x y z qx qy qz qw, in metres, of a unit quaternion."""

import os
import socket
import sys
from collections import Counter
from collections.abc import Callable
from threading import Thread

import numpy as np

from lidarcfg.errors import ConfigError, one_line, reason
from lidarcfg.geometry import Array
from lidarcfg.world.motion import UNIT, matrices

STDIN = "-"
NUMBERS = ("x", "y", "z", "qx", "qy", "qz", "qw")
ALLOWED = f"allowed: NAME {' '.join(NUMBERS)}"
READ = 1 << 16  # bytes at a time
LINE_MAX = 1000  # bytes
SHOWN_MAX = 60  # characters of a wrong line, in a warning
LOCAL = "127.0.0.1"


class PoseLines:
    """Takes lines, and gives their poses T_world_object (4, 4) to `move` by their names.

    Wrong ones are left out: of each kind the first is told, and the number in the end. `move` raises ConfigError for an
    unknown name.
    """

    def __init__(self, move: Callable[[str, Array], None], on_warning: Callable[[str], None]) -> None:
        self._move = move
        self._on_warning = on_warning
        self._begun = b""
        self.wrong = Counter[str]()  # by kind

    def feed(self, data: bytes) -> None:
        """Take some bytes of a stream; its last line may go on in the next."""
        *lines, self._begun = (self._begun + data).split(b"\n")
        if len(self._begun) > LINE_MAX:
            lines.append(self._begun)
            self._begun = b""
        for line in lines:
            self.take(line.decode(errors="replace"))

    def take(self, line: str) -> None:
        """Take a line; empty ones and those that begin with # are comments."""
        words = line.rsplit(maxsplit=len(NUMBERS))  # a name may contain spaces
        if not words or words[0].startswith("#"):
            return
        if len(words) <= len(NUMBERS):
            self._refuse("not a pose", line, ALLOWED)
            return
        try:
            values = np.array([float(word) for word in words[1:]])
        except ValueError:
            self._refuse("not numbers", line, ALLOWED)
            return
        if not np.isfinite(values).all() or not abs(np.linalg.norm(values[3:]) - 1) <= UNIT:
            self._refuse("not finite, or not a unit quaternion", line, ALLOWED)
            return
        T = np.eye(4)
        T[:3, :3] = matrices(values[None, 3:])[0]
        T[:3, 3] = values[:3]
        try:
            self._move(words[0].strip(), T)
        except ConfigError as error:
            self._refuse("refused", line, str(error))

    def tell(self) -> None:
        """Tell how many were left out, where it is more than was told."""
        for kind, count in self.wrong.items():
            if count > 1:
                self._on_warning(f"{count:,} lines of poses were left out: {kind}")

    def _refuse(self, kind: str, line: str, allowed: str) -> None:
        self.wrong[kind] += 1
        if self.wrong[kind] == 1:
            self._on_warning(one_line(f"poses: {line.strip()[:SHOWN_MAX]!r}: {kind}; {allowed}"))


class PoseReader:
    """Reads lines from stdin (`-`) or from a UDP port (PORT or ADDRESS:PORT), from entering to leaving it.

    It reads in another thread. Raises ConfigError for a port that is none, and on entering for one that is taken.
    """

    def __init__(self, source: str, lines: PoseLines) -> None:
        self._source = source
        self._lines = lines
        self._socket: socket.socket | None = None
        address, _, port = source.rpartition(":")
        if source != STDIN and not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
            raise ConfigError(f"{source!r} is no source of poses; allowed: - for stdin, or [ADDRESS:]PORT for UDP")
        self._endpoint = (address or LOCAL, 0 if source == STDIN else int(port))

    def __enter__(self) -> "PoseReader":
        if self._source != STDIN:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                self._socket.bind(self._endpoint)
            except OSError as error:
                self._socket.close()
                raise ConfigError(f"{self._source}: poses cannot come here: {reason(error)}") from None
        Thread(target=self._read, name="poses", daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._socket:
            self._socket.close()
        self._lines.tell()

    def _read(self) -> None:
        if self._socket is None:
            while data := os.read(sys.stdin.fileno(), READ):
                self._lines.feed(data)
            self._lines.feed(b"\n")
            return
        while True:
            try:
                data = self._socket.recv(READ)
            except OSError:  # it is closed
                return
            self._lines.feed(data + b"\n")
