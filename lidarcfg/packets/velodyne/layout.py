"""Velodyne's packets: 1206 bytes of returns, 512 bytes of position; encode and decode side by side.

Layout: VLP-16 User Manual 63-9243 Rev D, sections 9.3 and 9.4; what differs between models comes from the
sensor's YAML.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets.firing import (
    Firings,
    Times,
    firing_facts,
    head_offset_ns,
    packet_offsets_ns,
    packet_period_ns,
    packet_stamps_ns,
)
from lidarcfg.packets.velodyne import decode_kernels as kernels
from lidarcfg.packets.velodyne.status import calibration, status_bytes
from lidarcfg.sensor import BLOCKS, SLOTS, Packet, Range, Sensor
from lidarcfg.units import HOUR_NS

if TYPE_CHECKING:
    from lidarcfg.rig import PpsState

RETURN = np.dtype([("distance", "<u2"), ("intensity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("returns", RETURN, (SLOTS,))])
PACKET = np.dtype([("blocks", BLOCK, (BLOCKS,)), ("stamp_us", "<u4"), ("return_mode", "u1"), ("product_id", "u1")])
POSITION = np.dtype(
    {
        "names": ["stamp_us", "pps", "nmea"],
        "formats": ["<u4", "u1", "S128"],
        "offsets": [198, 202, 206],
        "itemsize": 512,
    }
)

TURN = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
DISTANCE_MAX = 65535  # units; 0 is no return
RETURNS = ("strongest", "last")  # the last axis of dual returns
HOUR_US = 3600 * 10**6
PPS_STATES: tuple["PpsState", ...] = ("absent", "synchronising", "locked", "error")
KNOT_M_S = 1852 / 3600

Packets = NDArray[np.void]


@dataclass(frozen=True)
class Returns:
    """What the packets hold: one entry a return, in the order of the packets."""

    xyz_m: Array  # (N, 3) in the sensor frame
    range_m: Array  # (N,) along the beam, or empty
    azimuth_rad: Array  # (N,) of the beam, or empty
    time_ns: Times  # (N,) device time
    laser: NDArray[np.uint8]  # (N,)
    ring: NDArray[np.uint8]  # (N,) 0 is the lowest beam
    intensity: NDArray[np.uint8]  # (N,)
    return_type: NDArray[np.uint8]  # (N,) 0 strongest, 1 last, 2 second strongest, where the last is the strongest


def encode(
    sensor: Sensor,
    return_mode: str,
    firings: Firings,
    range_m: Array,
    reflectivity: NDArray[np.uint8],
    pps: "PpsState" = "locked",
) -> Packets:
    """Packets (P,) of firings and what they met: range (P, S, L) in metres (inf: nothing), reflectivity.

    With dual returns both are (P, S, L, 2): strongest (or second strongest, if the last is the strongest) and
    last, equal where there is one return only. What the sensor does not measure, or the packet cannot say, is no
    return. Distances and intensities are those of which decoding makes the nearest there are. Raises ConfigError.
    """
    from lidarcfg.packets.velodyne import encode_kernels  # which decoding can do without

    check_encodable(sensor, return_mode)
    firing, facts = firing_facts(sensor)
    dual = return_mode == "dual"
    number, span = slots(facts, dual), _span(facts, dual)
    first_laser = int(np.argmin(firing.offset_ns))
    head = firings.azimuth_rad[:, :: facts.sequences_per_block, first_laser]
    packets = np.zeros(len(range_m), PACKET)
    blocks = packets["blocks"][:, : len(number)]
    blocks["flag"] = np.tile(_flags(facts, dual), len(number) // span)
    blocks["azimuth"] = np.repeat(np.rint(head / RADIANS).astype(np.int64) % TURN, span, axis=1)
    laser, limits = number // (1 + dual) % sensor.count, _limits(sensor)
    seen = _flat(range_m, len(packets)), _flat(reflectivity, len(packets))
    returns = blocks["returns"]["distance"], blocks["returns"]["intensity"]
    encode_kernels.fill(*seen, number, sensor.distance_offset_m[laser], limits, *returns)
    if sensor.near_offset_m is not None:
        azimuth = _flat(firings.azimuth_rad, len(packets))
        tables = sensor.elevation_rad, sensor.azimuth_offset_rad, sensor.lateral_offset_m, sensor.distance_offset_m
        encode_kernels.fill_near(*seen, azimuth, number, laser, (*tables, sensor.near_offset_m), limits, *returns)
    if sensor.focal is not None:
        encode_kernels.unfocus(returns[0], laser, sensor.focal, returns[1])
    stamps_ns, _ = packet_stamps_ns(sensor, firings)
    packets["stamp_us"] = stamp_us(stamps_ns)
    if facts.return_modes:
        packets["return_mode"] = getattr(facts.return_modes, return_mode)
        packets["product_id"] = facts.product_id
    elif facts.status:
        types, values = status_bytes(sensor, facts.status, return_mode, pps, stamps_ns, packet_period_ns(sensor, dual))
        packets["return_mode"], packets["product_id"] = types, values
    return packets


def sent_returns(sensor: Sensor, return_mode: str, packets: Packets) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """Distances in units, 0 for no return, and intensities that the packets (P,) say of their N firings in all.

    Both (N, 1), or (N, 2) with dual returns, in the order of what is encoded.
    """
    dual = return_mode == "dual"
    number = slots(firing_facts(sensor)[1], dual)
    order, said = np.argsort(number, axis=None), packets["blocks"]["returns"][:, : len(number)]
    distance, intensity = (
        said[key].reshape(len(packets), -1).take(order, axis=1).reshape(-1, 1 + dual)
        for key in ("distance", "intensity")
    )
    return distance, intensity


def check_encodable(sensor: Sensor, return_mode: str) -> None:
    """Raises ConfigError unless packets can say the sensor's returns in this mode, and its calibration."""
    _, facts = firing_facts(sensor)
    if return_mode == "dual" and facts.dual is None:
        raise ConfigError(f"sensor {sensor.name!r} has no dual returns")
    if facts.status:
        calibration(sensor, facts.status, return_mode)


