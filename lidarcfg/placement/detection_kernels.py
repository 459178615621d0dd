"""The compiled loops of detection: boxes against the subspaces that they touch.

A box of whole cuboids lies in one subspace if each of its upright rows does, and each row's first cuboid is of the
subspace of the next row's. So 64 boxes above one another are compared at once, bit by bit.
"""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.placement.bits import ALL, BIT, NONE, ONE, Words, lowest, ones
from lidarcfg.placement.components import Labels
from lidarcfg.placement.rows import Counts

Flags = NDArray[np.bool_]
NOBODY = np.empty(0, np.bool_)


class Slices(NamedTuple):
    """Slices of boxes across x, by place of a box along y and z: (nx, my, words) each."""

    free: Words  # without an excluded cuboid
    whole: Words  # in one subspace
    like: Words  # whose first cuboid is of the same subspace as that of the next slice


class Rows(NamedTuple):
    """Upright rows of boxes at one x, by place of a box along z: (ny, words) each."""

    free: Words
    whole: Words
    like: Words  # as that of the next row along y


@inner()
def _write_rows(labels: Labels, i: int, height: int, count: int, rows: Rows) -> None:
    """Write the rows of cuboids i of x, so many cuboids high, at `count` places along z."""
    ny = labels.shape[1]
    for j in range(ny):
        for word in range(rows.free.shape[1]):
            rows.free[j, word] = rows.whole[j, word] = rows.like[j, word] = NONE
        other, free, whole = -1, 0, 0  # how many cuboids up from here are free, and how many of one subspace
        for k in range(count + height - 2, -1, -1):
            label = labels[i, j, k]
            whole = whole + 1 if label == other else 1
            free = free + 1 if label >= 0 else 0
            other = label
            if k < count and free >= height:
                rows.free[j, k >> 6] |= BIT[k & 63]
                if whole >= height:
                    rows.whole[j, k >> 6] |= BIT[k & 63]
        for k in range(count if j + 1 < ny else 0):
            rows.like[j, k >> 6] |= BIT[k & 63] if labels[i, j, k] == labels[i, j + 1, k] else NONE


@inner()
def _write_slice(labels: Labels, i: int, size: tuple[int, int, int], count: int, rows: Rows, slices: Slices) -> None:
    """Write the slices at x = i, at `count` places along z."""
    _write_rows(labels, i, size[2], count, rows)
    for j in range(slices.free.shape[1]):
        for word in range(slices.free.shape[2]):
            free = whole = ALL
            for n in range(j, j + size[1]):
                free &= rows.free[n, word]
                whole &= rows.whole[n, word]
                if n + 1 < j + size[1]:
                    whole &= rows.like[n, word]
            slices.free[i, j, word], slices.whole[i, j, word], slices.like[i, j, word] = free, whole, NONE
        for k in range(count if i + 1 < labels.shape[0] else 0):
            slices.like[i, j, k >> 6] |= BIT[k & 63] if labels[i, j, k] == labels[i + 1, j, k] else NONE


@inner(makes_arrays=True)
def _touches_more(labels: Labels, i: int, j: int, k: int, size: tuple[int, int, int], most: int, seen: Labels) -> bool:
    """Whether a box touches more than so many subspaces; seen: room for as many."""
    found, last = 0, -1
    for a in range(i, i + size[0]):
        for b in range(j, j + size[1]):
            for c in range(k, k + size[2]):
                label = labels[a, b, c]
                if label != last:
                    last, new = label, True
                    for n in range(found):
                        new = new and seen[n] != label
                    if new:
                        if found == most:
                            return True
                        seen[found] = label
                        found += 1
    return False


