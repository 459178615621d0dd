"""A capture cut into revolutions: the points of one sensor while its head turns once."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.decode import decode_chunks
from lidarcfg.capture.reader import CHUNK_PACKETS, CaptureReader
from lidarcfg.capture.stream import Packets
from lidarcfg.clouds.cloud import PointCloud, concatenate
from lidarcfg.geometry import Array, Times
from lidarcfg.sensors.rig import Rig

BACK_RAD = math.radians(1)  # a drop of the azimuth by more means that the head has passed 0
LATE_NS = 10**8  # a packet later than this was not overtaken; instead, the clock was set back
LONGEST_NS = 10**9  # a head that does not turn makes no revolutions


def revolutions(
    path: Path,
    on_warning: Callable[[str], None],
    rig: Rig | None = None,
    model: str | None = None,
    chunk_packets: int = CHUNK_PACKETS,
    on_source: Callable[[str, str], None] = lambda name, family: None,
    driver: bool = False,
) -> Iterator[PointCloud]:
    """The points of each revolution, in its sensor's frame, in the order in which they end; memory is bounded.

    A revolution begins with the first packet whose azimuth has passed 0, as velodyne_driver has it (a VLS-128's lasers
    that fire up to 8.7 us before the packet's stamp end the one before), and is no longer than a second.
    `on_source` is called with name and family of each source before its first revolution. With `driver`, clouds also
    have the columns that the makers' ROS drivers publish. Raises PacketError and ConfigError.
    """
    if rig:
        own = tuple(replace(mount, position_m=(0.0, 0.0, 0.0), rpy_rad=(0.0, 0.0, 0.0)) for mount in rig.mounts)
        rig = replace(rig, mounts=own)
    heads: dict[int, Head] = defaultdict(Head)

    def observed() -> Iterator[list[Packets]]:
        for chunk in CaptureReader(path, on_warning, rig, model).chunks(chunk_packets):
            for packets in chunk:
                sensor = packets.sensor
                if sensor.index not in heads:
                    on_source(sensor.name, sensor.family)
                heading_rad = packets.decoder.heading_rad(packets.data[packets.wanted])
                heads[sensor.index].add(packets.device_ns[packets.wanted], heading_rad)
            yield chunk

    begun: dict[int, list[PointCloud]] = {}
    numbers: dict[int, int] = {}
    for cloud in decode_chunks(observed(), driver):
        for i in np.unique(cloud.sensor).tolist():
            mine = _rows(cloud, cloud.sensor == i, cloud.sensor_names[i])
            number = np.searchsorted(np.unique(heads[i].starts_ns), mine.time_ns, side="right")
            edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
            for first, last in pairwise(edges):
                if i in begun and numbers[i] != number[first]:
                    yield concatenate(begun.pop(i))
                begun.setdefault(i, []).append(_rows(mine, slice(first, last), cloud.sensor_names[i]))
                numbers[i] = int(number[first])
    for i in sorted(begun, key=lambda i: int(begun[i][-1].time_ns[-1])):
        yield concatenate(begun[i])


def _rows(cloud: PointCloud, rows: slice | NDArray[np.bool_], name: str) -> PointCloud:
    """Some of the cloud's points, all of the sensor of this name."""
    some = cloud.rows(rows)
    return replace(some, sensor_names=(name,), sensor=np.zeros(len(some.xyz), np.uint16))


class Head:
    """The last direction of a sensor's head, and the device times at which its revolutions began."""

    def __init__(self) -> None:
        self.starts_ns: list[int] = []
        self._azimuth_rad = 0.0
        self._time_ns = -LATE_NS

    def add(self, time_ns: Times, azimuth_rad: Array) -> None:
        """Add the head's directions at the start of the next packets (n,)."""
        for at_rad, at_ns in zip(azimuth_rad.tolist(), time_ns.tolist(), strict=True):
            if self._time_ns - LATE_NS < at_ns <= self._time_ns:
                continue  # came too late to be put in order
            begins = not self.starts_ns or at_rad < self._azimuth_rad - BACK_RAD
            if begins or not 0 <= at_ns - self.starts_ns[-1] < LONGEST_NS:
                self.starts_ns.append(at_ns)
            self._azimuth_rad = at_rad
            self._time_ns = at_ns
