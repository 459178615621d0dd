"""Encodes firings and their measurements as packets of points."""

import numpy as np

from lidarcfg import maths
from lidarcfg.geometry import Array, Bytes, Flags
from lidarcfg.packets.livox.layout import (
    HUNDREDTHS,
    INTERVAL_NS,
    TIME_TYPES,
    UNITS_PER_M,
    VERSION,
    DataType,
    Packets,
    packet_of,
)
from lidarcfg.packets.livox.model import LivoxUnit
from lidarcfg.sensors.firing import FiringBatch, Firings
from lidarcfg.sensors.rig import Clock

DEGREES = 18000 / np.pi  # hundredths of one in a radian


def encode(
    unit: LivoxUnit, kind: DataType, clock: Clock, batch: FiringBatch, range_m: Array, reflectivity: Bytes
) -> Packets:
    """Packets (P,) of N firings and their ranges and reflectivities (N,). A point without return is all zeros."""
    facts = unit.facts.packet
    packets: Packets = np.zeros(len(batch.number), packet_of(kind, facts.points))
    time_ns = batch.firings.time_ns.reshape(-1, facts.points)
    header = packets["header"]
    header["version"] = VERSION
    header["length"] = packets.itemsize
    header["interval"] = (time_ns[:, -1] - time_ns[:, 0] + INTERVAL_NS // 2) // INTERVAL_NS
    header["points"] = facts.points
    header["count"] = batch.number % 2**16
    header["type"] = kind
    header["time_type"] = TIME_TYPES[clock]
    header["time_ns"] = time_ns[:, 0]
    least_m, most_m = unit.range.reported_m
    there = (range_m >= least_m) & (range_m <= most_m)
    write_points(packets, kind, batch.firings, np.where(there, range_m, 0.0), reflectivity, facts.tag)
    return packets


def write_points(
    packets: Packets, kind: DataType, fired: Firings, range_m: Array, reflectivity: Bytes, tag: int
) -> None:
    """Write the points of firings with ranges (N,), which are 0 where there is no return.

    What the kind of points cannot hold is no return either. The sensor's y axis is to the left, azimuths are clockwise.
    """
    points = packets["points"]
    shape = points.shape
    length = range_m * UNITS_PER_M[kind]
    most = 2**32 - 1 if kind == DataType.SPHERICAL else np.iinfo(points.dtype["x"]).max
    there = (length >= 1) & (length <= most)
    if not there.all():
        length = np.where(there, length, 0.0)
    if kind == DataType.SPHERICAL:
        zenith = np.rint(HUNDREDTHS / 4 - fired.elevation_rad * DEGREES)
        points["depth"] = np.rint(length).reshape(shape)
        points["zenith"] = (zenith * there).reshape(shape)
        points["azimuth"] = (np.rint(-fired.encoder_rad * DEGREES) % HUNDREDTHS * there).reshape(shape)
    else:
        flat = length * maths.cos(fired.elevation_rad)
        points["x"] = np.rint(flat * maths.cos(fired.encoder_rad)).reshape(shape)
        points["y"] = np.rint(-flat * maths.sin(fired.encoder_rad)).reshape(shape)
        points["z"] = np.rint(length * maths.sin(fired.elevation_rad)).reshape(shape)
    points["reflectivity"] = (reflectivity * there).reshape(shape)
    points["tag"] = (np.uint8(tag) * there).reshape(shape) if np.any(tag) else 0


def sent(packets: Packets, kind: DataType) -> Flags:
    """(N, 1) which points are returns."""
    return returns(packets["points"], kind).reshape(-1, 1)


def returns(points: Packets, kind: DataType) -> Flags:
    """Which points, of any shape, are returns: those that are not at the origin."""
    if kind == DataType.SPHERICAL:
        return np.asarray(points["depth"] != 0)
    return np.asarray((points["x"] | points["y"] | points["z"]) != 0)
