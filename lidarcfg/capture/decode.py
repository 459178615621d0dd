"""Point clouds from the data packets in a capture, ours or a real one."""

import os
import socket
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.capture.pcap import Datagrams, read_batches
from lidarcfg.capture.selection import ALL, ALWAYS_NS, Selection, around, window_ns
from lidarcfg.capture.stream import Source, SourceStats
from lidarcfg.cloud import PointCloud, concatenate
from lidarcfg.errors import ConfigError, LidarcfgError, PacketError
from lidarcfg.packets.velodyne.layout import PACKET
from lidarcfg.packets.velodyne.status import carried_beams
from lidarcfg.sensor import Beams, Sensor, Status, catalogue, load_sensor

if TYPE_CHECKING:
    from lidarcfg.rig import Rig

CHUNK_PACKETS = 1024
CARRIED_PACKETS = 3 * 4160  # a calibration in status bytes takes 4160 packets: one of three should be whole

Endpoint = tuple[str, int]  # the address that sends, and the port that it sends to
Job = Callable[[], PointCloud]


def decode_pcap(
    path: str | Path,
    on_warning: Callable[[str], None],
    rig: "Rig | None" = None,
    model: str | None = None,
    chunk_packets: int = CHUNK_PACKETS,
    on_stats: Callable[[SourceStats], None] | None = None,
    selection: Selection = ALL,
) -> Iterator[PointCloud]:
    """The capture's points in clouds of about `chunk_packets` packets; memory does not grow with its length.

    With a rig they are in the vehicle frame and the sensors are its mounts; without, each source (called
    host:port) is in its own sensor's frame, and `sensor_names` grows as sources appear. `model` overrides
    what the product id byte says. `on_warning` is told of a file that is cut off, `on_stats` at the end of each
    source. What is chosen comes as it does in the whole capture. Raises PacketError and ConfigError.
    """
    capture = _Capture(path, on_warning, rig, load_sensor(model) if model else None, selection)
    yield from _ahead(capture.jobs(chunk_packets))
    if on_stats:
        for source in capture.sources:
            if source.packets:
                on_stats(source.stats())


