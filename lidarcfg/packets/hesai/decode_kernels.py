"""The loops of decoding: which slots are returns of their own, of which kind, and where each point lies."""

# mypy: disallow-untyped-decorators=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.packets.codec import Returns

RADIANS = math.pi / 18000
STRONGEST, LAST, SECOND_STRONGEST, FIRST = range(4)  # types of returns, as `Returns` has them
BY_BLOCK, NONE = 254, 255

Counts = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Words = NDArray[np.uint16]
Flags = NDArray[np.bool_]


class Wire(NamedTuple):
    """What P packets of B blocks with L lasers say."""

    distance: Words  # (P, B, L)
    reflectivity: Bytes  # (P, B, L)
    azimuth: Words  # (P, B)
    unit_mm: Bytes  # (P,)
    stamp_ns: Counts  # (P,)
    dual: Flags  # (P,) whether neighbouring blocks hold two returns of the same firings
    loop: Counts  # (P,) with dual returns: which lasers fire
    near: Bytes  # (P,) the type of a pair's nearer return, or of single returns
    far: Bytes  # (P,) the type of a pair's farther return


class Tables(NamedTuple):
    """What is known of the L lasers and of when they fire."""

    cos_elevation: Array
    sin_elevation: Array
    cos_offset: Array  # of the azimuth offset
    sin_offset: Array
    ring: Bytes
    offset_ns: Counts  # (loops, L)
    group_ns: Counts  # (B,) single: when each block starts, after the stamp
    pair_ns: Counts  # (B / 2,) dual: when each pair starts


@njit(cache=True, nogil=True)
def points(wire: Wire, wanted: Flags, tables: Tables, out: Returns) -> int:
    """Fill in the returns of the packets that are wanted (P,), in their order; returns how many."""
    lasers, loops = wire.distance.shape[2], len(tables.offset_ns)
    kind = np.empty(lasers, np.uint8)
    total = 0
    for p in range(wire.distance.shape[0]):
        if not wanted[p]:
            continue
        for b in range(wire.distance.shape[1]):
            distance, reflectivity = wire.distance[p, b], wire.reflectivity[p, b]
            if wire.dual[p]:
                start_ns, loop = wire.stamp_ns[p] + tables.pair_ns[b // 2], wire.loop[p]
                other, strength = wire.distance[p, b ^ 1], wire.reflectivity[p, b ^ 1]
                _pair(distance, reflectivity, other, strength, b % 2, (wire.near[p], wire.far[p]), kind)
            else:
                start_ns, loop = wire.stamp_ns[p] + tables.group_ns[b], b % loops
                for k in range(lasers):
                    kind[k] = wire.near[p] if distance[k] else NONE
            total = _write(
                (distance, reflectivity, kind),
                (wire.azimuth[p, b], wire.unit_mm[p] / 1000, start_ns),
                tables.offset_ns[loop],
                tables,
                total,
                out,
            )
    return total


@inner(makes_arrays=True)
def _pair(
    distance: Words, reflectivity: Bytes, other: Words, strength: Bytes, odd: int, types: tuple[int, int], kind: Bytes
) -> None:
    """Write the types (L,) of a block's returns, given its neighbour's; `types` are a nearer and a farther return's.

    An identical pair is one return, the strongest, and stands in the even block. Which of two is the last return, the
    distance decides and not the block, as early firmware has them the other way round.
    """
    near, far = types
    for k in range(len(distance)):
        if distance[k] == 0:
            kind[k] = NONE
        elif other[k] == 0:
            kind[k] = STRONGEST
        elif distance[k] == other[k] and reflectivity[k] == strength[k]:
            kind[k] = NONE if odd else STRONGEST
        else:
            nearer = distance[k] < other[k] or (distance[k] == other[k] and odd == 1)
            kind[k] = near if nearer else far
            if kind[k] == BY_BLOCK:
                kind[k] = SECOND_STRONGEST if odd else STRONGEST
            elif kind[k] == STRONGEST and reflectivity[k] < strength[k]:
                kind[k] = SECOND_STRONGEST


@njit(cache=True, nogil=True)
def _write(
    block: tuple[Words, Bytes, Bytes],
    head: tuple[int, float, int],
    offset_ns: Counts,
    tables: Tables,
    total: int,
    out: Returns,
) -> int:
    """Fill in a block's returns: distances, reflectivities and types (L,); azimuth, unit in metres and start."""
    distance, reflectivity, kind = block
    azimuth, unit_m, start_ns = head
    polar, cos_a, sin_a = len(out.range_m) > 0, math.cos(azimuth * RADIANS), math.sin(azimuth * RADIANS)
    for k in range(len(distance)):
        if kind[k] != NONE:
            range_m = distance[k] * unit_m
            flat = range_m * tables.cos_elevation[k]
            out.xyz_m[total, 0] = flat * (sin_a * tables.cos_offset[k] + cos_a * tables.sin_offset[k])
            out.xyz_m[total, 1] = flat * (cos_a * tables.cos_offset[k] - sin_a * tables.sin_offset[k])
            out.xyz_m[total, 2] = range_m * tables.sin_elevation[k]
            out.time_ns[total] = start_ns + offset_ns[k]
            out.laser[total], out.ring[total] = k, tables.ring[k]
            out.intensity[total], out.return_type[total] = reflectivity[k], kind[k]
            if polar:
                angle = azimuth * RADIANS + math.atan2(tables.sin_offset[k], tables.cos_offset[k]) - math.pi / 2
                out.range_m[total] = range_m
                out.azimuth_rad[total] = angle - 2 * math.pi * math.floor(angle / (2 * math.pi))
            total += 1
    return total