@njit(cache=True, nogil=True)
def detected_positions(
    labels: Labels, size: tuple[int, int, int], threshold: int, layers: int, misses: int, held: Flags
) -> tuple[Counts, Counts]:
    """At how many places a box of cuboids touches more than `threshold` subspaces, and how many places there are.

    labels (nx, ny, nz), −1 for excluded cuboids; size in cuboids; the box's lowest layer is one of the first `layers`.
    A place counts when the whole box lies inside the grid and contains no excluded cuboid. Both (mx, my), by the
    lowest cuboid of the box along x and y, summed over layers. Ends early after so many places without detection.
    Notes in held (n,) the subspaces that a box at some place lies in; nobody asks where it is empty.
    """
    nx, ny, nz = labels.shape
    count = min(nz - size[2] + 1, layers)
    words, seen = (count + 63) >> 6, np.empty(threshold, np.int32)
    places = np.zeros((nx - size[0] + 1, ny - size[1] + 1), np.int64)
    detected = np.zeros_like(places)
    rows = Rows(np.empty((ny, words), np.uint64), np.empty((ny, words), np.uint64), np.empty((ny, words), np.uint64))
    sliced = (nx, places.shape[1], words)
    slices = Slices(np.empty(sliced, np.uint64), np.empty(sliced, np.uint64), np.empty(sliced, np.uint64))
    written = 0
    for i in range(places.shape[0]):
        while written < i + size[0]:
            _write_slice(labels, written, size, count, rows, slices)
            written += 1
        for j in range(places.shape[1]):
            for word in range(words):
                free = whole = ALL
                for n in range(i, i + size[0]):
                    free &= slices.free[n, j, word]
                    whole &= slices.whole[n, j, word]
                    if n + 1 < i + size[0]:
                        whole &= slices.like[n, j, word]
                bits = free & ~whole if threshold > 0 else free
                if threshold > 1:
                    left = bits
                    while left != NONE:
                        k = word << 6 | lowest(left)
                        left &= left - ONE
                        if not _touches_more(labels, i, j, k, size, threshold, seen):
                            bits ^= BIT[k & 63]
                places[i, j] += ones(free)
                detected[i, j] += ones(bits)
                whole &= free if held.size else NONE
                while whole != NONE:
                    held[labels[i, j, word << 6 | lowest(whole)]] = True
                    whole &= whole - ONE
            misses -= places[i, j] - detected[i, j]
            if misses <= 0:
                return detected, places
    return detected, places


@njit(cache=True, nogil=True)
def detected_boxes(
    labels: Labels, low: Array, edge: Array, boxes: Array, size: tuple[float, float, float], threshold: int
) -> tuple[int, int]:
    """How many of some boxes touch more than `threshold` subspaces, and how many touch no excluded cuboid.

    labels (nx, ny, nz), −1 for excluded cuboids, with edges (3,) and their lower corner at low (3,); boxes (n, 4):
    centre x and y, bottom z, heading. A box touches a cuboid if their interiors intersect (separating axes).
    """
    nx, ny, nz = labels.shape
    seen = np.empty(threshold + 1, np.int32)
    places = detected = 0
    for n in range(boxes.shape[0]):
        x, y = boxes[n, 0] - low[0], boxes[n, 1] - low[1]
        c, s = np.cos(boxes[n, 3]), np.sin(boxes[n, 3])
        reach_x = (size[0] * abs(c) + size[1] * abs(s)) / 2
        reach_y = (size[0] * abs(s) + size[1] * abs(c)) / 2
        along, across = (edge[0] * abs(c) + edge[1] * abs(s)) / 2, (edge[0] * abs(s) + edge[1] * abs(c)) / 2
        bottom = max(int(np.floor((boxes[n, 2] - low[2]) / edge[2] + 1e-9)), 0)
        top = min(int(np.ceil((boxes[n, 2] - low[2] + size[2]) / edge[2] - 1e-9)), nz)
        free, found = True, 0
        for i in range(max(int((x - reach_x) / edge[0]), 0), min(int((x + reach_x) / edge[0]) + 1, nx)):
            for j in range(max(int((y - reach_y) / edge[1]), 0), min(int((y + reach_y) / edge[1]) + 1, ny)):
                dx, dy = (i + 0.5) * edge[0] - x, (j + 0.5) * edge[1] - y
                if abs(dx * c + dy * s) >= size[0] / 2 + along or abs(dy * c - dx * s) >= size[1] / 2 + across:
                    continue
                for k in range(bottom, top):
                    label = labels[i, j, k]
                    free = free and label >= 0
                    if free and found <= threshold:
                        new = True
                        for m in range(found):
                            new = new and seen[m] != label
                        if new:
                            seen[found] = label
                            found += 1
        places += free
        detected += free and found > threshold
    return detected, places
