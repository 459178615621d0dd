"""Replays a capture over the network at its own pace, to test a driver live."""

import socket
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from lidarcfg.capture.pcap import Datagram, each_datagram
from lidarcfg.capture.selection import Selection, read_window, window_ns
from lidarcfg.errors import PacketError

LOOPBACK = "127."
LEAST_NS = 1_000  # between two passes, at least


@dataclass(frozen=True)
class ReplayResult:
    """How a replay went."""

    packets: int
    seconds: float  # of the real clock
    latest_s: float  # the largest delay of a datagram
    interrupted: bool = False  # by Ctrl-C
    sources: Mapping[str, str] = field(default_factory=dict)  # by sensor's address, the one sent from; empty: any


def read_selected(path: str | Path, on_warning: Callable[[str], None], selection: Selection) -> Iterator[Datagram]:
    """The datagrams of a window of a capture, from any sensor. Raises PacketError."""
    begin_ns, end_ns = window_ns(path, selection)
    for batch in read_window(path, on_warning, (begin_ns, end_ns)):
        yield from each_datagram(batch[(batch.time_ns >= begin_ns) & (batch.time_ns < end_ns)])


def repeat(read: Callable[[], Iterator[Datagram]]) -> Iterator[Datagram]:
    """Repeat the datagrams endlessly. Host times continue; passes are their mean interval apart."""
    shift_ns = 0
    again = True
    while again:
        count = 0
        first_ns = 0
        last_ns = 0
        for count, datagram in enumerate(read(), 1):
            first_ns = first_ns if count > 1 else datagram.time_ns
            last_ns = datagram.time_ns
            yield replace(datagram, time_ns=datagram.time_ns + shift_ns)
        span_ns = last_ns - first_ns
        again = count > 0
        shift_ns += span_ns + max(span_ns // max(count - 1, 1), LEAST_NS)


def replay(datagrams: Iterable[Datagram], host: str, port: int | None, speed: float = 1.0) -> ReplayResult:
    """Send the datagrams to a host: to one port, or each to its own; `speed` times as fast as they were captured.

    The first is sent at once, each other one at its host time relative to the first. Each sensor's come from an address
    of its own, where the system has one: see `Senders`. Ctrl-C ends the replay. Raises PacketError for an unknown
    host and for an empty capture.
    """
    try:
        address = str(socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0])
    except (OSError, UnicodeError):
        raise PacketError(f"{host!r} is not a known host") from None
    count = 0
    latest_s = 0.0
    first_ns = 0
    began = time.perf_counter()
    interrupted = False
    with Senders(address) as senders:
        try:
            for datagram in datagrams:
                if not count:
                    first_ns = datagram.time_ns
                    began = time.perf_counter()
                due = began + (datagram.time_ns - first_ns) / 1e9 / speed
                wait_s = due - time.perf_counter()
                if wait_s > 0:
                    time.sleep(wait_s)
                senders.of(datagram.host).sendto(datagram.payload, (address, port or datagram.port))
                count += 1
                latest_s = max(latest_s, time.perf_counter() - due)
        except KeyboardInterrupt:
            interrupted = True
    if not (count or interrupted):
        raise PacketError("there are no UDP datagrams to send")
    return ReplayResult(count, time.perf_counter() - began, latest_s, interrupted, senders.sources)


class Senders:
    """A socket for each sensor, from its own address if this machine has that.

    To a loopback address a sensor sends from the loopback address with the same last three numbers, which Linux has
    for all: 127.168.1.201 stands for 192.168.1.201.
    """

    def __init__(self, target: str) -> None:
        self._local = target.startswith(LOOPBACK)
        self._sockets: dict[str, socket.socket] = {}
        self._open = ExitStack()
        self.sources: dict[str, str] = {}

    def __enter__(self) -> "Senders":
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def of(self, host: str) -> socket.socket:
        """The socket of the sensor at an address."""
        if host not in self._sockets:
            self._sockets[host] = self._made(host)
        return self._sockets[host]

    def _made(self, host: str) -> socket.socket:
        made = self._open.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        made.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        address = LOOPBACK + host.partition(".")[2] if self._local else host
        self.sources[host] = ""
        if address not in self.sources.values():
            with suppress(OSError):  # not an address of this machine
                made.bind((address, 0))
                self.sources[host] = address
        return made
