"""Encodes firings and their measurements as packets; of protocols 3.2 and 1.4 with functional safety and checksums."""

import numpy as np

from lidarcfg.core import packets as core
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.hesai.layout import (
    DISTANCE_MAX,
    FACTORY,
    FIRST_LAST,
    HEADER,
    RETURN_MODE_CODES,
    SAFETY,
    START,
    Packets,
    azimuth_of,
    azimuth_state_of,
    bytes_of,
    date_of,
    device_time_ns,
    return_bytes,
)
from lidarcfg.packets.hesai.model import HesaiUnit, head_rad, within
from lidarcfg.sensors.firing import FiringBatch
from lidarcfg.sensors.rig import Mount
from lidarcfg.units import SECOND_NS

COLUMNS = ("time_ns", "laser", "encoder_rad")
VERSION = 1
COUNTER_NS = 5_111_060  # the rolling counter's step, 46 periods, as recorded
COUNTERS = 6  # its values 0 to 5
TICK_NS = 25  # of the inertial measurements' clock: udp_protocol_v1_4.h
UNITS = 122, 763  # of accelerations, 1e-6 g; of rates, 1e-5 degrees a second: 4 g and 250 degrees a second, a guess
MOTION_MAX = 32767


def encode(unit: HesaiUnit, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Packets:
    """Packets (P,) of a batch and what it measured, (N, 1) or with dual returns (N, 2): as `Codec.encode` says."""
    dual = mount.dual
    pair = unit.columns(mount.return_mode)
    packets = np.zeros(len(batch.number), unit.dtype)
    shape = len(packets), unit.groups(dual), unit.lasers.shape[1]
    time_ns, laser, encoder_rad = (getattr(batch.firings, key).reshape(shape) for key in COLUMNS)
    loop = _loops(unit, laser) if batch.loop is None else batch.loop
    head = head_rad(unit, mount, loop, laser[:, :, 0], encoder_rad[:, :, 0])
    inside = within(mount, head)
    blocks = packets["blocks"]
    facts = unit.range
    blocks["azimuth"] = np.repeat(azimuth_of(head), 1 + dual, axis=1)
    returns = blocks["returns"]
    if unit.facts.packet.protocol != "1.4":
        returns["confidence"] = unit.facts.packet.confidence
    column = np.array(pair * shape[1], np.int64)
    limits = *facts.reported_m, unit.resolution_m, float(DISTANCE_MAX)
    firings = len(packets), shape[1] * shape[2]
    core.write_hesai_returns(
        np.ascontiguousarray(range_m, np.float64).reshape(*firings, 1 + dual),
        np.ascontiguousarray(reflectivity).reshape(*firings, 1 + dual),
        np.ascontiguousarray(laser).reshape(firings),
        column,
        inside,
        limits,
        unit.count,
        return_bytes(unit.dtype),
        bytes_of(packets),
    )
    first = laser[:, -1, 0]
    stamp_ns = time_ns[:, -1, 0] - unit.offset_ns[loop[:, -1], first] - unit.facts.firing.stamp_ns
    stamp_ns = (stamp_ns + 500) // 1000 * 1000
    _head(unit, packets, dual)
    tail = packets["tail"]
    tail["return_mode"] = RETURN_MODE_CODES[mount.return_mode]
    tail["rpm"] = round(mount.rpm / unit.facts.packet.speed_unit_rpm)
    tail["factory"] = FACTORY
    tail["date"] = date_of(stamp_ns)
    tail["microseconds"] = stamp_ns % SECOND_NS // 1000
    tail["sequence"] = batch.number
    if unit.facts.packet.protocol == "3.2":
        if len(unit.fires) > 1:
            packets["mode_flag"] = 1 - loop[:, 0]  # with single returns too Hesai's SDK takes the first loop from it
        write_safety(packets, stamp_ns)
    elif unit.facts.packet.protocol == "1.4":
        packets["azimuth_state"] = azimuth_state_of(np.repeat(loop, 1 + dual, axis=1))
        packets["operational_state"] = unit.operational_state
        write_safety(packets, stamp_ns)
    return packets


def write_inertial(packets: Packets, acceleration_g: Array, rate_deg_s: Array) -> None:
    """Write measurements (P, 3) at the stamps of packets (P,), then the checksum."""
    inertial = packets["imu"]
    inertial["units"] = UNITS
    inertial["ticks"] = device_time_ns(packets) // TICK_NS % 2**32
    motion = np.concatenate([acceleration_g * (1e6 / UNITS[0]), rate_deg_s * (1e5 / UNITS[1])], axis=1)
    inertial["motion"] = np.clip(np.rint(motion), -MOTION_MAX, MOTION_MAX)
    _write_tail_checksum(packets)


def sent(unit: HesaiUnit, packets: Packets, return_mode: str, laser: Bytes) -> Flags:
    """(N, 1) or (N, 2) of firings of `laser` (N,): which are returns in the packets; of two alike, the first."""
    returns = packets["blocks"]["returns"]
    pair = unit.columns(return_mode)
    at = laser.reshape(len(packets), unit.groups(len(pair) == 2), -1).astype(np.int64)
    distance, reflectivity = (
        np.stack(
            [
                np.take_along_axis(returns[:, i :: len(pair)][key], at, axis=2).ravel()
                for i in np.argsort(pair).tolist()
            ],
            axis=-1,
        )
        for key in ("distance", "reflectivity")
    )
    found: Flags = distance > 0
    if len(pair) == 2:
        found[:, 1] &= (distance[:, 0] != distance[:, 1]) | (reflectivity[:, 0] != reflectivity[:, 1])
    return found


def holds_one(unit: HesaiUnit, range_m: Array, reflectivity: Bytes) -> Flags:
    """(N,): which pairs of ranges (N, 2) hold a single return, once or twice."""
    least_m, most_m = unit.range.reported_m
    inside = (range_m >= least_m) & (range_m <= most_m)
    units = np.rint(np.where(inside, range_m, 0) / unit.range.resolution_m)
    same = (units[:, 0] == units[:, 1]) & (reflectivity[:, 0] == reflectivity[:, 1])
    return np.asarray(same | ~inside.all(axis=1))


def fired_ns(unit: HesaiUnit, batch: FiringBatch, range_m: Array) -> Times:
    """(N, R): when the firings of ranges (N, R) were; near returns may come from a separate firing."""
    firings = batch.firings
    time_ns = np.broadcast_to(firings.time_ns[:, None], range_m.shape)
    if unit.facts.firing.near is None or batch.loop is None:
        return time_ns
    later_ns = (unit.near_ns - unit.offset_ns)[np.repeat(batch.loop.ravel(), unit.lasers.shape[1]), firings.laser]
    is_near = np.rint(range_m / unit.resolution_m) * unit.resolution_m < unit.near_m
    return np.where(is_near, time_ns + later_ns[:, None], time_ns)


def _head(unit: HesaiUnit, packets: Packets, dual: bool) -> None:
    header = packets["header"]
    protocol = unit.facts.packet.protocol
    header["start"] = START
    header["model"] = unit.facts.packet.header_model
    header["flags"] = unit.facts.packet.header_flags
    header["major"], header["minor"] = map(int, protocol.split("."))
    header["lasers"] = unit.count
    header["blocks"] = unit.facts.packet.blocks
    header["unit_mm"] = unit.unit_mm
    header["first_return"] = FIRST_LAST * dual
    header["returns"] = 1 + dual


def _loops(unit: HesaiUnit, laser: Bytes) -> Times:
    """(P, G): which loop's lasers (P, G, F) fire."""
    if len(unit.fires) == 1:
        return np.zeros(laser.shape[:2], np.int64)
    only = int(np.argmax(unit.fires[1] & ~unit.fires[0]))
    return np.asarray((laser == only).any(axis=2), np.int64)


def write_safety(packets: Packets, stamp_ns: Times) -> None:
    """Write the functional safety of packets (P,) without a fault, then the checksums. `stamp_ns` is (P,)."""
    assert packets.dtype.names
    if "safety" in packets.dtype.names:
        safety = packets["safety"]
        safety["version"] = VERSION
        safety["state"] = stamp_ns // COUNTER_NS % COUNTERS
    write_checksums(packets)


def write_checksums(packets: Packets) -> None:
    """Write the checksums of packets (P,): body, functional safety without its version if there is any, and tail."""
    fields = packets.dtype.fields
    assert fields
    data = bytes_of(packets)
    at = {key: value[1] for key, value in fields.items()}
    packets["body_crc"] = core.crc32_mpeg2(data, HEADER.itemsize, at["body_crc"])
    if "safety" in at:
        end = at["safety"] + SAFETY.itemsize - 4
        packets["safety"]["crc"] = core.crc32_mpeg2(data, at["safety"] + 1, end)
    _write_tail_checksum(packets)


def _write_tail_checksum(packets: Packets) -> None:
    assert packets.dtype.fields
    begin, end = (packets.dtype.fields[key][1] for key in ("status", "tail_crc"))
    packets["tail_crc"] = core.crc32_mpeg2(bytes_of(packets), begin, end)
