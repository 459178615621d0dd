"""The loops of decoding: how the head turns from block to block, and the point of each return."""

# mypy: disallow-untyped-decorators=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.packets.codec import Returns
from lidarcfg.units import SECOND_NS

SLOTS = 32  # returns in a block
REVOLUTION = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
HOUR_US = 3600 * 10**6
PERIOD_TOLERANCE = 0.1  # successive packets are this near to the period, as a fraction of it
JUMP = 50  # hundredths: a step half as large again as the packet's least one, and this, leads over a gap
FAR_M, NEAR_X_M, NEAR_Y_M = 25.04, 2.4, 1.93  # where distance offsets are given: HDL-64E manual, two-point calibration
FOCAL_FAR_M, RAW_MAX = 131.0, 65535  # the intensity's correction, as velodyne_decoder 3.1 and ros-drivers have it
SECOND_STRONGEST = 2
SMALL = 0.05  # radians, up to which three terms of sine and cosine are exact to 2e-12
KNOWN_STEPS = 16  # of which sines and cosines are kept: a head that turns evenly has two or three

Counts = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Words = NDArray[np.uint16]
Flags = NDArray[np.bool_]


class Slots(NamedTuple):
    """What is known of a packet's N slots, W of them in each group of blocks that are fired together."""

    laser: Counts  # (W,)
    fraction: Array  # (N,) of the step from the group's start to the next one's
    offset_ns: Counts  # (N,) after the packet's stamp
    kind: Bytes  # (W,) with dual returns: 0 strongest, 1 last
    other: Counts  # (W,) where in the group the pair's other return is; -1 with single returns


class Lasers(NamedTuple):
    """The L lasers: angles in radians, lengths in metres."""

    elevation: Array
    azimuth_offset: Array
    left: Array
    up: Array
    distance_offset: Array
    ring: Bytes
    near_offset: Array  # (L, 2), or (0, 2) if distances near by are as those far off
    focal: Array  # (L, 4) focal distance, slope, least and greatest intensity; or (0, 4) if they are right as they come


class Wire(NamedTuple):
    """What P packets say, of the B blocks in use and their G groups."""

    distance: Words  # (P, B, 32)
    intensity: Bytes  # (P, B, 32)
    azimuth: Counts  # (P, G)
    step: Array  # (P, G)
    late_ns: Counts  # (P, G)
    stamp_ns: Counts  # (P,)
    last: Flags  # (P,) whether single returns are the last ones


