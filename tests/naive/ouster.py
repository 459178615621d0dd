"""Plain-loop twins for Ouster's packets, written from the sensor documentation's tables ("Sensor Data": data packet
formats, lidar range to XYZ) and the text of CRC-64/ECMA-182. Those with zones, colours and window states are not on these
pages; they are read off the names of ouster-sdk's tables."""

import json
import math
import struct

# bytes of a pixel, and of each return the bits (first, how many, how many are dropped) of range, reflectivity, signal
PIXELS = {
    "LEGACY": (12, [((0, 20, 0), (32, 8, 0), (48, 16, 0))]),
    "RNG19_RFL8_SIG16_NIR16": (12, [((0, 19, 0), (32, 8, 0), (48, 16, 0))]),
    "RNG19_RFL8_SIG16_NIR16_DUAL": (
        16,
        [((0, 19, 0), (24, 8, 0), (64, 16, 0)), ((32, 19, 0), (56, 8, 0), (80, 16, 0))],
    ),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": (12, [((0, 19, 0), (32, 8, 0), (48, 16, 0))]),
    "RNG19_RFL8_SIG16_ZONE16_DUAL": (
        16,
        [((0, 19, 0), (24, 8, 0), (64, 16, 0)), ((32, 19, 0), (56, 8, 0), (80, 16, 0))],
    ),
    "RNG19_RFL8_SIG16_NIR16_RGB16": (16, [((0, 19, 0), (24, 8, 0), (32, 16, 0))]),
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": (
        20,
        [((0, 19, 0), (24, 8, 0), (64, 16, 0)), ((32, 19, 0), (56, 8, 0), (80, 16, 0))],
    ),
    "RNG15_RFL8_WIN8": (4, [((0, 15, 3), (16, 8, 0), None)]),
    "RNG15_RFL8_NIR8_ZONE16": (8, [((0, 15, 3), (16, 8, 0), None)]),
    "RNG15_RFL8_NIR8": (4, [((0, 15, 3), (16, 8, 0), None)]),
    "RNG15_RFL8_NIR8_DUAL": (8, [((0, 15, 3), (16, 8, 0), None), ((32, 15, 3), (48, 8, 0), None)]),
    "FUSA_RNG15_RFL8_NIR8_DUAL": (8, [((0, 15, 3), (16, 8, 0), None), ((32, 15, 3), (48, 8, 0), None)]),
}
ENCODER_TICKS = 90112  # in a revolution, which LEGACY packets count


def crc64(data: bytes) -> int:
    """Bit by bit."""
    value = 0xFFFFFFFFFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xC96C5795D7870F42 if value & 1 else 0)
    return value ^ 0xFFFFFFFFFFFFFFFF


def pixel(profile: str, returns: list[tuple[int, int, int]]) -> bytes:
    """A pixel with these ranges in mm, reflectivities and signals."""
    size, places = PIXELS[profile]
    value = 0
    for found, fields in zip(returns, places, strict=True):
        for number, field in zip(found, fields, strict=True):
            if field:
                first, bits, dropped = field
                value |= (number >> dropped & (1 << bits) - 1) << first
    return value.to_bytes(size, "little")


def packet(
    profile: str, head: dict[str, int], columns: list[tuple[int, int, bool, list[bytes]]], per_turn: int, footer: str
) -> bytes:
    """A lidar packet: of each column time, measurement id, whether it is valid, and its pixels."""
    out = b""
    if profile.startswith("FUSA") or head.get("fusa"):
        out = struct.pack("<I", 1 | head["init"] << 8) + struct.pack("<I", head["frame"])
        out += bytes([head["alerts"], 0, 0]) + head["serial"].to_bytes(5, "little")
    elif profile != "LEGACY":
        out = struct.pack("<HH", 1, head["frame"]) + head["init"].to_bytes(3, "little")
        out += head["serial"].to_bytes(5, "little") + bytes([head["alerts"]])
    out = out.ljust(0 if profile == "LEGACY" else 32, b"\0")
    for time_ns, measurement, valid, pixels in columns:
        if profile == "LEGACY":
            encoder = measurement * ENCODER_TICKS // per_turn
            out += struct.pack("<QHHI", time_ns, measurement, head["frame"], encoder) + b"".join(pixels)
            out += struct.pack("<I", 0xFFFFFFFF if valid else 0)
        else:
            out += struct.pack("<QHH", time_ns, measurement, int(valid)) + b"".join(pixels)
    if profile == "LEGACY":
        return out
    out += bytes(24)
    ends = {"crc": struct.pack("<Q", crc64(out)), "constant": bytes.fromhex("dec00000efbeadde"), "zero": bytes(8)}
    return out + ends[footer]


