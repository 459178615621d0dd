"""What an Ouster reports about itself: metadata, the JSON file that decoding needs, and inertial measurements.

Inertial measurements include gravity.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes
from lidarcfg.packets.codec import PacketSource, Payloads
from lidarcfg.packets.inertial import GRAVITY_M_S2, measured, samples
from lidarcfg.packets.ouster.layout import (
    ALERTS,
    PACKET_COLUMNS,
    PROFILES,
    TICKS,
    Layout,
    PacketHeaders,
    crc64,
    packet_headers,
    write_packet_headers,
)
from lidarcfg.packets.ouster.model import IMU_MEASUREMENTS, LASERS_MAX, Mode, OusterUnit, phase, unit
from lidarcfg.sensors.rig import Clock, Mount
from lidarcfg.sensors.sensor import Beams, Sensor
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.world.motion import Trajectory

SUFFIX = ".json"  # of metadata
USUAL = tuple(
    Layout(name, pixels, 1024, columns, profile.fusa)
    for name, profile in PROFILES.items()
    for pixels in (16, 32, 64, 128, 256)
    for columns in ((16,) if name == "LEGACY" else (16, 8))
)
COLUMNS_MAX = 8192
PACKET_COLUMNS_MAX = 64
IMAGES = {
    "2.3": "ousteros-image-prod-aries-v2.3.0",
    "3.2": "ousteros-image-prod-bootes-v3.2.0",
    "4.0": "ousteros-image-prod-bootes-v4.0.0",  # a guess, of which readers take the number only
}
FIXED_CONFIG = {  # as in recordings of sensors that nobody has configured
    "multipurpose_io_mode": "OFF",
    "nmea_baud_rate": "BAUD_9600",
    "nmea_ignore_valid_char": 0,
    "nmea_in_polarity": "ACTIVE_HIGH",
    "nmea_leap_seconds": 0,
    "operating_mode": "NORMAL",
    "signal_multiplier": 1,
    "sync_pulse_in_polarity": "ACTIVE_HIGH",
    "sync_pulse_out_angle": 360,
    "sync_pulse_out_frequency": 1,
    "sync_pulse_out_polarity": "ACTIVE_HIGH",
    "sync_pulse_out_pulse_width": 10,
}
OLD_PIXELS = 64  # of a column, in packets of firmware before 1.14
OLD_BEAM_ORIGINS_MM = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}  # metadata before 2.0 does not say it, but
OLDEST_BEAM_ORIGIN_MM = 12.163  # ouster-sdk does (sensor_info.cpp), and of the first generation, also its pose
OLDEST_LIDAR_TO_SENSOR = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]
LIDAR_MODE = re.compile(r"(512|1024|2048|4096)x(5|10|20)")
PRODUCT_LINE = re.compile(r"(OS-(?:[0-9]|DOME)(?:-MAX)?)-([0-9]+)")
BUILT = "2026-01-01T00:00:00Z"
IMU_PERIOD_NS = SECOND_NS // 100  # as in all recordings
CHUNK = 1024  # packets
IMU_PACKET = np.dtype([("time_ns", "<u8", (3,)), ("acceleration_g", "<f4", (3,)), ("rate_deg_s", "<f4", (3,))])
IMU_MEASUREMENT = np.dtype(
    [
        *[("time_ns", "<u8"), ("column", "<u2"), ("status", "<u2")],
        *[("acceleration_m_s2", "<f4", (3,)), ("rate_rad_s", "<f4", (3,))],
    ]
)
FRAMED_IMU_PACKET = np.dtype(  # as ouster-sdk's parsing.cpp has it
    [
        *[("head", "u1", (32,)), ("nmea_ns", "<u8"), ("sentence", "S92")],
        *[("measured", IMU_MEASUREMENT, (IMU_MEASUREMENTS,)), ("reserved", "u1", (24,)), ("crc", "<u8")],
    ]
)
FRAMED_KIND = 2  # of an IMU packet, in its header
TIMESTAMP_MODES: dict[Clock, str] = {
    "ptp": "TIME_FROM_PTP_1588",
    "gps": "TIME_FROM_SYNC_PULSE_IN",
    "free": "TIME_FROM_INTERNAL_OSC",
}


@dataclass(frozen=True)
class Metadata:
    """The contents of a metadata file that decoding needs."""

    name: str  # the file's
    layout: Layout
    window: tuple[int, int]  # first and last column
    elevation_rad: Array  # (L,)
    azimuth_rad: Array  # (L,) clockwise from the encoder's angle
    start_m: tuple[float, float]  # of the beams: ahead of the axis, and up
    T_sensor_lidar: Array  # (4, 4)
    line: str  # the product's: OS-1-128
    serial: int  # 0: not known
    init: int  # 0: not known
    port: int | None
    nearest_first: bool  # the order of two returns

    @property
    def model(self) -> str:
        """The model as the catalogue names it, such as os1-128."""
        found = PRODUCT_LINE.match(self.line)
        return f"{found[1]}-{found[2]}".lower().replace("os-", "os") if found else self.line.lower() or "ouster"


def read_metadata(name: str, content: bytes) -> Metadata | None:
    """The metadata in a file called `name`; None if it is another kind of JSON. Raises PacketError if it is damaged."""
    try:
        metadata = json.loads(content)
    except (ValueError, RecursionError):
        metadata = None
    if not isinstance(metadata, dict) or not ({"beam_intrinsics", "beam_altitude_angles"} & metadata.keys()):
        return None
    try:
        return _read(name, _completed(_flat(metadata)))
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise PacketError(f"{name}: not the metadata of an Ouster: {what}") from None


def _flat(metadata: dict[str, Any]) -> dict[str, Any]:
    """The keys of all parts in one flat map, as firmware before 3 writes them.

    What a sensor does not know, clients of its HTTP interface write as "error: Command not recognized.".
    """
    known = {key: value for key, value in metadata.items() if not str(value).startswith("error: ")}
    form = _part(known, "data_format" if "data_format" in known else "lidar_data_format")
    flat = dict(known)
    for key in ("beam_intrinsics", "lidar_intrinsics", "sensor_info", "config_params"):
        flat |= _part(known, key)
    return flat | {"data_format": form}


def _part(metadata: dict[str, Any], key: str) -> dict[str, Any]:
    found = metadata.get(key, {})
    if not isinstance(found, dict):
        raise TypeError(f"{key} is {str(found)[:40]!r}, not keys and values")
    return found


def _completed(metadata: dict[str, Any]) -> dict[str, Any]:
    """With what firmware before 2.0 does not say, or reduced metadata, as ouster-sdk's metadata.cpp takes it to be."""
    product = PRODUCT_LINE.match(str(metadata.get("prod_line", "")))
    form = {"columns_per_packet": PACKET_COLUMNS, "pixels_per_column": int(product[2]) if product else OLD_PIXELS}
    if mode := LIDAR_MODE.fullmatch(str(metadata.get("lidar_mode", ""))):
        form["columns_per_frame"] = int(mode[1])
    form |= metadata["data_format"]
    if "columns_per_frame" not in form:
        raise ValueError("there is neither a lidar_data_format with columns_per_frame nor a lidar_mode like 1024x10")
    origin_mm = OLD_BEAM_ORIGINS_MM.get(product[1] if product else "", OLDEST_BEAM_ORIGIN_MM)
    missing = {"lidar_origin_to_beam_origin_mm": origin_mm, "lidar_to_sensor_transform": OLDEST_LIDAR_TO_SENSOR}
    return missing | metadata | {"data_format": form}


