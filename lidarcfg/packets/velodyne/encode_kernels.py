"""The loops of encoding: what the slots of packets say of ranges and reflectivities."""

import math

import numpy as np

from lidarcfg.jit import inner, njit
from lidarcfg.packets.velodyne.decode_kernels import FAR_M, NEAR_X_M, NEAR_Y_M, raised

STEPS, SETTLED_M = 40, 1e-9  # to a correction near by; of a real unit's, each leaves a hundredth of what is wrong


@njit(cache=True, nogil=True)
def fill(range_m, reflectivity, number, offset_m, limits, distance, intensity):
    """Write the blocks of packets (P, B, 32): in each slot (B, 32) the return with that number of the packet's (P, N).

    The slot's laser has the offset (B, 32); limits as in `_units`.
    """
    for p in range(len(range_m)):
        for b in range(number.shape[0]):
            for i in range(number.shape[1]):
                n = number[b, i]
                units = _units(range_m[p, n], offset_m[b, i], limits)
                distance[p, b, i] = units
                intensity[p, b, i] = reflectivity[p, n] if units > 0 else 0


@njit(cache=True, nogil=True)
def _units(range_m, offset_m, limits):
    """A range in whole units: 0 unless it is within least and most metres, and no more units than there may be."""
    least_m, most_m, unit_m, units_max = limits
    units = np.rint((range_m - offset_m) / unit_m)
    return np.uint16(units) if least_m <= range_m <= most_m and 0 <= units <= units_max else np.uint16(0)


@njit(cache=True, nogil=True)
def fill_near(range_m, reflectivity, azimuth, number, laser, tables, limits, distance, intensity):
    """Write again those slots of `fill` whose distances are corrected for x and y apart.

    The head pointed to azimuth (P, N, or N / 2 with dual returns), and the slots are those of `laser` (B, 32). The
    lasers' tables (L,) are elevation, azimuth offset, lateral and distance offset, and (L, 2) the latter near by.
    """
    elevation, azimuth_offset, left, offset, near = tables
    least_m, most_m, unit_m, units_max = limits
    each = range_m.shape[1] // azimuth.shape[1]
    cos_w, sin_w = np.cos(elevation), np.sin(elevation)
    last = math.floor(FAR_M / unit_m) - 1  # units of the last distance that is corrected so
    while (last + 1) * unit_m < FAR_M:
        last += 1
    for p in range(len(range_m)):
        for b in range(number.shape[0]):
            for i in range(number.shape[1]):
                n, k = number[b, i], laser[b, i]
                hit_m = range_m[p, n]
                if least_m <= hit_m <= most_m and np.rint((hit_m - offset[k]) / unit_m) <= last:
                    angle = azimuth[p, n // each] + azimuth_offset[k]
                    units = _near_units(hit_m, angle, cos_w[k], sin_w[k], left[k], offset[k], near[k], unit_m, last)
                    sent = 0 < units <= units_max
                    distance[p, b, i] = np.uint16(units) if sent else 0
                    intensity[p, b, i] = reflectivity[p, n] if sent else 0


@inner(makes_arrays=True)
def _near_units(range_m, angle, cos_w, sin_w, left_m, offset_m, near_m, unit_m, last):
    """Whole units up to `last`, where x and y are corrected apart: those whose point is nearest along the beam.

    Beyond `last` nothing is corrected, with a jump: one more where that point is nearer.
    """
    c, s = math.cos(angle), math.sin(angle)
    side = (near_m[0] - offset_m) / (FAR_M - NEAR_X_M) * (cos_w * cos_w * s * s + sin_w * sin_w / 2)
    ahead = (near_m[1] - offset_m) / (FAR_M - NEAR_Y_M) * (cos_w * cos_w * c * c + sin_w * sin_w / 2)
    last_m, added_m = last * unit_m + offset_m, 0.0
    for _ in range(STEPS):
        before_m, flat_m = added_m, min(range_m - added_m, last_m) * cos_w
        to_x, to_y = abs(flat_m * s - left_m * c), abs(flat_m * c + left_m * s)
        added_m = side * (FAR_M - to_x) + ahead * (FAR_M - to_y)
        if abs(added_m - before_m) < SETTLED_M:
            break
    if range_m > last_m + (unit_m + added_m) / 2:
        return last + 1.0
    return min(np.rint((range_m - added_m - offset_m) / unit_m), last)


@njit(cache=True, nogil=True)
def unfocus(distance, laser, focal, intensity):
    """Write again the intensities (P, B, 32): of which the corrections (L, 4) by focal distance make what they are.

    Where no byte gives that, it is one that comes nearest. The slots are those of `laser` (B, 32).
    """
    for p in range(len(distance)):
        for b in range(laser.shape[0]):
            for i in range(laser.shape[1]):
                if distance[p, b, i] > 0:
                    added = raised(distance[p, b, i], focal[laser[b, i]])
                    intensity[p, b, i] = min(max(np.rint(intensity[p, b, i] - added), 0), 255)
