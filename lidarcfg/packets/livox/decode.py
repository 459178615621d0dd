"""Decodes packets of points. They hold coordinates, so no angles are needed, and the model only to number the lines."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics
from lidarcfg.packets.livox.encode import DEGREES, returns
from lidarcfg.packets.livox.layout import (
    HEADER,
    INTERVAL_NS,
    NUMBERS,
    UNITS_PER_M,
    VERSION,
    DataType,
    Packets,
    crcs,
    headers_of,
    offsets_ns,
    packet_of,
    point_size,
)
from lidarcfg.packets.livox.model import LivoxUnit
from lidarcfg.packets.loss import PacketLossCounter, missing_numbers
from lidarcfg.sensors.firing import STRONGEST

RESTART = 2**15  # a counter that jumps further was reset


class LivoxDecoder(Decoder):
    """Decodes the packets of one Livox."""

    def __init__(self, where: str, unit: LivoxUnit, kind: DataType, points: int) -> None:
        self._where = where
        self._unit = unit
        self._kind = kind
        self._points = points
        self._packet = packet_of(kind, points)
        self._losses = PacketLossCounter()
        self.period_ns = round(unit.firing_ns * points)

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        return stamps_ns(headers_of(packets))

    def heading_rad(self, packets: Bytes) -> Array:
        """(P,) the phase in a frame; frames begin at multiples of their length, as in livox_ros_driver2."""
        frame_ns = self._unit.sensor.pattern.frame_ns
        return np.asarray(np.mod(stamps_ns(headers_of(packets)), frame_ns) * (2 * math.pi / frame_ns))

    def check(self, packets: Bytes) -> None:
        check(self._where, packets, self._kind)

    def sound(self, packets: Bytes) -> Flags:
        return sound(packets, self._kind)

    def count(self, packets: Bytes, wanted: Flags) -> None:
        number: Times = headers_of(packets)["count"].astype(np.int64)
        self._losses.add(missing_numbers(number, NUMBERS, RESTART), wanted)

    def statistics(self) -> DecodeStatistics:
        return DecodeStatistics((self._unit.name,), ("strongest",), self._losses.lost, math.nan)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        return decode(self._wanted(packets, wanted), self._kind, self._unit.count)

    def driver_columns(self, packets: Bytes, wanted: Flags) -> Mapping[str, NDArray[Any]]:
        points = self._wanted(packets, wanted)["points"]
        return {"tag": points["tag"][returns(points, self._kind)]}

    def _wanted(self, packets: Bytes, wanted: Flags) -> Packets:
        some = packets if wanted.all() else packets[wanted]
        found: Packets = np.ascontiguousarray(some).view(self._packet)[:, 0]
        return found


def decode(packets: Packets, kind: DataType, lines: int) -> DecodedReturns:
    """The returns in packets (P,), from a sensor with this many lasers, which fire in turn."""
    points = packets["points"]
    rows = returns(points, kind)
    everything = bool(rows.all())
    units = UNITS_PER_M[kind]
    count = rows.size if everything else int(np.count_nonzero(rows))
    line = np.broadcast_to((np.arange(points.shape[1]) % lines).astype(np.uint8), points.shape)

    def column(values: NDArray[Any]) -> NDArray[Any]:
        return values.ravel() if everything else values[rows]

    xyz_m = np.empty((count, 3))
    if kind == DataType.SPHERICAL:
        depth_m = column(points["depth"]) / units
        zenith = column(points["zenith"]) / DEGREES
        azimuth = column(points["azimuth"]) / DEGREES
        flat_m = depth_m * maths.sin(zenith)
        np.multiply(flat_m, maths.cos(azimuth), out=xyz_m[:, 0])
        np.multiply(flat_m, maths.sin(azimuth), out=xyz_m[:, 1])
        np.multiply(depth_m, maths.cos(zenith), out=xyz_m[:, 2])
    else:
        for i, axis in enumerate("xyz"):
            np.divide(column(points[axis]), units, out=xyz_m[:, i])
    return DecodedReturns(
        xyz_m=xyz_m,
        range_m=np.empty(0),
        azimuth_rad=np.empty(0),
        time_ns=column(point_times_ns(packets)),
        laser=column(line),
        ring=column(line),
        intensity=column(points["reflectivity"]),
        return_type=np.full(count, STRONGEST, np.uint8),
    )


def point_times_ns(packets: Packets) -> Times:
    """(P, points) when each point of packets (P,) is measured."""
    header = packets["header"]
    interval = header["interval"].astype(np.int64)
    points = packets["points"].shape[1]
    if len(interval) and (interval == interval[0]).all():
        interval = interval[:1]
    return np.asarray(stamps_ns(header)[:, None] + offsets_ns(interval, points))


def stamps_ns(headers: Packets) -> Times:
    """(P,) the times of packets; those beyond the range of int64 become its last value but for an hour."""
    latest = np.uint64(2**63 - 3600 * 10**9)
    return np.asarray(np.minimum(headers["time_ns"], latest), np.int64)


def check(where: str, data: Bytes, kind: DataType) -> None:
    """Raises PacketError unless all of these packets (P, size) hold points of one kind, and their CRCs are right."""
    headers = headers_of(data)
    for what, key, allowed in (("version", "version", VERSION), ("data type", "type", kind)):
        wrong = headers[key] != allowed
        if wrong.any():
            raise PacketError(f"{where} sends {what} {headers[key][wrong][0]}, and {allowed}; one is allowed")
    if not sound(data, kind).all():
        raise PacketError(f"{where} sends packets whose length, number of points or CRC is wrong")


def sound(data: Bytes, kind: DataType) -> Flags:
    """(P,) which packets hold points of this kind, as many as fit, with a right CRC if they have one.

    A Mid-360 sends 0 instead of the CRC of points.
    """
    headers = headers_of(data)
    size = data.shape[1]
    points = (size - HEADER.itemsize) // point_size(kind)
    good = (headers["version"] == VERSION) & (headers["type"] == kind)
    good &= (headers["length"] == size) & (headers["points"] == points)
    said = np.flatnonzero(headers["crc"])
    if len(said):
        good[said] &= headers["crc"][said] == crcs(data[said])
    return np.asarray(good)


def points_of(where: str, data: Bytes) -> tuple[DataType, int]:
    """What most of these packets (P, size) hold, and how many points each. Raises PacketError."""
    kinds, counts = np.unique(headers_of(data)["type"], return_counts=True)
    kind = int(kinds[counts.argmax()])
    if not point_size(kind):
        what = "pairs of returns (data type 0x11)" if kind == DataType.PAIRS else f"data type 0x{kind:02X}"
        raise PacketError(f"{where} sends {what}; allowed: 1, 2, 3")
    points, rest = divmod(data.shape[1] - HEADER.itemsize, point_size(kind))
    if rest or not points:
        raise PacketError(f"{where} sends {data.shape[1]} bytes, which are no whole points of data type {kind}")
    return DataType(kind), points


def identify(data: Bytes, known: Sequence[LivoxUnit]) -> LivoxUnit:
    """Which of the known sensors sends these packets (P, size): the one that fires at the rate nearest to theirs."""
    headers = headers_of(data)
    steps = np.maximum(headers["points"].astype(np.float64) - 1, 1)
    step_ns = max(float(np.median(headers["interval"].astype(np.float64) * INTERVAL_NS / steps)), 1.0)
    return min(known, key=lambda unit: max(step_ns / unit.firing_ns, unit.firing_ns / step_ns))
