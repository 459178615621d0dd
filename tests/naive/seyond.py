"""Seyond's packets in plain loops, from inno_lidar_packet.h and inno_lidar_packet_utils of inno-lidar-sdk 3.103.4.

Bit fields are taken from the bytes as one long little-endian integer, as GCC lays out packed structs. Coordinates are
turned from the SDK's (x up, y right, z ahead) into ours (x ahead, y left, z up).
"""

import math
import struct
from typing import NamedTuple

HEAD = struct.Struct("<HBBHIIBBdBBQHHIHIHhh")  # 54 bytes: InnoDataPacketV1, up to its points
UNIT_RAD = math.pi / 32768


class Point(NamedTuple):
    """One point with a distance."""

    xyz: tuple[float, float, float]
    time_ns: int
    channel: int
    reflectance: int
    second: int
    which: int  # 0 or 1: the place among the returns of its channel
    scan_id: int
    scan_idx: int
    roi: int


def crc32c(data: bytes) -> int:
    """Castagnoli's, bit by bit."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def checks(payload: bytes) -> bool:
    """Whether the CRC is that of the version, and of all from the size on (calculate_packet_crc32)."""
    return int.from_bytes(payload[6:10], "little") == crc32c(payload[:6] + payload[10:])


def header(payload: bytes) -> dict[str, float]:
    """The fields before the points."""
    names = "magic major minor firmware crc size clock lidar start_us mode status frame sub_frame sequence"
    names += " type_count item_size topic flags roi_h roi_v"
    found = dict(zip(names.split(), HEAD.unpack_from(payload), strict=True))
    found["type"] = found["type_count"] & 0xFF
    found["count"] = found["type_count"] >> 8
    found["returns"] = found["flags"] >> 2 & 7
    found["last_sub_frame"] = found["flags"] >> 7 & 1
    found["first_sub_frame"] = found["flags"] >> 11 & 1
    found["long"] = found["flags"] >> 13 & 1
    return found


class Bits:
    """Bit fields that follow each other."""

    def __init__(self, data: bytes) -> None:
        self.value = int.from_bytes(data, "little")

    def take(self, width: int, signed: bool = False) -> int:
        """The next one."""
        found = self.value & ((1 << width) - 1)
        self.value >>= width
        return found - (1 << width) if signed and found >> (width - 1) else found


def int16(value: int) -> int:
    """What an int16_t keeps of it."""
    return (value + 32768) % 65536 - 32768


def towards_zero(value: int, by: int) -> int:
    """C's division."""
    return abs(value) // by * (1 if value >= 0 else -1)


def falcon_start(table, h: int, v: int, channel: int) -> tuple[float, float, float]:
    """lookup_xz_adjustment_: up, right, ahead; cells beyond 13 x 45 are 0."""
    row = (towards_zero(v, 512) + 6) & 15
    column = (towards_zero(h, 512) + 22) & 63
    if row >= len(table) or column >= len(table[0]):
        return 0.0, 0.0, 0.0
    up, ahead = table[row][column][channel]
    return int(up) * 0.0025, 0.0, int(ahead) * 0.0025


def robin_start(table, h: int, line: int) -> list[float]:
    """lookup_xyz_adjustment_: up, right, ahead; cells beyond 55 are 0."""
    turned = h + (27 << 9)
    cell = min((turned >> 9) & 63, 62)
    offset = turned & 511
    found = []
    for axis in range(3):
        one, other = (int(table[line][at][axis]) if at < len(table[line]) else 0 for at in (cell, cell + 1))
        found.append(((one * (512 - offset) + other * offset + 256) >> 9) * 0.001)
    return found


