"""Reads a capture: the packets of its LiDARs, chunk by chunk, those of each sensor in the order of its clock."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.ethernet import Datagrams
from lidarcfg.capture.selection import ALL, ALWAYS_NS, Selection, read_window, window_ns
from lidarcfg.capture.source_finder import Flow, SourceFinder
from lidarcfg.capture.stream import CapturedSensor, Packets, SourceStats, Stream
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.sensors.rig import Rig

CHUNK_PACKETS = 1024
CHUNK_BYTES = 1 << 21  # of packets
SENSORS_MAX = 10_000  # of a capture that are decoded together; each takes memory and time of its own


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
        sidecars: Sequence[str | Path] = (),
    ) -> None:
        self._path = Path(path)
        self._on_warning = on_warning
        self._rig = rig
        self._selection = selection
        self._window_ns = window_ns(path, selection)
        self._sources = SourceFinder(self._path, on_warning, rig, model, driver_view, sidecars)
        self._streams: dict[Flow, Stream | None] = {}  # in the order of their appearance; None: not selected
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
            left, numbers = self._sources.lidar(batch)
            while len(left.size):
                enough = int(np.searchsorted(np.cumsum(left.size), CHUNK_BYTES - waiting_bytes)) + 1
                count = min(chunk_packets - waiting, enough)
                self._add(left[:count], numbers[:count])
                waiting += len(numbers[:count])
                waiting_bytes += int(left.size[:count].sum())
                left = left[count:]
                numbers = numbers[count:]
                if waiting == chunk_packets or waiting_bytes >= CHUNK_BYTES:
                    if chunk := self._take(last=False):
                        yield chunk
                    waiting = 0
                    waiting_bytes = 0
        chunk = self._take(last=True)
        for warning in chain(self._sources.strangers, self._sources.unread):
            self._on_warning(warning)
        self._check_found()
        for stream in self._selected:
            if stream.damaged:
                self._on_warning(stream.damaged)
        yield chunk

    def stats(self) -> list[SourceStats]:
        """The statistics of all sources that packets were read from."""
        return [stream.stats() for stream in self._selected if stream.packets]

    def _datagrams(self) -> Iterator[Datagrams]:
        return read_window(self._path, self._on_warning, self._window_ns)

    @property
    def _selected(self) -> list[Stream]:
        return [stream for stream in self._streams.values() if stream]

    def _add(self, datagrams: Datagrams, numbers: NDArray[np.intp]) -> None:
        """Hand the packets to the streams of their flows."""
        for flow, mine in self._sources.by_flow(numbers):
            if flow not in self._streams:
                self._streams[flow] = self._stream(flow)
            if stream := self._streams[flow]:
                stream.add(datagrams[mine].payloads(flow.size), datagrams.time_ns[mine])

    def _take(self, last: bool) -> list[Packets]:
        """The packets that each stream can release now."""
        streams = [stream for stream in self._selected if last or stream.fresh]
        return [packets for stream in streams if (packets := stream.take(self._sensor_names, last))]

    def _stream(self, flow: Flow) -> Stream | None:
        """The stream of a new flow: with a rig, of the mount at its address; None if the flow is not selected."""
        name = flow.name
        index, mount = self._sources.mount(flow)
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
        sensor = CapturedSensor(
            where=f"{self._path}: {name}",
            name=mount.name if mount else name,
            family=self._sources.family_of(flow),
            index=index,
            T_vehicle_sensor=mount.T_vehicle_sensor if mount else None,
        )
        return Stream(sensor, self._window_ns, partial(self._sources.decoder, flow))

    def _check_found(self) -> None:
        """Raises PacketError if there is nothing, or nothing of what was selected."""
        found = {name for flow, stream in self._streams.items() if stream for name in (stream.name, flow.name)}
        missing = [name for name in self._selection.sensors if name not in found]
        if self._streams and missing:
            there = ", ".join(dict.fromkeys(flow.name for flow in self._streams))
            raise PacketError(f"{self._path}: no data packets of {missing[0]!r}; there are those of {there}")
        if self._window_ns != ALWAYS_NS and not any(stream.packets for stream in self._selected):
            raise PacketError(f"{self._path}: no LiDAR data packets in the window")
        if not self._streams:
            sizes = ", ".join(f"{n} of {size} bytes" for size, n in sorted(self._sources.other_sizes.items())[:5])
            datagrams = f"its UDP datagrams: {sizes}" if sizes else "no UDP datagrams at all"
            raise PacketError(f"{self._path}: no LiDAR data packets; {datagrams}")