def _read(name: str, metadata: dict[str, Any]) -> Metadata:
    form = metadata["data_format"]
    elevation, azimuth = (_numbers(metadata, key) for key in ("beam_altitude_angles", "beam_azimuth_angles"))
    pixels = _whole(form, "pixels_per_column", 1, LASERS_MAX)
    if not len(elevation) == len(azimuth) == pixels:
        raise ValueError(f"{pixels} pixels a column, {len(elevation)} altitude and {len(azimuth)} azimuth angles")
    profile = form.get("udp_profile_lidar", "LEGACY")
    if profile not in PROFILES:
        raise ValueError(f"profile {profile!r} cannot be read; allowed: {', '.join(PROFILES)}")
    usual = "FUSA" if PROFILES[profile].fusa else "STANDARD"
    fusa = form.get("header_type", usual) == "FUSA" and profile != "LEGACY"
    if (abs(elevation) > 90).any() or len(np.unique(elevation)) < pixels:
        raise ValueError("beam_altitude_angles are not within -90 to 90, each once")
    count = _whole(form, "columns_per_frame", 1, COLUMNS_MAX)
    per_packet = _whole(form, "columns_per_packet", 1, PACKET_COLUMNS_MAX)
    if count % per_packet:
        raise ValueError(f"{count} columns are no whole packets of {per_packet}")
    first, last = (int(column) for column in form.get("column_window", (0, count - 1)))
    if not (0 <= first < count and 0 <= last < count):
        raise ValueError(f"column_window {first}, {last} is outside of {count} columns")
    if "beam_to_lidar_transform" in metadata:
        to_lidar = _matrix(metadata, "beam_to_lidar_transform")
        start_mm = float(to_lidar[0, 3]), float(to_lidar[2, 3])
    else:
        start_mm = float(metadata["lidar_origin_to_beam_origin_mm"]), 0.0
    to_sensor = _matrix(metadata, "lidar_to_sensor_transform")
    to_sensor[:3, 3] /= 1000
    if not (np.isfinite(start_mm).all() and max(map(abs, start_mm)) < 1e6):
        raise ValueError(f"beams start at {start_mm} mm")
    port = metadata.get("udp_port_lidar")
    return Metadata(
        name=name,
        layout=Layout(profile, pixels, count, per_packet, fusa),
        window=(first, last),
        elevation_rad=np.radians(elevation),
        azimuth_rad=np.radians(azimuth),
        start_m=(start_mm[0] / 1000, start_mm[1] / 1000),
        T_sensor_lidar=to_sensor,
        line=str(metadata.get("prod_line", "")),
        serial=int(metadata.get("prod_sn") or 0),
        init=int(metadata.get("initialization_id") or 0),
        port=int(port) if port else None,
        nearest_first=metadata.get("return_order") == "NEAREST_TO_FARTHEST",
    )


