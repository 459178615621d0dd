"""Replays a capture over the network at its own pace, to test a driver live."""

import socket
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from lidarcfg.capture.pcap import Datagram, each_datagram
from lidarcfg.capture.selection import Selection, read_window, window_ns
from lidarcfg.errors import PacketError

LEAST_NS = 1_000  # between two passes, at least


@dataclass(frozen=True)
class ReplayResult:
    """How a replay went."""

    packets: int
    seconds: float  # of the real clock
    latest_s: float  # the largest delay of a datagram
    interrupted: bool = False  # by Ctrl-C


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

    The first is sent at once, each other one at its host time relative to the first. Their source is this machine.
    Ctrl-C ends the replay. Raises PacketError for an unknown host and for an empty capture.
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
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        try:
            for datagram in datagrams:
                if not count:
                    first_ns = datagram.time_ns
                    began = time.perf_counter()
                due = began + (datagram.time_ns - first_ns) / 1e9 / speed
                wait_s = due - time.perf_counter()
                if wait_s > 0:
                    time.sleep(wait_s)
                sender.sendto(datagram.payload, (address, port or datagram.port))
                count += 1
                latest_s = max(latest_s, time.perf_counter() - due)
        except KeyboardInterrupt:
            interrupted = True
    if not (count or interrupted):
        raise PacketError("there are no UDP datagrams to send")
    return ReplayResult(count, time.perf_counter() - began, latest_s, interrupted)
