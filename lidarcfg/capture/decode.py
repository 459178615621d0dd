"""Point clouds from the data packets in a capture, ours or a real one."""

import os
import socket
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from glob import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.frames import Datagrams
from lidarcfg.capture.manifest import load_manifest, manifest_path, rig_file
from lidarcfg.capture.pcap import read_batches
from lidarcfg.capture.selection import ALL, ALWAYS_NS, Selection, around, window_ns
from lidarcfg.capture.stream import ENOUGH, OnHeads, Place, SourceStats, Stream
from lidarcfg.clouds.cloud import PointCloud, concatenate
from lidarcfg.errors import ConfigError, LidarcfgError, PacketError
from lidarcfg.futures import ordered_results
from lidarcfg.geometry import Bytes, Times
from lidarcfg.inputs import read_regular
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, Source
from lidarcfg.packets.families import FAMILIES, codec, family
from lidarcfg.packets.point_fields import asked
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.sensors.sensor import Sensor, catalogue, load_sensor

CHUNK_PACKETS = 1024
CHUNK_BYTES = 1 << 21  # of packets
SIDECAR_MAX = 64_000_000  # bytes of a file beside a capture
CLAIMED_BY = 3  # packets of a source, at most, that are examined to find its family

Job = Callable[[], PointCloud]
OnSource = Callable[[str, str], None]


@dataclass(frozen=True)
class Recorded:
    """All packets of one source, in the order of the capture."""

    name: str  # host:port, or the mount's
    source: Source
    sensor: Sensor
    packets: Bytes  # (P, size)
    host_ns: Times  # (P,)


@dataclass(frozen=True)
class DecodeMetadata:
    """What a reader gets of a capture besides its points."""

    on_heads: OnHeads | None = None  # called before each cloud with the heads' directions
    on_source: OnSource | None = None  # called with name and family of each source before its first cloud
    driver: bool = False  # whether clouds have the columns of the makers' ROS drivers


def decode_pcap(
    path: str | Path,
    on_warning: Callable[[str], None],
    rig: Rig | None = None,
    model: str | None = None,
    chunk_packets: int = CHUNK_PACKETS,
    on_stats: Callable[[SourceStats], None] | None = None,
    selection: Selection = ALL,
) -> Iterator[PointCloud]:
    """The capture's points in clouds of at most about `chunk_packets` packets; memory does not grow with its length.

    With a rig the points are in the vehicle frame and the sensors are its mounts. Without one the points of each source
    (called host:port) are in its sensor's frame, and `sensor_names` grows as sources appear. `model` overrides what the
    packets say. `on_warning` gets a line if the file is cut off, `on_stats` the figures of each source at the end. A
    selected part decodes exactly as it does within the whole capture. Raises PacketError and ConfigError.
    """
    capture = Capture(path, on_warning, rig, model, selection)
    yield from capture.clouds(chunk_packets)
    if on_stats:
        for stream in capture.streams:
            if stream.packets:
                on_stats(stream.stats())


def decode(
    path: str | Path,
    rig: Rig | str | Path | None = None,
    on_warning: Callable[[str], None] = print,
    deskew: bool = False,
) -> PointCloud:
    """All points of a capture as one cloud: in the rig's vehicle frame, or deskewed by its manifest in the world frame.

    Without a rig, that of the capture's manifest is used; without one, or with the rig "none", each point is in its
    sensor's own frame. Raises PacketError, also for a capture without points, and ConfigError.
    """
    path = Path(path)
    motion = load_manifest(path).motion(manifest_path(path)) if deskew else None
    if not isinstance(rig, Rig):
        file = rig_file(path, rig)
        rig = load_rig(file) if file else None
    if motion and not rig:
        raise ConfigError(f"{path}: deskewing needs the rig, which says where the sensors are on the vehicle")
    cloud = concatenate(list(decode_pcap(path, on_warning, rig)))
    return replace(cloud, xyz=motion.world(cloud.xyz, cloud.time_ns)) if motion else cloud


