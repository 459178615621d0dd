"""RoboSense's packets in plain loops, from the manuals of Helios 16 and Helios 32 (V1.1) and rs_driver's geometry."""

import math
import struct

LENS_M = 0.03498


def seconds_us(payload: bytes, at: int) -> int:
    """A stamp in microseconds: six bytes of seconds, four of microseconds."""
    return int.from_bytes(payload[at : at + 6]) * 10**6 + int.from_bytes(payload[at + 6 : at + 10])


def difop_angles(payload: bytes) -> tuple[list[float], list[float]]:
    """Vertical and horizontal angles in degrees, of 32 lasers."""
    assert payload[:8].hex() == "a5ff005a11115555"
    assert payload[1246:].hex() == "0ff0"
    out = []
    for first in (468, 564):
        found = []
        for k in range(32):
            sign, hundredths = struct.unpack_from(">BH", payload, first + 3 * k)
            found.append((-hundredths if sign == 1 else hundredths) / 100)
        out.append(found)
    return out[0], out[1]


def azimuths(payload: bytes) -> list[int]:
    """Of the 12 blocks, in hundredths of a degree."""
    return [struct.unpack_from(">H", payload, 42 + 100 * b + 2)[0] for b in range(12)]


def cells(payload: bytes):
    """Block, place in the block, distance in units and intensity of each channel."""
    for b in range(12):
        assert payload[42 + 100 * b : 44 + 100 * b] == b"\xff\xee"
        for c in range(32):
            yield b, c, *struct.unpack_from(">HB", payload, 42 + 100 * b + 4 + 3 * c)


def point(units: int, head_deg: float, vertical_deg: float, horizontal_deg: float) -> tuple[float, float, float]:
    """As rs_driver has it: the lens lies ahead of the axis, x is forward, azimuth clockwise."""
    r = units * 0.0025
    w = math.radians(vertical_deg)
    h = math.radians(head_deg)
    a = math.radians(head_deg + horizontal_deg)
    return (
        r * math.cos(w) * math.cos(a) + LENS_M * math.cos(h),
        -r * math.cos(w) * math.sin(a) - LENS_M * math.sin(h),
        r * math.sin(w),
    )


def single(payloads: list[bytes], lasers: int, vertical: list[float], horizontal: list[float], first_us: float = 0.0):
    """(laser, intensity, time in ns, x, y, z) of single returns in packets that follow each other at once.

    All lasers fire every 1/18000 s, one every 1.73 us, the first so long after the stamp.
    """
    per_block = 32 // lasers
    for p, payload in enumerate(payloads):
        assert payload[:4].hex() == "55aa055a"
        azimuth = azimuths(payload)
        after = azimuths(payloads[p + 1])[0] if p + 1 < len(payloads) else None
        for b, c, units, intensity in cells(payload):
            if not units:
                continue
            to = azimuth[b + 1] if b < 11 else after
            step = (to - azimuth[b]) % 36000 if to is not None else (azimuth[b] - azimuth[b - 1]) % 36000
            laser = c % lasers
            within = c // lasers
            part = (within * 55.556 + 1.73 * laser) / (per_block * 55.556)
            head_deg = (azimuth[b] + step * part) / 100
            late_us = (b * per_block + within) * 55.556 + first_us + 1.73 * laser
            time_ns = seconds_us(payload, 20) * 1000 + late_us * 1000
            yield laser, intensity, time_ns, *point(units, head_deg, vertical[laser], horizontal[laser])


def as_rs_driver_reads_a_16p(payloads: list[bytes], vertical: list[float], horizontal: list[float]):
    """(laser, intensity, time in ns, x, y, z) of single returns, by decoder_RSHELIOS_16P.hpp: 1.73 us from place to place.

    It cuts azimuths to hundredths of a degree, and takes the last block's step from the speed; this does neither.
    """
    for p, payload in enumerate(payloads):
        azimuth = azimuths(payload)
        after = azimuths(payloads[p + 1])[0] if p + 1 < len(payloads) else azimuth[-1] + azimuth[-1] - azimuth[-2]
        for b, c, units, intensity in cells(payload):
            if not units:
                continue
            step = ([*azimuth, after][b + 1] - azimuth[b]) % 36000
            late_us = 1.73 * c
            head_deg = (azimuth[b] + step * late_us / (2 * 55.56)) / 100
            time_ns = seconds_us(payload, 20) * 1000 + (b * 2 * 55.56 + late_us) * 1000
            yield c % 16, intensity, time_ns, *point(units, head_deg, vertical[c % 16], horizontal[c % 16])


def dual_cells(payload: bytes, lasers: int):
    """(azimuth, laser, [units, intensity] of the first return, and of the second) of a packet with dual returns."""
    azimuth = azimuths(payload)
    found = {(b, c): rest for b, c, *rest in cells(payload)}
    for b in range(0, 12, lasers // 16):
        for laser in range(lasers):
            second = (b, laser + 16) if lasers == 16 else (b + 1, laser)
            assert azimuth[second[0]] == azimuth[b]
            yield azimuth[b], laser, found[b, laser], found[second]
