"""RoboSense Fairy in plain loops, from its manual (48TX, V1.0: tables 8 to 13, 30) and rs_driver (decoder_RSFAIRY.hpp).

Of 96 channels only rs_driver tells: two blocks a column. So does it of byte 17 of MSOP (3: dual returns, each column twice)
and of the lens centre. DIFOP is an Airy's.
"""

import math
import struct

TURN = 36000  # hundredths of a degree
COLUMN_US = 555.55 / 8  # table 8: a packet has eight columns of 48; rs_driver has 69.462
LENS_M = math.hypot(0.01952, 0.0095)  # rs_driver: RX, RY
LENS_UP_M = 0.045  # rs_driver: RZ
FIRING_US = {
    48: [0.0] * 8 + [5.28] * 8 + [14.08] * 8 + [28.16] * 8 + [42.24] * 8 + [51.04] * 8,  # table 30
    96: [0.0] * 32 + [8.16] * 16 + [31.008] * 16 + [53.856] * 32,  # rs_driver
}


def columns(payload: bytes, channels: int) -> list[tuple[int, list[list[tuple[int, int]]]]]:
    """(azimuth in hundredths, one or two lists of (distance in units, intensity) by channel) of each column."""
    assert len(payload) == 1248
    assert payload[:4].hex() == "55aa055a"
    assert (payload[16], payload[31]) == (0, 0x0A)
    returns = 2 if payload[17] == 3 else 1
    blocks = []
    for block in range(8):
        at = 42 + 148 * block
        assert payload[at : at + 2] == b"\xff\xee"
        cells = [struct.unpack_from(">HB", payload, at + 4 + 3 * c) for c in range(48)]
        blocks.append((struct.unpack_from(">H", payload, at + 2)[0], [(raw & 0x7FFF, light) for raw, light in cells]))
    each = channels // 48
    found = []
    for first in range(0, 8, each * returns):
        together = blocks[first : first + each * returns]
        assert len({azimuth for azimuth, _ in together}) == 1
        lists = [[cell for _, cells in together[k * each : k * each + each] for cell in cells] for k in range(returns)]
        found.append((together[0][0], lists))
    return found


def points(payloads: list[bytes], channels: int, vertical_deg: list[float], horizontal_deg: list[float]):
    """(channel, which return, intensity, time in us, x, y, z): x ahead, azimuth clockwise, the lens where the head points.

    The head turns on from a column's azimuth until a channel fires, by the next column's; after the last by the speed.
    """
    seen = [columns(one, channels) for one in payloads]
    stamps_us = [int.from_bytes(one[20:26]) * 10**6 + int.from_bytes(one[26:30]) for one in payloads]
    heads = [azimuth for some in seen for azimuth, _ in some]
    for n, (some, stamp_us) in enumerate(zip(seen, stamps_us, strict=True)):
        for k, (azimuth, lists) in enumerate(some):
            at = n * len(some) + k
            step = (heads[at + 1] - azimuth) % TURN if at + 1 < len(heads) else TURN / 1440
            for which, cells in enumerate(lists):
                for channel in range(channels):
                    units, intensity = cells[channel]
                    if not units or (which and cells[channel] == lists[0][channel]):
                        continue
                    late_us = FIRING_US[channels][channel]
                    head = math.radians((azimuth + step * late_us / COLUMN_US) / 100)
                    beam = head + math.radians(horizontal_deg[channel])
                    up = math.radians(vertical_deg[channel])
                    flat_m = units * 0.005 * math.cos(up)
                    xyz = (
                        flat_m * math.cos(beam) + LENS_M * math.cos(head),
                        -flat_m * math.sin(beam) - LENS_M * math.sin(head),
                        units * 0.005 * math.sin(up) + LENS_UP_M,
                    )
                    yield channel, which, intensity, stamp_us + k * COLUMN_US + late_us, *xyz


def imu(payload: bytes) -> dict[str, object]:
    """Acceleration in m/s², angular velocity in rad/s, and the codes of rate and ranges (table 13)."""
    assert len(payload) == 51
    assert payload[:4].hex() == "aa555a05"
    assert payload[49:].hex() == "f00f"
    values = struct.unpack_from(">6f", payload, 14)
    return {"acceleration_m_s2": values[:3], "rate_rad_s": values[3:], "codes": tuple(payload[42:45])}
