"""The loop of decoding an Ouster's packets: where each return lies."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import outer
from lidarcfg.packets.codec import Octets, Times

loop = outer(fastmath={"contract", "nsz"}, error_model="numpy")  # products may be fused with sums


class Pixels(NamedTuple):
    """Where packets have columns and their pixels, in 32-bit words."""

    head: int  # before the first column
    first: int  # before a column's first pixel
    column: int  # from one column to the next
    columns: int
    valid: tuple[int, int]  # where a column says whether it is valid, and the bits that are set if so
    width: int  # from one pixel to the next
    ranges: NDArray[np.int64]  # (R, 4) rows of the layout's bits, of each return
    bright: NDArray[np.int64]  # (R, 4) the same of reflectivities


class Beams(NamedTuple):
    """The L pixels of a column, in the sensor's frame."""

    axes: Array  # (3, 3, L) of x, y, z of directions, what is summed up times 1, cosine and sine of the encoder's angle
    turning: int  # how many of x, y, z change with that angle; the others are those times 1
    heading: Array  # (columns of a revolution, 2) cosine and sine of the encoder's angle
    start: Array  # (3, 3) x, y, z of where all start, to be summed up in the same way
    start_m: float  # how far that is from the middle
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
def points(words, pixels, beams, turned, out):
    """Write the returns of packets, column by column, a pixel's first before its second; and say how many there are.

    `words` (P, W) are the packets in 32-bit words. `turned` (3, L) is room for a column's directions, and holds what of
    them does not turn.
    """
    heading, kinds, valid = beams.heading, beams.kinds, np.uint32(pixels.valid[1])
    dual, n = len(kinds) == 2, np.uint64(0)  # unsigned: never from the end
    for p in range(len(words)):
        for column in range(pixels.columns):
            said = words[p, pixels.head + column * pixels.column :]
            measurement = np.int64(said[2] & np.uint32(0xFFFF))
            if said[pixels.valid[0]] & valid != valid or measurement >= len(heading):
                continue
            cos, sin = heading[measurement, 0], heading[measurement, 1]
            for axis in range(beams.turning):
                _turn(beams.axes[axis], cos, sin, turned[axis])
            origin, part, begun = _start(beams.start, cos, sin, beams.start_m), said[pixels.first :], np.int64(n)
            if dual:
                n = _two(part, pixels, turned, origin, beams, out, n)
            else:
                n = _one(part, pixels, turned, origin, beams, out, n)
            time_ns = np.int64(np.uint64(said[1]) << np.uint64(32) | np.uint64(said[0]))
            _fill(time_ns, out.time_ns[begun : np.int64(n)])
    if not dual:
        _fill(kinds[0], out.kind[: np.int64(n)])
    return np.int64(n)


@loop
def _one(part, pixels, turned, origin, beams, out, n):
    """Write a column's returns, from number n on, where a pixel has one; and say the number of the next."""
    xyz, intensity, out_ring, ring = out.xyz, out.intensity, out.ring, beams.ring
    x, y, z = turned[0], turned[1], turned[2]
    word, gray_word, shift, gray_shift, mask, dropped = _bits(pixels, 0)
    at, width = np.uint64(0), np.uint64(pixels.width)
    for i in range(np.uint64(len(ring))):
        units = ((part[at + word] >> shift) & mask) << dropped
        if units:
            _put(xyz, n, units, (x[i], y[i], z[i]), origin)
            intensity[n], out_ring[n] = part[at + gray_word] >> gray_shift, ring[i]
            n += np.uint64(1)
        at += width
    return n


@loop
def _two(part, pixels, turned, origin, beams, out, n):
    """The same where a pixel has up to two, whose types are also written."""
    xyz, intensity, out_ring, ring, kind = out.xyz, out.intensity, out.ring, beams.ring, out.kind
    x, y, z = turned[0], turned[1], turned[2]
    word, gray_word, shift, gray_shift, mask, dropped = _bits(pixels, 0)
    word2, gray_word2, shift2, gray_shift2, mask2, dropped2 = _bits(pixels, 1)
    first, second = beams.kinds[0], beams.kinds[1]
    at, width = np.uint64(0), np.uint64(pixels.width)
    for i in range(np.uint64(len(ring))):
        units = ((part[at + word] >> shift) & mask) << dropped
        if units:
            _put(xyz, n, units, (x[i], y[i], z[i]), origin)
            intensity[n], out_ring[n], kind[n] = part[at + gray_word] >> gray_shift, ring[i], first
            n += np.uint64(1)
        units = ((part[at + word2] >> shift2) & mask2) << dropped2
        if units:
            _put(xyz, n, units, (x[i], y[i], z[i]), origin)
            intensity[n], out_ring[n], kind[n] = part[at + gray_word2] >> gray_shift2, ring[i], second
            n += np.uint64(1)
        at += width
    return n


@loop
def _bits(pixels, which):
    """Where a pixel has a return's range and reflectivity: words and shifts; the range's mask and dropped bits."""
    row, gray = pixels.ranges[which], pixels.bright[which]
    at = np.uint64(row[0]), np.uint64(gray[0])
    return at[0], at[1], np.uint32(row[1]), np.uint32(gray[1]), np.uint32(row[2]), np.uint32(row[3])


@loop
def _turn(axes, cos, sin, turned):
    """Write one of x, y, z of the directions at an encoder angle."""
    fixed, by_cos, by_sin = axes[0], axes[1], axes[2]
    for i in range(len(turned)):
        turned[i] = fixed[i] + by_cos[i] * cos + by_sin[i] * sin


@loop
def _start(start, cos, sin, start_m):
    """Where beams start at an encoder angle, and how far that is from the middle."""
    return (
        start[0, 0] + start[1, 0] * cos + start[2, 0] * sin,
        start[0, 1] + start[1, 1] * cos + start[2, 1] * sin,
        start[0, 2] + start[1, 2] * cos + start[2, 2] * sin,
        start_m,
    )


@loop
def _put(xyz, n, units, direction, origin):
    """Write where return n lies."""
    x, y, z, start_m = origin
    length_m, k = np.int32(units) * 0.001 - start_m, np.uint64(3) * n
    xyz[k] = direction[0] * length_m + x
    xyz[k + np.uint64(1)] = direction[1] * length_m + y
    xyz[k + np.uint64(2)] = direction[2] * length_m + z


@loop
def _fill(value, out):
    for i in range(len(out)):
        out[i] = value
