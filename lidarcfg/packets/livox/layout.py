"""Livox's packets, byte by byte: points in one of three kinds, and inertial measurements.

Layout: Livox-SDK2 (08f523c), include/livox_lidar_def.h. What the CRC covers and the units of inertial measurements: the
Mid-360's protocol in Livox's wiki, livox-wiki-en.readthedocs.io. All is little endian.
"""

import zlib
from enum import IntEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Bytes, Times
from lidarcfg.sensors.rig import Clock


class DataType(IntEnum):
    """What a packet holds."""

    INERTIAL = 0
    CARTESIAN_MM = 1
    CARTESIAN_CM = 2
    SPHERICAL = 3  # depth in mm, zenith angle and azimuth in hundredths of a degree
    PAIRS = 0x11  # two returns of each firing, by newer firmware


Packets = NDArray[np.void]
PTP = 1  # the clock's source
TIME_TYPES: dict[Clock, int] = {"free": 0, "ptp": PTP, "gps": 2}
VERSION = 0
HEADER = np.dtype(
    [
        *[("version", "u1"), ("length", "<u2"), ("interval", "<u2"), ("points", "<u2"), ("count", "<u2")],
        *[("frame", "u1"), ("type", "u1"), ("time_type", "u1"), ("reserved", "u1", (12,)), ("crc", "<u4")],
        ("time_ns", "<u8"),
    ]
)
CHECKED = HEADER.itemsize - 8  # where the bytes begin that the CRC covers: the time and all behind it
INTERVAL_NS = 100  # the unit of the header's interval
LOOK = [("reflectivity", "u1"), ("tag", "u1")]
POINT = {
    DataType.CARTESIAN_MM: np.dtype([*[(axis, "<i4") for axis in "xyz"], *LOOK]),
    DataType.CARTESIAN_CM: np.dtype([*[(axis, "<i2") for axis in "xyz"], *LOOK]),
    DataType.SPHERICAL: np.dtype([("depth", "<u4"), ("zenith", "<u2"), ("azimuth", "<u2"), *LOOK]),
}
UNITS_PER_M = {DataType.CARTESIAN_MM: 1000, DataType.CARTESIAN_CM: 100, DataType.SPHERICAL: 1000}
HUNDREDTHS = 36000  # of a degree, all around
INERTIAL = np.dtype([("header", HEADER), ("rate_rad_s", "<f4", (3,)), ("acceleration_g", "<f4", (3,))])


@cache
def packet_of(kind: DataType, points: int) -> np.dtype[np.void]:
    """A packet of this many points."""
    return np.dtype([("header", HEADER), ("points", POINT[kind], (points,))])


def is_points(size: int, payload: bytes) -> bool:
    """Whether a payload of this size has a header of points, and their number fits its size."""
    if size < HEADER.itemsize or len(payload) < HEADER.itemsize:
        return False
    head = np.frombuffer(payload, HEADER, 1)[0]
    kind = int(head["type"])
    if head["version"] != VERSION or head["length"] != size or not head["points"]:
        return False
    each = 2 * POINT[DataType.CARTESIAN_MM].itemsize if kind == DataType.PAIRS else point_size(kind)
    return each > 0 and HEADER.itemsize + int(head["points"]) * each == size


def point_size(kind: int) -> int:
    """The bytes of a point; 0 if it is of none of the three kinds."""
    return POINT[DataType(kind)].itemsize if kind in set(POINT) else 0


def headers_of(data: Bytes) -> Packets:
    """(P,) the headers of packets (P, size), in the same memory."""
    data = np.ascontiguousarray(data)
    return np.ndarray(len(data), HEADER, data, strides=data.strides[:1])


def bytes_of(packets: Packets) -> Bytes:
    """(P, size) bytes of packets (P,), in the same memory."""
    return packets.view(np.uint8).reshape(len(packets), packets.itemsize)


def crcs(data: Bytes) -> NDArray[np.uint32]:
    """(P,) the CRC-32 of each packet's time and contents."""
    return np.array([zlib.crc32(row) for row in np.ascontiguousarray(data[:, CHECKED:])], np.uint32)


def offsets_ns(interval: Times, points: int) -> Times:
    """(P, points) when each point is measured after its packet's time.

    The interval is from the first point to the last: a Mid-360 was measured to say 475 us in packets of 96 points every
    480 us. livox_ros_driver2 divides it by the number of points; its last one is 5 us early.
    """
    return np.asarray(interval[:, None] * INTERVAL_NS * np.arange(points) // max(points - 1, 1))
