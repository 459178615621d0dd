"""Emulates sensors while their packets are sent: answers what drivers ask before they read packets.

The answers are the maker's: `packets/emulator.py` has the interface. This module finds the sensors of a capture, or of
a rig, that can answer; `emulation_server` has the sockets.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidarcfg.capture.manifest import load_manifest, manifest_path
from lidarcfg.capture.selection import Selection, read_window, window_ns
from lidarcfg.capture.sender import Receiver, receiver_address, sender_address
from lidarcfg.capture.source_finder import Flow, SourceFinder
from lidarcfg.capture.stream import ENOUGH
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Bytes
from lidarcfg.packets.codec import Codec, PacketSource
from lidarcfg.packets.emulator import Emulator, NetworkSite
from lidarcfg.packets.families import FAMILIES, codec, family, first_packet
from lidarcfg.sensors.rig import Mount, Rig, load_rig
from lidarcfg.units import SECOND_NS

SEARCHED_NS = 2 * SECOND_NS  # of a capture, for its sensors


@dataclass(frozen=True)
class EmulatedSensor:
    """A sensor that answers."""

    host: str  # its address in the capture, or the rig
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

    They are those of the manifest's rig, if there is one. Warns of those that cannot. `sidecars` are those of `decode`.
    Raises PacketError, ConfigError if none can, or one lacks what it needs for it.
    """
    sources = SourceFinder(path, on_warning, _recorded_rig(path, on_warning), sidecars=sidecars)
    sensors = (
        _Asked(
            codec(sources.sensor(flow, packets)),
            f"{flow.name} ({sources.family_of(flow)})",
            sources.source(flow),
            packets,
        )
        for flow, packets in _first_packets(path, sources, selection)
    )
    found = _emulated(sensors, Receiver(target, receiver_address(target), port), str(path), on_warning)
    for warning in sources.unread:
        on_warning(warning)
    return found


def emulated_mounts(
    mounts: Sequence[Mount], receiver: Receiver, on_warning: Callable[[str], None]
) -> list[EmulatedSensor]:
    """The sensors of a rig that can answer drivers while they send to a receiver.

    Warns of those that cannot. Raises PacketError, ConfigError if none can.
    """
    sensors = (
        _Asked(
            codec(mount.sensor),
            f"{mount.name} ({mount.sensor.codec})",
            _source(mount, on_warning),
            first_packet(mount).data,
        )
        for mount in mounts
    )
    return _emulated(sensors, receiver, "the rig", on_warning)


class _Asked(NamedTuple):
    """A sensor that may be asked."""

    maker: Codec
    name: str
    source: PacketSource
    packets: Bytes  # (P, size) its first


def _emulated(
    sensors: Iterable[_Asked], receiver: Receiver, where: str, on_warning: Callable[[str], None]
) -> list[EmulatedSensor]:
    """Those of some sensors that can answer. Raises PacketError, ConfigError."""
    found: dict[str, EmulatedSensor] = {}
    without: list[str] = []
    for maker, name, source, packets in sensors:
        site = NetworkSite(sender_address(source.host, receiver.address), receiver.address, receiver.port)
        emulator = maker.emulator(source, packets, site)
        if emulator is None:
            without.append(name)
        elif source.host in found:
            what = f"several sensors have the address {source.host}, and only one can answer there"
            raise ConfigError(f"{where}: {what}; give each its own in the rig")
        else:
            found[source.host] = EmulatedSensor(source.host, site, emulator)
    if not found:
        makers = ", ".join(name for name in FAMILIES if family(name).emulator is not Codec.emulator)
        there = ", ".join(without) or "none"
        raise PacketError(f"{where}: no sensor that can be emulated; allowed: those of {makers}; its sensors: {there}")
    if without:
        on_warning(f"{', '.join(without)}: no driver asks such a sensor, so it only sends")
    return list(found.values())


def _recorded_rig(path: Path, on_warning: Callable[[str], None]) -> Rig | None:
    """The rig of a capture's manifest; None without one, and with a warning if it has changed since."""
    if not manifest_path(path).exists():
        return None
    try:
        file = load_manifest(path).input_path("rig", "so sensors are told by their packets alone")
        return load_rig(file) if file else None
    except ConfigError as error:
        on_warning(str(error))
        return None


def _source(mount: Mount, on_warning: Callable[[str], None]) -> PacketSource:
    """What is known of a mount's packets before it sends any: the files that an export writes beside them."""
    files = {f"{mount.name}{suffix}": content for suffix, content in codec(mount.sensor).sidecar_files(mount).items()}
    return PacketSource(
        where=mount.name,
        host=mount.host,
        port=mount.data_port,
        sidecar_files=lambda suffix: {name: content for name, content in files.items() if name.endswith(suffix)},
        payloads=lambda port, size: iter(()),
        search=lambda kind, size: iter(()),
        on_warning=on_warning,
        settings=mount.settings,
    )


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