def _numbers(metadata: dict[str, Any], key: str) -> Array:
    found = np.array(metadata[key], np.float64)
    if found.ndim != 1 or not (abs(found) <= 360).all():
        raise ValueError(f"{key} is no list of angles")
    return found


def _matrix(metadata: dict[str, Any], key: str) -> Array:
    found = np.array(metadata[key], np.float64)
    if found.size != 16 or not (abs(found) < 1e9).all():
        raise ValueError(f"{key} is no 4 x 4 matrix")
    return found.reshape(4, 4)


def _whole(metadata: dict[str, Any], key: str, least: int, most: int) -> int:
    value = metadata[key]
    if not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{key} is {value!r}; allowed: {least} to {most}")
    return value


def is_lidar_packet(layout: Layout, payload: bytes) -> bool:
    """Whether the first bytes are a lidar packet's."""
    if layout.legacy:
        measurement = int.from_bytes(payload[8:10], "little")
        ticks = int.from_bytes(payload[12:16], "little")
        return ticks < TICKS and measurement <= ticks
    return payload[:1] == b"\x01" if layout.fusa else payload[:2] == b"\x01\0"


def matches(source: PacketSource, size: int, payload: bytes) -> bool:
    """By metadata beside the capture; or by size and header, so that missing metadata is reported as an error."""
    usual = any(layout.size == size and is_lidar_packet(layout, payload) for layout in USUAL)
    return usual or any(is_lidar_packet(one.layout, payload) for one in _metadata_beside(source, size))


def _metadata_beside(source: PacketSource, size: int) -> list[Metadata]:
    """The metadata beside the capture whose packets are of this size."""
    found = [read_metadata(name, content) for name, content in source.sidecar_files(SUFFIX).items()]
    return [one for one in found if one and one.layout.size == size]


def find_metadata(source: PacketSource, packets: Bytes) -> Metadata:
    """The metadata of the source's packets. Raises PacketError if there is none, or if several fit."""
    size = packets.shape[1]
    payload = packets[0].tobytes()
    beside = _metadata_beside(source, size)
    if not beside:
        needed = "a .json named as the capture beside it, or one given with --sidecar"
        what = f"an Ouster's packets of {size} bytes need the sensor's metadata, {needed}"
        there = ", ".join(source.sidecar_files(SUFFIX))
        raise PacketError(f"{source.where}: {what}" + (f"; {there} is not that" if there else ""))
    fit = [one for one in beside if is_lidar_packet(one.layout, payload)]
    same = [one for one in fit if one.layout.legacy or not one.serial or _serial(one, packets) == one.serial]
    if not same:
        serials = ", ".join(f"{one.name} is of {one.line} {one.serial}" for one in beside)
        other = f"{_serial(fit[0], packets)}" if fit else "another profile"
        raise PacketError(f"{source.where}: its packets are of {other}; {serials}")
    first = same[0]
    if any(not _alike(first, one) for one in same[1:]):
        names = ", ".join(one.name for one in same)
        raise PacketError(f"{source.where}: several metadata fit its packets: {names}")
    return first


