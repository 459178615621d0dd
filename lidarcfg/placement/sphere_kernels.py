"""The compiled loops of the largest spheres: a search over the lattice of half cuboids.

A node 2x + p of the lattice is the lower face of cuboid x where p is 0, and its middle where p is 1. A sphere around a
node is as large as the nearest cuboid that is not of the node's subspace lets it be. So a node has no larger sphere
than the best so far if one such cuboid is near enough, and a column of cuboids that shows it for one node mostly shows
it for its neighbours. Along z each test passes over all nodes that its cuboid is near enough to.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
from typing import NamedTuple

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.placement.bits import BIT, NONE, ONE, Words, highest, lowest
from lidarcfg.placement.components import Labels
from lidarcfg.placement.rows import Counts

STRIDES = np.array([8, 1])  # some of the nodes first, so that there is a good sphere to beat
STEP = 2**31 - 1  # through the columns, which are fewer: a prime, so that all are tried, in an order that spreads them


class Search(NamedTuple):
    """What is searched, the best sphere so far, and what rules out others. Squares are of metres."""

    label: Labels  # (nx, ny, nz) the subspace of each cuboid, −1 where it is excluded
    ends: Words  # (nx, ny, words) of each column along z a bit where the next cuboid is of another subspace
    half: Array  # (3,) half a cuboid
    best: Array  # (1,) the square of the largest radius so far
    node: Counts  # (4,) its centre, and the half cuboids in its radius along z
    columns: Counts  # (4, columns, 3) by parity of a node: the columns of cuboids in reach, see _columns
    counts: Counts  # (4,) of them
    squares: Array  # (4,) the squares that they are for
    recent: Counts  # (4, some, 3) those that ruled out a node lately


@inner()
def _apart(cuboids, parity):
    """Half cuboids from a node of this parity to the nearest side of a cuboid that is so many on."""
    if cuboids > 0:
        return 2 * cuboids - parity
    return -2 * cuboids - 2 + parity if cuboids < 0 else 0


@inner()
def _square(count, half):
    """Of a length in half cuboids."""
    return (count * half) * (count * half)


@inner()
def _chord(square, level, half):
    """The most half cuboids along z that, with the square of what is across, are within a square; −1 where none are."""
    if level > square:
        return -1
    count = int(np.sqrt(square - level) / half)
    while level + _square(count + 1, half) <= square:
        count += 1
    while level + _square(count, half) > square:
        count -= 1
    return count


@inner()
def _columns(search, parity):
    """Write the columns around a node that the best sphere reaches: cuboids on along x, along y, and the chord."""
    half, best, columns, count = search.half, search.best[0], search.columns, 0
    far_x, far_y = int(np.sqrt(best) / half[0]) // 2 + 2, int(np.sqrt(best) / half[1]) // 2 + 2
    for x in range(-far_x, far_x + 1):
        across = _square(_apart(x, parity >> 1), half[0])
        for y in range(-far_y, far_y + 1):
            chord = _chord(best, across + _square(_apart(y, parity & 1), half[1]), half[2])
            if chord >= 0:
                columns[parity, count, 0], columns[parity, count, 1], columns[parity, count, 2] = x, y, chord
                count += 1
    search.counts[parity], search.squares[parity] = count, best


@inner()
def _highest_other(label, ends, x, y, low, high, one):
    """The highest of a column's cuboids from low to high that is not of a subspace; −1 where all are."""
    if label[x, y, high] != one:
        return high
    for word in range(high >> 6, (low >> 6) - 1, -1):
        bits = ends[x, y, word]
        if word == high >> 6:
            bits &= BIT[high & 63] - ONE
        if word == low >> 6:
            bits &= ~(BIT[low & 63] - ONE)
        if bits != NONE:
            return word << 6 | highest(bits)
    return -1


