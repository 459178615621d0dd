"""Plain-loop twins of the packet encoder and decoder, written from the VLP-16 manual (63-9243 Rev D)."""

import math
import struct

ELEVATION_DEG = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15]
VERTICAL_MM = [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]


def firing_ns(sequence: int, laser: int) -> int:
    """Since the packet's first firing."""
    return sequence * 55296 + laser * 2304


def head_deg(time_ns: int, rpm: int) -> float:
    """The head's azimuth at a time since it stood at 0; exact up to the last division."""
    return (time_ns * rpm * 360 % (60 * 10**9 * 360)) / (60 * 10**9)


def encode(stamp_us: int, azimuths: list[int], returns: list[list[tuple[int, int]]]) -> bytes:
    """12 azimuths in hundredths of a degree, 24 sequences of 16 (distance in 2 mm, intensity)."""
    out = b""
    for block in range(12):
        out += b"\xff\xee" + struct.pack("<H", azimuths[block])
        for sequence in (2 * block, 2 * block + 1):
            for distance, intensity in returns[sequence]:
                out += struct.pack("<HB", distance, intensity)
    return out + struct.pack("<I", stamp_us) + b"\x37\x22"


def decode(payload: bytes, following: bytes | None) -> list[tuple[float, float, float, int, int, int, float]]:
    """x, y, z in metres, intensity, laser, ns since the first firing, azimuth in degrees of each return."""
    azimuths = [struct.unpack_from("<H", payload, 100 * block + 2)[0] for block in range(12)]
    points = []
    for block in range(12):
        if block < 11:
            step = (azimuths[block + 1] - azimuths[block]) % 36000
        elif following is not None:
            step = (struct.unpack_from("<H", following, 2)[0] - azimuths[11]) % 36000
        else:
            step = (azimuths[11] - azimuths[10]) % 36000
        for slot in range(32):
            distance, intensity = struct.unpack_from("<HB", payload, 100 * block + 4 + 3 * slot)
            if distance == 0:
                continue
            into_block = firing_ns(slot // 16, slot % 16)
            azimuth = (azimuths[block] + step * into_block / 110592) / 100
            a, w, r = math.radians(azimuth), math.radians(ELEVATION_DEG[slot % 16]), distance * 0.002
            z = r * math.sin(w) + VERTICAL_MM[slot % 16] / 1000
            x, y = r * math.cos(w) * math.cos(a), -r * math.cos(w) * math.sin(a)
            points.append((x, y, z, intensity, slot % 16, block * 110592 + into_block, azimuth))
    return points


def nmea_checksum(sentence: bytes) -> str:
    """Of what stands between $ and *."""
    value = 0
    for byte in sentence[1 : sentence.index(b"*")]:
        value ^= byte
    return f"{value:02X}"