def _ahead(jobs: Iterator[Job]) -> Iterator[PointCloud]:
    """The results of the jobs in their order, computed on all cores."""
    threads = os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        yield from ordered_results(map(pool.submit, jobs), threads)


class Capture:
    """Reads a capture; gives more details than `decode_pcap`, which see."""

    def __init__(
        self,
        path: str | Path,
        on_warning: Callable[[str], None],
        rig: Rig | None = None,
        model: str | None = None,
        selection: Selection = ALL,
        details: DecodeMetadata | None = None,
    ) -> None:
        self._path = Path(path)
        self._on_warning = on_warning
        self._selection = selection
        self._details = details or DecodeMetadata()
        self._rig = rig
        self._override = load_sensor(model) if model else None
        self._names = tuple(mount.name for mount in rig.mounts) if rig else ()
        self._catalogue = cache(_catalogued)
        self._window_ns = window_ns(path, selection)
        self._others: Counter[int] = Counter()  # sizes of other datagrams
        self._families: dict[int, type[Codec] | None] = {}  # by host, port and size; None: not a LiDAR's
        self._streams: dict[int, Stream | None] = {}  # by the same; None: not selected
        if rig:
            for name in selection.sensors:
                if not any(name in (mount.name, f"{mount.host}:{mount.data_port}") for mount in rig.mounts):
                    has = ", ".join(self._names)
                    raise ConfigError(f"no sensor of the rig {rig.name!r} is called {name!r}; allowed: {has}")

    @property
    def streams(self) -> list[Stream]:
        """In the order of their appearance."""
        return [stream for stream in self._streams.values() if stream]

    def clouds(self, chunk_packets: int = CHUNK_PACKETS) -> Iterator[PointCloud]:
        """The points of at most about `chunk_packets` packets at a time; of fewer, if they are large."""
        return _ahead(self._jobs(chunk_packets))

    def sources(self) -> list[Recorded]:
        """The sources, each with all of its packets in memory, in the order of their appearance.

        Raises PacketError, ConfigError.
        """
        parts: dict[int, list[Datagrams]] = {}
        for batch in around(self._path, self._on_warning, self._window_ns):
            some, keys = self._claimed(batch)
            for key in dict.fromkeys(keys.tolist()):
                self._streams[key] = None
                parts.setdefault(key, []).append(some[keys == key])
        self._check_found()
        return [self._recorded(key, some) for key, some in parts.items()]

    def _recorded(self, key: int, some: list[Datagrams]) -> Recorded:
        packets = np.concatenate([one.payloads(int(one.size[0])) for one in some])
        host_ns = np.concatenate([one.time_ns for one in some])
        sensor, index = self._given(key)
        found = self._families[key]
        source = self._source(key)
        assert found
        if sensor is None:
            known = partial(self._catalogue, next(one for one in FAMILIES if family(one) is found))
            sensor = found.identify(source, packets[:ENOUGH], known)
        return Recorded(_name(key) if index is None else self._names[index], source, sensor, packets, host_ns)

    def _jobs(self, chunk_packets: int) -> Iterator[Job]:
        """What is to be done of each so many packets. An error is raised in the place of its job, as the last."""
        try:
            waiting = waiting_bytes = 0
            for batch in around(self._path, self._on_warning, self._window_ns):
                left, keys = self._claimed(batch)
                while len(left.size):
                    enough = int(np.searchsorted(np.cumsum(left.size), CHUNK_BYTES - waiting_bytes)) + 1
                    count = min(chunk_packets - waiting, enough)
                    self._add(left[:count], keys[:count])
                    waiting += len(keys[:count])
                    waiting_bytes += int(left.size[:count].sum())
                    left = left[count:]
                    keys = keys[count:]
                    if waiting == chunk_packets or waiting_bytes >= CHUNK_BYTES:
                        yield self._job(last=False)
                        waiting = waiting_bytes = 0
            job = self._job(last=True)
            self._check_found()
            for damaged in filter(None, (stream.damaged for stream in self.streams)):
                self._on_warning(damaged)
            yield job
        except LidarcfgError as error:
            yield partial(_fail, error)

    def _claimed(self, batch: Datagrams) -> tuple[Datagrams, NDArray[np.uint64]]:
        """The datagrams that hold a LiDAR's returns, each with a key of host, port and size; counts the others."""
        host, port, size = (column.astype(np.uint64) for column in (batch.host, batch.port, batch.size))
        keys = np.asarray(host << 32 | port << 16 | size, np.uint64)
        kinds, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
        if not self._families.keys() >= set(kinds.tolist()):
            order = np.argsort(inverse, kind="stable")
            ends = np.cumsum(counts)
            for key, count, end in zip(kinds.tolist(), counts.tolist(), ends.tolist(), strict=True):
                if key not in self._families:
                    rows = order[end - count : end][:CLAIMED_BY].tolist()  # the first may be damaged
                    payloads = (batch.data[batch.start[i] : batch.start[i] + batch.size[i]].tobytes() for i in rows)
                    self._families[key] = next(filter(None, (self._family(key, one) for one in payloads)), None)
        lidar = np.array([self._families[key] is not None for key in kinds.tolist()], np.bool_)[inverse]
        self._others.update(batch.size[~lidar].tolist())
        return batch[lidar], keys[lidar]

    def _family(self, key: int, payload: bytes) -> type[Codec] | None:
        """The family of a source: that of the given sensor, or the first that claims its packets; None if none does."""
        given = self._given(key)[0]
        families = [type(codec(given))] if given else map(family, FAMILIES)  # each loaded when it is its turn
        source = self._source(key)
        return next((one for one in families if one.matches(source, len(payload), payload)), None)

    def _add(self, some: Datagrams, keys: NDArray[np.uint64]) -> None:
        """Hand the packets to their streams."""
        for key in dict.fromkeys(keys.tolist()):
            if key not in self._streams:
                self._streams[key] = self._stream(key)
            if stream := self._streams[key]:
                mine = some[keys == key]
                stream.add(mine.payloads(int(mine.size[0])), mine.time_ns)

    def _job(self, last: bool) -> Job:
        """A job that decodes the packets of all streams into one cloud. Raises PacketError, ConfigError."""
        jobs = [job for stream in self.streams if (job := stream.take(self._names, last))]
        return partial(_together, jobs, self._names)

    def _given(self, key: int) -> tuple[Sensor | None, int | None]:
        """The sensor given for a source, by --model or by the rig, and the index of its mount; None if not given."""
        mounts = self._rig.mounts if self._rig else ()
        index = next((i for i, m in enumerate(mounts) if (m.host, m.data_port) == _endpoint(key)), None)
        return self._override or (None if index is None else mounts[index].sensor), index

    def _source(self, key: int) -> Source:
        host, port = _endpoint(key)
        return Source(
            where=f"{self._path}: {_name(key)}",
            host=host,
            port=port,
            sidecar_files=partial(_sidecar_files, self._path),
            payloads=partial(_payloads, self._path, host),
            on_warning=self._on_warning,
        )

    def _stream(self, key: int) -> Stream | None:
        """The stream of a new source: with a rig, of the mount at its address; None if the source is not selected."""
        name = _name(key)
        mounts = self._rig.mounts if self._rig else ()
        sensor, index = self._given(key)
        if self._rig and index is None and not self._selection.sensors:
            has = ", ".join(f"{mount.host}:{mount.data_port}" for mount in mounts)
            raise PacketError(f"{self._path}: {name} is not in the rig {self._rig.name!r}; it has {has}")
        mount = None if index is None else mounts[index]
        if not self._selection.takes(name, mount.name if mount else name):
            return None
        if index is None:
            index = len(self._names)
            self._names = (*self._names, name)
        place = Place(
            f"{self._path}: {name}",
            mount.name if mount else name,
            index,
            mount.T_vehicle_sensor if mount else None,
            self._window_ns,
        )
        found = self._families[key]
        assert found
        codec_name = next(one for one in FAMILIES if family(one) is found)
        details = self._details
        if details.on_source:
            details.on_source(place.name, codec_name)
        known = partial(self._catalogue, codec_name)
        opened = partial(_decoder, self._source(key), found, sensor, known, self._override is None)
        return Stream(place, opened, details.on_heads, asked(found.point_fields) if details.driver else ())

    def _check_found(self) -> None:
        """Raises PacketError if there is nothing, or nothing of what was selected."""
        found = {name for key, stream in self._streams.items() if stream for name in (stream.name, _name(key))}
        missing = [name for name in self._selection.sensors if name not in found]
        if self._streams and missing:
            there = ", ".join(dict.fromkeys(map(_name, self._streams)))
            raise PacketError(f"{self._path}: no data packets of {missing[0]!r}; there are those of {there}")
        if self._window_ns != ALWAYS_NS and not any(stream.packets for stream in self.streams):
            raise PacketError(f"{self._path}: no LiDAR data packets in the window")
        if not self._streams:
            sizes = ", ".join(f"{n} of {size} bytes" for size, n in sorted(self._others.items())[:5])
            datagrams = f"its UDP datagrams: {sizes}" if sizes else "no UDP datagrams at all"
            raise PacketError(f"{self._path}: no LiDAR data packets; {datagrams}")