@njit(cache=True, nogil=True)
def _step(from_: int, to: int) -> int:
    """Hundredths from one azimuth to another, the shorter way round."""
    return (to - from_ + REVOLUTION // 2) % REVOLUTION - REVOLUTION // 2


@njit(cache=True, nogil=True)
def steps(azimuth: Counts, stamp_us: Counts, period_ns: int, group_ns: int) -> tuple[Array, Counts]:
    """Of each block's time: the step to the next, and how much later it is than the packet's stamp says.

    Azimuth (P, G) in hundredths at the blocks' starts, stamps (P,) of successive packets → step (P, G) in
    hundredths, late (P, G) in nanoseconds. The last block looks into the next packet if that follows at once, else
    it turns as the one before it. Where the field of view has a gap, azimuths jump within a packet: the block before
    the jump turns as those before it, and those after it are late by what the next packet's stamp shows.
    """
    packets, groups = azimuth.shape
    step = np.zeros((packets, groups), np.float64)
    late = np.zeros((packets, groups), np.int64)
    ahead = np.zeros(groups, np.float64)
    jump = np.zeros(groups, np.bool_)
    for p in range(packets):
        gap_ns, follows = 0, False
        ahead[groups - 1] = 0
        for k in range(groups - 1):
            ahead[k] = _step(azimuth[p, k], azimuth[p, k + 1])
        if p + 1 < packets:
            gap_ns = (stamp_us[p + 1] - stamp_us[p]) % HOUR_US * 1000
            follows = abs(gap_ns - period_ns) <= PERIOD_TOLERANCE * period_ns
            ahead[groups - 1] = _step(azimuth[p, groups - 1], azimuth[p + 1, 0])
        cut = _jumps(ahead, gap_ns, follows, jump)
        usual = step[p - 1, 0] if groups == 1 and p > 0 else 0.0  # the step of the last block that did not jump
        for k in range(groups - 1, -1, -1):
            if not jump[k]:
                usual = ahead[k]
        for k in range(groups):
            if not jump[k]:
                usual = ahead[k]
            step[p, k] = usual
        if cut:
            _delays(ahead, jump, step[p], gap_ns, period_ns, group_ns, late[p])
    return step, late


@inner(makes_arrays=True)
def _jumps(ahead: Array, gap_ns: int, follows: bool, jump: Flags) -> bool:
    """Mark which of a packet's steps (G,) lead over a gap; whether one within the packet does."""
    groups = len(ahead)
    least = abs(ahead[groups - 1]) if follows else math.inf
    for k in range(groups - 1):
        least = min(least, abs(ahead[k]))
    cut = False
    for k in range(groups - 1):
        jump[k] = abs(ahead[k]) > 1.5 * least + JUMP
        cut |= jump[k]
    near = abs(ahead[groups - 1]) <= 1.5 * least + JUMP
    jump[groups - 1] = not (near and (follows or (cut and gap_ns > 0)))
    return cut


@inner(makes_arrays=True)
def _delays(ahead: Array, jump: Flags, step: Array, gap_ns: int, period_ns: int, group_ns: int, late: Counts) -> None:
    """Write how much later (G,) the blocks of a packet with jumps are than its stamp says."""
    groups = len(ahead)
    missing = 0.0  # hundredths that the head turned while nothing was fired
    turned, steady = 0.0, 0
    for k in range(groups):
        if not jump[k]:
            turned += step[k]
            steady += 1
        elif k + 1 < groups or gap_ns > 0:
            missing += max(ahead[k] % REVOLUTION - step[k], 0)
    spare_ns = float(gap_ns - period_ns)
    if not 0 < spare_ns < SECOND_NS:
        spare_ns = missing * steady / turned * group_ns if turned > 0 else 0.0
    passed = 0.0
    for k in range(groups - 1):
        if jump[k]:
            passed += max(ahead[k] % REVOLUTION - step[k], 0)
        late[k + 1] = round(spare_ns * passed / missing) if missing > 0 else 0


@inner(makes_arrays=True)
def _rotations(step: float, fraction: Array, cos: Array, sin: Array) -> None:
    """Cosine and sine of fractions of a step in hundredths."""
    for k in range(len(fraction)):
        delta = step * fraction[k] * RADIANS
        if abs(delta) < SMALL:
            square = delta * delta
            sin[k] = delta * (1 - square * (1 - square / 20) / 6)
            cos[k] = 1 - square * (1 - square * (1 - square / 30) / 12) / 2
        else:
            cos[k], sin[k] = math.cos(delta), math.sin(delta)


@njit(cache=True, nogil=True)
def raised(raw: int, focal: Array) -> float:
    """By how much an intensity is corrected for how far the raw distance is from the laser's focal one."""
    away = 256 * (1 - focal[0] / FOCAL_FAR_M) ** 2 - 256 * (1 - raw / RAW_MAX) ** 2
    return float(focal[1] * abs(away))


@inner(makes_arrays=True)
def _focused(intensity: int, raw: int, focal: Array) -> int:
    """An intensity corrected so, within the laser's least and greatest."""
    corrected: int = round(min(max(intensity + raised(raw, focal), focal[2]), focal[3]))
    return corrected


@njit(cache=True, nogil=True)
def points(wire: Wire, wanted: Flags, slots: Slots, lasers: Lasers, unit_m: float, out: Returns) -> int:
    """Fill in one entry a return of the packets that are wanted (P,), in their order; returns how many.

    With near offsets x and y have corrections of their own up to 25.04 m, and z their mean, as velodyne_decoder 3.1
    has it. One function: split into several, it was measured 1.3 to 1.7 times as slow, and with parts inlined by numba
    1.1 to 1.3 times.
    """
    distance, intensity, azimuth, step, late_ns, stamp_ns, last = wire
    groups, width = azimuth.shape[1], len(slots.laser)
    blocks = width // SLOTS
    cos_w, sin_w = np.cos(lasers.elevation)[slots.laser], np.sin(lasers.elevation)[slots.laser]
    cos_o, sin_o = np.cos(lasers.azimuth_offset)[slots.laser], np.sin(lasers.azimuth_offset)[slots.laser]
    left, up, offset = lasers.left[slots.laser], lasers.up[slots.laser], lasers.distance_offset[slots.laser]
    near = lasers.near_offset[slots.laser] if len(lasers.near_offset) else lasers.near_offset
    known = np.full((KNOWN_STEPS, groups), math.nan)  # steps that the tables hold
    cos_t, sin_t = np.empty((KNOWN_STEPS, groups, width)), np.empty((KNOWN_STEPS, groups, width))
    # One width, so that the compiler can do several at once; indices have no sign, else each would be checked for it.
    raw, strength = np.empty(width, np.int64), np.empty(width, np.int64)
    kept, kind, return_type = np.empty(width, np.int64), np.empty(width, np.int64), slots.kind.astype(np.int64)
    paired, other, which = slots.other[0] >= 0, slots.other.astype(np.uint64), np.empty(width, np.uint64)
    raw_other, strength_other = np.empty(width, np.int64), np.empty(width, np.int64)
    laser, ring = slots.laser.astype(np.uint8), lasers.ring[slots.laser]
    fraction, offset_ns = slots.fraction.reshape(groups, width), slots.offset_ns.reshape(groups, width)
    c, s, ahead, side = np.empty(width), np.empty(width), np.empty(width), np.empty(width)
    x, y, z = np.empty(width), np.empty(width), np.empty(width)
    total = 0
    for p in range(distance.shape[0]):
        if not wanted[p]:
            continue
        for g in range(groups):
            row = int(step[p, g]) % KNOWN_STEPS
            if known[row, g] != step[p, g]:
                known[row, g] = step[p, g]
                _rotations(step[p, g], fraction[g], cos_t[row, g], sin_t[row, g])
            cos_g, sin_g = math.cos(azimuth[p, g] * RADIANS), math.sin(azimuth[p, g] * RADIANS)
            cos_d, sin_d = cos_t[row, g], sin_t[row, g]
            for b in range(blocks):
                for i in range(SLOTS):
                    raw[b * SLOTS + i] = distance[p, g * blocks + b, i]
                    strength[b * SLOTS + i] = intensity[p, g * blocks + b, i]
            for k in range(width):  # with a return or without
                cos_a, sin_a = cos_g * cos_d[k] - sin_g * sin_d[k], sin_g * cos_d[k] + cos_g * sin_d[k]
                c[k], s[k] = cos_a * cos_o[k] - sin_a * sin_o[k], sin_a * cos_o[k] + cos_a * sin_o[k]
                ahead[k] = side[k] = raw[k] * unit_m + offset[k]
            if len(near):
                for k in range(width):
                    if raw[k] * unit_m < FAR_M:
                        r, flat = ahead[k], ahead[k] * cos_w[k]
                        to_x, to_y = abs(flat * s[k] - left[k] * c[k]), abs(flat * c[k] + left[k] * s[k])
                        side[k] = r + (near[k, 0] - offset[k]) * (FAR_M - to_x) / (FAR_M - NEAR_X_M)
                        ahead[k] = r + (near[k, 1] - offset[k]) * (FAR_M - to_y) / (FAR_M - NEAR_Y_M)
            for k in range(width):
                x[k] = ahead[k] * cos_w[k] * c[k] + left[k] * s[k]
                y[k] = left[k] * c[k] - side[k] * cos_w[k] * s[k]
                z[k] = (ahead[k] + side[k]) / 2 * sin_w[k] + up[k]
            for k in range(width):
                kept[k] = raw[k] != 0
                kind[k] = last[p]
            if paired:
                for k in range(width):
                    raw_other[k], strength_other[k] = raw[other[k]], strength[other[k]]
                for k in range(width):
                    differs = (raw[k] != raw_other[k]) | (strength[k] != strength_other[k])
                    second = (raw_other[k] != 0) & (strength[k] < strength_other[k])
                    kept[k] &= (return_type[k] == 0) | differs
                    kind[k] = return_type[k] + SECOND_STRONGEST * ((return_type[k] == 0) & differs & second)
            found = 0
            for k in range(width):  # what is not kept is written over: no branch
                which[found] = k
                found += kept[k]
            began_ns = stamp_ns[p] + late_ns[p, g]
            rows = slice(total, total + found)
            part = Returns(
                out.xyz_m[rows],
                out.range_m[rows],
                out.azimuth_rad[rows],
                out.time_ns[rows],
                out.laser[rows],
                out.ring[rows],
                out.intensity[rows],
                out.return_type[rows],
            )
            for j in range(found):
                k = which[j]
                part.xyz_m[j, 0], part.xyz_m[j, 1], part.xyz_m[j, 2] = x[k], y[k], z[k]
                part.time_ns[j] = began_ns + offset_ns[g, k]
                part.laser[j], part.ring[j] = laser[k], ring[k]
                part.intensity[j], part.return_type[j] = strength[k], kind[k]
            if len(out.range_m):
                for j in range(found):
                    k = which[j]
                    angle = azimuth[p, g] * RADIANS + step[p, g] * fraction[g, k] * RADIANS
                    angle += lasers.azimuth_offset[laser[k]]
                    part.range_m[j] = raw[k] * unit_m + offset[k]
                    part.azimuth_rad[j] = angle - 2 * math.pi * math.floor(angle / (2 * math.pi))
            if len(lasers.focal):
                for j in range(found):
                    k = which[j]
                    part.intensity[j] = _focused(strength[k], raw[k], lasers.focal[laser[k]])
            total += found
    return total
