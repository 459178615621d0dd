"""The loops of skipping: boxes around what stands still, and which of a sensor's beams come near to balls."""

# mypy: disallow-untyped-decorators=False
import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lidarcfg.geometry import Array

CUTS = 128  # of a triangle in a row: two halve its longest edge

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@njit(cache=True, nogil=True)
def gathered(vertices_m: Array, triangles: Index, size_m: float, most: int) -> tuple[Array, Array, bool]:
    """Low and high corners (C, 3) of boxes that hold all triangles (T, 3), and whether `most` of them are enough.

    Triangles are cut across their longest edge until none is longer than `size_m`. Pieces whose middles share a cell
    of a grid of that size share a box; boxes are in the order in which their cells are met.
    """
    low, high, cells, count, box = np.empty((most, 3)), np.empty((most, 3)), np.empty((most, 3), np.int64), 0, -1
    slots = 2
    while slots < 2 * most:
        slots *= 2
    table = np.full(slots, -1, np.int64)  # of boxes, by their cells
    stack, cell, least, largest = np.empty((CUTS, 3, 3)), np.empty(3, np.int64), np.empty(3), np.empty(3)
    for t in range(len(triangles)):
        for c in range(3):
            stack[0, c] = vertices_m[triangles[t, c]]
        height = 1
        while height:
            piece = stack[height - 1]
            a, b, longest = 0, 1, -1.0
            for c in range(3):
                d = (c + 1) % 3
                x, y, z = piece[d, 0] - piece[c, 0], piece[d, 1] - piece[c, 1], piece[d, 2] - piece[c, 2]
                if x * x + y * y + z * z > longest:
                    a, b, longest = c, d, x * x + y * y + z * z
            if longest > size_m * size_m:
                stack[height] = piece
                for k in range(3):
                    stack[height, a, k] = piece[b, k] = (piece[a, k] + piece[b, k]) / 2
                height += 1
                continue
            height -= 1
            for k in range(3):
                least[k] = min(piece[0, k], piece[1, k], piece[2, k])
                largest[k] = max(piece[0, k], piece[1, k], piece[2, k])
                cell[k] = math.floor((least[k] + largest[k]) / 2 / size_m)
            if box < 0 or not _same(cell, cells[box]):
                slot = _slot(cell, cells, table)
                box = table[slot]
                if box < 0:
                    if count == most:
                        return low, high, False
                    table[slot] = box = count
                    low[box], high[box], cells[box] = least, largest, cell
                    count += 1
            for k in range(3):
                low[box, k], high[box, k] = min(low[box, k], least[k]), max(high[box, k], largest[k])
    return low[:count], high[:count], True


@njit(cache=True, nogil=True)
def _slot(cell: Index, cells: Index, table: Index) -> int:
    """Where a cell (3,) is in a table by open addressing, or where it is to be."""
    mixed = cell[0] * 73856093 ^ cell[1] * 19349663 ^ cell[2] * 83492791
    slot = (mixed ^ mixed >> 17) & len(table) - 1
    while table[slot] >= 0 and not _same(cell, cells[table[slot]]):
        slot = (slot + 1) & len(table) - 1
    return int(slot)


@njit(cache=True, nogil=True)
def _same(a: Index, b: Index) -> bool:
    return bool(a[0] == b[0] and a[1] == b[1] and a[2] == b[2])


@njit(cache=True, nogil=True)
def mark_cap(towards: Array, least: float, fan: Array, table: Mask) -> None:
    """Mark in a table (L, sectors) what comes as near to a unit vector (3,) as an angle whose cosine is `least`.

    The fan (3, L) is the lasers' sines and cosines of elevation, and their offsets of azimuth. By the spherical law
    of cosines an interval of azimuth comes so near, of which every sector that it touches is marked.
    """
    lasers, sectors = table.shape
    flat, middle = math.sqrt(towards[0] ** 2 + towards[1] ** 2), math.atan2(-towards[1], towards[0])
    scale = sectors / (2 * math.pi)
    for k in range(lasers):
        level, across = least - fan[0, k] * towards[2], fan[1, k] * flat
        if level > across:
            continue
        turned = math.acos(level / across) if level > -across else math.pi
        begin = math.floor((middle - fan[2, k] - turned) * scale)
        end = min(math.floor((middle - fan[2, k] + turned) * scale) + 1, begin + sectors)
        turns = begin - begin % sectors
        table[k, begin - turns : end - turns] = True
        table[k, : max(end - turns - sectors, 0)] = True


@njit(cache=True, nogil=True)
def mark_balls(
    centre_m: Array,
    radius_m: Array,
    R: Array,
    t: Array,
    range_m: float,
    off_m: float,
    wide_rad: float,
    fan: Array,
    table: Mask,
) -> None:
    """Mark what may meet balls (B, 3), (B,) within range of a sensor that stands at t (3,), turned by R (3, 3).

    It may be off by `off_m`, and its rays by `wide_rad`, which is less than a right angle.
    """
    towards, cosine, sine = np.empty(3), math.cos(wide_rad), math.sin(wide_rad)
    for i in range(len(centre_m)):
        x, y, z = centre_m[i, 0] - t[0], centre_m[i, 1] - t[1], centre_m[i, 2] - t[2]
        distance, radius = math.sqrt(x * x + y * y + z * z), radius_m[i] + off_m
        if distance - radius > range_m:
            continue
        if distance <= radius:
            table[:] = True
            return
        for k in range(3):
            towards[k] = (R[0, k] * x + R[1, k] * y + R[2, k] * z) / distance
        share = radius / distance  # the sine of half the angle that the ball takes up
        mark_cap(towards, math.sqrt(1 - share * share) * cosine - share * sine, fan, table)
