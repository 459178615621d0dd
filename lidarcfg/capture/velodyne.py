"""Velodyne's packets: 1206 bytes of returns, 512 bytes of position; encode and decode side by side.

Layout: VLP-16 User Manual 63-9243 Rev D, sections 9.3 and 9.4; what differs between models comes from the
sensor's YAML.
"""

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.firing import Firings, Times, firing_facts, packet_offsets_ns, packet_period_ns
from lidarcfg.capture.scene import GeoOrigin
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Array
from lidarcfg.sensor import BLOCKS, SLOTS, Sensor

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
HOUR_NS = 3600 * 10**9
HOUR_US = 3600 * 10**6
STAMP_SLACK_US = 2  # successive packets are this near to the period
PPS_LOCKED = 2
WGS84_A_M, WGS84_E2 = 6378137.0, 6.69437999014e-3  # semi-major axis, eccentricity squared

Packets = NDArray[np.void]


@dataclass(frozen=True)
class Returns:
    """What the packets hold: one entry a return, in the order of the packets."""

    xyz_m: Array  # (N, 3) in the sensor frame
    range_m: Array  # (N,) along the beam
    azimuth_rad: Array  # (N,) of the beam
    time_ns: Times  # (N,) device time
    laser: NDArray[np.uint8]  # (N,)
    intensity: NDArray[np.uint8]  # (N,)
    return_type: NDArray[np.uint8]  # (N,) 0 strongest, 1 last


def encode(
    sensor: Sensor, return_mode: str, firings: Firings, range_m: Array, reflectivity: NDArray[np.uint8]
) -> Packets:
    """Packets (P,) of firings and what they met: range (P, S, L) in metres (inf: nothing), reflectivity.

    What the sensor does not measure, or the packet cannot say, is no return. Raises ConfigError.
    """
    firing, facts = firing_facts(sensor)
    distance = wire_distance(sensor, range_m)
    groups, first_laser = len(facts.block_flags), int(np.argmin(firing.offset_ns))
    head = firings.azimuth_rad[:, :: facts.sequences_per_block, first_laser]
    azimuth = np.rint(head / RADIANS).astype(np.int64) % TURN

    packets = np.zeros(len(range_m), PACKET)
    blocks = packets["blocks"]
    blocks["flag"] = np.resize(facts.block_flags, BLOCKS)
    blocks["azimuth"] = np.repeat(azimuth, groups, axis=1)
    blocks["returns"]["distance"] = distance.reshape(blocks["returns"].shape)
    blocks["returns"]["intensity"] = np.where(distance > 0, reflectivity, 0).reshape(blocks["returns"].shape)
    packets["stamp_us"] = stamp_us(firings.time_ns[:, 0, first_laser])
    packets["return_mode"] = getattr(facts.return_modes, return_mode)
    packets["product_id"] = facts.product_id
    return packets


def wire_distance(sensor: Sensor, range_m: Array) -> Array:
    """What the packet says of ranges (P, S, L) or (P, S, L, 2) in metres: whole units, 0 for no return.

    Raises ConfigError.
    """
    if sensor.range is None:
        raise ConfigError(f"sensor {sensor.name!r} is for placement only: it has no range facts")
    seen = (range_m >= sensor.range.min_m) & (range_m <= sensor.range.max_m)
    distance = np.rint(np.where(seen, range_m, 0) / sensor.range.resolution_m)
    distance[distance > DISTANCE_MAX] = 0
    return distance


