"""Plain-loop twins for Hesai's packets, written from the user manuals (PandarXT, QT128C2X: section 3.1, appendix B)."""

import calendar
import csv
import math
import struct

SHAPES = {1080: (32, 8), 568: (16, 8), 820: (32, 6), 1127: (128, 2)}  # lasers and blocks by size


def angles(text: str) -> list[tuple[float, float]]:
    """Elevation and azimuth offset by channel."""
    rows = [row for row in csv.reader(text.splitlines()) if len(row) >= 3 and row[0].strip().isdigit()]
    return [(float(row[1]), float(row[2])) for row in rows]


def crc32_mpeg2(data: bytes) -> int:
    """Bit by bit."""
    value = 0xFFFFFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            top = value >> 31 ^ byte >> bit & 1
            value = (value << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if top else 0)
    return value


def stamp_us(payload: bytes) -> int:
    """UTC in microseconds."""
    at = 1076 if len(payload) == 1127 else len(payload) - 15
    year, month, day, hour, minute, second = payload[at : at + 6]
    whole = calendar.timegm((1900 + year, month, day, hour, minute, second))
    return whole * 10**6 + struct.unpack_from("<I", payload, at + 6)[0]


def points(payload: bytes, table: list[tuple[float, float]]) -> list[tuple[float, float, float, int, int, int]]:
    """x, y, z, reflectivity, channel and block of each return, but for the second of two that are alike."""
    lasers, blocks = SHAPES[len(payload)]
    assert payload[:2] == b"\xee\xff"
    assert (payload[6], payload[7]) == (lasers, blocks)
    unit_m = payload[9] / 1000
    found = []
    for block in range(blocks):
        at = 12 + block * (2 + 4 * lasers)
        azimuth = struct.unpack_from("<H", payload, at)[0] / 100
        for channel in range(lasers):
            here = at + 2 + 4 * channel
            distance, reflectivity = struct.unpack_from("<HB", payload, here)
            twin = here - (2 + 4 * lasers)
            if not distance or (block % 2 and payload[10] > 1 and payload[here : here + 3] == payload[twin : twin + 3]):
                continue
            elevation, offset = table[channel]
            flat = distance * unit_m * math.cos(math.radians(elevation))
            angle = math.radians(azimuth + offset)
            z = distance * unit_m * math.sin(math.radians(elevation))
            found.append((flat * math.sin(angle), flat * math.cos(angle), z, reflectivity, channel, block))
    return found


def fire_times_us(size: int) -> list[float]:
    """Of the channels in Hesai's firing time files for the sensors of protocol 6.1."""
    step = {1080: 1.512, 568: 3.024, 820: 2.888}[size]
    return [6 + step * (channel % 16 if size == 820 else channel) for channel in range(SHAPES[size][0])]


def driver_points(
    payload: bytes, table: list[tuple[float, float]], loops: list[list[float]]
) -> list[tuple[float, float, float, int, int]]:
    """x, y, z, nanoseconds and channel of each return, but for the second of two that are alike.

    As ComputeXYZI of Hesai's SDK 2.0.11 has it (udp6_1_parser.cc, udp3_2_parser.cc) with firing times in microseconds.
    """
    lasers, blocks = SHAPES[len(payload)]
    qt128 = len(payload) == 1127
    tail = 1073 if qt128 else len(payload) - 18
    mode = payload[tail]
    rpm = struct.unpack_from("<H", payload, tail + 1)[0]
    returns = 2 if mode >= 0x39 else 1
    found = []
    for block in range(blocks):
        at = 12 + block * (2 + 4 * lasers)
        block_ns = 9000 + 111110 * (block // returns) if qt128 else -50000 * ((blocks - block - 1) // returns)
        loop = (payload[1066] + block // returns + 1) % 2 if qt128 else 0
        for channel in range(lasers):
            here = at + 2 + 4 * channel
            twin = here - (2 + 4 * lasers)
            distance = struct.unpack_from("<H", payload, here)[0]
            if not distance or (block % 2 and returns == 2 and payload[here : here + 3] == payload[twin : twin + 3]):
                continue
            azimuth = struct.unpack_from("<H", payload, at)[0] / 100
            azimuth += loops[loop][channel] * rpm * 6e-6
            elevation, offset = table[channel]
            angle = math.radians(azimuth + offset)
            range_m = distance * payload[9] / 1000
            flat = range_m * math.cos(math.radians(elevation))
            z = range_m * math.sin(math.radians(elevation))
            time_ns = stamp_us(payload) * 1000 + block_ns + round(loops[loop][channel] * 1000)
            found.append((flat * math.sin(angle), flat * math.cos(angle), z, time_ns, channel))
    return found
