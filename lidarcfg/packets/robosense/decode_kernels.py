"""The loops of decoding: how the head turns from block to block, and the point of each return."""

# mypy: disallow-untyped-decorators=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.packets.codec import Returns
from lidarcfg.units import SECOND_NS

BLOCKS, SLOTS = 12, 32  # blocks in a packet, returns in a block
FIRST, BLOCK, HEAD, RETURN = 42, 100, 4, 3  # bytes before the blocks, of a block, of its head, of a return
REVOLUTION = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
JUMP = 50  # hundredths: a step half as large again as the packet's least one, and this, leads over a gap
PERIOD_TOLERANCE = 0.1  # of the period, in the time between packets that follow each other
SMALL = 0.05  # radians, up to which three terms of sine and cosine are exact to 2e-12
SECOND_STRONGEST = 2

Counts = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]


class Slots(NamedTuple):
    """What is known of the W slots that share an azimuth."""

    at: Counts  # (W,) where the return is, after the first one of the azimuth's blocks
    laser: Counts  # (W,)
    fraction: Array  # (W,) of the step to the next azimuth, when it is fired
    offset_ns: Counts  # (W,) after the time of the azimuth's first block
    kind: Bytes  # (W,) with dual returns: 0 strongest, 1 last
    other: Counts  # (W,) how many bytes on the pair's other return is; 0 with single returns
    blocks: int  # that share an azimuth


class Lasers(NamedTuple):
    """The L lasers: angles in radians, lengths in metres."""

    elevation: Array
    azimuth_offset: Array
    forward: Array
    left: Array
    up: Array
    ring: Bytes


@njit(cache=True, nogil=True)
def steps(azimuth: Counts, stamp_ns: Counts, period_ns: int, group_ns: int) -> tuple[Array, Counts]:
    """Of each azimuth (P, G) in hundredths: the step to the next one, and how much later it is than nominal.

    The last one of a packet looks into the next packet if that follows at once, else it turns as the one before it.
    Where the field of view has a gap, azimuths jump: the head turned evenly meanwhile.
    """
    packets, groups = azimuth.shape
    step, late = np.zeros((packets, groups)), np.zeros((packets, groups), np.int64)
    for p in range(packets):
        gap_ns = stamp_ns[p + 1] - stamp_ns[p] if p + 1 < packets else 0
        least = math.inf
        for k in range(groups):
            to = azimuth[p, k + 1] if k + 1 < groups else (azimuth[p + 1, 0] if p + 1 < packets else 0)
            step[p, k] = (to - azimuth[p, k]) % REVOLUTION
            if k + 1 < groups:
                least = min(least, step[p, k])
        follows = abs(gap_ns - period_ns) <= PERIOD_TOLERANCE * period_ns
        usual, missing = least, 0.0
        for k in range(groups):
            late[p, k] = round(missing)
            if step[p, k] <= 1.5 * least + JUMP and (k + 1 < groups or follows):
                usual = step[p, k]
            else:
                if usual > 0 and (k + 1 < groups or gap_ns > 0):
                    missing += max(step[p, k] / usual - 1, 0) * group_ns
                step[p, k] = usual
        spare_ns = gap_ns - period_ns
        if late[p, groups - 1] and 0 < gap_ns < SECOND_NS:  # the next packet says how long that took
            for k in range(groups):
                late[p, k] = round(late[p, k] / missing * max(spare_ns, 0))
    return step, late


@njit(cache=True, nogil=True)
def count(data: Bytes, wanted: Flags) -> int:
    """How many returns the packets (P, size) that are wanted (P,) hold at most."""
    found = 0
    for p in range(len(data)):
        if wanted[p]:
            packet = data[p]
            for b in range(BLOCKS):
                at = FIRST + b * BLOCK + HEAD
                for i in range(SLOTS):
                    found += (packet[at + RETURN * i] | packet[at + RETURN * i + 1]) != 0
    return found


@njit(cache=True, nogil=True)
def points(
    data: Bytes,
    wanted: Flags,
    turning: tuple[Counts, Array, Counts, Counts],
    slots: Slots,
    lasers: Lasers,
    group_ns: int,
    unit_m: float,
    single: int,
    out: Returns,
) -> int:
    """Fill in one entry a return of the packets that are wanted (P,), in their order; returns how many.

    `turning` is azimuth and step (P, G) in hundredths, how late (P, G), and the packets' stamps (P,). Single returns
    are of type `single`. An identical pair is one return, the strongest.
    """
    azimuth, step, late_ns, stamp_ns = turning
    width = len(slots.at)
    cos_w, sin_w = np.cos(lasers.elevation)[slots.laser], np.sin(lasers.elevation)[slots.laser]
    cos_o, sin_o = np.cos(lasers.azimuth_offset)[slots.laser], np.sin(lasers.azimuth_offset)[slots.laser]
    forward, left, up = lasers.forward[slots.laser], lasers.left[slots.laser], lasers.up[slots.laser]
    total = 0
    for p in range(len(data)):
        if not wanted[p]:
            continue
        packet = data[p]
        for g in range(azimuth.shape[1]):
            begin = FIRST + g * slots.blocks * BLOCK + HEAD
            angle = azimuth[p, g] * RADIANS
            cos_g, sin_g, step_rad = math.cos(angle), math.sin(angle), step[p, g] * RADIANS
            time_ns = stamp_ns[p] + late_ns[p, g] + g * group_ns
            for k in range(width):
                at = begin + slots.at[k]
                raw, strength = packet[at] << 8 | packet[at + 1], packet[at + 2]
                if raw == 0:
                    continue
                kind = np.uint8(single)
                if slots.other[k]:
                    there = at + slots.other[k]
                    raw_there, strength_there = packet[there] << 8 | packet[there + 1], packet[there + 2]
                    kind = slots.kind[k]
                    differs = raw != raw_there or strength != strength_there
                    if kind and not differs:
                        continue
                    if not kind and differs and raw_there and strength < strength_there:
                        kind = np.uint8(SECOND_STRONGEST)
                delta = step_rad * slots.fraction[k]
                square = delta * delta
                if abs(delta) < SMALL:
                    sin_d = delta * (1 - square * (1 - square / 20) / 6)
                    cos_d = 1 - square * (1 - square * (1 - square / 30) / 12) / 2
                else:
                    sin_d, cos_d = math.sin(delta), math.cos(delta)
                cos_h, sin_h = cos_g * cos_d - sin_g * sin_d, sin_g * cos_d + cos_g * sin_d
                c, s = cos_h * cos_o[k] - sin_h * sin_o[k], sin_h * cos_o[k] + cos_h * sin_o[k]
                flat = raw * unit_m * cos_w[k]
                out.xyz_m[total, 0] = flat * c + forward[k] * cos_h + left[k] * s
                out.xyz_m[total, 1] = left[k] * c - flat * s - forward[k] * sin_h
                out.xyz_m[total, 2] = raw * unit_m * sin_w[k] + up[k]
                out.time_ns[total] = time_ns + slots.offset_ns[k]
                out.laser[total], out.ring[total] = slots.laser[k], lasers.ring[slots.laser[k]]
                out.intensity[total], out.return_type[total] = strength, kind
                total += 1
    return total
