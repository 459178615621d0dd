"""A plain-loop decoder of Hesai's protocol 1.4: OT128, JT128 and Pandar128 (E3X).

Sources: Hesai SDK 2.0 `udp_protocol_v1_4.h` (sizes, the options in the flag byte, tail, IMU), `udp1_4_parser.cc` (which
option byte follows which), `udp_parser.cc` (the model in byte 4); Nebula `hesai_packet.hpp` (dates, return modes),
`pandar_128e3x.hpp` (azimuth state, functional safety) and `pandar_128e4x.hpp` (block order of first and last). The
reach of the three CRC-32/MPEG-2 is that which recordings of the QT128C2X, whose packet has the same parts, have.
"""

import calendar
import struct
from typing import NamedTuple

SEQUENCE = 0x01
IMU = 0x02
SAFETY = 0x04
SIGNATURE = 0x08
UNIT_OPTIONS = (0x10, 0x20, 0x40)  # confidence, weight factor, environment light: a byte each

SINGLE = {0x33: "first", 0x34: "second", 0x37: "strongest", 0x38: "last"}
DUAL = {  # by block of a pair
    0x39: ("last", "strongest"),
    0x3A: ("first", "second"),
    0x3B: ("last", "first"),
    0x3C: ("first", "strongest"),
    0x3E: ("strongest", "second strongest"),
}
FIRST_BLOCK_STRONGEST = 2  # byte 8; 1: the first block is the last return


class Point(NamedTuple):
    channel: int  # from 0
    azimuth_deg: float  # of the block
    distance_m: float
    reflectivity: int
    block: int
    kind: str
    time_us: int  # of the packet, UTC


class Tail(NamedTuple):
    model: str
    azimuth_states: tuple[int, ...]  # by block
    operation: int
    return_mode: int
    motor_speed: int  # as sent
    time_us: int
    sequence: int | None
    temperature_deg_c: float | None
    acceleration: tuple[float, float, float] | None  # in the unit that the packet names
    angular_rate: tuple[float, float, float] | None


def crc32_mpeg2(data: bytes) -> int:
    """Bit by bit: polynomial 04C11DB7, not reflected, all ones at first, no final xor."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte << 24
        for _ in range(8):
            carry = value & 0x80000000
            value = value << 1 & 0xFFFFFFFF
            if carry:
                value ^= 0x04C11DB7
    return value


def model(payload: bytes) -> str:
    version = payload[4]
    if version >= 137:
        return "JT128"
    if version > 127:
        return "OT128"
    return "Pandar128"


def unit_size(flags: int) -> int:
    size = 3
    for option in UNIT_OPTIONS:
        if flags & option:
            size += 1
    return size


def parts(payload: bytes) -> dict[str, tuple[int, int]]:
    """Where each part begins and ends."""
    flags = payload[11]
    sizes = [
        ("header", 12),
        ("body", payload[7] * (2 + payload[6] * unit_size(flags))),
        ("body crc", 4),
        ("safety", 17 if flags & SAFETY else 0),
        ("tail", 9 + 2 + 1 + 1 + 2 + 6 + 4 + 1),
        ("sequence", 4 if flags & SEQUENCE else 0),
        ("imu", 22 if flags & IMU else 0),
        ("tail crc", 4),
        ("signature", 32 if flags & SIGNATURE else 0),
    ]
    found = {}
    at = 0
    for name, size in sizes:
        found[name] = (at, at + size)
        at += size
    assert at == len(payload), (at, len(payload))
    return found


def check(payload: bytes) -> None:
    """Delimiter, protocol, size and all CRCs."""
    assert payload[:4] == b"\xee\xff\x01\x04"
    where = parts(payload)
    begin, end = where["body"]
    assert struct.unpack_from("<I", payload, end)[0] == crc32_mpeg2(payload[begin:end])
    begin, end = where["safety"]
    if end > begin:  # the version byte is not in it
        assert struct.unpack_from("<I", payload, end - 4)[0] == crc32_mpeg2(payload[begin + 1 : end - 4])
    begin = where["tail"][0]
    end = where["tail crc"][0]
    assert struct.unpack_from("<I", payload, end)[0] == crc32_mpeg2(payload[begin:end])


def time_us(payload: bytes) -> int:
    """UTC of the packet: years after 1900; year 0: whole seconds, most significant byte first."""
    at = parts(payload)["tail"][0] + 15
    year, month, day, hour, minute, second = payload[at : at + 6]
    if year:
        whole = calendar.timegm((1900 + year, month, day, hour, minute, second))
    else:
        whole = int.from_bytes(payload[at + 1 : at + 6], "big")
    return whole * 10**6 + struct.unpack_from("<I", payload, at + 6)[0]


def kinds(payload: bytes) -> list[str]:
    """What each block's returns are."""
    mode = payload[parts(payload)["tail"][0] + 12]
    blocks = payload[7]
    if mode in SINGLE:
        return [SINGLE[mode]] * blocks
    pair = DUAL[mode]
    if mode == 0x39 and payload[8] == FIRST_BLOCK_STRONGEST:
        pair = ("strongest", "last")
    return [pair[block % 2] for block in range(blocks)]


def tail(payload: bytes) -> Tail:
    where = parts(payload)
    at = where["tail"][0]
    state, operation, mode, speed = struct.unpack_from("<HBBH", payload, at + 9)
    states = tuple(state >> 14 - 2 * block & 3 for block in range(payload[7]))
    sequence = None
    if payload[11] & SEQUENCE:
        sequence = struct.unpack_from("<I", payload, where["sequence"][0])[0]
    temperature = None
    acceleration = None
    rate = None
    if payload[11] & IMU:
        values = struct.unpack_from("<hHHI6h", payload, where["imu"][0])
        temperature = values[0] / 100
        acceleration = (values[4] * values[1] / 1e6, values[5] * values[1] / 1e6, values[6] * values[1] / 1e6)
        rate = (values[7] * values[2] / 1e5, values[8] * values[2] / 1e5, values[9] * values[2] / 1e5)
    return Tail(
        model(payload),
        states,
        operation,
        mode,
        speed,
        time_us(payload),
        sequence,
        temperature,
        acceleration,
        rate,
    )


def points(payload: bytes) -> list[Point]:
    """Every return of a distance above 0, of both blocks of a pair, block by block."""
    check(payload)
    lasers = payload[6]
    unit_m = payload[9] / 1000
    step = unit_size(payload[11])
    when = time_us(payload)
    kind = kinds(payload)
    found = []
    at = 12
    for block in range(payload[7]):
        azimuth = struct.unpack_from("<H", payload, at)[0]
        at += 2
        for channel in range(lasers):
            distance, reflectivity = struct.unpack_from("<HB", payload, at)
            if distance:
                point = Point(channel, azimuth / 100, distance * unit_m, reflectivity, block, kind[block], when)
                found.append(point)
            at += step
    return found
