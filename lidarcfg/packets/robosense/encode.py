"""Encodes firings and their measurements as MSOP packets."""

import numpy as np

from lidarcfg.geometry import Array, Bytes, Flags
from lidarcfg.packets.blocks import by_packet
from lidarcfg.packets.robosense.layout import (
    BLOCK_ID,
    MSOP_ID,
    MSOP_TAIL,
    RADIANS,
    REVOLUTION,
    Packets,
    bytes_of,
    write_time,
)
from lidarcfg.packets.robosense.model import RobosenseUnit, byte_offsets, slot_numbers
from lidarcfg.sensors.firing import FiringBatch


def encode(unit: RobosenseUnit, dual: bool, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Packets:
    """Packets (P,) of N firings and their measurements, (N, 1) or with dual returns (N, 2): see `Codec.encode`."""
    schedule = unit.firing_schedule(dual)
    series = unit.series
    fired = batch.firings
    stamped_ns, _ = schedule.stamps_ns(fired)
    packets: Packets = np.zeros(len(stamped_ns), series.msop)
    packets["id"] = MSOP_ID
    packets["version"] = 1
    packets["tail"] = MSOP_TAIL
    packets["count"] = batch.number % series.counts
    packets["kind"] = series.kinds[dual]
    packets["type"] = series.lidar_type
    packets["model"] = unit.facts.packet.model
    write_time(packets, stamped_ns)
    blocks = packets["blocks"]
    blocks["id"] = BLOCK_ID
    azimuth = np.rint(schedule.head_rad(fired) / RADIANS).astype(np.int64) % REVOLUTION
    blocks["azimuth"] = np.repeat(azimuth, blocks.shape[1] // azimuth.shape[1], axis=1)
    limits = *unit.range.reported_m, unit.resolution_m, float(series.distance_max)
    measured = by_packet(range_m, len(packets), np.float64), by_packet(reflectivity, len(packets), np.uint8)
    number = np.argsort(slot_numbers(unit, dual))
    series.write_returns(*measured, number, np.zeros(len(number)), limits, bytes_of(packets))
    return packets


def sent(unit: RobosenseUnit, dual: bool, data: Bytes) -> Flags:
    """(N, 1) or (N, 2): which are returns in the packets; of two equal ones, only the first."""
    at = byte_offsets(unit, dual)
    high, low, intensity = (data[:, at + byte].reshape(-1, 1 + dual) for byte in range(3))
    found: Flags = (high | low) != 0
    if dual:
        found[:, 1] &= (high[:, 0] != high[:, 1]) | (low[:, 0] != low[:, 1]) | (intensity[:, 0] != intensity[:, 1])
    return found