def _catalogued(codec: str, name: str | None = None) -> list[Sensor]:
    """The catalogue's sensors with this codec, or that of this name, if it has this codec."""
    return [load_sensor(one) for one in catalogue(codec) if name in (None, one)]


def _decoder(
    source: Source, found: type[Codec], sensor: Sensor | None, known: KnownSensors, trusted: bool, packets: Bytes
) -> Decoder:
    """The decoder for a source that begins with these packets. Raises PacketError, ConfigError."""
    return codec(sensor or found.identify(source, packets, known)).decoder(source, packets, known, trusted)


def _fail(error: LidarcfgError) -> PointCloud:
    try:
        raise error
    finally:
        del error  # its traceback refers to it, which keeps the packets in memory until the next garbage collection


def _together(jobs: list[Job], names: tuple[str, ...]) -> PointCloud:
    """What the jobs give, as one cloud."""
    clouds = [job() for job in jobs]
    return clouds[0] if len(clouds) == 1 else concatenate([PointCloud.none(names), *clouds])


def _endpoint(key: int) -> tuple[str, int]:
    """A source's address, and the port that it sends to."""
    return socket.inet_ntoa((key >> 32).to_bytes(4)), key >> 16 & 0xFFFF


def _name(key: int) -> str:
    host, port = _endpoint(key)
    return f"{host}:{port}"


def _sidecar_files(path: Path, suffix: str) -> Mapping[str, bytes]:
    """The files beside a capture NAME.pcap that match NAME, NAME-* or NAME.*, followed by `suffix`."""
    stem = escape(path.stem)
    end = escape(suffix)
    found = {file for between in ("", "-*", ".*") for file in path.parent.glob(stem + between + end)}
    try:
        return {str(one): read_regular(one, SIDECAR_MAX) for one in sorted(found)}
    except OSError as error:
        raise PacketError.from_os(error.filename, error) from None


def _payloads(path: Path, host: str, port: int | None, size: int) -> Iterator[Bytes]:
    """All payloads of one size that a host sends to a port, or to any port."""
    number = int.from_bytes(socket.inet_aton(host))
    for batch in read_batches(path, lambda warning: None):
        mine = (batch.host == number) & (batch.size == size)
        yield batch[mine if port is None else mine & (batch.port == port)].payloads(size)