def _limits(sensor: Sensor) -> tuple[float, float, float, float]:
    """What is measured, from and to, in metres; the packet's unit; and how many of them it can say."""
    facts = range_facts(sensor)
    return facts.min_m, facts.max_m, facts.resolution_m, float(DISTANCE_MAX)


def _span(facts: Packet, dual: bool) -> int:
    """How many blocks hold one block's time of all lasers."""
    return len(facts.block_flags) * (1 + dual)


def _flags(facts: Packet, dual: bool) -> tuple[int, ...]:
    """The flags of those blocks."""
    if dual and facts.dual and facts.dual.by == "block":
        return tuple(flag for flag in facts.block_flags for _ in range(2))
    return facts.block_flags * (1 + dual)


def slots(facts: Packet, dual: bool) -> NDArray[np.int64]:
    """(blocks, 32): which number of a packet's (S, L) firings, or (S, L, 2) returns, stands in each slot.

    Blocks at the end that are not used are left out.
    """
    times, groups = BLOCKS // _span(facts, dual), len(facts.block_flags)
    numbers = np.arange(times * groups * SLOTS * (1 + dual)).reshape(times, groups, SLOTS, 1 + dual)
    if dual and facts.dual:
        numbers = numbers[..., [RETURNS.index(name) for name in facts.dual.order]]
        numbers = np.moveaxis(numbers, -1, 2 if facts.dual.by == "block" else 1)
    return numbers.reshape(-1, SLOTS)


def is_dual(facts: Packet, packets: Packets) -> NDArray[np.bool_]:
    """(P,) whether each packet holds dual returns: it says so or, where it cannot, repeats its azimuths."""
    if facts.return_modes:
        return np.asarray(packets["return_mode"] == facts.return_modes.dual)
    azimuth, groups = packets["blocks"]["azimuth"], len(facts.block_flags)
    if facts.dual is None or 2 * groups >= BLOCKS:
        return np.zeros(len(packets), np.bool_)
    return np.asarray((azimuth[:, 0] == azimuth[:, groups]) & (azimuth[:, 0] != azimuth[:, 2 * groups]))


