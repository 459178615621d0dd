"""RoboSense EMX in plain loops, from its manual (V1.0.9, tables 6 to 8) and rs_driver's formulas (decoder_RSEMX.hpp).

Bytes of MSOP that only rs_driver names: 6 (what is taken off elevations), 24 (azimuth), 27 (surface). It reads two packets
a column where byte 8 is 0: each pixel twice, the lower half of the pixels in odd packets, the upper half in even ones.
"""

import math
import struct

ROWS = 192


def msop(payload: bytes) -> dict[str, object]:
    """The header of a packet, and 192 of (distance in units, intensity, attribute)."""
    assert len(payload) == 812
    assert payload[:4].hex() == "55aa5aa5"
    number, offset, mode, clock = struct.unpack_from(">HhBB", payload, 4)
    (yaw,) = struct.unpack_from(">h", payload, 24)
    return {
        "number": number,
        "pitch_offset_deg": offset / 32768,
        "return_mode": {0: "first-last", 4: "strongest", 5: "last", 6: "first"}[mode],
        "clock": clock,
        "time_us": int.from_bytes(payload[10:16]) * 10**6 + int.from_bytes(payload[16:20]),
        "yaw_deg": yaw / 512,
        "surface": payload[27],
        "type": payload[30],
        "points": [struct.unpack_from(">HBB", payload, 32 + 4 * n) for n in range(ROWS)],
    }


def pitches_deg(payload: bytes) -> list[float]:
    """The elevations in a DIFOP packet of 500 bytes."""
    assert len(payload) == 500
    assert payload[:4].hex() == "a5ff00ae"
    assert tuple(payload[67:70]) == (2, 8, 24)  # surfaces, pixels of a VCSEL, VCSELs of a column
    return [struct.unpack_from(">h", payload, 94 + 2 * n)[0] * 0.005 for n in range(ROWS)]


def state(payload: bytes) -> dict[str, object]:
    """What a DIFOP packet of 256 bytes says."""
    assert len(payload) == 256
    assert payload[:4].hex() == "a5ff005a"
    return {
        "serial": payload[35:51].rstrip(b"\0").decode(),
        "work_mode": payload[51],
        "frame_rate": payload[52],
        "wave_mode": payload[53],
        "clock": (payload[89], payload[90]),
        "time_us": int.from_bytes(payload[91:97]) * 10**6 + int.from_bytes(payload[97:101]),
        "host": ".".join(str(byte) for byte in payload[102:106]),
        "mac": payload[110:116].hex(":"),
        "msop": (".".join(str(byte) for byte in payload[116:120]), *struct.unpack_from(">HH", payload, 120)),
        "difop": (".".join(str(byte) for byte in payload[124:128]), *struct.unpack_from(">HH", payload, 128)),
    }


def points(payload: bytes, pitch_deg: list[float]) -> list[tuple[int, int, int, int, float, float, float]]:
    """(row, which return, intensity, time in us, x, y, z) of each point with a distance: x ahead, y to the left."""
    said = msop(payload)
    pairs = said["return_mode"] == "first-last"
    found = []
    for n, (units, intensity, _) in enumerate(said["points"]):
        if not units:
            continue
        row = n // 2 + (96 if said["number"] % 2 == 0 else 0) if pairs else n
        pitch = math.radians(pitch_deg[row] - said["pitch_offset_deg"])
        yaw = math.radians(said["yaw_deg"])
        flat_m = units * 0.005 * math.cos(pitch)
        which = n % 2 if pairs else 0
        xyz = flat_m * math.cos(yaw), flat_m * math.sin(yaw), units * 0.005 * math.sin(pitch)
        found.append((row, which, intensity, said["time_us"], *xyz))
    return found