@inner()
def _onward(label, ends, i, j, k, one, on_x, on_y, chord):
    """The first node of a row, from k on, that a column does not rule out; for all but the row's end k in reach."""
    x, y, z, p = (i >> 1) + on_x, (j >> 1) + on_y, k >> 1, k & 1
    if x < 0 or y < 0 or x >= label.shape[0] or y >= label.shape[1]:
        return 2 * label.shape[2] + 1
    found = _highest_other(label, ends, x, y, z - (chord + 2 - p) // 2, z + (chord + p) // 2, one)
    return k if found < 0 else 2 * found + 3 + chord


@inner()
def _ruled_out(search, i, j, k, one):
    """The first node of a row, from k on, that no test for k rules out."""
    label, ends, columns, recent, parity = (
        search.label,
        search.ends,
        search.columns,
        search.recent,
        2 * (i & 1) + (j & 1),
    )
    for n in range(recent.shape[1]):
        x, y, chord = recent[parity, n, 0], recent[parity, n, 1], recent[parity, n, 2]
        onward = _onward(label, ends, i, j, k, one, x, y, chord)
        if onward > k:
            for m in range(n, 0, -1):
                for value in range(3):
                    recent[parity, m, value] = recent[parity, m - 1, value]
            recent[parity, 0, 0], recent[parity, 0, 1], recent[parity, 0, 2] = x, y, chord
            return onward
    if search.squares[parity] != search.best[0]:
        _columns(search, parity)
    at, count = 0, search.counts[parity]
    for _ in range(count):
        x, y, chord = columns[parity, at, 0], columns[parity, at, 1], columns[parity, at, 2]
        onward = _onward(label, ends, i, j, k, one, x, y, chord)
        if onward > k:
            for m in range(recent.shape[1] - 1, 0, -1):
                for value in range(3):
                    recent[parity, m, value] = recent[parity, m - 1, value]
            recent[parity, 0, 0], recent[parity, 0, 1], recent[parity, 0, 2] = x, y, chord
            return onward
        at = (at + STEP) % count
    return k


@inner()
def _nearest(label, half, i, j, k):
    """The squared distance of a node from the nearest cuboid that is not of its subspace."""
    nx, ny, nz = label.shape
    x, y, z, one, nearest = i >> 1, j >> 1, k >> 1, label[i >> 1, j >> 1, k >> 1], np.inf
    for side_x in (0, 1):
        for n in range(nx + 1):
            on_x = -n - 1 if side_x else n
            across = _square(_apart(on_x, i & 1), half[0])
            if across >= nearest:
                break
            for side_y in (0, 1):
                for m in range(ny + 1):
                    on_y = -m - 1 if side_y else m
                    level = across + _square(_apart(on_y, j & 1), half[1])
                    if level >= nearest:
                        break
                    outside = x + on_x < 0 or x + on_x >= nx or y + on_y < 0 or y + on_y >= ny
                    for side_z in (0, 1):
                        for c in range(nz + 1):
                            on_z = -c - 1 if side_z else c
                            square = level + _square(_apart(on_z, k & 1), half[2])
                            if square >= nearest:
                                break
                            beyond = outside or z + on_z < 0 or z + on_z >= nz
                            if beyond or label[x + on_x, y + on_y, z + on_z] != one:
                                nearest = square
                                break
    return nearest


@inner()
def _search_row(search, number, i, j):
    """Raise the best to the largest sphere around a node of a row along z; `number`: of this subspace, −1: of any."""
    label, ends, half, best, node = search.label, search.ends, search.half, search.best, search.node
    x, y, first, nz = i >> 1, j >> 1, 0, label.shape[2]
    while first < nz:
        word = first >> 6
        bits = ends[x, y, word] & ~(BIT[first & 63] - ONE)
        while bits == NONE:
            word += 1
            bits = ends[x, y, word]
        last, one = word << 6 | lowest(bits), label[x, y, first]
        if one >= 0 and (number < 0 or one == number):
            k = 2 * first + node[3] + 1
            while k <= 2 * last + 1 - node[3]:
                onward = _ruled_out(search, i, j, k, one)
                if onward == k:
                    best[0] = _nearest(label, half, i, j, k)
                    node[0], node[1], node[2], node[3] = i, j, k, _chord(best[0], 0.0, half[2])
                    onward = max(k + 1, 2 * first + node[3] + 1)
                k = onward
        first = last + 1


@njit(cache=True, nogil=True)
def largest(search: Search, number: int, low: Counts, high: Counts) -> None:
    """Find the largest sphere in a subspace that lies within the cuboids from low to high (3,), or −1, in any.

    Writes to search.best the square of its radius and to search.node the first of its centres, by x, y, z.
    """
    half, best, node = search.half, search.best, search.node
    for stride in STRIDES:
        best[0] = max(np.nextafter(best[0], -1.0), 0.0)  # the first of equals comes last
        node[3] = _chord(best[0], 0.0, half[2])
        for i in range(2 * low[0] + 1, 2 * high[0], stride):
            if _square(min(i - 2 * low[0], 2 * high[0] - i), half[0]) > best[0]:
                for j in range(2 * low[1] + 1, 2 * high[1], stride):
                    if _square(min(j - 2 * low[1], 2 * high[1] - j), half[1]) > best[0]:
                        _search_row(search, number, i, j)


@njit(cache=True, nogil=True)
def clearance(label: Labels, half: Array, i: int, j: int, k: int) -> float:
    """The squared distance of a node from the nearest face; 0 on one."""
    nx, ny, nz = label.shape
    if i >= 2 * nx or j >= 2 * ny or k >= 2 * nz or label[i >> 1, j >> 1, k >> 1] < 0:
        return 0.0
    return float(_nearest(label, half, i, j, k))
