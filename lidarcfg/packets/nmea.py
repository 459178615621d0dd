"""Sentences of a GPS receiver on the vehicle, as sensors of several makers pass them on."""

import math
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg import maths
from lidarcfg.geometry import Times
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

KNOT_M_S = 1852 / 3600
HUNDREDTH_NS = SECOND_NS // 100
SLOWEST_M_S = 0.1  # below this speed the course is the vehicle's heading


def fixes(trajectory: "Trajectory", origin: "GeoOrigin", at_ns: Times, known_ns: Times) -> list[bytes]:
    """Sentences of fixes at times (n,); the last one before the drive has the place of its start, at `known_ns`."""
    from lidarcfg.world.geodesy import geographic  # loaded where it is needed

    place_m = trajectory.world(np.zeros((len(known_ns), 3)), known_ns)
    ahead_m = trajectory.world(np.tile([1.0, 0.0, 0.0], (len(known_ns), 1)), known_ns) - place_m
    velocity_m_s = trajectory.velocity_m_s(known_ns)
    speed_m_s = maths.hypot(*velocity_m_s[:, :2].T)
    along = np.where(speed_m_s[:, None] >= SLOWEST_M_S, velocity_m_s, ahead_m)
    course_rad = maths.atan2(along[:, 1], along[:, 0])
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
    body = text.encode()
    checksum = 0
    for byte in body:
        checksum ^= byte
    return b"$%s*%02X\r\n" % (body, checksum)


def _degrees(angle_deg: float, digits: int, signs: str) -> str:
    """An angle in NMEA's form: degrees, minutes with seven decimals, hemisphere; rounded once, in whole units."""
    degrees, units = divmod(round(abs(angle_deg) * 60 * 10**7), 60 * 10**7)
    minutes, decimals = divmod(units, 10**7)
    return f"{degrees:0{digits}d}{minutes:02d}.{decimals:07d},{signs[angle_deg < 0]}"
