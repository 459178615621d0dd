"""A capture by sensor and turn of the head."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.decode import Endpoint, decode_pcap
from lidarcfg.capture.pcap import Datagram, read_datagrams
from lidarcfg.cloud import FIELDS, PointCloud, concatenate
from lidarcfg.packets.firing import Times
from lidarcfg.packets.velodyne.layout import PACKET, device_time_ns
from lidarcfg.rig import Rig

CHUNK_PACKETS = 1024
BACK = 100  # hundredths of a degree: the head has passed 0 where the azimuth falls by more
LATE_NS = 10**8  # a packet later than that was not overtaken: the clock was set back
LONGEST_NS = 10**9  # a head that stands still makes no turns


def turns(
    path: Path, on_warning: Callable[[str], None], rig: Rig | None = None, model: str | None = None
) -> Iterator[PointCloud]:
    """The points of each sensor's turns in the sensor's own frame, as they end; memory does not grow with the length.

    A turn begins with the first packet whose azimuth has passed 0, as velodyne_driver cuts them (a VLS-128's lasers
    that fire up to 8.7 us before the packet's stamp end the turn before), and is no longer than a second.
    Raises what `decode_pcap` does.
    """
    starts = turn_starts(path)
    if rig:
        endpoints = {mount.name: (mount.host, mount.data_port) for mount in rig.mounts}
        still = tuple(replace(mount, position_m=(0.0, 0.0, 0.0), rpy_rad=(0.0, 0.0, 0.0)) for mount in rig.mounts)
        rig = replace(rig, mounts=still)
    else:
        endpoints = {f"{host}:{port}": (host, port) for host, port in starts}
    begun: dict[str, list[PointCloud]] = {}
    numbers: dict[str, int] = {}
    for cloud in decode_pcap(path, on_warning, rig, model):
        for i in np.unique(cloud.sensor).tolist():
            name = cloud.sensor_names[i]
            mine = _rows(cloud, cloud.sensor == i, name)
            number = np.searchsorted(starts[endpoints[name]], mine.time_ns, side="right")
            edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
            for first, last in pairwise(edges):
                if name in begun and numbers[name] != number[first]:
                    yield concatenate(begun.pop(name))
                begun.setdefault(name, []).append(_rows(mine, slice(first, last), name))
                numbers[name] = int(number[first])
    for name in sorted(begun, key=lambda name: int(begun[name][-1].time_ns[-1])):
        yield concatenate(begun[name])


def _rows(cloud: PointCloud, rows: slice | NDArray[np.bool_], name: str) -> PointCloud:
    """Some of the cloud's points, all of the sensor of this name."""
    columns = {key: getattr(cloud, key)[rows] for key in FIELDS}
    return PointCloud(sensor_names=(name,), **columns | {"sensor": np.zeros(len(columns["xyz"]), np.uint16)})


def turn_starts(path: Path) -> dict[Endpoint, Times]:
    """When each source's turns begin: device times, ascending."""
    waiting: dict[Endpoint, list[Datagram]] = defaultdict(list)
    sources: dict[Endpoint, _Head] = defaultdict(_Head)
    for datagram in read_datagrams(path, lambda warning: None):
        if len(datagram.payload) == PACKET.itemsize:
            endpoint = datagram.host, datagram.port
            waiting[endpoint].append(datagram)
            if len(waiting[endpoint]) == CHUNK_PACKETS:
                sources[endpoint].add(waiting.pop(endpoint))
    for endpoint, datagrams in waiting.items():
        sources[endpoint].add(datagrams)
    return {endpoint: np.unique(np.array(head.starts_ns, np.int64)) for endpoint, head in sources.items()}


class _Head:
    """Where one sensor's head was last, and when its turns began."""

    def __init__(self) -> None:
        self.starts_ns: list[int] = []
        self._azimuth, self._time_ns = 0, -LATE_NS

    def add(self, datagrams: list[Datagram]) -> None:
        """More packets, as they came."""
        packets = np.frombuffer(b"".join(datagram.payload for datagram in datagrams), PACKET)
        host_ns = np.array([datagram.time_ns for datagram in datagrams], np.int64)
        times_ns = device_time_ns(packets["stamp_us"], host_ns).tolist()
        for azimuth, time_ns in zip(packets["blocks"]["azimuth"][:, 0].tolist(), times_ns, strict=True):
            if self._time_ns - LATE_NS < time_ns <= self._time_ns:
                continue  # was overtaken, or is a double
            begins = not self.starts_ns or azimuth < self._azimuth - BACK
            if begins or not 0 <= time_ns - self.starts_ns[-1] < LONGEST_NS:
                self.starts_ns.append(time_ns)
            self._azimuth, self._time_ns = azimuth, time_ns
