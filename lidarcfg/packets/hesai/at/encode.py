"""Encodes firings and their measurements as packets, with checksums."""

import numpy as np

from lidarcfg.core import packets as core
from lidarcfg.geometry import Array, Bytes
from lidarcfg.packets.hesai.at.layout import AZIMUTH_BYTES, E2E, SIGNATURE, seconds_of, write_angles
from lidarcfg.packets.hesai.at.model import HesaiAtUnit
from lidarcfg.packets.hesai.layout import (
    DISTANCE_MAX,
    FACTORY,
    FIRST_LAST,
    HEADER,
    RETURN_MODE_CODES,
    SEQUENCE,
    START,
    Packets,
    bytes_of,
    return_bytes,
)
from lidarcfg.packets.hesai.model import held
from lidarcfg.sensors.firing import FiringBatch
from lidarcfg.sensors.rig import Mount
from lidarcfg.units import SECOND_NS


def encode(unit: HesaiAtUnit, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Packets:
    """Packets (P,) of a batch and what it measured, (N, 1) or with dual returns (N, 2): as `Codec.encode` says."""
    dual = mount.dual
    facts = unit.facts.packet
    groups = unit.groups(dual)
    packets: Packets = np.zeros(len(batch.number), unit.dtype)
    columns = unit.columns
    column = (batch.number[:, None] * groups + np.arange(groups)) % len(columns.angle)
    angle = np.repeat(columns.angle[column], 1 + dual, axis=1)
    write_angles(packets, angle)
    packets["blocks"]["returns"]["confidence"] = facts.confidence
    firings = len(packets), groups * unit.count
    core.write_hesai_returns(
        np.ascontiguousarray(range_m, np.float64).reshape(*firings, 1 + dual),
        np.ascontiguousarray(reflectivity).reshape(*firings, 1 + dual),
        np.ascontiguousarray(batch.firings.laser).reshape(firings),
        np.array(held(facts.pairs, mount.return_mode) * groups, np.int64),
        np.ones((len(packets), groups), np.bool_),
        (*unit.range.reported_m, unit.resolution_m, float(DISTANCE_MAX)),
        unit.count,
        return_bytes(unit.dtype),
        AZIMUTH_BYTES,
        bytes_of(packets),
    )
    _head(unit, packets, dual)
    time_ns = batch.firings.time_ns.reshape(len(packets), groups, unit.count)[:, -1, 0]
    offset_ns = unit.offset_ns.min(axis=1)[columns.facet[column[:, -1]]]
    stamp_ns = (time_ns - offset_ns - facts.stamp_ns + 500) // 1000 * 1000
    tail = packets["tail"]
    if facts.protocol == "4.7":
        tail["frame"] = columns.facet[column[:, 0]]
    tail["speed"] = facts.speed
    tail["microseconds"] = stamp_ns % SECOND_NS // 1000
    tail["return_mode"] = RETURN_MODE_CODES[mount.return_mode]
    tail["factory"] = FACTORY
    tail["date"] = seconds_of(stamp_ns)
    if facts.flags & SEQUENCE:
        packets["sequence"] = batch.number
    write_checksums(packets, batch.number)
    return packets


def _head(unit: HesaiAtUnit, packets: Packets, dual: bool) -> None:
    header = packets["header"]
    facts = unit.facts.packet
    header["start"] = START
    header["major"], header["minor"] = map(int, facts.protocol.split("."))
    header["lasers"] = unit.count
    header["blocks"] = facts.blocks
    header["unit_mm"] = unit.unit_mm
    header["first_return"] = FIRST_LAST * dual
    header["returns"] = 1 + dual
    header["flags"] = facts.flags


def write_checksums(packets: Packets, number: np.ndarray) -> None:
    """Write the checksums of packets (P,): of the body, and of the tail or, in protocol 4.7, of all before it."""
    fields = packets.dtype.fields
    assert fields
    data = bytes_of(packets)
    at = {key: value[1] for key, value in fields.items()}
    packets["body_crc"] = core.crc32_mpeg2(data, HEADER.itemsize, at["body_crc"])
    if "tail_crc" in at:
        packets["tail_crc"] = core.crc32_mpeg2(data, at["tail"], at["tail_crc"])
        return
    end = at["e2e"] + E2E.itemsize
    packets["e2e"]["length"] = end + SIGNATURE * ("signature" in at)
    packets["e2e"]["counter"] = number % 2**16
    packets["e2e"]["crc"] = core.crc32_mpeg2(data, 0, end - 4)
