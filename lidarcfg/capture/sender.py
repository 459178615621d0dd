"""Sends datagrams over the network, each when its time has come: what `replay`, `writer` and `live` have in common."""

import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from types import MappingProxyType

from lidarcfg.capture.pcap import Datagram
from lidarcfg.errors import PacketError, reason
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.emulator import Emulator, Target
from lidarcfg.units import SECOND_NS

UDP = "udp://"
LOOPBACK = "127."
NO_EMULATORS: Mapping[str, Emulator] = MappingProxyType({})


@dataclass(frozen=True)
class Receiver:
    """A host that datagrams are sent to."""

    name: str
    address: str  # IPv4
    port: int | None  # None: each datagram keeps its own

    @classmethod
    def parse(cls, text: str) -> "Receiver":
        """HOST or HOST:PORT, also after udp://. Raises PacketError."""
        name, _, port = text.removeprefix(UDP).partition(":")
        if ":" in text.removeprefix(UDP) and not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
            raise PacketError(f"{text}: {port!r} is not a port, 1 to 65535")
        return cls(name, receiver_address(name), int(port) if port else None)

    def target(self, port: int) -> Target:
        """Where a datagram for a port goes."""
        return self.address, self.port or port


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


class PacedSender:
    """Sends datagrams to hosts, the first at once, each other one at its time after the first, `speed` times as fast.

    Each sensor's come from an address of its own, where the system has one: see `Senders`. Those of a sensor with an
    emulator, by its address in the capture, go where drivers have them sent, or nowhere; it has one receiver.
    """

    def __init__(
        self, receivers: Sequence[Receiver], speed: float = 1.0, emulators: Mapping[str, Emulator] = NO_EMULATORS
    ) -> None:
        self._receivers = [(one, Senders(one.address)) for one in receivers]
        self._speed = speed
        self._emulators = emulators
        self._zero_s: float | None = None  # of the clock, at time 0 of the datagrams
        self.sent = 0
        self.unsent = 0  # that no driver had sent to it, or not to where a way leads
        self.latest_s = 0.0  # the largest delay of a datagram

    def __enter__(self) -> "PacedSender":
        return self

    def __exit__(self, *error: object) -> None:
        for _, senders in self._receivers:
            senders.__exit__()

    @property
    def sources(self) -> Mapping[str, str]:
        """By a sensor's address, the one that its datagrams come from; empty: any."""
        return self._receivers[0][1].sources

    def late_s(self, time_ns: int) -> float:
        """How long ago a datagram of this time was due; it is less than 0 if that is to come."""
        now_s = time.perf_counter()
        if self._zero_s is None:
            self._zero_s = now_s - time_ns / SECOND_NS / self._speed
        return now_s - self._zero_s - time_ns / SECOND_NS / self._speed

    def postpone(self, seconds: float) -> None:
        """Have all that follows be due later."""
        assert self._zero_s is not None
        self._zero_s += seconds

    def wait(self, time_ns: int) -> None:
        """Wait until a datagram of this time is due."""
        wait_s = -self.late_s(time_ns)
        if wait_s > 0:
            time.sleep(wait_s)

    def send(self, datagram: Datagram) -> None:
        """Send a datagram when it is due, or at once. Raises PacketError if a receiver cannot be reached."""
        self.wait(datagram.time_ns)
        emulator = self._emulators.get(datagram.host)
        payload = emulator.payload(datagram.payload, datagram.later_ns) if emulator else datagram.payload
        opened = datagram.source_port == datagram.port  # by a driver on this machine
        keeps = not opened or (emulator and emulator.own_ports)
        sent = False
        for receiver, senders in self._receivers:
            to = emulator.destination(datagram.port) if emulator else receiver.target(datagram.port)
            try:
                sender = senders.of(datagram.host, datagram.source_port if keeps else 0)
                sent = to is not None and sender.sendto(payload, to) >= 0
            except OSError as error:
                if to == receiver.target(datagram.port):
                    raise PacketError(f"{receiver.name}: {reason(error)}") from None
        if not sent:
            self.unsent += 1
            return
        self.sent += 1
        self.latest_s = max(self.latest_s, self.late_s(datagram.time_ns))


class SendQueue:
    """Brings what sensors send into the order of time, as it becomes known."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, Datagram]] = []  # time, stream

    def add(self, stream: int, host: str, payloads: Payloads) -> None:
        """Take what a sensor sends; at equal times, those of a lower stream go first."""
        source_port = payloads.header.source_port or payloads.port
        for at_ns, data in zip(payloads.time_ns.tolist(), payloads.data, strict=True):
            datagram = Datagram(at_ns, host, source_port, payloads.port, data.tobytes())
            self._waiting.append((at_ns, stream, datagram))

    def ready(self, known_ns: int) -> Iterator[Datagram]:
        """Those that are before a time, by which all others have come."""
        self._waiting.sort(key=lambda one: one[:2])
        count = sum(at_ns < known_ns for at_ns, *_ in self._waiting)
        ready = self._waiting[:count]
        del self._waiting[:count]
        return (datagram for *_, datagram in ready)