def decode(sensor: Sensor, packets: Packets, host_time_ns: Times, count: int | None = None) -> Returns:
    """The returns of the first `count` packets (all, if not given) of one sensor's successive packets (P,).

    The others only say how far the head turns in the last block. Raises PacketError, ConfigError.
    """
    firing, facts = firing_facts(sensor)
    if sensor.range is None:
        raise ConfigError(f"sensor {sensor.name!r} is for placement only: it has no range facts")
    modes, flags = packets["return_mode"], packets["blocks"]["flag"]
    single = facts.return_modes.strongest, facts.return_modes.last
    _check(modes, np.isin(modes, single), f"{sensor.name}: return mode", single)
    wanted = np.resize(facts.block_flags, BLOCKS)
    _check(flags, flags == wanted, f"not a packet of {sensor.name}: block flag", facts.block_flags)

    offsets = packet_offsets_ns(sensor)
    group_ns = facts.sequences_per_block * firing.sequence_ns
    into_group = (offsets % group_ns / group_ns).ravel()  # share of the step to the next block
    group = (offsets // group_ns).ravel()
    laser = np.broadcast_to(np.arange(sensor.count, dtype=np.uint8), offsets.shape).ravel()

    start, step = _turning(sensor, packets)
    returns = packets["blocks"]["returns"][:count].reshape(-1, BLOCKS * SLOTS)
    packet, slot = np.nonzero(returns["distance"])
    beam = laser[slot]
    range_m = returns["distance"][packet, slot] * sensor.range.resolution_m
    azimuth = start[packet, group[slot]] + step[packet, group[slot]] * into_group[slot]
    azimuth_rad = azimuth * RADIANS % (2 * math.pi) + sensor.azimuth_offset_rad[beam]
    flat = range_m * np.cos(sensor.elevation_rad)[beam]
    xyz = np.empty((len(range_m), 3))
    xyz[:, 0] = flat * np.cos(azimuth_rad)
    xyz[:, 1] = -flat * np.sin(azimuth_rad)
    xyz[:, 2] = range_m * np.sin(sensor.elevation_rad)[beam] + sensor.vertical_offset_m[beam]
    return Returns(
        xyz_m=xyz,
        range_m=range_m,
        azimuth_rad=azimuth_rad,
        time_ns=device_time_ns(packets["stamp_us"], host_time_ns)[packet] + offsets.ravel()[slot],
        laser=beam,
        intensity=returns["intensity"][packet, slot],
        return_type=(modes == facts.return_modes.last).astype(np.uint8)[packet],
    )


def _turning(sensor: Sensor, packets: Packets) -> tuple[Array, Array]:
    """Azimuth at the start of each block group and the turn to the next (P, groups), in hundredths.

    The last group looks into the next packet if that follows at once, else turns as the one before it.
    """
    _, facts = firing_facts(sensor)
    azimuth = packets["blocks"]["azimuth"][:, :: len(facts.block_flags)].astype(np.float64)
    step = np.empty_like(azimuth)
    step[:, :-1] = np.diff(azimuth, axis=1)
    step[:, -1] = step[:, -2]
    stamp = packets["stamp_us"].astype(np.int64)
    gap_us = (stamp[1:] - stamp[:-1]) % HOUR_US
    follows = np.flatnonzero(abs(gap_us - packet_period_ns(sensor) / 1000) <= STAMP_SLACK_US)
    step[follows, -1] = azimuth[follows + 1, 0] - azimuth[follows, -1]
    return azimuth, (step + TURN / 2) % TURN - TURN / 2


def _check(got: NDArray[np.integer], right: NDArray[np.bool_], what: str, allowed: tuple[int, ...]) -> None:
    if not right.all():
        raise PacketError(f"{what} 0x{got[~right][0]:02X}; allowed: {', '.join(f'0x{n:02X}' for n in allowed)}")


def stamp_us(time_ns: Times) -> Times:
    """Device time as packets say it: microseconds past the hour, rounded."""
    return np.asarray((time_ns + 500) // 1000 % HOUR_US)


def device_time_ns(stamp_us: NDArray[np.uint32], host_time_ns: Times) -> Times:
    """Device time since 1970 from stamps past the hour: the hour that brings them nearest to host time."""
    past_hour = stamp_us.astype(np.int64) * 1000
    return past_hour + (host_time_ns - past_hour + HOUR_NS // 2) // HOUR_NS * HOUR_NS


def position_packet(time_ns: int, geo_origin: GeoOrigin, east_north_m: tuple[float, float], yaw_rad: float) -> bytes:
    """The position packet of a vehicle that stands at (x east, y north) of the world with this yaw."""
    packet = np.zeros((), POSITION)
    packet["stamp_us"] = stamp_us(np.array(time_ns, np.int64))
    packet["pps"] = PPS_LOCKED
    packet["nmea"] = gprmc(time_ns, geo_origin, east_north_m, yaw_rad)
    return packet.tobytes()


def gprmc(time_ns: int, geo_origin: GeoOrigin, east_north_m: tuple[float, float], yaw_rad: float) -> bytes:
    """The NMEA sentence, with checksum and CR LF, of a vehicle that stands still.

    Where the plane of `geographic` leaves the Earth's latitudes there is no fix: status V and no position.
    """
    latitude_deg, longitude_deg = geographic(geo_origin, east_north_m)
    now = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=time_ns // 10**9)
    if abs(latitude_deg) <= 90:
        course_deg = round(90 - math.degrees(yaw_rad), 1) % 360
        place = f"{_degrees(latitude_deg, 2, 'NS')},{_degrees(longitude_deg, 3, 'EW')}"
        text = f"GPRMC,{now:%H%M%S}.00,A,{place},0.000,{course_deg:.1f},{now:%d%m%y},0.0,E,A"
    else:
        text = f"GPRMC,{now:%H%M%S}.00,V,,,,,,,{now:%d%m%y},,,N"
    body, checksum = text.encode(), 0
    for byte in body:
        checksum ^= byte
    return b"$%s*%02X\r\n" % (body, checksum)


def geographic(origin: GeoOrigin, east_north_m: tuple[float, float]) -> tuple[float, float]:
    """Latitude and longitude in degrees of a point on the plane that touches WGS 84 at the origin.

    Longitude is within ±180; latitude is beyond ±90 where the plane reaches further than a pole.
    """
    east, north = east_north_m
    latitude = math.radians(origin.latitude_deg)
    w2 = 1 - WGS84_E2 * math.sin(latitude) ** 2
    meridian_m, normal_m = WGS84_A_M * (1 - WGS84_E2) / w2**1.5, WGS84_A_M / math.sqrt(w2)
    longitude_deg = origin.longitude_deg + math.degrees(east / (normal_m * math.cos(latitude)))
    return origin.latitude_deg + math.degrees(north / meridian_m), (longitude_deg + 180) % 360 - 180


def _degrees(angle_deg: float, digits: int, signs: str) -> str:
    """As NMEA says it: degrees, minutes with seven decimals, hemisphere; rounded once, in whole units."""
    degrees, units = divmod(round(abs(angle_deg) * 60 * 10**7), 60 * 10**7)
    minutes, decimals = divmod(units, 10**7)
    return f"{degrees:0{digits}d}{minutes:02d}.{decimals:07d},{signs[angle_deg < 0]}"
