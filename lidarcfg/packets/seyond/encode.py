"""Encodes firings and their measurements as packets of blocks."""

import numpy as np

from lidarcfg.geometry import Array, Bytes, Flags
from lidarcfg.packets.seyond.layout import (
    CLOCKS,
    CONFIDENT,
    MAGIC,
    NORMAL,
    PACKET_BITS,
    ROBIN_W,
    TICK_NS,
    WORKING,
    BlockKind,
    Integers,
    Packets,
    bytes_of,
    crcs,
)
from lidarcfg.packets.seyond.model import MODES, SeyondUnit
from lidarcfg.sensors.firing import FiringBatch
from lidarcfg.sensors.rig import Clock, Mount


def encode(unit: SeyondUnit, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Packets:
    """Packets (P,) of N firings and their ranges and reflectivities (N, R). The second of two alike is left out."""
    kind = unit.kind
    count = unit.blocks_of(mount)
    frame = unit.packets_of(mount)
    returns = range_m.shape[1]
    packets: Packets = np.zeros(len(batch.number), kind.packet(unit.facts.packet.version[0], returns, count))
    time_ns = batch.firings.time_ns.reshape(len(packets), count, kind.channels)[:, :, 0]
    start_us = time_ns[:, 0] // 1000
    number = batch.number
    header = packets["header"]
    write_header(header, unit, mount.clock or "ptp", packets.itemsize)
    header["start_us"] = start_us
    header["frame"] = number // frame
    header["sub_frame"] = number % frame
    header["sequence"] = number % 65536
    header["item_size"] = packets.dtype["blocks"].base.itemsize
    for name, value in (
        *[("type", kind.type), ("count", count), ("reflectance", 1), ("returns", MODES[mount.return_mode])],
        *[("confidence", CONFIDENT), ("last_sub_frame", number % frame == frame - 1), ("last_sequence", 1)],
        *[("locked", 1), ("first_sub_frame", number % frame == 0)],
    ):
        PACKET_BITS[name].put(header, value)
    head = packets["blocks"]["head"]
    head["ticks"] = (time_ns - 1000 * start_us[:, None] + TICK_NS // 2) // TICK_NS
    _write_heads(unit, head, (number[:, None] * count + np.arange(count)) % len(unit.blocks.scan))
    shape = len(packets), count, kind.channels, returns
    distance = np.moveaxis(units_of(kind, range_m, unit.range.reported_m).reshape(shape), 3, 2)
    bright = np.moveaxis(reflectivity.reshape(shape), 3, 2)
    if returns == 2:
        alike = (distance[:, :, 0] == distance[:, :, 1]) & (bright[:, :, 0] == bright[:, :, 1])
        distance[:, :, 1][alike] = 0
    _write_points(kind, packets["blocks"]["points"], distance, bright)
    header["crc"] = crcs(bytes_of(packets))
    return packets


def write_header(header: Packets, unit: SeyondUnit, clock: Clock, size: int) -> None:
    """Write what all packets of a sensor say; these have `size` bytes."""
    facts = unit.facts.packet
    header["magic"] = MAGIC
    header["major"], header["minor"] = facts.version
    header["size"] = size
    PACKET_BITS["sync"].put(header, CLOCKS[clock])
    header["lidar"] = facts.lidar_type
    header["mode"] = WORKING
    header["status"] = NORMAL


def units_of(kind: BlockKind, range_m: Array, limits_m: tuple[float, float]) -> Integers:
    """Distances in units; 0 where a range is beyond the limits, or what a point can hold."""
    least_m, most_m = limits_m
    there = (range_m >= least_m) & (range_m <= most_m)
    units = np.rint(np.where(there, range_m, 0.0) * kind.units_per_m).astype(np.int64)
    return np.where(units < 1 << kind.point_bits["distance"].width, units, 0)


def sent(packets: Packets, kind: BlockKind) -> Flags:
    """(N, R) which ranges are returns in the packets."""
    distance = kind.point_bits["distance"].of(packets["blocks"]["points"])
    return np.asarray(np.moveaxis(distance, 2, 3).reshape(-1, distance.shape[2]) > 0)


def _write_heads(unit: SeyondUnit, head: Packets, block: Integers) -> None:
    """Write the heads (P, B) of blocks with these numbers in their frame, but for the time."""
    kind = unit.kind
    blocks = unit.blocks
    bits = kind.head_bits
    head["column"] = blocks.column[block]
    bits["scan"].put(head, blocks.scan[block])
    bits["facet"].put(head, blocks.facet[block])
    if kind is ROBIN_W:
        head["polygon"] = blocks.azimuth[block, 0] // 2
        return
    head["azimuth"] = blocks.azimuth[block, 0]
    head["elevation"] = blocks.elevation[block, 0]
    for k in range(1, kind.channels):
        bits[f"h{k}"].put(head, (blocks.azimuth[:, k] - blocks.azimuth[:, 0])[block])
        bits[f"v{k}"].put(head, (blocks.elevation[:, k] - blocks.elevation[:, 0] - kind.spacing * k)[block])


def _write_points(kind: BlockKind, points: Packets, distance: Integers, bright: Bytes) -> None:
    """Write the points (P, B, R, C), all zeros without return."""
    bits = kind.point_bits
    there = distance > 0
    bits["distance"].put(points, distance)
    bits["reflectivity"].put(points, bright.astype(np.int64) * kind.reflectivity_step * there)
    if "intensity" in (points.dtype.names or ()):
        points["intensity"] = points["reflectivity"]
    if "strong" in bits:
        bits["strong"].put(points, there)
    bits["second"].put(points, there & (np.arange(distance.shape[2]) == 1)[:, None])
