"""Emulates the sensors of a capture while it is replayed: answers what drivers ask before they read packets.

The answers are the maker's: `packets/emulator.py` has the interface. This module finds the sensors of a capture that
can answer; `emulation_server` has the sockets.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidarcfg.capture.replay import receiver_address, sender_address
from lidarcfg.capture.selection import Selection, read_window, window_ns
from lidarcfg.capture.source_finder import Flow, SourceFinder
from lidarcfg.capture.stream import ENOUGH
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Bytes
from lidarcfg.packets.codec import Codec
from lidarcfg.packets.emulator import Emulator, NetworkSite
from lidarcfg.packets.families import FAMILIES, codec, family
from lidarcfg.units import SECOND_NS

SEARCHED_NS = 2 * SECOND_NS  # of a capture, for its sensors


@dataclass(frozen=True)
class EmulatedSensor:
    """A sensor of a capture that answers."""

    host: str  # its address in the capture
    site: NetworkSite
    emulator: Emulator

    def __str__(self) -> str:
        ports = " and ".join(f"{one.name} on {one.transport.upper()} port {one.port}" for one in self.emulator.services)
        return f"{self.site.address} answers as {self.emulator.name}: {ports}"


def find_emulated(
    path: Path,
    target: str,
    port: int | None,
    selection: Selection,
    on_warning: Callable[[str], None],
    sidecars: Sequence[Path] = (),
) -> list[EmulatedSensor]:
    """The sensors in a part of a capture that can answer drivers while it is sent to a host and port.

    Warns of those that cannot. `sidecars` are those of `decode`. Raises PacketError, ConfigError if none can, or one
    lacks what it needs for it.
    """
    sources = SourceFinder(path, on_warning, sidecars=sidecars)
    receiver = receiver_address(target)
    found: dict[str, EmulatedSensor] = {}
    without: list[str] = []
    for flow, packets in _first_packets(path, sources, selection):
        source = sources.source(flow)
        site = NetworkSite(sender_address(source.host, receiver), receiver, port)
        emulator = codec(sources.sensor(flow, packets)).emulator(source, packets, site)
        if emulator is None:
            without.append(f"{flow.name} ({sources.family_of(flow)})")
        elif source.host in found:
            what = f"several sensors have the address {source.host}, and only one can answer there"
            raise ConfigError(f"{path}: {what}; give each its own in the rig")
        else:
            found[source.host] = EmulatedSensor(source.host, site, emulator)
    if not found:
        makers = ", ".join(name for name in FAMILIES if family(name).emulator is not Codec.emulator)
        there = ", ".join(without) or "none"
        raise PacketError(f"{path}: no sensor that can be emulated; allowed: those of {makers}; its sensors: {there}")
    for warning in sources.unread:
        on_warning(warning)
    if without:
        on_warning(f"{', '.join(without)}: no driver asks such a sensor, so it only sends")
    return list(found.values())


def _first_packets(path: Path, sources: SourceFinder, selection: Selection) -> Iterator[tuple[Flow, Bytes]]:
    """The flows in the beginning of a part of a capture, and their first packets (P, size)."""
    begin_ns, end_ns = window_ns(path, selection)
    first: dict[Flow, Bytes] = {}
    until_ns = 0
    for batch in read_window(path, lambda warning: None, (begin_ns, end_ns)):
        inside = batch[(batch.time_ns >= begin_ns) & (batch.time_ns < end_ns)]
        if not len(inside.time_ns):
            continue
        until_ns = until_ns or int(inside.time_ns[0]) + SEARCHED_NS
        lidar, numbers = sources.lidar(inside)
        for flow, mine in sources.by_flow(numbers):
            packets = np.ascontiguousarray(lidar[mine][:ENOUGH].payloads(flow.size))
            first[flow] = np.concatenate([first[flow], packets])[:ENOUGH] if flow in first else packets
        if inside.time_ns.min() >= until_ns:
            break
    yield from first.items()
