"""Plain-loop twins of the packet encoder and decoder, written from the VLP-16 manual (63-9243 Rev D); other layouts by
the facts in sensors/*.yaml."""

import math
import struct
from datetime import datetime

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


def encode_any(flags, sequences_per_block, order, by, stamp_us, azimuths, returns, tail: bytes) -> bytes:
    """Any layout: azimuths of the blocks' times, in hundredths; returns[sequence][laser] of (distance, intensity).

    With dual returns each is a pair, strongest and last: `order` names which comes first, `by` what is repeated.
    """
    blocks = []
    times = 12 // (len(flags) * (2 if order else 1))
    for time in range(times):
        turns = [("strongest", k) for k in range(len(flags))]
        if order and by == "block":
            turns = [(which, k) for k in range(len(flags)) for which in order]
        elif order:
            turns = [(which, k) for which in order for k in range(len(flags))]
        for which, k in turns:
            block = struct.pack("<HH", flags[k], azimuths[time])
            for slot in range(32):
                lasers = len(returns[0])
                if sequences_per_block > 1:
                    sequence = time * sequences_per_block + slot // lasers
                    laser = slot % lasers
                else:
                    sequence = time
                    laser = 32 * k + slot
                found = returns[sequence][laser]
                if order:
                    found = found[0] if which == "strongest" else found[1]
                block += struct.pack("<HB", *found)
            blocks.append(block)
    return b"".join(blocks).ljust(1200, b"\0") + struct.pack("<I", stamp_us) + tail


def unit_point(beam: dict[str, float], raw: int, unit_m: float, azimuth: float) -> tuple[float, float, float]:
    """x, y, z in metres of a raw distance by one beam's whole calibration (HDL-64E manual, velodyne_decoder 3.1)."""
    a = azimuth + math.radians(beam["azimuth_offset_deg"])
    w = math.radians(beam["elevation_deg"])
    left = beam["lateral_offset_mm"] / 1000
    far = beam["distance_offset_mm"] / 1000
    r = for_x = for_y = raw * unit_m + far
    if raw * unit_m < 25.04:
        x = abs(r * math.cos(w) * math.sin(a) - left * math.cos(a))
        y = abs(r * math.cos(w) * math.cos(a) + left * math.sin(a))
        for_y += (beam["near_x_offset_mm"] / 1000 - far) * (25.04 - x) / (25.04 - 2.4)
        for_x += (beam["near_y_offset_mm"] / 1000 - far) * (25.04 - y) / (25.04 - 1.93)
    return (
        for_x * math.cos(w) * math.cos(a) + left * math.sin(a),
        left * math.cos(a) - for_y * math.cos(w) * math.sin(a),
        (for_x + for_y) / 2 * math.sin(w) + beam["vertical_offset_mm"] / 1000,
    )


def unit_distance(beam: dict[str, float], range_m: float, unit_m: float, azimuth: float) -> int:
    """Whole units, of all those around, whose point is nearest along the beam; the far ones where these will do."""
    a = azimuth + math.radians(beam["azimuth_offset_deg"])
    w = math.radians(beam["elevation_deg"])
    far = round((range_m - beam["distance_offset_mm"] / 1000) / unit_m)
    if far * unit_m >= 25.04:
        return far

    def away(raw: int) -> float:
        x, y, z = unit_point(beam, raw, unit_m, azimuth)
        x -= beam["lateral_offset_mm"] / 1000 * math.sin(a)
        y -= beam["lateral_offset_mm"] / 1000 * math.cos(a)
        z -= beam["vertical_offset_mm"] / 1000
        return abs(x * math.cos(w) * math.cos(a) - y * math.cos(w) * math.sin(a) + z * math.sin(w) - range_m)

    return min(range(far - 100, far + 101), key=away)


def unit_intensity(beam: dict[str, float], raw: int, intensity: int) -> int:
    """The byte, of all, that is corrected by the focal distance to this intensity, or to what is nearest to it."""
    raised = beam["focal_slope"] * abs(
        256 * (1 - beam["focal_distance_mm"] / 131_000) ** 2 - 256 * (1 - raw / 65535) ** 2
    )

    def away(byte: int) -> tuple[float, float]:
        corrected = round(min(max(byte + raised, beam["intensity_min"]), beam["intensity_max"]))
        return abs(corrected - intensity), abs(byte + raised - intensity)

    return min(range(256), key=away)


def status(packet: int, when: datetime, letters: str, warnings: str, gps: int, calibration: bytes) -> bytes:
    """Type and value of packet number `packet` since 1970: the letters, then seven bytes of the calibration."""
    cycle = packet // (len(letters) + 7)
    place = packet % (len(letters) + 7)
    if place < len(letters):
        values = {
            "H": when.hour,
            "M": when.minute,
            "S": when.second,
            "D": when.day,
            "N": when.month,
            "Y": when.year - 2000,
            "G": gps,
        }
        return bytes([ord(letters[place]), values.get(letters[place], 0)])
    at = (7 * cycle + place - len(letters)) % len(calibration)
    kind = warnings if warnings and at == len(calibration) - 4 else "1234567"[at % 7]
    return bytes([ord(kind), calibration[at]])


def checksum(octets: bytes) -> int:
    """Of the Internet (RFC 1071), word by word."""
    total = 0
    for i in range(0, len(octets), 2):
        total += int.from_bytes(octets[i : i + 2].ljust(2, b"\0"), "big")
        total = (total & 0xFFFF) + (total >> 16)
    return 0xFFFF - total


def frame(macs: bytes, ttl: int, flags: int, number: int, hosts: bytes, ports: tuple[int, int], summed: bool, payload: bytes) -> bytes:  # fmt: skip
    """Ethernet, IP without options, UDP; macs are destination and source, hosts source and destination."""
    ip = struct.pack(">BBHHHBBH", 0x45, 0, 28 + len(payload), number, flags, ttl, 17, 0) + hosts
    ip = ip[:10] + struct.pack(">H", checksum(ip)) + ip[12:]
    udp = struct.pack(">HHHH", *ports, 8 + len(payload), 0)
    if summed:
        found = checksum(hosts + struct.pack(">HH", 17, len(udp) + len(payload)) + udp + payload)
        udp = udp[:6] + struct.pack(">H", found or 0xFFFF)
    return macs + b"\x08\x00" + ip + udp + payload


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
            a = math.radians(azimuth)
            w = math.radians(ELEVATION_DEG[slot % 16])
            r = distance * 0.002
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


def records(data: bytes, order: str, most: int) -> tuple[list[int], int, int]:
    """Where a pcap's whole records start, where the last one ends, and the size last read, in either byte order."""
    starts = []
    at = 0
    size = 0
    while at + 16 <= len(data):
        size = struct.unpack_from(order + "I", data, at + 8)[0]
        if size > most or at + 16 + size > len(data):
            break
        starts.append(at)
        at += 16 + size
    return starts, at, size
