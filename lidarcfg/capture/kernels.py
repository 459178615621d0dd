"""The loops of decoding: how the head turns from block to block, and the point of each return."""

import math

import numpy as np
from numba import njit

TURN = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
HOUR_US = 3600 * 10**6
SECOND_NS = 10**9
PERIOD_SLACK = 0.1  # successive packets are this near to the period, as a share of it
JUMP = 50  # hundredths: a turn that is half as large again as the packet's least one, and this, leaves out a sector
FAR_M, NEAR_X_M, NEAR_Y_M = 25.04, 2.4, 1.93  # where distance offsets are given: HDL-64E manual, two-point calibration
SECOND_STRONGEST = 2
SMALL = 0.05  # radians, up to which three terms of sine and cosine are exact to 2e-12


@njit(cache=True, nogil=True)
def turning(azimuth, stamp_us, period_ns, group_ns):  # type: ignore[no-untyped-def]
    """Of each block's time: the turn to the next, and how much later it is than the packet's stamp says.

    Azimuth (P, G) in hundredths at the blocks' starts, stamps (P,) of successive packets → turn (P, G) in
    hundredths, late (P, G) in nanoseconds. The last block looks into the next packet if that follows at once, else
    it turns as the one before it. Where a sector is cut out, azimuths jump within a packet: the block before the
    jump turns as those before it, and those after it are late by what the next packet's stamp shows.
    """
    packets, groups = azimuth.shape
    turn = np.zeros((packets, groups), np.float64)
    late = np.zeros((packets, groups), np.int64)
    ahead = np.zeros(groups, np.float64)
    jump = np.zeros(groups, np.bool_)
    for p in range(packets):
        gap_ns, follows = 0, False
        ahead[groups - 1] = 0
        for k in range(groups - 1):
            ahead[k] = (azimuth[p, k + 1] - azimuth[p, k] + TURN // 2) % TURN - TURN // 2
        if p + 1 < packets:
            gap_ns = (stamp_us[p + 1] - stamp_us[p]) % HOUR_US * 1000
            follows = abs(gap_ns - period_ns) <= PERIOD_SLACK * period_ns
            ahead[groups - 1] = (azimuth[p + 1, 0] - azimuth[p, groups - 1] + TURN // 2) % TURN - TURN // 2
        least = abs(ahead[groups - 1]) if follows else math.inf
        for k in range(groups - 1):
            least = min(least, abs(ahead[k]))
        cut = False
        for k in range(groups - 1):
            jump[k] = abs(ahead[k]) > 1.5 * least + JUMP
            cut |= jump[k]
        near = abs(ahead[groups - 1]) <= 1.5 * least + JUMP
        jump[groups - 1] = not (near and (follows or (cut and gap_ns > 0)))
        usual = 0.0  # the turn of the last block that did not jump
        if groups == 1 and p > 0:
            usual = turn[p - 1, 0]
        for k in range(groups - 1, -1, -1):
            if not jump[k]:
                usual = ahead[k]
        for k in range(groups):
            if not jump[k]:
                usual = ahead[k]
            turn[p, k] = usual
        if not cut:
            continue
        missing = 0.0  # hundredths that the head turned while nothing was fired
        turned, steady = 0.0, 0
        for k in range(groups):
            if not jump[k]:
                turned += turn[p, k]
                steady += 1
            elif k + 1 < groups or gap_ns > 0:
                missing += max(ahead[k] % TURN - turn[p, k], 0)
        spare_ns = float(gap_ns - period_ns)
        if not 0 < spare_ns < SECOND_NS:
            spare_ns = missing * steady / turned * group_ns if turned > 0 else 0.0
        passed = 0.0
        for k in range(groups - 1):
            if jump[k]:
                passed += max(ahead[k] % TURN - turn[p, k], 0)
            late[p, k + 1] = round(spare_ns * passed / missing) if missing > 0 else 0
    return turn, late


@njit(cache=True, nogil=True)
def points(  # type: ignore[no-untyped-def]
    distance, intensity, azimuth, turn, late_ns, stamp_ns, kind,  # packets
    laser, group, share, offset_ns, slot_kind, other,  # slots
    elevation, azimuth_offset, left, up, distance_offset, near_offset,  # lasers
    unit_m,
    xyz, range_m, azimuth_rad, time_ns, beam, strength, return_type,  # out
):  # fmt: skip
    """Fill in one entry a return, in the order of the packets; returns how many.

    Distance and intensity (P, N) of the N slots; azimuth, turn, late (P, G); stamp and kind of single returns (P,).
    A slot has its laser, group, share of the turn and time; with dual returns its kind and the slot of its
    pair's other return (else -1). near_offset (L, 2) is empty if distances near by are as those far off; else x and y
    have corrections of their own up to 25.04 m, and z their mean, as velodyne_decoder 3.1 has it.
    """
    cos_w, sin_w = np.cos(elevation), np.sin(elevation)
    cos_o, sin_o = np.cos(azimuth_offset), np.sin(azimuth_offset)
    count = 0
    for p in range(distance.shape[0]):
        g, cos_g, sin_g = -1, 1.0, 0.0
        for n in range(distance.shape[1]):
            raw = distance[p, n]
            if raw == 0:
                continue
            what = kind[p]
            if other[n] >= 0:
                what = slot_kind[n]
                raw_other, strength_other = distance[p, other[n]], intensity[p, other[n]]
                if raw == raw_other and intensity[p, n] == strength_other:
                    if what == 1:
                        continue
                elif what == 0 and raw_other != 0 and intensity[p, n] < strength_other:
                    what = SECOND_STRONGEST
            if group[n] != g:
                g = group[n]
                cos_g, sin_g = math.cos(azimuth[p, g] * RADIANS), math.sin(azimuth[p, g] * RADIANS)
            b = laser[n]
            delta = turn[p, g] * share[n] * RADIANS
            if abs(delta) < SMALL:
                square = delta * delta
                sin_d = delta * (1 - square * (1 - square / 20) / 6)
                cos_d = 1 - square * (1 - square * (1 - square / 30) / 12) / 2
            else:
                sin_d, cos_d = math.sin(delta), math.cos(delta)
            c, s = cos_g * cos_d - sin_g * sin_d, sin_g * cos_d + cos_g * sin_d
            c, s = c * cos_o[b] - s * sin_o[b], s * cos_o[b] + c * sin_o[b]
            r = raw * unit_m + distance_offset[b]
            ahead = side = r
            flat = r * cos_w[b]
            if len(near_offset) and raw * unit_m < FAR_M:
                x, y = abs(flat * s - left[b] * c), abs(flat * c + left[b] * s)
                side = r + (near_offset[b, 0] - distance_offset[b]) * (FAR_M - x) / (FAR_M - NEAR_X_M)
                ahead = r + (near_offset[b, 1] - distance_offset[b]) * (FAR_M - y) / (FAR_M - NEAR_Y_M)
            xyz[count, 0] = ahead * cos_w[b] * c + left[b] * s
            xyz[count, 1] = left[b] * c - side * cos_w[b] * s
            xyz[count, 2] = (ahead + side) / 2 * sin_w[b] + up[b]
            range_m[count] = r
            angle = azimuth[p, g] * RADIANS + delta + azimuth_offset[b]
            azimuth_rad[count] = angle - 2 * math.pi * math.floor(angle / (2 * math.pi))
            time_ns[count] = stamp_ns[p] + offset_ns[n] + late_ns[p, g]
            beam[count] = b
            strength[count] = intensity[p, n]
            return_type[count] = what
            count += 1
    return count
