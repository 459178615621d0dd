"""The loop of decoding an Ouster's packets: where each return lies."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import outer
from lidarcfg.packets.codec import Octets, Times
from lidarcfg.packets.ouster.eight import copy, place, same, which

loop = outer(fastmath={"contract", "nsz"}, error_model="numpy")  # products may be fused with sums
ONE, TWO, THREE, SEVEN, EIGHT = (np.uint64(i) for i in (1, 2, 3, 7, 8))  # unsigned: never from the end
ALL = np.uint8(255)


class Pixels(NamedTuple):
    """Where packets have columns and their pixels, in 32-bit words."""

    head: int  # before the first column
    first: int  # before a column's first pixel
    column: int  # from one column to the next
    columns: int
    valid: tuple[int, int]  # where a column says whether it is valid, and the bits that are set if so
    width: int  # from one pixel to the next
    ranges: NDArray[np.uint64]  # (R,) a pixel's words that begin with the range of each return
    bright: NDArray[np.uint64]  # (R, 2) the words of its reflectivities, and with which bit these begin
    mask: int  # of a range
    unit_m: float


class Beams(NamedTuple):
    """The L pixels of a column, in a frame whose z is the axis."""

    ahead: Array  # (L,) parts of the directions where the encoder's angle is 0
    right: Array  # (L,)
    up: Array  # (L,)
    heading: Array  # (columns of a revolution, 2) cosine and sine of the encoder's angle
    start_m: tuple[float, float]  # of all beams: ahead, and from the middle
    shift_m: tuple[float, float, float]  # that is added to all
    ring: Octets  # (L,)
    kinds: Octets  # (R,) types of the returns


class Returned(NamedTuple):
    """What is filled in, one entry a return."""

    xyz: Array  # (3 N,) x, y, z of each
    time_ns: Times
    ring: Octets
    intensity: Octets
    kind: Octets


@loop
def points(words, pixels, beams, out):
    """Write the returns of packets, column by column, a pixel's first before its second; and say how many there are.

    The packets are given in 32-bit words (P, W).
    """
    heading, kinds, valid = beams.heading, beams.kinds, np.uint32(pixels.valid[1])
    shift_m, times_ns, (ahead_m, start_m) = beams.shift_m, out.time_ns, beams.start_m
    n = np.uint64(0)
    for p in range(len(words)):
        for column in range(pixels.columns):
            said = words[p, pixels.head + column * pixels.column :]
            measurement = np.int64(said[2] & np.uint32(0xFFFF))
            if said[pixels.valid[0]] & valid != valid or measurement >= len(heading):
                continue
            cos, sin = heading[measurement, 0], heading[measurement, 1]
            how = cos, sin, ahead_m * cos + shift_m[0], ahead_m * sin + shift_m[1], shift_m[2], start_m
            begun, n = n, _column(said[pixels.first :], pixels, beams, how, out, n)
            _fill(np.int64(np.uint64(said[1]) << np.uint64(32) | np.uint64(said[0])), begun, n, times_ns)
    if len(kinds) == 1:
        _fill(kinds[0], np.uint64(0), n, out.kind)
    return np.int64(n)


@loop
def _column(part, pixels, beams, how, out, n):
    """Write a column's returns, from number n on, and say the number of the next.

    Eight pixels at a time, which mostly have one return each, or none.
    """
    mask, width, count, dual = (
        np.uint32(pixels.mask),
        np.uint64(pixels.width),
        np.uint64(len(beams.ring)),
        len(beams.kinds) == 2,
    )
    ranges, bright, ring, out_ring = pixels.ranges, pixels.bright, beams.ring, out.ring
    ways, whole, more = (beams.ahead, beams.right, beams.up), count & ~SEVEN, np.uint8(0)
    for i in range(np.uint64(0), whole, EIGHT):
        at = i * width
        found = which(part, at + ranges[0], width, mask)
        if dual:
            more = which(part, at + ranges[1], width, mask)
        if more:
            n = _singly(part, pixels, beams, how, out, i, i + EIGHT, n)
        elif found:
            place(part, at + ranges[0], width, mask, pixels.unit_m, ways, i, how, out.xyz, n)
            copy(part, at + bright[0, 0], width, np.uint32(bright[0, 1]), out.intensity, n)
            same(ring, i, out_ring, n)
            if dual:
                _fill(beams.kinds[0], n, n + EIGHT, out.kind)
            n = n + EIGHT if found == ALL else _chosen(np.uint64(found), out, n)
    return _singly(part, pixels, beams, how, out, whole, count, n)


@loop
def _chosen(bits, out, n):
    """Of eight returns that were written, from number n on, keep those with a bit; and say the number of the next."""
    xyz, intensity, ring, kept = out.xyz, out.intensity, out.ring, n
    for k in range(n, n + EIGHT):
        for axis in range(THREE):
            xyz[THREE * kept + axis] = xyz[THREE * k + axis]
        intensity[kept], ring[kept] = intensity[k], ring[k]
        kept += bits & ONE
        bits >>= ONE
    return kept


@loop
def _singly(part, pixels, beams, how, out, first, last, n):
    """The same for some pixels, one after the other."""
    mask, width, (cos, sin, x, y, z, start_m) = np.uint32(pixels.mask), np.uint64(pixels.width), how
    for i in range(first, last):
        for r in range(len(beams.kinds)):
            units = part[i * width + pixels.ranges[r]] & mask
            if units:
                length_m, k = units * pixels.unit_m - start_m, THREE * n
                out.xyz[k] = (beams.ahead[i] * cos + beams.right[i] * sin) * length_m + x
                out.xyz[k + ONE] = (beams.ahead[i] * sin - beams.right[i] * cos) * length_m + y
                out.xyz[k + TWO] = beams.up[i] * length_m + z
                gray = part[i * width + pixels.bright[r, 0]] >> pixels.bright[r, 1]
                out.intensity[n], out.ring[n], out.kind[n] = gray & np.uint64(255), beams.ring[i], beams.kinds[r]
                n += ONE
    return n


@loop
def _fill(value, first, last, out):
    for i in range(first, last):
        out[i] = value
