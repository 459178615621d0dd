"""Reads a capture: the packets of its LiDARs, chunk by chunk, those of each sensor in the order of its clock."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.frames import Datagrams
from lidarcfg.capture.selection import ALL, ALWAYS_NS, Selection, read_window, window_ns
from lidarcfg.capture.sources import SourceFinder, endpoint_name
from lidarcfg.capture.stream import ENOUGH, Packets, Sender, SourceStats, Stream
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Bytes, Times
from lidarcfg.packets.codec import PacketSource
from lidarcfg.sensors.rig import Rig
from lidarcfg.sensors.sensor import Sensor

CHUNK_PACKETS = 1024
CHUNK_BYTES = 1 << 21  # of packets
SENSORS_MAX = 10_000  # of a capture that are decoded together; each takes memory and time of its own


@dataclass(frozen=True)
class Recording:
    """All packets of one source, in the order of the capture."""

    name: str  # host:port, or the mount's
    source: PacketSource
    sensor: Sensor
    packets: Bytes  # (P, size)
    host_ns: Times  # (P,)


class CaptureReader:
    """Reads a capture. Its arguments are those of `decode_pcap`. Raises PacketError, ConfigError."""

    def __init__(
        self,
        path: str | Path,
        on_warning: Callable[[str], None],
        rig: Rig | None = None,
        model: str | None = None,
        selection: Selection = ALL,
        driver_view: bool = False,
    ) -> None:
        self._path = Path(path)
        self._on_warning = on_warning
        self._rig = rig
        self._selection = selection
        self._window_ns = window_ns(path, selection)
        self._sources = SourceFinder(self._path, on_warning, rig, model, driver_view)
        self._streams: dict[int, Stream | None] = {}  # by source, in the order of their appearance; None: not selected
        self._sensor_names = tuple(mount.name for mount in rig.mounts) if rig else ()
        if rig:
            for name in selection.sensors:
                if not any(name in (mount.name, f"{mount.host}:{mount.data_port}") for mount in rig.mounts):
                    allowed = ", ".join(self._sensor_names)
                    raise ConfigError(f"no sensor of the rig {rig.name!r} is called {name!r}; allowed: {allowed}")

    def chunks(self, chunk_packets: int = CHUNK_PACKETS) -> Iterator[list[Packets]]:
        """The packets of all sensors, at most about `chunk_packets` at a time; fewer, if they are large."""
        waiting = 0
        waiting_bytes = 0
        for batch in self._datagrams():
            left, keys = self._sources.lidar(batch)
            while len(left.size):
                enough = int(np.searchsorted(np.cumsum(left.size), CHUNK_BYTES - waiting_bytes)) + 1
                count = min(chunk_packets - waiting, enough)
                self._add(left[:count], keys[:count])
                waiting += len(keys[:count])
                waiting_bytes += int(left.size[:count].sum())
                left = left[count:]
                keys = keys[count:]
                if waiting == chunk_packets or waiting_bytes >= CHUNK_BYTES:
                    if chunk := self._take(last=False):
                        yield chunk
                    waiting = 0
                    waiting_bytes = 0
        chunk = self._take(last=True)
        for warning in self._sources.strangers:
            self._on_warning(warning)
        self._check_found()
        for stream in self._selected:
            if stream.damaged:
                self._on_warning(stream.damaged)
        yield chunk

    def stats(self) -> list[SourceStats]:
        """The statistics of all sources that packets were read from."""
        return [stream.stats() for stream in self._selected if stream.packets]

    def recordings(self) -> list[Recording]:
        """The sources, each with all of its packets in memory, as they were captured."""
        parts: dict[int, list[Datagrams]] = {}
        for batch in self._datagrams():
            found, keys = self._sources.lidar(batch)
            for key in dict.fromkeys(keys.tolist()):
                self._streams[key] = None
                parts.setdefault(key, []).append(found[keys == key])
        for warning in self._sources.strangers:
            self._on_warning(warning)
        self._check_found()
        return [self._recording(key, batches) for key, batches in parts.items()]

    def _recording(self, key: int, batches: list[Datagrams]) -> Recording:
        packets = np.concatenate([batch.payloads(int(batch.size[0])) for batch in batches])
        host_ns = np.concatenate([batch.time_ns for batch in batches])
        _, mount = self._sources.mount(key)
        name = mount.name if mount else endpoint_name(key)
        sensor = self._sources.sensor(key, packets[:ENOUGH])
        return Recording(name, self._sources.source(key), sensor, packets, host_ns)

    def _datagrams(self) -> Iterator[Datagrams]:
        return read_window(self._path, self._on_warning, self._window_ns)

    @property
    def _selected(self) -> list[Stream]:
        return [stream for stream in self._streams.values() if stream]

    def _add(self, datagrams: Datagrams, keys: NDArray[np.uint64]) -> None:
        """Hand the packets to their streams."""
        for key in dict.fromkeys(keys.tolist()):
            if key not in self._streams:
                self._streams[key] = self._stream(key)
            if stream := self._streams[key]:
                mine = datagrams[keys == key]
                stream.add(mine.payloads(int(mine.size[0])), mine.time_ns)

    def _take(self, last: bool) -> list[Packets]:
        """The packets that each stream can release now."""
        streams = [stream for stream in self._selected if last or stream.fresh]
        return [packets for stream in streams if (packets := stream.take(self._sensor_names, last))]

    def _stream(self, key: int) -> Stream | None:
        """The stream of a new source: with a rig, of the mount at its address; None if the source is not selected."""
        name = endpoint_name(key)
        index, mount = self._sources.mount(key)
        if self._rig and mount is None and not self._selection.sensors:
            has = ", ".join(f"{mount.host}:{mount.data_port}" for mount in self._rig.mounts)
            raise PacketError(f"{self._path}: {name} is not in the rig {self._rig.name!r}; it has {has}")
        if not self._selection.includes(name, mount.name if mount else name):
            return None
        if mount is None:
            index = len(self._sensor_names)
            if index == SENSORS_MAX:
                what = f"LiDAR packets of more than {SENSORS_MAX:,} addresses and ports"
                raise PacketError(f"{self._path}: {what}; allowed: {SENSORS_MAX:,}, or the few that --sensor names")
            self._sensor_names = (*self._sensor_names, name)
        sender = Sender(
            where=f"{self._path}: {name}",
            name=mount.name if mount else name,
            family=self._sources.family_of(key),
            index=index,
            T_vehicle_sensor=mount.T_vehicle_sensor if mount else None,
        )
        return Stream(sender, self._window_ns, partial(self._sources.decoder, key))

    def _check_found(self) -> None:
        """Raises PacketError if there is nothing, or nothing of what was selected."""
        found = {name for key, stream in self._streams.items() if stream for name in (stream.name, endpoint_name(key))}
        missing = [name for name in self._selection.sensors if name not in found]
        if self._streams and missing:
            there = ", ".join(dict.fromkeys(map(endpoint_name, self._streams)))
            raise PacketError(f"{self._path}: no data packets of {missing[0]!r}; there are those of {there}")
        if self._window_ns != ALWAYS_NS and not any(stream.packets for stream in self._selected):
            raise PacketError(f"{self._path}: no LiDAR data packets in the window")
        if not self._streams:
            sizes = ", ".join(f"{n} of {size} bytes" for size, n in sorted(self._sources.other_sizes.items())[:5])
            datagrams = f"its UDP datagrams: {sizes}" if sizes else "no UDP datagrams at all"
            raise PacketError(f"{self._path}: no LiDAR data packets; {datagrams}")
