"""A capture sent again over the network at its own pace, so that a driver can be tested live."""

import socket
import time
from collections.abc import Iterable
from dataclasses import dataclass

from lidarcfg.capture.pcap import Datagram
from lidarcfg.errors import PacketError


@dataclass(frozen=True)
class Replayed:
    """How a replay went."""

    packets: int
    seconds: float  # of the real clock
    latest_s: float  # by how much a datagram left after its time, at most


def replay(datagrams: Iterable[Datagram], host: str, port: int | None, speed: float = 1.0) -> Replayed:
    """Send the datagrams to a host: to one port, or each to its own; `speed` times as fast as they were captured.

    The first leaves at once, and each other as long after it as its host time says. Their source is this machine.
    Raises PacketError for an unknown host and for an empty capture.
    """
    try:
        address = str(socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0])
    except (OSError, UnicodeError):
        raise PacketError(f"{host!r} is not a host that is known here") from None
    count, latest_s, first_ns, began = 0, 0.0, 0, time.perf_counter()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        for count, datagram in enumerate(datagrams, 1):
            if count == 1:
                first_ns, began = datagram.time_ns, time.perf_counter()
            due = began + (datagram.time_ns - first_ns) / 1e9 / speed
            wait_s = due - time.perf_counter()
            if wait_s > 0:
                time.sleep(wait_s)
            sender.sendto(datagram.payload, (address, port or datagram.port))
            latest_s = max(latest_s, time.perf_counter() - due)
    if not count:
        raise PacketError("there are no UDP datagrams to send")
    return Replayed(count, time.perf_counter() - began, latest_s)