def table_angles(payload: bytes, facet: int, polygon: int, scan: int) -> list[tuple[int, int]]:
    """get_block_full_angles_interpolate_impl: h and v of the eight receivers, by a table packet."""
    total = max(polygon + 8192, 0)
    index = min(total >> 8, 63)
    offset = total & 255
    found = []
    for receiver in range(8):
        at = [70 + 10 + 4 * (((facet * 65 + index + step) * 6 + scan) * 8 + receiver) for step in (0, 1)]
        (v, h), (next_v, next_h) = (struct.unpack_from("<hh", payload, one) for one in at)
        found.append(((h * (256 - offset) + next_h * offset) >> 8, (v * (256 - offset) + next_v * offset) >> 8))
    return found


def points(payload: bytes, starts, table: bytes = b"") -> list[Point]:
    """The points with a distance, block by block, channel by channel; `starts` are the tables of seyond-starts.npz."""
    head = header(payload)
    at = 54 if head["major"] == 1 else 70
    returns = 1 if head["returns"] == 1 else 2
    start_ns = int(head["start_us"]) * 1000 + round(head["start_us"] % 1 * 1000)
    found = []
    for _ in range(head["count"]):
        block = payload[at : at + head["item_size"]]
        at += head["item_size"]
        if head["type"] == 13:
            polygon, _, ticks, column = struct.unpack_from("<hhHH", block)
            bits = Bits(block[8:10])
            scan, roi, facet = bits.take(9), bits.take(2), bits.take(3)
            if scan >= 6 or facet >= 4:
                continue
            angles = table_angles(table, facet, polygon, scan)
            size, channels, body = 4, 8, 10
        else:
            h, v, ticks = struct.unpack_from("<hhH", block)
            if head["type"] == 1:
                (column,) = struct.unpack_from("<H", block, 6)
                bits = Bits(block[8:17])
                scan = bits.take(9)
                apart_h = [0, *(bits.take(width, True) for width in (9, 10, 11))]
                apart_v = [0, *(bits.take(width, True) for width in (8, 9, 9))]
                roi, facet = bits.take(2), bits.take(3)
                size, body = 4, 17
            else:
                bits = Bits(block[6:14])
                apart_h = [0, *(bits.take(width, True) for width in (11, 11, 12))]
                apart_v = [0, *(bits.take(width, True) for width in (10, 10, 10))]
                (column,) = struct.unpack_from("<H", block, 14)
                bits = Bits(block[16:18])
                scan, roi, facet = bits.take(9), bits.take(2), bits.take(3)
                size, body = 8, 18
            channels = 4
            angles = [(int16(h + apart_h[c]), int16(v + apart_v[c] + 196 * c)) for c in range(4)]
        for channel in range(channels):
            h, v = angles[channel]
            if head["type"] == 13 and not -10922 <= h <= 10922:
                continue
            for which in range(returns):
                place = body + size * (which * channels + channel)
                bits = Bits(block[place : place + size])
                if head["type"] == 1:
                    radius, refl, second = bits.take(17), bits.take(8), bits.take(1)
                    metres = (radius << head["long"]) / 200
                elif head["type"] == 9:
                    refl, _, _, second, radius = (bits.take(width) for width in (16, 16, 7, 1, 19))
                    metres = radius / 400
                else:
                    refl, radius, second = bits.take(12), bits.take(18), bits.take(1)
                    metres = radius / 400
                if radius == 0:
                    continue
                line = scan
                if head["type"] == 13:
                    order = scan * 8 + channel
                    line = [0, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40, 44][order % 12] + order // 12 + 48 * facet
                    start = robin_start(starts["robin_w"], h, line)
                else:
                    start = falcon_start(starts["falcon"], h, v, channel)
                up = metres * math.sin(v * UNIT_RAD) + start[0]
                right = metres * math.cos(v * UNIT_RAD) * math.sin(h * UNIT_RAD) + start[1]
                ahead = metres * math.cos(v * UNIT_RAD) * math.cos(h * UNIT_RAD) + start[2]
                time_ns = start_ns + ticks * 10_000
                found.append(
                    Point((ahead, -right, up), time_ns, channel, refl, second, which, line, column, roi),
                )
    return found
