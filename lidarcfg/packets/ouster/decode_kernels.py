"""The loop of decoding an Ouster's packets: where each return lies."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import outer
from lidarcfg.packets.codec import Octets, Times

loop = outer(fastmath={"contract", "nsz"}, error_model="numpy")  # products may be fused with sums
ONE, TWO, THREE, FOUR = (np.uint64(i) for i in (1, 2, 3, 4))  # unsigned: never from the end


class Pixels(NamedTuple):
    """Where packets have columns and their pixels, in 32-bit words."""

    head: int  # before the first column
    first: int  # before a column's first pixel
    column: int  # from one column to the next
    columns: int
    valid: tuple[int, int]  # where a column says whether it is valid, and the bits that are set if so
    width: int  # from one pixel to the next
    ranges: NDArray[np.uint64]  # (R,) a pixel's words that begin with the range of each return
    bright: NDArray[np.uint64]  # (R,) the octets of its reflectivities
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
def points(words, octets, pixels, beams, turned, out):
    """Write the returns of packets, column by column, a pixel's first before its second; and say how many there are.

    The packets are given in 32-bit words (P, W) and in octets (P, 4 W). `turned` (2, L) is room for a column's
    directions.
    """
    heading, kinds, valid = beams.heading, beams.kinds, np.uint32(pixels.valid[1])
    shift_m, times_ns, (ahead_m, start_m) = beams.shift_m, out.time_ns, beams.start_m
    dual, n = len(kinds) == 2, np.uint64(0)
    for p in range(len(words)):
        for column in range(pixels.columns):
            at = pixels.head + column * pixels.column
            said = words[p, at:]
            measurement = np.int64(said[2] & np.uint32(0xFFFF))
            if said[pixels.valid[0]] & valid != valid or measurement >= len(heading):
                continue
            cos, sin = heading[measurement, 0], heading[measurement, 1]
            _turn(beams.ahead, beams.right, cos, sin, turned)
            start = ahead_m * cos + shift_m[0], ahead_m * sin + shift_m[1], shift_m[2], start_m
            part, bright, begun = said[pixels.first :], octets[p, 4 * (at + pixels.first) :], n
            if dual:
                n = _two(part, bright, pixels, beams, turned, start, out, n)
            else:
                n = _one(part, bright, pixels, beams, turned, start, out, n)
            _fill(np.int64(np.uint64(said[1]) << np.uint64(32) | np.uint64(said[0])), begun, n, times_ns)
    if not dual:
        _fill(kinds[0], np.uint64(0), n, out.kind)
    return np.int64(n)


@loop
def _one(part, bright, pixels, beams, turned, start, out, n):
    """Write a column's returns, from number n on, where a pixel has one; and say the number of the next.

    Two pixels at a time, which mostly both have one.
    """
    xyz, intensity, out_ring, ring = out.xyz, out.intensity, out.ring, beams.ring
    x, y, z = turned[0], turned[1], beams.up
    mask, unit_m, width = np.uint32(pixels.mask), pixels.unit_m, np.uint64(pixels.width)
    at, gray, count = pixels.ranges[0], pixels.bright[0], np.uint64(len(ring))
    for i in range(np.uint64(0), count & ~ONE, TWO):
        here, there = part[at] & mask, part[at + width] & mask
        if here and there:
            _put(xyz, n, here * unit_m, (x[i], y[i], z[i]), start)
            _put(xyz, n + ONE, there * unit_m, (x[i + ONE], y[i + ONE], z[i + ONE]), start)
            intensity[n], intensity[n + ONE] = bright[gray], bright[gray + FOUR * width]
            out_ring[n], out_ring[n + ONE] = ring[i], ring[i + ONE]
            n += TWO
        elif here | there:
            which = np.uint64(here == 0)
            k = i + which
            _put(xyz, n, (here | there) * unit_m, (x[k], y[k], z[k]), start)
            intensity[n], out_ring[n] = bright[gray + FOUR * width * which], ring[k]
            n += ONE
        at, gray = at + TWO * width, gray + np.uint64(8) * width
    if count & ONE and part[at] & mask:
        k = count - ONE
        _put(xyz, n, (part[at] & mask) * unit_m, (x[k], y[k], z[k]), start)
        intensity[n], out_ring[n] = bright[gray], ring[k]
        n += ONE
    return n


@loop
def _two(part, bright, pixels, beams, turned, start, out, n):
    """The same where a pixel has up to two, whose types are also written."""
    xyz, intensity, out_ring, ring, kind = out.xyz, out.intensity, out.ring, beams.ring, out.kind
    x, y, z = turned[0], turned[1], beams.up
    mask, unit_m, width = np.uint32(pixels.mask), pixels.unit_m, np.uint64(pixels.width)
    near, far = pixels.ranges[0], pixels.ranges[1]
    near_gray, far_gray, at = pixels.bright[0], pixels.bright[1], np.uint64(0)
    first, second = beams.kinds[0], beams.kinds[1]
    for i in range(np.uint64(len(ring))):
        units, more = part[at + near] & mask, part[at + far] & mask
        if units:
            _put(xyz, n, units * unit_m, (x[i], y[i], z[i]), start)
            intensity[n], out_ring[n], kind[n] = bright[FOUR * at + near_gray], ring[i], first
            n += ONE
        if more:
            _put(xyz, n, more * unit_m, (x[i], y[i], z[i]), start)
            intensity[n], out_ring[n], kind[n] = bright[FOUR * at + far_gray], ring[i], second
            n += ONE
        at += width
    return n


@loop
def _turn(ahead, right, cos, sin, turned):
    """Write x and y of the directions at an encoder angle."""
    x, y = turned[0], turned[1]
    for i in range(np.uint64(len(ahead))):
        x[i] = ahead[i] * cos + right[i] * sin
        y[i] = ahead[i] * sin - right[i] * cos


@loop
def _put(xyz, n, range_m, direction, start):
    """Write where return n lies, given how far it is from the middle."""
    x, y, z, start_m = start
    length_m, k = range_m - start_m, THREE * n
    xyz[k] = direction[0] * length_m + x
    xyz[k + ONE] = direction[1] * length_m + y
    xyz[k + TWO] = direction[2] * length_m + z


@loop
def _fill(value, first, last, out):
    for i in range(first, last):
        out[i] = value
