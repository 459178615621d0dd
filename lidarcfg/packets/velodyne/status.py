"""Status bytes: what some models send instead of return mode and product id, one type and value a packet.

After each cycle's letters (clock and state) come seven bytes of the calibration: a mark, two thresholds, a record of
28 bytes for each laser, and the unit's settings; as velodyne_decoder reads them, after the HDL-64E manual.
"""

from datetime import UTC, datetime
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.sensor import Beams, Sensor, Status

if TYPE_CHECKING:
    from lidarcfg.rig import PpsState

MARK = b"UNIT#"
HEAD, ROW, ROWS, RECORD = 7, 7, 4, 28  # bytes; rows of a record, of which the calibration takes three
LASERS = 64
LENGTH = HEAD + LASERS * RECORD + 3 * ROW
MODE_AT, WARNING_AT = LENGTH - 5, LENGTH - 4
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
    "far": ("distance_offset_mm", 1),
    "near_x": ("near_x_offset_mm", 1),
    "near_y": ("near_y_offset_mm", 1),
    "vertical": ("vertical_offset_mm", 1),
    "lateral": ("lateral_offset_mm", 1),
    "focal_distance": ("focal_distance_mm", 1),
    "focal_slope": ("focal_slope", 10),
    "intensity_min": ("intensity_min", 1),
    "intensity_max": ("intensity_max", 1),
}


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, from 0, most significant bit first."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ (0x8005 if value & 0x8000 else 0)) & 0xFFFF
    return value


@lru_cache
def calibration(sensor: Sensor, status: Status, return_mode: str) -> bytes:
    """The calibration of a sensor's beams, as its status bytes carry it. Times and thresholds are left at zero.

    Raises ConfigError for what they cannot say; digits beyond theirs are rounded away.
    """
    if sensor.count != LASERS:
        raise ConfigError(f"sensor {sensor.name!r} has {sensor.count} beams; status bytes say those of {LASERS}")
    table = np.zeros(LASERS, LASER)
    table["id"], table["intensity_max"] = np.arange(LASERS), 255
    for field, (key, scale) in BEAMS.items():
        values = getattr(sensor.beams, key)
        if not values and field in ("near_x", "near_y"):
            values = sensor.beams.distance_offset_mm
        if not values:
            continue
        units, allowed = np.rint(np.array(values) * scale), np.iinfo(table[field].dtype)
        for k in np.flatnonzero((units < allowed.min) | (units > allowed.max)):
            low, high = sorted((allowed.min / scale, allowed.max / scale))
            what = f"{values[k]:g} is beyond what status bytes can say; allowed: {low:g} to {high:g}"
            raise ConfigError(f"sensor {sensor.name!r}: beams.{key}[{k}]: {what}")
        table[field] = units
    for k in np.setdiff1d(table["id"], np.unique(table["elevation"], return_index=True)[1]):
        what = f"{sensor.beams.elevation_deg[k]} is another beam's already in the hundredths of status bytes"
        raise ConfigError(f"sensor {sensor.name!r}: beams.elevation_deg[{k}]: {what}")
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


def status_bytes(
    sensor: Sensor, status: Status, return_mode: str, pps: "PpsState", stamp_ns: NDArray[np.int64], period_ns: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Types (P,) and values (P,) of the packets with these stamps: the same whatever packets they come with."""
    carried = calibration(sensor, status, return_mode)
    cycle, gps = len(status.letters) + ROW, getattr(status.gps, pps)
    types, values = np.zeros(len(stamp_ns), np.uint8), np.zeros(len(stamp_ns), np.uint8)
    for i, time_ns in enumerate(stamp_ns.tolist()):
        turns, place = divmod(time_ns // period_ns, cycle)
        if place < len(status.letters):
            letter = status.letters[place]
            now = datetime.fromtimestamp(time_ns // 10**9, UTC)
            clock = {"H": now.hour, "M": now.minute, "S": now.second, "D": now.day, "N": now.month, "Y": now.year % 100}
            types[i], values[i] = ord(letter), (clock | {"G": gps}).get(letter, 0)
        else:
            at = (turns * ROW + place - len(status.letters)) % LENGTH
            warning = status.warnings and at == WARNING_AT
            types[i] = ord(status.warnings) if warning else ord("1") + at % ROW
            values[i] = carried[at]
    return types, values


def carried_beams(status: Status, types: NDArray[np.uint8], values: NDArray[np.uint8]) -> tuple[Beams, str] | None:
    """Beams and return mode that the status bytes of successive packets (P,) carry; None if there is none, whole and
    with the right checksum. Raises PacketError if it makes no sense.
    """
    letters = np.isin(types, np.frombuffer(status.letters.encode(), np.uint8))
    stream = values[~letters].tobytes()
    at = stream.find(MARK)
    while at >= 0 and len(stream) >= LENGTH:
        found = stream[at : at + LENGTH]
        found += stream[len(stream) - LENGTH : at][: LENGTH - len(found)]  # what is cut off came a round before
        records = [found[HEAD + i * RECORD :][:RECORD] for i in range(LASERS)]
        checksum = crc16(b"".join(record[1:21] for record in records)) if status.checksum == "crc16" else LENGTH
        table = np.frombuffer(b"".join(record[: LASER.itemsize] for record in records), LASER)
        if int.from_bytes(found[-2:], "little") == checksum and (table["id"] == np.arange(LASERS)).all():
            modes = {code: name for name, code in MODES.items()}
            try:
                return _beams(table), modes.get(found[MODE_AT], "strongest")
            except ValidationError as error:
                what = error.errors()[0]["msg"]
                raise PacketError(f"status bytes carry a calibration that no sensor has: {what}") from None
        at = stream.find(MARK, at + 1)
    return None


def _beams(table: NDArray[np.void]) -> Beams:
    even = (table["near_x"] == table["far"]) & (table["near_y"] == table["far"])
    focused = (table["focal_slope"] == 0) & (table["intensity_min"] == 0) & (table["intensity_max"] == 255)
    left_out = {"near_x", "near_y"} if even.all() else set[str]()
    if focused.all():
        left_out |= {"focal_distance", "focal_slope", "intensity_min", "intensity_max"}
    columns = {
        key: tuple((table[field] if table[field].dtype == np.uint8 else table[field] / scale).tolist())
        for field, (key, scale) in BEAMS.items()
        if field not in left_out
    }
    return Beams(source="the capture's status bytes", **columns)
