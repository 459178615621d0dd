"""What a sensor reports about itself: status bytes with its calibration, and position packets with an NMEA sentence.

Some models send status bytes instead of return mode and product id, one type and value a packet. After each cycle's
letters (clock and state) come seven bytes of the calibration: a mark, two thresholds, a record of 28 bytes for each
laser, and the unit's settings; as velodyne_decoder reads them, after the HDL-64E manual.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Array, Times
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.inertial import measured
from lidarcfg.packets.nmea import fixes, gprmc
from lidarcfg.packets.velodyne.layout import (
    POSITION,
    PPS_STATES,
    PpsState,
    bytes_of,
    stamp_us,
)
from lidarcfg.packets.velodyne.model import (
    Calibration,
    InertialScales,
    Status,
    VelodyneSettings,
    VelodyneUnit,
    settings_of,
)
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Beams
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory


MARK = b"UNIT#"
HEAD = 7  # bytes
ROW = 7
ROWS = 4  # of a record; the calibration takes three
RECORD = 28  # bytes
LASERS = 64
LENGTH = HEAD + LASERS * RECORD + 3 * ROW
MODE_AT = LENGTH - 5
WARNING_AT = LENGTH - 4
MODES = {"strongest": 0, "last": 1, "dual": 2}
LASER = np.dtype(
    [
        *[
            ("id", "u1"),
            ("elevation", "<i2"),
            ("rotation", "<i2"),
            ("far", "<i2"),
            ("near_x", "<i2"),
            ("near_y", "<i2"),
        ],
        *[("vertical", "<i2"), ("lateral", "<i2"), ("focal_distance", "<i2"), ("focal_slope", "<i2")],
        *[("intensity_min", "u1"), ("intensity_max", "u1")],
    ]
)
BEAMS = {  # the beams' table that a field holds, and how many of the field's units are one of its
    "elevation": ("elevation_deg", 100),
    "rotation": ("azimuth_offset_deg", -100),
    "vertical": ("vertical_offset_mm", 1),
    "lateral": ("lateral_offset_mm", 1),
}
CALIBRATION = {  # the same of the calibration's tables
    "far": ("distance_offset_mm", 1),
    "near_x": ("near_x_offset_mm", 1),
    "near_y": ("near_y_offset_mm", 1),
    "focal_distance": ("focal_distance_mm", 1),
    "focal_slope": ("focal_slope", 10),
    "intensity_min": ("intensity_min", 1),
    "intensity_max": ("intensity_max", 1),
}
CHUNK = 1024  # position packets at a time
YEAR_2000_NS = 946_684_800 * 10**9


@dataclass(frozen=True)
class EmbeddedCalibration:
    """The contents of the status bytes of a unit."""

    beams: Beams
    calibration: Calibration
    return_mode: str  # of single returns

    def unit(self, example: VelodyneUnit) -> VelodyneUnit:
        """The example unit with the calibration from the packets in place of its own."""
        sensor = example.sensor.model_copy(update={"beams": self.beams})
        return VelodyneUnit(sensor, example.facts.model_copy(update={"calibration": self.calibration}))


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, from 0, most significant bit first."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ (0x8005 if value & 0x8000 else 0)) & 0xFFFF
    return value


@lru_cache
def calibration(unit: VelodyneUnit, status: Status, return_mode: str) -> bytes:
    """The calibration of a sensor's beams in the format of status bytes. Times and thresholds are zero.

    Values are rounded to the format's digits. Raises ConfigError for values that it cannot hold.
    """
    if unit.count != LASERS:
        raise ConfigError(f"sensor {unit.name!r} has {unit.count} beams; status bytes say those of {LASERS}")
    table = np.zeros(LASERS, LASER)
    table["id"] = np.arange(LASERS)
    table["intensity_max"] = 255
    beams = unit.sensor.beams
    values = unit.facts.calibration
    _fill(table, BEAMS, beams, f"sensor {unit.name!r}: beams")
    if not values.near_x_offset_mm:
        far = values.distance_offset_mm
        values = values.model_copy(update={"near_x_offset_mm": far, "near_y_offset_mm": far})
    _fill(table, CALIBRATION, values, f"sensor {unit.name!r}: velodyne.calibration")
    for k in np.setdiff1d(table["id"], np.unique(table["elevation"], return_index=True)[1]):
        what = f"{beams.elevation_deg[k]} is another beam's already in the hundredths of status bytes"
        raise ConfigError(f"sensor {unit.name!r}: beams.elevation_deg[{k}]: {what}")
    out = bytearray(LENGTH)
    out[: len(MARK)] = MARK
    for i, row in enumerate(table):
        out[HEAD + i * RECORD : HEAD + i * RECORD + LASER.itemsize] = row.tobytes()
    out[-RECORD : -RECORD + 6] = bytes([0, 1, 1, 0, 0, 0])  # calibrated at: 2000-01-01
    out[MODE_AT] = MODES[return_mode]
    records = [bytes(out[HEAD + i * RECORD : HEAD + (i + 1) * RECORD]) for i in range(LASERS)]
    checksum = crc16(b"".join(record[1:21] for record in records)) if status.checksum == "crc16" else LENGTH
    out[-2:] = checksum.to_bytes(2, "little")
    return bytes(out)


def _fill(
    table: NDArray[np.void], columns: dict[str, tuple[str, int]], tables: Beams | Calibration, where: str
) -> None:
    """Write the tables, in the units of their fields. Raises ConfigError for a value beyond these."""
    for field, (key, scale) in columns.items():
        values = getattr(tables, key)
        if not values:
            continue
        units = np.rint(np.array(values) * scale)
        allowed = np.iinfo(table[field].dtype)
        for k in np.flatnonzero((units < allowed.min) | (units > allowed.max)):
            low, high = sorted((allowed.min / scale, allowed.max / scale))
            what = f"{values[k]:g} is beyond what status bytes can say; allowed: {low:g} to {high:g}"
            raise ConfigError(f"{where}.{key}[{k}]: {what}")
        table[field] = units


def status_bytes(
    unit: VelodyneUnit, status: Status, return_mode: str, pps: PpsState, stamp_ns: NDArray[np.int64], period_ns: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Types (P,) and values (P,) of the packets with these stamps: the same whatever packets they come with."""
    carries = calibration(unit, status, return_mode)
    cycle = len(status.letters) + ROW
    gps = getattr(status.gps, pps)
    types = np.zeros(len(stamp_ns), np.uint8)
    values = np.zeros(len(stamp_ns), np.uint8)
    for i, time_ns in enumerate(stamp_ns.tolist()):
        rounds, place = divmod(time_ns // period_ns, cycle)
        if place < len(status.letters):
            letter = status.letters[place]
            now = datetime.fromtimestamp(time_ns // 10**9, UTC)
            clock = {"H": now.hour, "M": now.minute, "S": now.second, "D": now.day, "N": now.month, "Y": now.year % 100}
            types[i] = ord(letter)
            values[i] = (clock | {"G": gps}).get(letter, 0)
        else:
            at = (rounds * ROW + place - len(status.letters)) % LENGTH
            warning = status.warnings and at == WARNING_AT
            types[i] = ord(status.warnings) if warning else ord("1") + at % ROW
            values[i] = carries[at]
    return types, values


def parse_calibration(
    status: Status, types: NDArray[np.uint8], values: NDArray[np.uint8]
) -> EmbeddedCalibration | None:
    """What the status bytes of successive packets (P,) carry; None if there is none, whole and with the right checksum.

    Raises PacketError if it makes no sense.
    """
    letters = np.isin(types, np.frombuffer(status.letters.encode(), np.uint8))
    stream = values[~letters].tobytes()
    at = stream.find(MARK)
    while at >= 0 and len(stream) >= LENGTH:
        found = stream[at : at + LENGTH]
        found += stream[len(stream) - LENGTH : at][
            : LENGTH - len(found)
        ]  # the part that is cut off is in the cycle before
        records = [found[HEAD + i * RECORD :][:RECORD] for i in range(LASERS)]
        checksum = crc16(b"".join(record[1:21] for record in records)) if status.checksum == "crc16" else LENGTH
        table = np.frombuffer(b"".join(record[: LASER.itemsize] for record in records), LASER)
        if int.from_bytes(found[-2:], "little") == checksum and (table["id"] == np.arange(LASERS)).all():
            modes = {code: name for name, code in MODES.items()}
            try:
                return EmbeddedCalibration(*_read(table), modes.get(found[MODE_AT], "strongest"))
            except ValidationError as error:
                what = error.errors()[0]["msg"]
                raise PacketError(f"status bytes carry a calibration that no sensor has: {what}") from None
        at = stream.find(MARK, at + 1)
    return None


def _read(table: NDArray[np.void]) -> tuple[Beams, Calibration]:
    even = (table["near_x"] == table["far"]) & (table["near_y"] == table["far"])
    focused = (table["focal_slope"] == 0) & (table["intensity_min"] == 0) & (table["intensity_max"] == 255)
    idle = {"near_x", "near_y"} if even.all() else set[str]()  # fields that correct nothing
    if focused.all():
        idle |= {"focal_distance", "focal_slope", "intensity_min", "intensity_max"}

    def tables(columns: dict[str, tuple[str, int]]) -> dict[str, Any]:
        return {
            key: tuple((table[field] if table[field].dtype == np.uint8 else table[field] / scale).tolist())
            for field, (key, scale) in columns.items()
            if field not in idle
        }

    return Beams(source="the capture's status bytes", **tables(BEAMS)), Calibration(**tables(CALIBRATION))


def position_payloads(
    unit: VelodyneUnit, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
) -> Iterator[Payloads]:
    """The position packets of a sensor that has them, evenly spaced."""
    facts = unit.facts.position_packet
    headers = unit.facts.headers
    if facts is None or headers is None or headers.position is None:
        return
    settings = settings_of(mount)
    period_ns = SECOND_NS / Fraction(facts.rate_hz)
    begin, end = (math.ceil(at_ns / period_ns) for at_ns in (due_ns.start, due_ns.stop))
    for first in range(begin, end, CHUNK):
        numbers = range(first, min(first + CHUNK, end))
        times_ns = start_ns + np.array([int(number * period_ns) for number in numbers], np.int64)
        nmea = sentences(unit, settings, trajectory, origin, start_ns, times_ns)
        packets = position_packets(times_ns, settings.pps, nmea)
        if facts.inertial:
            packets["inertial"] = inertial(facts.inertial, *measured(mount, trajectory, np.zeros(3), times_ns))
        sent_ns = (times_ns + 500) // 1000 * 1000
        yield Payloads(sent_ns, bytes_of(packets), mount.telemetry_port, headers, headers.position, first)


def position_packets(time_ns: Times, pps: PpsState, nmea: Sequence[bytes]) -> NDArray[np.void]:
    """The position packets (n,) of these times (n,), each with an NMEA sentence."""
    packets = np.zeros(len(time_ns), POSITION)
    packets["stamp_us"] = stamp_us(time_ns)
    packets["pps"] = PPS_STATES.index(pps)
    packets["nmea"] = nmea
    return packets


def inertial(facts: InertialScales, acceleration_g: Array, rate_deg_s: Array) -> NDArray[np.uint16]:
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
    unit: VelodyneUnit,
    settings: VelodyneSettings,
    trajectory: "Trajectory",
    origin: "GeoOrigin",
    start_ns: int,
    times_ns: Times,
) -> list[bytes]:
    """The GPS receiver's last sentence at each of these times (n,), with a fix if its pulse is locked."""
    facts = unit.facts.position_packet
    period_ns = SECOND_NS // settings.fix_rate_hz
    if settings.pps == "absent":
        if facts is None or facts.sentence_without_gps == "none":
            return [b""] * len(times_ns)
        times_ns = times_ns - start_ns + YEAR_2000_NS
    at_ns, which = np.unique(times_ns // period_ns * period_ns, return_inverse=True)
    if settings.pps == "locked":
        found = fixes(trajectory, origin, at_ns, np.maximum(at_ns, start_ns))
    else:
        found = [gprmc(one_ns, None) for one_ns in at_ns.tolist()]
    return [found[i] for i in which.tolist()]