def light(reflectivity: int) -> float:
    """Per cent of a white target's: twice as much with each sixteen above 100."""
    return float(reflectivity) if reflectivity <= 100 else 100 * math.exp2((reflectivity - 100) / 16)


def measured(
    range_m: float,
    reflectivity: int,
    least_m: float,
    most_m: float,
    start_mm: float,
    unit_mm: int,
    bits: int,
    scale: float,
) -> tuple[int, int, int]:
    """Range in mm, reflectivity and signal of an echo; zeros of what is beyond the limits or the packet's bits."""
    if not least_m <= range_m <= most_m:
        return 0, 0, 0
    units = round((range_m * 1000 + start_mm) / unit_mm)
    if not 0 < units < 1 << bits:
        return 0, 0, 0
    return units * unit_mm, reflectivity, min(round(scale * light(reflectivity) / range_m**2), 65535)


def points(payload: bytes, metadata: bytes) -> list[tuple[float, float, float, int, int, int, int]]:
    """x, y, z in the sensor frame, time, pixel, reflectivity and number of each return, in the order of the packet."""
    said = json.loads(metadata)
    form = said["lidar_data_format"]
    beams = said["beam_intrinsics"]
    profile = form["udp_profile_lidar"]
    lasers = form["pixels_per_column"]
    per_turn = form["columns_per_frame"]
    size, places = PIXELS[profile]
    legacy = profile == "LEGACY"
    to_beam = beams["beam_to_lidar_transform"]
    to_sensor = said["lidar_intrinsics"]["lidar_to_sensor_transform"]
    reach_mm = math.sqrt(to_beam[3] ** 2 + to_beam[11] ** 2)
    found = []
    at = 0 if legacy else 32
    for _ in range(form["columns_per_packet"]):
        time_ns, measurement, status = struct.unpack_from("<QHH", payload, at)
        start = at + (16 if legacy else 12)
        at = start + lasers * size + (4 if legacy else 0)
        valid = payload[at - 4 : at] == b"\xff\xff\xff\xff" if legacy else status & 1
        if not valid or measurement >= per_turn:
            continue
        encoder = 2 * math.pi * (1 - measurement / per_turn)
        for laser in range(lasers):
            value = int.from_bytes(payload[start + laser * size : start + (laser + 1) * size], "little")
            azimuth = encoder - math.radians(beams["beam_azimuth_angles"][laser])
            altitude = math.radians(beams["beam_altitude_angles"][laser])
            for number, ((first, bits, dropped), (bright, *_), _) in enumerate(places):
                range_mm = (value >> first & (1 << bits) - 1) << dropped
                if range_mm:
                    flat = (range_mm - reach_mm) * math.cos(altitude)
                    x = flat * math.cos(azimuth) + to_beam[3] * math.cos(encoder)
                    y = flat * math.sin(azimuth) + to_beam[3] * math.sin(encoder)
                    z = (range_mm - reach_mm) * math.sin(altitude) + to_beam[11]
                    where = [sum(to_sensor[4 * k + m] * (x, y, z, 1)[m] for m in range(4)) / 1000 for k in range(3)]
                    found.append((*where, time_ns, laser, value >> bright & 255, number))
    return found
