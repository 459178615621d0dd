"""Livox's point and inertial packets in plain loops, from Livox-SDK2's livox_lidar_def.h (08f523c) and its drivers.

`LivoxLidarEthernetPacket`, packed and little endian: 36 bytes, then the points. Angles and times of points are those of
livox_ros_driver2 (13eb05e, pub_handler.cpp). The CRC-32 covers the timestamp and the data (SDK2 wiki, Mid-360 protocol);
neither the SDK nor the driver checks it.
"""

import math
import struct
from typing import NamedTuple

HEADER = 36
SIZES = {0: 24, 1: 14, 2: 8, 3: 10}  # bytes of a point, or of the inertial measurement


class Point(NamedTuple):
    """One point as a packet says it."""

    x: float  # metres; of type 3 by the driver's formula
    y: float
    z: float
    reflectivity: int
    tag: int
    time_ns: int
    spherical: tuple[float, float, float] | None  # of type 3: depth in metres, zenith and azimuth in degrees


def crc32(data: bytes) -> int:
    """IEEE's, bit by bit."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def header(payload: bytes) -> dict[str, int]:
    """The fields before the points; asserts what they must be for the payload's length."""
    names = ["version", "length", "interval", "points", "count", "frame", "type", "time_type"]
    found = dict(zip(names, struct.unpack_from("<BHHHHBBB", payload), strict=True))
    found["crc"], found["stamp_ns"] = struct.unpack_from("<IQ", payload, 24)
    assert found["version"] == 0
    assert found["length"] == len(payload) == HEADER + found["points"] * SIZES[found["type"]]
    return found


def checks(payload: bytes) -> bool:
    """Whether the CRC is that of the timestamp and the data."""
    return header(payload)["crc"] == crc32(payload[28:])


def points(payload: bytes, first_to_last: bool = False) -> list[Point]:
    """Every point of a packet of type 1, 2 or 3, those without return (all zeros) as well.

    The header's interval, in 0.1 us, is divided by the number of points, as the driver does it. A Mid-360 was measured
    (livox-mid360-core) with 475 us in packets of 96 points that follow each other by 480: the interval is then the time
    from the first point to the last. `first_to_last` divides it so.
    """
    head = header(payload)
    count = head["points"]
    steps = max(count - first_to_last, 1)
    found = []
    for i in range(count):
        at = HEADER + i * SIZES[head["type"]]
        spherical = None
        if head["type"] == 1:  # millimetres
            x, y, z, reflectivity, tag = struct.unpack_from("<iiiBB", payload, at)
            x = x / 1000
            y = y / 1000
            z = z / 1000
        elif head["type"] == 2:  # centimetres
            x, y, z, reflectivity, tag = struct.unpack_from("<hhhBB", payload, at)
            x = x / 100
            y = y / 100
            z = z / 100
        else:
            assert head["type"] == 3
            depth_mm, theta, phi, reflectivity, tag = struct.unpack_from("<IHHBB", payload, at)
            spherical = depth_mm / 1000, theta / 100, phi / 100
            zenith = math.radians(theta / 100)
            azimuth = math.radians(phi / 100)
            x = depth_mm / 1000 * math.sin(zenith) * math.cos(azimuth)
            y = depth_mm / 1000 * math.sin(zenith) * math.sin(azimuth)
            z = depth_mm / 1000 * math.cos(zenith)
        time_ns = head["stamp_ns"] + i * head["interval"] * 100 // steps
        found.append(Point(x, y, z, reflectivity, tag, time_ns, spherical))
    return found


def inertial(payload: bytes) -> tuple[int, tuple[float, float, float], tuple[float, float, float]]:
    """The stamp in ns, rotation rates in rad/s and accelerations in g (units: SDK2 wiki) of a packet of type 0."""
    head = header(payload)
    assert (head["type"], head["points"]) == (0, 1)
    gx, gy, gz, ax, ay, az = struct.unpack_from("<6f", payload, HEADER)
    return head["stamp_ns"], (gx, gy, gz), (ax, ay, az)