def _ahead(jobs: Iterator[Job]) -> Iterator[PointCloud]:
    """What the jobs give, in their order; while the first is waited for, the next are done as well."""
    threads = os.cpu_count() or 1
    waiting: deque[Future[PointCloud]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for job in jobs:
            waiting.append(pool.submit(job))
            del job  # if it is to raise an error, that one's traceback would hold it until the garbage is collected
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


class _Capture:
    """A capture that is being read: what its sources sent."""

    def __init__(
        self,
        path: str | Path,
        on_warning: Callable[[str], None],
        rig: "Rig | None",
        override: Sensor | None,
        selection: Selection,
    ) -> None:
        self._path, self._on_warning, self._rig, self._override, self._selection = (
            path,
            on_warning,
            rig,
            override,
            selection,
        )
        self._names = tuple(mount.name for mount in rig.mounts) if rig else ()
        self._known = cache(lambda: [load_sensor(name) for name in catalogue()])
        self._window_ns = window_ns(path, selection)
        self._others: Counter[int] = Counter()  # sizes of other datagrams
        self._endpoints: dict[Endpoint, Source | None] = {}  # none: passed over
        if rig:
            for name in selection.sensors:
                if not any(name in (mount.name, f"{mount.host}:{mount.data_port}") for mount in rig.mounts):
                    has = ", ".join(self._names)
                    raise ConfigError(f"no sensor of the rig {rig.name!r} is called {name!r}; allowed: {has}")

    @property
    def sources(self) -> list[Source]:
        """In the order of their appearance."""
        return [source for source in self._endpoints.values() if source]

    def jobs(self, chunk_packets: int) -> Iterator[Job]:
        """What is to be done of each so many packets. What goes wrong before one comes in its turn, as the last."""
        try:
            waiting = 0
            for batch in around(self._path, self._on_warning, self._window_ns):
                left = self._data(batch)
                while len(left.size):
                    some, left = left[: chunk_packets - waiting], left[chunk_packets - waiting :]
                    self._add(some)
                    waiting += len(some.size)
                    if waiting == chunk_packets:
                        yield self._job(last=False)
                        waiting = 0
            job = self._job(last=True)
            self._check_found()
            yield job
        except LidarcfgError as error:
            yield partial(_fail, error)

    def _data(self, batch: Datagrams) -> Datagrams:
        """Those of the size of data packets; the others are counted."""
        sized = batch.size == PACKET.itemsize
        self._others.update(batch.size[~sized].tolist())
        return batch[sized]

    def _add(self, some: Datagrams) -> None:
        """Hand the packets to their sources."""
        keys = some.host.astype(np.int64) << 16 | some.port
        for key in dict.fromkeys(keys.tolist()):
            endpoint = socket.inet_ntoa((key >> 16).to_bytes(4)), key & 0xFFFF
            if endpoint not in self._endpoints:
                self._endpoints[endpoint] = self._source(endpoint)
            if source := self._endpoints[endpoint]:
                mine = some[keys == key]
                source.add(mine.payloads(PACKET), mine.time_ns)

    def _job(self, last: bool) -> Job:
        """Decodes what all sources have, as one cloud. Raises PacketError, ConfigError."""
        jobs = [job for source in self.sources if (job := source.take(self._names, last))]
        return partial(_together, jobs, self._names)

    def _source(self, endpoint: Endpoint) -> Source | None:
        """A source that appears: with a rig the mount with its address and port; none if it is not wanted."""
        name, mounts = _name(endpoint), self._rig.mounts if self._rig else ()
        index = next((i for i, m in enumerate(mounts) if (m.host, m.data_port) == endpoint), None)
        if self._rig and index is None and not self._selection.sensors:
            has = ", ".join(f"{mount.host}:{mount.data_port}" for mount in mounts)
            raise PacketError(f"{self._path}: {name} is not in the rig {self._rig.name!r}; it has {has}")
        mount = None if index is None else mounts[index]
        if not self._selection.takes(name, mount.name if mount else name):
            return None
        if index is None:
            index = len(self._names)
            self._names = (*self._names, name)
        return Source(
            f"{self._path}: {name}",
            mount.name if mount else name,
            index,
            self._override or (mount.sensor if mount else None),
            mount.T_vehicle_sensor if mount else None,
            self._override is None,
            self._known,
            self._window_ns,
            partial(_carried, self._path, endpoint),
            self._on_warning,
        )

    def _check_found(self) -> None:
        """Raises PacketError if there is nothing, or nothing of what was chosen."""
        met = {name for key, source in self._endpoints.items() if source for name in (source.name, _name(key))}
        missing = [name for name in self._selection.sensors if name not in met]
        if self._endpoints and missing:
            there = ", ".join(map(_name, self._endpoints))
            raise PacketError(f"{self._path}: no data packets of {missing[0]!r}; there are those of {there}")
        if self._window_ns != ALWAYS_NS and not any(source.packets for source in self.sources):
            raise PacketError(f"{self._path}: no LiDAR data packets in the window")
        if not self._endpoints:
            sizes = ", ".join(f"{n} of {size} bytes" for size, n in sorted(self._others.items())[:5])
            found = f"its UDP datagrams: {sizes}" if sizes else "no UDP datagrams at all"
            raise PacketError(f"{self._path}: no LiDAR data packets of {PACKET.itemsize} bytes; {found}")


def _fail(error: LidarcfgError) -> PointCloud:
    try:
        raise error
    finally:
        del error  # else its traceback holds it, and the packets with it, until the garbage is collected


def _together(jobs: list[Job], names: tuple[str, ...]) -> PointCloud:
    """What the jobs give, as one cloud."""
    clouds = [job() for job in jobs]
    return clouds[0] if len(clouds) == 1 else concatenate([PointCloud.none(names), *clouds])


def _name(endpoint: Endpoint) -> str:
    return f"{endpoint[0]}:{endpoint[1]}"


def _carried(path: str | Path, endpoint: Endpoint, status: Status) -> tuple[Beams, str] | None:
    """The beams and mode of single returns that status bytes carry, in the packets of one source."""
    host, port = int.from_bytes(socket.inet_aton(endpoint[0])), endpoint[1]
    found, count = [], 0
    for batch in read_batches(path, lambda warning: None):
        mine = (batch.host == host) & (batch.port == port) & (batch.size == PACKET.itemsize)
        found.append(batch[mine].payloads(PACKET)[: CARRIED_PACKETS - count])
        count += len(found[-1])
        if count == CARRIED_PACKETS:
            break
    packets = np.concatenate(found)
    return carried_beams(status, packets["return_mode"], packets["product_id"])
