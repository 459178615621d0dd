"""Replays a capture over the network at its own pace, to test a driver live."""

import socket
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from lidarcfg.capture.pcap import Datagram, each_datagram
from lidarcfg.capture.selection import Selection, read_window, window_ns
from lidarcfg.errors import PacketError, reason
from lidarcfg.packets.emulator import Emulator

LOOPBACK = "127."
LEAST_NS = 1_000  # between two passes, at least
NO_EMULATORS: Mapping[str, Emulator] = MappingProxyType({})


@dataclass(frozen=True)
class ReplayResult:
    """How a replay went."""

    packets: int
    seconds: float  # of the real clock
    latest_s: float  # the largest delay of a datagram
    interrupted: bool = False  # by Ctrl-C
    sources: Mapping[str, str] = field(default_factory=dict)  # by sensor's address, the one sent from; empty: any
    unsent: int = 0  # datagrams that no driver had sent to it, or not to where a way leads


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
            yield replace(datagram, time_ns=datagram.time_ns + shift_ns, later_ns=shift_ns)
        span_ns = last_ns - first_ns
        again = count > 0
        shift_ns += span_ns + max(span_ns // max(count - 1, 1), LEAST_NS)


def receiver_address(host: str) -> str:
    """The IPv4 address of the host to send to. Raises PacketError."""
    try:
        return str(socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0])
    except (OSError, UnicodeError):
        raise PacketError(f"{host!r} is not a known host") from None


def sender_address(sensor: str, receiver: str) -> str:
    """The address that a sensor sends from: its own or, to a loopback address, the one with the same last numbers.

    Linux has all of these: 127.168.1.201 stands for 192.168.1.201.
    """
    return LOOPBACK + sensor.partition(".")[2] if receiver.startswith(LOOPBACK) else sensor


def replay(
    datagrams: Iterable[Datagram],
    host: str,
    port: int | None,
    speed: float = 1.0,
    emulators: Mapping[str, Emulator] = NO_EMULATORS,
) -> ReplayResult:
    """Send the datagrams to a host: to one port, or each to its own; `speed` times as fast as they were captured.

    The first is sent at once, each other one at its host time relative to the first. Each sensor's come from an address
    of its own, where the system has one: see `Senders`. Those of a sensor with an emulator, by its address in the
    capture, go where drivers have them sent, or nowhere. Ctrl-C ends the replay. Raises PacketError for an unknown
    host, for an empty capture, and if the host cannot be reached.
    """
    address = receiver_address(host)
    count = 0
    unsent = 0
    latest_s = 0.0
    first_ns = 0
    began = time.perf_counter()
    interrupted = False
    with Senders(address) as senders:
        try:
            for datagram in datagrams:
                if not count + unsent:
                    first_ns = datagram.time_ns
                    began = time.perf_counter()
                due = began + (datagram.time_ns - first_ns) / 1e9 / speed
                wait_s = due - time.perf_counter()
                if wait_s > 0:
                    time.sleep(wait_s)
                emulator = emulators.get(datagram.host)
                to = emulator.destination(datagram.port) if emulator else (address, port or datagram.port)
                payload = emulator.payload(datagram.payload, datagram.later_ns) if emulator else datagram.payload
                try:
                    opened = datagram.source_port == datagram.port  # by a driver on this machine
                    keeps = emulator and (emulator.own_ports or not opened)
                    sender = senders.of(datagram.host, datagram.source_port if keeps else 0)
                    sent = to is not None and sender.sendto(payload, to) >= 0
                except OSError as error:
                    if to == (address, port or datagram.port):
                        raise PacketError(f"{host}: {reason(error)}") from None
                    sent = False
                if not sent:
                    unsent += 1
                    continue
                count += 1
                latest_s = max(latest_s, time.perf_counter() - due)
        except KeyboardInterrupt:
            interrupted = True
    if not (count or unsent or interrupted):
        raise PacketError("there are no UDP datagrams to send")
    return ReplayResult(count, time.perf_counter() - began, latest_s, interrupted, senders.sources, unsent)


class Senders:
    """A socket for each sensor, from its own address if this machine has that: see `sender_address`.

    Drivers may know a sensor's data by the port that it comes from: `of` gives a socket with that port, if it is free.
    """

    def __init__(self, receiver: str) -> None:
        self._receiver = receiver
        self._sockets: dict[tuple[str, int], socket.socket] = {}
        self._open = ExitStack()
        self.sources: dict[str, str] = {}

    def __enter__(self) -> "Senders":
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def of(self, host: str, port: int = 0) -> socket.socket:
        """The socket of the sensor at an address, which sends from a port; 0: any."""
        if (host, port) not in self._sockets:
            self._sockets[host, port] = self._made(host, port)
        return self._sockets[host, port]

    def _made(self, host: str, port: int) -> socket.socket:
        made = self._open.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        made.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        address = sender_address(host, self._receiver)
        self.sources.setdefault(host, "")
        if address in (one for sensor, one in self.sources.items() if sensor != host):
            return made
        for own in dict.fromkeys((port, 0)):
            with suppress(OSError):  # the port is taken, or it is not an address of this machine
                made.bind((address, own))
                self.sources[host] = address
                break
        return made
