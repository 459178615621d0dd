"""Position packets: what a sensor says of its GPS receiver, with an NMEA sentence."""

import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Payloads, Times
from lidarcfg.packets.inertial import measured
from lidarcfg.packets.velodyne.facts import Inertial, PpsState, Settings, Unit
from lidarcfg.packets.velodyne.layout import POSITION, PPS_STATES, octets_of, stamp_us
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.rig import Mount
    from lidarcfg.world.motion import Trajectory
    from lidarcfg.world.scene import GeoOrigin

CHUNK = 1024  # position packets at a time
YEAR_2000_NS = 946_684_800 * 10**9
KNOT_M_S = 1852 / 3600
HUNDREDTH_NS = SECOND_NS // 100
SLOWEST_M_S = 0.1  # below this speed the course is the vehicle's heading


def position_payloads(
    unit: Unit, mount: "Mount", trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, duration_ns: int
) -> Iterator[Payloads]:
    """The position packets of a sensor that has them, evenly spaced."""
    facts, headers = unit.facts.position_packet, unit.facts.headers
    if facts is None or headers is None or headers.position is None:
        return
    settings = mount.settings.checked(Settings)
    period_ns = SECOND_NS / Fraction(facts.rate_hz)
    total = math.ceil(duration_ns / period_ns)
    for first in range(0, total, CHUNK):
        numbers = range(first, min(first + CHUNK, total))
        times_ns = start_ns + np.array([int(number * period_ns) for number in numbers], np.int64)
        nmea = sentences(unit, settings, trajectory, origin, start_ns, times_ns)
        packets = position_packets(times_ns, settings.pps, nmea)
        if facts.inertial:
            packets["inertial"] = inertial(facts.inertial, *measured(mount, trajectory, np.zeros(3), times_ns))
        sent_ns = (times_ns + 500) // 1000 * 1000
        yield Payloads(sent_ns, octets_of(packets), mount.telemetry_port, headers, headers.position, first)


def position_packets(time_ns: Times, pps: PpsState, nmea: Sequence[bytes]) -> NDArray[np.void]:
    """The position packets (n,) of these times (n,), each with an NMEA sentence."""
    packets = np.zeros(len(time_ns), POSITION)
    packets["stamp_us"] = stamp_us(time_ns)
    packets["pps"] = PPS_STATES.index(pps)
    packets["nmea"] = nmea
    return packets


def inertial(facts: Inertial, acceleration_g: Array, rate_deg_s: Array) -> NDArray[np.uint16]:
    """(n, 3, 4) of what is measured (n, 3) ahead, to the left and up: 12 bits of two's complement, and 4 of the kind.

    Temperatures are 0, 25 degrees. Each gyroscope turns about the axis across its accelerometer's two.
    """
    ahead, left, up = np.rint(acceleration_g / facts.acceleration_g).T
    turns = np.rint(rate_deg_s / facts.rate_deg_s)
    none = np.zeros(len(turns))
    groups = [(turns[:, 0], none, up, left), (turns[:, 1], none, up, -ahead), (turns[:, 2], none, -left, -ahead)]
    values = np.moveaxis(np.array(groups), 2, 0).clip(-2048, 2047).astype(np.int64)
    return (values % 4096 + 4096 * np.arange(4)).astype(np.uint16)


def sentences(
    unit: Unit, settings: Settings, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, times_ns: Times
) -> list[bytes]:
    """What the sensor has of its receiver at these times (n,): its last sentence, with a fix if its pulse is locked."""
    facts, period_ns = unit.facts.position_packet, SECOND_NS // settings.fix_rate_hz
    if settings.pps == "absent":
        if facts is None or facts.sentence_without_gps == "none":
            return [b""] * len(times_ns)
        times_ns = times_ns - start_ns + YEAR_2000_NS
    at_ns, which = np.unique(times_ns // period_ns * period_ns, return_inverse=True)
    if settings.pps == "locked":
        found = _fixes(trajectory, origin, at_ns, np.maximum(at_ns, start_ns))
    else:
        found = [gprmc(one_ns, None) for one_ns in at_ns.tolist()]
    return [found[i] for i in which.tolist()]


def _fixes(trajectory: "Trajectory", origin: "GeoOrigin", at_ns: Times, known_ns: Times) -> list[bytes]:
    """Sentences of fixes at times (n,); the last one before the drive has the place of its start, at `known_ns`."""
    from lidarcfg.world.geodesy import geographic  # loaded where it is needed

    place_m = trajectory.world(np.zeros((len(known_ns), 3)), known_ns)
    ahead_m = trajectory.world(np.tile([1.0, 0.0, 0.0], (len(known_ns), 1)), known_ns) - place_m
    velocity_m_s = trajectory.velocity_m_s(known_ns)
    speed_m_s = np.hypot(*velocity_m_s[:, :2].T)
    along = np.where(speed_m_s[:, None] >= SLOWEST_M_S, velocity_m_s, ahead_m)
    course_rad = np.arctan2(along[:, 1], along[:, 0])
    rows = np.column_stack([geographic(origin, place_m), course_rad, speed_m_s]).tolist()
    return [gprmc(one_ns, (row[0], row[1]), row[2], row[3]) for one_ns, row in zip(at_ns.tolist(), rows, strict=True)]


def gprmc(
    time_ns: int, place_deg: tuple[float, float] | None, course_rad: float = 0.0, speed_m_s: float = 0.0
) -> bytes:
    """The NMEA sentence, with checksum and CR LF, of a vehicle at this latitude and longitude.

    Speed is in knots; the course is clockwise from north, of a `course_rad` counter-clockwise from east. Without a
    place the receiver has no fix: the status is V, and there is no position, speed or course.
    """
    now = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=time_ns // SECOND_NS)
    clock = f"{now:%H%M%S}.{time_ns % SECOND_NS // HUNDREDTH_NS:02d}"
    if place_deg:
        course_deg = round(90 - math.degrees(course_rad), 1) % 360
        place = f"{_degrees(place_deg[0], 2, 'NS')},{_degrees(place_deg[1], 3, 'EW')}"
        text = f"GPRMC,{clock},A,{place},{speed_m_s / KNOT_M_S:.3f},{course_deg:.1f},{now:%d%m%y},0.0,E,A"
    else:
        text = f"GPRMC,{clock},V,,,,,,,{now:%d%m%y},,,N"
    body, checksum = text.encode(), 0
    for byte in body:
        checksum ^= byte
    return b"$%s*%02X\r\n" % (body, checksum)


def _degrees(angle_deg: float, digits: int, signs: str) -> str:
    """As NMEA says it: degrees, minutes with seven decimals, hemisphere; rounded once, in whole units."""
    degrees, units = divmod(round(abs(angle_deg) * 60 * 10**7), 60 * 10**7)
    minutes, decimals = divmod(units, 10**7)
    return f"{degrees:0{digits}d}{minutes:02d}.{decimals:07d},{signs[angle_deg < 0]}"
