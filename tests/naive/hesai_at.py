"""Plain-loop twins for Hesai's AT series, written from HesaiLidar_SDK_2.0: udp_protocol_v4_3.h, udp4_3_parser.cc."""

import math
import struct


def corrections(content: bytes) -> dict:
    """An AT128's angle correction file, angles in degrees."""
    lasers, facets, frames = content[4:7]
    unit = content[15]
    at = 16
    edges = [value * unit / 25600 for value in struct.unpack_from(f"<{2 * facets}I", content, at)]
    at += 8 * facets
    azimuth = [value * unit / 25600 for value in struct.unpack_from(f"<{lasers}i", content, at)]
    at += 4 * lasers
    elevation = [value * unit / 25600 for value in struct.unpack_from(f"<{lasers}i", content, at)]
    at += 4 * lasers
    tables = []
    for _ in range(2):
        flat = [value * unit / 100 for value in struct.unpack_from(f"{lasers * 180}b", content, at)]
        tables.append([flat[k * 180 : k * 180 + 180] for k in range(lasers)])
        at += lasers * 180
    return {
        "start": edges[:frames],
        "end": edges[facets : facets + frames],
        "azimuth": azimuth,
        "elevation": elevation,
        "azimuth_adjust": tables[0],
        "elevation_adjust": tables[1],
    }


def adjustment(row: list[float], angle: float, whole: bool) -> float:
    """Between two entries, which are 2 degrees apart; by whole degrees only, as Hesai's SDK has it."""
    if whole:
        angle = math.floor(angle)
    low = int(angle // 2)
    part = angle / 2 - low
    return (1 - part) * row[low] + part * row[(low + 1) % 180]


def pointing(table: dict, angle: float, laser: int, whole: bool = False) -> tuple[float, float] | None:
    """Azimuth from the y axis and elevation of a laser, in degrees, by the mirror's angle; none between facets."""
    for start, end in zip(table["start"], table["end"], strict=True):
        width = (end - start) % 360
        turned = (angle - start) % 360
        if turned <= width:
            azimuth = 2 * turned - table["azimuth"][laser] + adjustment(table["azimuth_adjust"][laser], angle, whole)
            elevation = table["elevation"][laser] + adjustment(table["elevation_adjust"][laser], angle, whole)
            return azimuth, elevation
    return None


def points(payload: bytes, table: dict, whole: bool = False) -> list[tuple]:
    """(laser, reflectivity, block, x, y, z) of each return of an AT128, but for the second of two that are alike."""
    assert payload[:4] == b"\xee\xff\x04\x03"
    lasers, blocks, _, unit_mm, returns = payload[6:11]
    found = []
    for block in range(blocks):
        at = 12 + block * (3 + 4 * lasers)
        hundredths, fine = struct.unpack_from("<HB", payload, at)
        angle = hundredths / 100 + fine / 25600
        for laser in range(lasers):
            here = at + 3 + 4 * laser
            distance, reflectivity = struct.unpack_from("<HB", payload, here)
            twin = here - (3 + 4 * lasers)
            if not distance or (block % 2 and returns > 1 and payload[here : here + 3] == payload[twin : twin + 3]):
                continue
            where = pointing(table, angle, laser, whole)
            if where is None:
                continue
            azimuth, elevation = map(math.radians, where)
            range_m = distance * unit_mm / 1000
            flat = range_m * math.cos(elevation)
            xyz = flat * math.sin(azimuth), flat * math.cos(azimuth), range_m * math.sin(elevation)
            found.append((laser, reflectivity, block, *xyz))
    return found


def stamp_us(payload: bytes) -> int:
    """UTC in microseconds: of the seconds the most significant byte is the first."""
    lasers, blocks = payload[6:8]
    tail = 12 + blocks * (3 + 4 * lasers) + 4
    (microseconds,) = struct.unpack_from("<I", payload, tail + 20)
    assert payload[tail + 26] == 0
    (seconds,) = struct.unpack_from(">I", payload, tail + 28)
    return seconds * 10**6 + microseconds


def atx_corrections(content: bytes) -> dict:
    """An ATX's angle correction file, from udp_protocol_v4_7.h: azimuths of even and odd frames, elevations."""
    lasers = content[6]
    (units,) = struct.unpack_from("<H", content, 7)
    flat = [value / units for value in struct.unpack_from(f"<{3 * lasers}h", content, 9)]
    return {"azimuth": [flat[:lasers], flat[lasers : 2 * lasers]], "elevation": flat[2 * lasers :]}


def atx_points(payload: bytes, table: dict, times_ns: list[list[int]]) -> list[tuple]:
    """(laser, reflectivity, block, x, y, z) of each return of an ATX, as udp4_7_parser.cc has it with firing times."""
    assert payload[:4] == b"\xee\xff\x04\x07"
    lasers, blocks, _, unit_mm, returns = payload[6:11]
    tail = 12 + blocks * (3 + 4 * lasers) + 4
    frame = payload[tail + 10] % 2
    (speed,) = struct.unpack_from("<h", payload, tail + 18)
    found = []
    for block in range(blocks):
        at = 12 + block * (3 + 4 * lasers)
        (angle,) = struct.unpack_from("<H", payload, at)
        for laser in range(lasers):
            here = at + 3 + 4 * laser
            distance, reflectivity = struct.unpack_from("<HB", payload, here)
            twin = here - (3 + 4 * lasers)
            if not distance or (block % 2 and returns > 1 and payload[here : here + 3] == payload[twin : twin + 3]):
                continue
            turned = times_ns[frame][laser] * abs(speed) * 1e-9 / 8
            azimuth = math.radians(angle / 256 + table["azimuth"][frame][laser] + (-turned if frame else turned))
            elevation = math.radians(table["elevation"][laser])
            range_m = distance * unit_mm / 1000
            flat = range_m * math.cos(elevation)
            xyz = flat * math.sin(azimuth), flat * math.cos(azimuth), range_m * math.sin(elevation)
            found.append((laser, reflectivity, block, *xyz))
    return found