def _serial(one: Metadata, packets: Bytes) -> int:
    return packet_headers(one.layout, packets[:1]).serial


def _alike(one: Metadata, other: Metadata) -> bool:
    """Whether both metadata decode to the same points."""
    return (
        (one.layout, one.start_m, one.window) == (other.layout, other.start_m, other.window)
        and np.array_equal(one.elevation_rad, other.elevation_rad)
        and np.array_equal(one.azimuth_rad, other.azimuth_rad)
        and np.array_equal(one.T_sensor_lidar, other.T_sensor_lidar)
    )


def unknown_sensor(found: Metadata, like: Sensor) -> Sensor:
    """A sensor outside the catalogue, for decoding only: beams from the metadata, all else from another model."""
    beams = Beams(
        source=found.name,
        elevation_deg=tuple(np.degrees(found.elevation_rad).tolist()),
        azimuth_offset_deg=tuple(np.degrees(found.azimuth_rad).tolist()),
    )
    section = unit(like).facts.model_dump()
    return Sensor.model_validate(
        {"name": found.model, "maker": "Ouster", "beams": beams, "codec": "ouster", "ouster": section}
    )


def metadata_file(unit: OusterUnit, mode: Mode, mount: Mount) -> bytes:
    """The metadata of a mount's sensor, with the parts of firmware 3 that ouster-sdk needs."""
    layout = mode.layout
    beams = unit.sensor.beams
    firmware = mode.firmware
    ahead_mm, up_mm = unit.start_mm
    azimuth_deg = beams.azimuth_offset_deg or (0.0,) * unit.sensor.count
    metadata: dict[str, Any] = {
        "beam_intrinsics": {
            "beam_altitude_angles": list(beams.elevation_deg),
            "beam_azimuth_angles": list(azimuth_deg),
            "beam_to_lidar_transform": _translation(ahead_mm, 0, 0),
            "lidar_origin_to_beam_origin_mm": ahead_mm,
        },
        "calibration_status": {"reflectivity": {"timestamp": BUILT[:-1], "valid": True}},
        "config_params": _config(unit, mode, mount),
        "imu_intrinsics": {"imu_to_sensor_transform": _translation(*unit.facts.imu.position_mm)},
        "lidar_data_format": {
            "column_window": list(mode.window),
            "columns_per_frame": layout.columns_per_frame,
            "columns_per_packet": layout.columns_per_packet,
            "pixel_shift_by_row": [round(angle / 360 * layout.columns_per_frame) for angle in azimuth_deg],
            "pixels_per_column": layout.pixels,
            "udp_profile_imu": mode.settings.imu_profile,
            "udp_profile_lidar": layout.name,
        },
        "lidar_intrinsics": {"lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, up_mm, 0, 0, 0, 1]},
        "sensor_info": {
            "build_date": BUILT,
            "build_rev": f"v{firmware}.0",
            "image_rev": IMAGES[firmware],
            "initialization_id": mode.init,
            "prod_line": unit.facts.product.line,
            "prod_pn": unit.facts.product.number,
            "prod_sn": str(mode.serial),
            "status": "RUNNING",
        },
    }
    if mode.settings.imu_profile != "LEGACY":
        metadata["imu_data_format"] = {
            "imu_measurements_per_packet": IMU_MEASUREMENTS,
            "imu_packets_per_frame": mode.imu_packets,
        }
    return (json.dumps(metadata, indent=2) + "\n").encode()


def _config(unit: OusterUnit, mode: Mode, mount: Mount) -> dict[str, Any]:
    """How a mount's sensor is configured."""
    layout = mode.layout
    (first, last) = mode.window
    step = 360_000 / layout.columns_per_frame  # encoder angles run against the columns
    whole = (last + 1) % layout.columns_per_frame == first
    edges = [0, 360_000] if whole else [round(360_000 - last * step) % 360_000, round(360_000 - first * step) % 360_000]
    config = FIXED_CONFIG | {
        "azimuth_window": edges,
        "columns_per_packet": layout.columns_per_packet,
        "lidar_mode": f"{layout.columns_per_frame}x{round(mode.rpm / 60)}",
        "phase_lock_enable": mount.phase_deg is not None,
        "phase_lock_offset": round((180 - (mount.phase_deg or 180)) % 360 * 1000),
        "timestamp_mode": TIMESTAMP_MODES[mount.clock or "ptp"],
        "udp_dest": mount.destination or unit.facts.headers.destination_ip,
        "udp_port_imu": mount.telemetry_port,
        "udp_port_lidar": mount.data_port,
        "udp_profile_imu": mode.settings.imu_profile,
        "udp_profile_lidar": layout.name,
    }
    if mode.nearest_first:
        config["return_order"] = "NEAREST_TO_FARTHEST"
    if mode.modern:
        config["min_range_threshold_cm"] = round(unit.range.reported_m[0] * 100)
    if mode.settings.imu_profile != "LEGACY":
        config["imu_packets_per_frame"] = mode.imu_packets
    return config


def _translation(x: float, y: float, z: float) -> list[float]:
    return [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1]


def legacy_imu_payloads(
    unit: OusterUnit, mode: Mode, mount: Mount, trajectory: "Trajectory", start_ns: int, due_ns: range
) -> Iterator[Payloads]:
    """A packet of 48 bytes every 10 ms: three equal times, of the system and both sensors, then the values."""
    headers = unit.facts.headers
    for number, time_ns, sent_ns in samples(start_ns, due_ns, IMU_PERIOD_NS):
        packets = np.zeros(len(time_ns), IMU_PACKET)
        packets["time_ns"] = time_ns[:, None]
        packets["acceleration_g"], packets["rate_deg_s"] = measured(mount, trajectory, _position_m(unit), time_ns)
        data = packets.view(np.uint8).reshape(len(packets), IMU_PACKET.itemsize)
        first = int(number[0])
        yield Payloads(sent_ns, data, mount.telemetry_port, headers, headers.imu, first, mode.settings.fragments)


def framed_imu_payloads(
    unit: OusterUnit, mode: Mode, mount: Mount, trajectory: "Trajectory", start_ns: int, due_ns: range
) -> Iterator[Payloads]:
    """Packets of profile ACCEL32_GYRO32_NMEA, which count revolutions as the lidar's do; without a sentence."""
    zero_ns, _ = phase(mode, start_ns, mount.phase_deg)
    period_ns = mode.revolution_ns // mode.imu_packets
    into_ns = start_ns - zero_ns
    zero = -(-into_ns // period_ns)  # the first that is not begun before the start
    begin, end = ((into_ns + at_ns) // period_ns for at_ns in (due_ns.start, due_ns.stop))
    for first in range(max(begin, zero), end, CHUNK):
        number = np.arange(first, min(first + CHUNK, end))
        revolution, place = np.divmod(number, mode.imu_packets)
        sample = place[:, None] * IMU_MEASUREMENTS + np.arange(IMU_MEASUREMENTS)
        since_ns = sample * mode.revolution_ns // (mode.imu_packets * IMU_MEASUREMENTS)
        packets = np.zeros(len(number), FRAMED_IMU_PACKET)
        values = packets["measured"]
        values["time_ns"] = zero_ns + revolution[:, None] * mode.revolution_ns + since_ns
        values["column"] = sample * mode.layout.columns_per_frame // (mode.imu_packets * IMU_MEASUREMENTS)
        values["status"] = 1
        at_ns = values["time_ns"].ravel().astype(np.int64)
        acceleration_g, rate_deg_s = measured(mount, trajectory, _position_m(unit), at_ns)
        values["acceleration_m_s2"] = (acceleration_g * GRAVITY_M_S2).reshape(*sample.shape, 3)
        values["rate_rad_s"] = np.radians(rate_deg_s).reshape(*sample.shape, 3)
        data = packets.view(np.uint8).reshape(len(packets), FRAMED_IMU_PACKET.itemsize)
        write_packet_headers(mode.layout, data, PacketHeaders(revolution, mode.init, mode.serial, ALERTS))
        data[:, 0] = FRAMED_KIND
        packets["crc"] = crc64(data)
        sent_ns = (zero_ns + (number + 1) * period_ns + 500) // 1000 * 1000
        headers = unit.facts.headers
        fragments = mode.settings.fragments
        yield Payloads(sent_ns, data, mount.telemetry_port, headers, headers.imu, first - zero, fragments)


def _position_m(unit: OusterUnit) -> Array:
    """(3,): where the inertial sensor is in the sensor's frame."""
    return np.array(unit.facts.imu.position_mm) / 1000