def decode(
    sensor: Sensor,
    packets: Packets,
    host_time_ns: Times,
    wanted: NDArray[np.bool_] | None = None,
    polar: bool = True,
) -> Returns:
    """The returns of one sensor's successive packets (P,), or of those that are wanted (P,).

    The others only say how the head turns before and after. Without `polar`, ranges and azimuths are left empty.
    Raises PacketError, ConfigError.
    """
    _, facts = firing_facts(sensor)
    if facts.return_modes:
        allowed = facts.return_modes.strongest, facts.return_modes.last, facts.return_modes.dual
        modes = packets["return_mode"]
        known = one_of(modes, allowed if facts.dual else allowed[:2])
        _check(modes, known, f"{sensor.name}: return mode", allowed)
    dual = is_dual(facts, packets)
    wanted = np.ones(len(packets), np.bool_) if wanted is None else wanted
    edges = [0, *(np.flatnonzero(np.diff(dual)) + 1).tolist(), len(packets)]
    runs = []
    for start, stop in pairwise(edges):
        run = slice(start, stop)
        runs.append(_decode(sensor, packets[run], host_time_ns[run], wanted[run], bool(dual[start:].any()), polar))
    if len(runs) == 1:
        return runs[0]
    return Returns(**{f.name: np.concatenate([getattr(r, f.name) for r in runs]) for f in fields(Returns)})


