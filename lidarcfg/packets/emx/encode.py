"""Encodes firings and their measurements as MSOP packets."""

import numpy as np

from lidarcfg.geometry import Array, Bytes, Flags
from lidarcfg.packets.emx.layout import (
    DISTANCE_MAX,
    MODES,
    MSOP,
    MSOP_ID,
    NORMAL,
    ROWS,
    SURFACES,
    YAW,
    Packets,
    write_time,
)
from lidarcfg.packets.emx.model import EmxUnit
from lidarcfg.sensors.firing import FiringBatch
from lidarcfg.units import SECOND_NS

E2E_NUMBERS = 2**16


def encode(unit: EmxUnit, mode: str, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Packets:
    """Packets (P,) of N firings and their measurements, (N, 1) or pairs (N, 2): the nearer return, then the farther."""
    count = len(batch.number)
    parts = range_m.shape[1]
    packets: Packets = np.zeros(count, MSOP)
    number = batch.number % (unit.columns * parts)
    packets["id"] = MSOP_ID
    packets["number"] = number + 1
    packets["return_mode"] = MODES[mode]
    packets["clock"] = unit.facts.packet.clock
    write_time(packets, batch.firings.time_ns[:: ROWS // parts])
    packets["frame_rate"] = SECOND_NS // unit.sensor.pattern.frame_ns
    packets["column"] = number // parts
    packets["yaw"] = np.rint(-np.degrees(batch.firings.encoder_rad[:: ROWS // parts]) * YAW)
    packets["surface"] = batch.number // (unit.columns * parts) % SURFACES
    packets["type"] = unit.facts.packet.type
    packets["length"] = MSOP.itemsize
    packets["number_sent"] = batch.number % E2E_NUMBERS
    least_m, most_m = unit.range.reported_m
    units = np.rint(range_m / unit.resolution_m)
    there = (range_m >= least_m) & (range_m <= most_m) & (units >= 1) & (units <= DISTANCE_MAX)
    points = packets["points"]
    points["distance"] = np.where(there, units, 0).reshape(count, ROWS)
    points["intensity"] = (reflectivity * there).reshape(count, ROWS)
    points["attribute"] = (NORMAL * there).reshape(count, ROWS)
    return packets


def sent(packets: Packets, parts: int) -> Flags:
    """(N, 1) or (N, 2): which are returns in the packets; of two equal ones, only the first."""
    points = packets["points"].reshape(-1, parts)
    found: Flags = points["distance"] != 0
    if parts == 2:
        found[:, 1] &= points["distance"][:, 0] != points["distance"][:, 1]
    return found
