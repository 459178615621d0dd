"""The loops of skipping: boxes around what stands still, and which of a sensor's beams come near to balls."""

# mypy: disallow-untyped-decorators=False
import math

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit

SMALL = 1 / 8  # of a cell: what is no wider is not cut
CUTS = 64  # a box, at most
DEPTH = 128  # cuts of a triangle in a row, each of which halves its cells along an axis
OUT = 2**60  # a cell beyond all others
CORNERS = 16  # of a piece that is cut further; there are nine, but for rounding
MIX = 0x5851F42D4C957F2D  # Knuth's multiplier, for a hash of cells

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@njit(cache=True, nogil=True)
def gathered(vertices_m: Array, triangles: Index, size_m: float, most: int) -> tuple[Array, Array, bool]:
    """Low and high corners (C, 3) of boxes that hold all triangles (T, 3); whether `most` are enough, by so many CUTS.

    Triangles are cut where they cross the planes of a grid, unless they are SMALL. Pieces in one of its cells share a
    box; boxes are in the order in which their cells are met. `size_m` is a power of two, so that no cell is rounded.
    """
    low, high, cells, count, box = np.empty((most, 3)), np.empty((most, 3)), np.empty((most, 3), np.int64), 0, -1
    slots = 2
    while slots < 2 * most:
        slots *= 2
    table = np.full(slots, -1, np.int64)  # of boxes, by their cells
    stack, corners = np.empty((DEPTH, 2 * CORNERS, 3)), np.empty(DEPTH, np.int64)  # pieces; so many corners each
    first, last = np.empty((DEPTH, 3), np.int64), np.empty((DEPTH, 3), np.int64)  # their cells
    least, largest = np.empty(3), np.empty(3)
    cuts, scale = CUTS * most, 1 / size_m
    for t in range(len(triangles)):
        for c in range(3):
            for k in range(3):
                stack[0, c, k], first[0, k], last[0, k] = vertices_m[triangles[t, c], k], -OUT, OUT
        corners[0] = 3
        top = 0
        while top >= 0:
            axis, widest = -1, SMALL * size_m
            for k in range(3):
                least[k] = largest[k] = stack[top, 0, k]
                for c in range(1, corners[top]):
                    least[k], largest[k] = min(least[k], stack[top, c, k]), max(largest[k], stack[top, c, k])
                first[top, k] = min(max(first[top, k], math.floor(least[k] * scale)), last[top, k])
                last[top, k] = max(min(last[top, k], math.ceil(largest[k] * scale) - 1), first[top, k])
                if last[top, k] > first[top, k] and largest[k] - least[k] > widest:
                    axis, widest = k, largest[k] - least[k]
            if axis >= 0 and corners[top] <= CORNERS:
                cuts -= 1
                if cuts < 0:
                    return low, high, False
                middle = (first[top, axis] + last[top, axis] + 1) // 2
                corners[top], corners[top + 1] = _cut(stack[top], corners[top], axis, middle * size_m, stack[top + 1])
                first[top + 1], last[top + 1] = first[top], last[top]
                last[top, axis], first[top + 1, axis] = middle - 1, middle
                top += 1
                continue
            cell = first[top]
            top -= 1
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
def _cut(piece: Array, corners: int, axis: int, at_m: float, above: Array) -> tuple[int, int]:
    """Cut a piece across an axis: what is below stays, the rest is written to `above`; how many corners each has."""
    whole, below, beyond = piece[:corners].copy(), 0, 0
    for c in range(corners):
        here, there = whole[c], whole[(c + 1) % corners]
        if here[axis] <= at_m:
            piece[below] = here
            below += 1
        if here[axis] >= at_m:
            above[beyond] = here
            beyond += 1
        if min(here[axis], there[axis]) < at_m < max(here[axis], there[axis]):
            share = (at_m - here[axis]) / (there[axis] - here[axis])
            for k in range(3):
                piece[below, k] = above[beyond, k] = here[k] + (there[k] - here[k]) * share
            piece[below, axis] = above[beyond, axis] = at_m
            below, beyond = below + 1, beyond + 1
    return below, beyond


@njit(cache=True, nogil=True)
def _slot(cell: Index, cells: Index, table: Index) -> int:
    """Where a cell (3,) is in a table by open addressing, or where it is to be."""
    mixed = cell[0]
    for k in (1, 2):
        mixed = (mixed ^ mixed >> 31) * MIX + cell[k]
    mixed = (mixed ^ mixed >> 31) * MIX
    slot = (mixed >> 32) & len(table) - 1
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
