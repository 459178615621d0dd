"""Replays a capture over the network at its own pace, to test a driver live."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from lidarcfg.capture.pcap import Datagram, each_datagram
from lidarcfg.capture.selection import Selection, read_window, window_ns
from lidarcfg.capture.sender import NO_EMULATORS, PacedSender, Receiver, receiver_address
from lidarcfg.errors import PacketError
from lidarcfg.packets.emulator import Emulator

LEAST_NS = 1_000  # between two passes, at least


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
    receiver = Receiver(host, receiver_address(host), port)
    began = time.perf_counter()
    interrupted = False
    with PacedSender([receiver], speed, emulators) as sender:
        try:
            for n, datagram in enumerate(datagrams):
                began = began if n else time.perf_counter()
                sender.send(datagram)
        except KeyboardInterrupt:
            interrupted = True
    if not (sender.sent or sender.unsent or interrupted):
        raise PacketError("there are no UDP datagrams to send")
    took_s = time.perf_counter() - began
    return ReplayResult(sender.sent, took_s, sender.latest_s, interrupted, sender.sources, sender.unsent)
