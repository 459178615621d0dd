"""The loop of decoding an Ouster's packets: where each return lies."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner
from lidarcfg.packets.codec import Octets, Times

loop = inner(fastmath={"contract", "nsz"}, error_model="numpy")  # products may be fused with sums


class Pixels(NamedTuple):
    """Where packets have the pixels, in 32-bit words."""

    first: int
    column: int  # from one column to the next
    width: int  # from one pixel to the next
    ranges: NDArray[np.int64]  # (R, 4) rows of the layout's bits, of each return
    bright: NDArray[np.int64]  # (R, 4) the same of reflectivities


class Beams(NamedTuple):
    """The L pixels of a column, in the sensor's frame."""

    axes: Array  # (3, 3 L) x, y, z of each direction: of this 1, cosine and sine of the encoder's angle are summed up
    start: Array  # (3, 3) x, y, z of where all start, to be summed up in the same way
    start_m: float  # how far that is from the middle
    ring: Octets  # (L,)
    kinds: Octets  # (R,) types of the returns


class Returned(NamedTuple):
    """What is filled in, one entry a return."""

    xyz: Array  # (3 N,) x, y, z of each
    time_ns: Times
    laser: Octets
    ring: Octets
    intensity: Octets
    kind: Octets


@loop
def points(words, columns, per_turn, pixels, beams, turned, out):
    """Write the returns of packets, column by column, a pixel's first before its second; and say how many there are.

    `words` (P, W) are the packets in 32-bit words, `columns` valid, measurement and time (P, C), of which there are
    `per_turn` in a revolution. `turned` (3 L,) is room for a column's directions.
    """
    valid, measurement, time_ns = columns
    axes, start, start_m, ring, kinds = beams
    xyz, out_time, laser, out_ring, intensity, kind = out
    dual, first, second = len(kinds) == 2, _bits(pixels, 0), _bits(pixels, len(kinds) - 1)
    kind1, kind2 = kinds[0], kinds[len(kinds) - 1]
    width, one, n = (
        np.uint64(pixels.width),
        np.uint64(1),
        np.uint64(0),
    )  # unsigned: never from the end
    for p in range(len(words)):
        for column in range(valid.shape[1]):
            if not valid[p, column]:
                continue
            angle = 2 * math.pi * (1 - measurement[p, column] / per_turn)
            cos, sin = math.cos(angle), math.sin(angle)
            _turn(axes, cos, sin, turned)
            origin = _start(start, cos, sin, start_m)
            part, at, begun = words[p, pixels.first + column * pixels.column :], np.uint64(0), np.int64(n)
            for i in range(np.uint64(len(ring))):
                if _put(part, at, first, turned, i, origin, xyz, intensity, n):
                    laser[n], out_ring[n], kind[n] = i, ring[i], kind1
                    n += one
                if dual and _put(part, at, second, turned, i, origin, xyz, intensity, n):
                    laser[n], out_ring[n], kind[n] = i, ring[i], kind2
                    n += one
                at += width
            _fill(time_ns[p, column], out_time[begun : np.int64(n)])
    return np.int64(n)


@loop
def _bits(pixels, which):
    """Where a pixel has a return's range and reflectivity: words and shifts; the range's mask and dropped bits."""
    row, gray = pixels.ranges[which], pixels.bright[which]
    at = np.uint64(row[0]), np.uint64(gray[0])
    return at[0], at[1], np.uint32(row[1]), np.uint32(gray[1]), np.uint32(row[2]), np.uint32(row[3])


@loop
def _turn(axes, cos, sin, turned):
    """Write directions at an encoder angle."""
    fixed, by_cos, by_sin = axes[0], axes[1], axes[2]
    for k in range(len(turned)):
        turned[k] = fixed[k] + by_cos[k] * cos + by_sin[k] * sin


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
def _put(part, at, bits, turned, i, origin, xyz, intensity, n):
    """Write where return n lies, and how bright it is, if pixel i has one."""
    word, gray_word, shift, gray_shift, mask, dropped = bits
    units = ((part[at + word] >> shift) & mask) << dropped
    if units == 0:
        return False
    x, y, z, start_m = origin
    length_m = np.int32(units) * 0.001 - start_m
    k, e = np.uint64(3) * n, np.uint64(3) * i
    xyz[k] = turned[e] * length_m + x
    xyz[k + np.uint64(1)] = turned[e + np.uint64(1)] * length_m + y
    xyz[k + np.uint64(2)] = turned[e + np.uint64(2)] * length_m + z
    intensity[n] = part[at + gray_word] >> gray_shift
    return True


@loop
def _fill(value, out):
    for i in range(len(out)):
        out[i] = value