def _decode(
    sensor: Sensor, packets: Packets, host_time_ns: Times, wanted: NDArray[np.bool_], dual: bool, polar: bool
) -> Returns:
    """The same of packets that are all dual, or all not."""
    firing, facts = firing_facts(sensor)
    order, span = slots(facts, dual), _span(facts, dual)
    used = packets["blocks"][:, : len(order)]
    flags = np.tile(_flags(facts, dual), len(order) // span)
    _check(used["flag"], used["flag"] == flags, f"not a packet of {sensor.name}: block flag", facts.block_flags)

    tables, lasers = _tables(sensor, dual)
    group_ns = facts.sequences_per_block * firing.sequence_ns
    azimuth = np.ascontiguousarray(used["azimuth"][:, ::span], np.int64)
    stamp = packets["stamp_us"].astype(np.int64)
    turn, late_ns = kernels.turning(azimuth, stamp, packet_period_ns(sensor, dual), group_ns)

    distance, intensity = (_read_only(used["returns"][key]) for key in ("distance", "intensity"))
    modes = facts.return_modes
    size = kernels.count(distance, wanted)
    out = Returns(
        xyz_m=np.empty((size, 3)),
        range_m=np.empty(size if polar else 0),
        azimuth_rad=np.empty(size if polar else 0),
        time_ns=np.empty(size, np.int64),
        laser=np.empty(size, np.uint8),
        ring=np.empty(size, np.uint8),
        intensity=np.empty(size, np.uint8),
        return_type=np.empty(size, np.uint8),
    )
    count = kernels.points(
        distance,
        intensity,
        azimuth,
        turn,
        late_ns,
        device_time_ns(packets["stamp_us"], host_time_ns),
        packets["return_mode"] == modes.last if modes else np.zeros(len(packets), np.bool_),
        wanted,
        tables,
        lasers,
        range_facts(sensor).resolution_m,
        kernels.Columns(*(getattr(out, field.name) for field in fields(out))),
    )
    return Returns(*(getattr(out, field.name)[:count] for field in fields(out)))


@lru_cache
def _tables(sensor: Sensor, dual: bool) -> tuple[kernels.Slots, kernels.Lasers]:
    """What the kernels know of a packet's slots, and of the lasers."""
    firing, facts = firing_facts(sensor)
    numbers, width = slots(facts, dual).ravel(), _span(facts, dual) * SLOTS
    fired, group = numbers // (1 + dual), np.arange(numbers.size) // width
    offset_ns = packet_offsets_ns(sensor, dual).ravel()[fired]
    group_ns = facts.sequences_per_block * firing.sequence_ns
    other = np.full(width, -1)
    if dual:
        pairs = np.argsort(numbers[:width]).reshape(-1, 2)
        other[pairs] = pairs[:, ::-1]
    near, focal = sensor.near_offset_m, sensor.focal
    slots_of_packet = kernels.Slots(
        laser=fired[:width] % sensor.count,
        share=(offset_ns - head_offset_ns(sensor)) / group_ns - group,
        offset_ns=offset_ns,
        kind=(numbers[:width] % (1 + dual)).astype(np.uint8),
        other=other,
    )
    lasers = kernels.Lasers(
        sensor.elevation_rad,
        sensor.azimuth_offset_rad,
        sensor.lateral_offset_m,
        sensor.vertical_offset_m,
        sensor.distance_offset_m,
        sensor.ring.astype(np.uint8),  # packets have no more beams
        np.empty((0, 2)) if near is None else near,
        np.empty((0, 4)) if focal is None else focal,
    )
    return slots_of_packet, lasers


def _read_only(field: NDArray[Any]) -> NDArray[Any]:
    """The same, of one kind wherever it comes from: kernels are compiled for each kind of array."""
    view = field.view()
    view.flags.writeable = False
    return view


def one_of(values: NDArray[np.integer], allowed: Sequence[int]) -> NDArray[np.bool_]:
    """(n,) whether each of the values (n,) is one of a few."""
    return np.asarray(np.logical_or.reduce([values == one for one in allowed]))


def _flat(values: NDArray[Any], rows: int) -> NDArray[Any]:
    """(rows, …) as a matrix, for the kernels."""
    return _read_only(np.ascontiguousarray(values).reshape(rows, -1))


def _check(got: NDArray[np.integer], right: NDArray[np.bool_], what: str, allowed: tuple[int, ...]) -> None:
    if not right.all():
        raise PacketError(f"{what} 0x{got[~right][0]:02X}; allowed: {', '.join(f'0x{n:02X}' for n in allowed)}")


def range_facts(sensor: Sensor) -> Range:
    """The sensor's range limits and resolution. Raises ConfigError if it is for placement only."""
    if sensor.range is None:
        raise ConfigError(f"sensor {sensor.name!r} is for placement only: it has no range facts")
    return sensor.range


def stamp_us(time_ns: Times) -> Times:
    """Device time as packets say it: microseconds past the hour, rounded."""
    return np.asarray((time_ns + 500) // 1000 % HOUR_US)


def device_time_ns(stamp_us: NDArray[np.uint32], host_time_ns: Times) -> Times:
    """Device time since 1970 from stamps past the hour: the hour that brings them nearest to host time."""
    past_hour = stamp_us.astype(np.int64) * 1000
    return past_hour + (host_time_ns - past_hour + HOUR_NS // 2) // HOUR_NS * HOUR_NS


def position_packets(time_ns: Times, pps: "PpsState", sentences: Sequence[bytes]) -> NDArray[np.void]:
    """The position packets (n,) of these times (n,), each with an NMEA sentence."""
    packets = np.zeros(len(time_ns), POSITION)
    packets["stamp_us"] = stamp_us(time_ns)
    packets["pps"] = PPS_STATES.index(pps)
    packets["nmea"] = sentences
    return packets


def gprmc(
    time_ns: int, place_deg: tuple[float, float] | None, course_rad: float = 0.0, speed_m_s: float = 0.0
) -> bytes:
    """The NMEA sentence, with checksum and CR LF, of a vehicle at this latitude and longitude.

    Speed is in knots; the course is clockwise from north, of a `course_rad` counter-clockwise from east. Without a
    place the receiver has no fix: the status is V, and there is no position, speed or course.
    """
    now = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=time_ns // 10**9)
    if place_deg:
        course_deg = round(90 - math.degrees(course_rad), 1) % 360
        place = f"{_degrees(place_deg[0], 2, 'NS')},{_degrees(place_deg[1], 3, 'EW')}"
        text = f"GPRMC,{now:%H%M%S}.00,A,{place},{speed_m_s / KNOT_M_S:.3f},{course_deg:.1f},{now:%d%m%y},0.0,E,A"
    else:
        text = f"GPRMC,{now:%H%M%S}.00,V,,,,,,,{now:%d%m%y},,,N"
    body, checksum = text.encode(), 0
    for byte in body:
        checksum ^= byte
    return b"$%s*%02X\r\n" % (body, checksum)


def _degrees(angle_deg: float, digits: int, signs: str) -> str:
    """As NMEA says it: degrees, minutes with seven decimals, hemisphere; rounded once, in whole units."""
    degrees, units = divmod(round(abs(angle_deg) * 60 * 10**7), 60 * 10**7)
    minutes, decimals = divmod(units, 10**7)
    return f"{degrees:0{digits}d}{minutes:02d}.{decimals:07d},{signs[angle_deg < 0]}"
