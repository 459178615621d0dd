"""The loops of Ouster's packets: pixels to fields and back, and the packet's CRC."""

import numpy as np

from lidarcfg.jit import inner, njit, outer

NO_FIELD = -1
loop = outer(error_model="numpy")


@njit(cache=True, nogil=True)
def measured(range_m, reflectivity, limits, light, by_strength, out):
    """Fields of N firings from what they measured (N, R): `out` (3 R, N) gets range, reflectivity and signal of each.

    What is measured, and the beam's start ahead of the axis, is written in the packet's unit. Limits are least and
    greatest length, that start, unit and how many of it there may be. `light` (256,) are photons of reflectivities from
    a metre away; they fall with the square of the range. Of two returns that are alike the second is none.
    With `by_strength` the stronger of two comes first.
    """
    least_m, most_m, start_m, unit_m, most = limits
    for n in range(len(range_m)):
        for r in range(range_m.shape[1]):
            length_m = range_m[n, r]
            units, bright, photons = 0.0, 0, 0.0
            if least_m <= length_m <= most_m:
                units = np.rint((length_m + start_m) / unit_m)
                if not 0 < units <= most:
                    units = 0.0
            if units > 0:
                bright = reflectivity[n, r]
                photons = min(np.rint(light[reflectivity[n, r]] / (length_m * length_m)), 65535.0)
            if r == 1 and out[0, n] == units and out[1, n] == bright:
                units, bright, photons = 0.0, 0, 0.0
            out[3 * r, n], out[3 * r + 1, n], out[3 * r + 2, n] = units, bright, photons
        two = range_m.shape[1] == 2 and out[0, n] > 0 and out[3, n] > 0
        if by_strength and two and _weaker(range_m[n], reflectivity[n], light):
            for k in range(3):
                out[k, n], out[3 + k, n] = out[3 + k, n], out[k, n]


@inner(makes_arrays=True)
def _weaker(range_m, reflectivity, light):
    """Whether the first of two returns is weaker than the second."""
    return light[reflectivity[0]] * range_m[1] ** 2 < light[reflectivity[1]] * range_m[0] ** 2


@njit(cache=True, nogil=True)
def pack(fields, rows, bits, first_word, column_words, pixel_words, shape, words):
    """Write fields (F, N) into the pixels of packets, 32-bit words (P, W): field f by the row `rows[f]` of `bits`.

    Of the N pixels come `shape` (columns, pixels) in each packet; a packet's first pixel is at `first_word`. A row of
    NO_FIELD is not written.
    """
    columns, pixels = shape
    for p in range(len(words)):
        for c in range(columns):
            n = (p * columns + c) * pixels
            at = first_word + c * column_words
            for f in range(len(rows)):
                if rows[f] == NO_FIELD:
                    continue
                shift, mask = np.uint32(bits[rows[f], 1]), np.uint32(bits[rows[f], 2])
                _put(fields[f, n : n + pixels], mask, shift, pixel_words, words[p, at + bits[rows[f], 0] :])


@loop
def _put(values, mask, shift, step, words):
    """Put a field's values where they belong in every so many words."""
    at, step = np.uint64(0), np.uint64(step)
    for value in values:
        words[at] |= (value & mask) << shift
        at += step


@njit(cache=True, nogil=True)
def unpack(words, bits, first_word, column_words, pixel_words, shape):
    """(F, P, C, pixels): the fields in the pixels of packets, 32-bit words (P, W), as they stand there."""
    columns, pixels = shape
    out = np.empty((len(bits), len(words), columns, pixels), np.uint32)
    for f in range(len(bits)):
        word, shift, mask = bits[f, 0], bits[f, 1], bits[f, 2]
        for p in range(len(words)):
            for c in range(columns):
                at = first_word + c * column_words + word
                for i in range(pixels):
                    out[f, p, c, i] = (np.int64(words[p, at + i * pixel_words]) >> shift) & mask
    return out


@njit(cache=True, nogil=True)
def crc64(words, tables, out):
    """CRC-64 of packets in 32-bit words (P, n), by the tables (8, 256) of the polynomial.

    Two packets together, as the processor waits for each word's remainder; two of their words at a time.
    """
    for p in range(0, len(words), 2):
        other = min(p + 1, len(words) - 1)
        out[p], out[other] = _crc64(words[p], words[other], tables)


@loop
def _crc64(first, second, tables):
    ones, one = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(1)
    a, b, at, whole = ones, ones, np.uint64(0), np.uint64(len(first) // 2 * 2)
    while at < whole:
        a = _reduced(a ^ (np.uint64(first[at]) | np.uint64(first[at + one]) << np.uint64(32)), tables)
        b = _reduced(b ^ (np.uint64(second[at]) | np.uint64(second[at + one]) << np.uint64(32)), tables)
        at += np.uint64(2)
    if len(first) % 2:
        a, b = a ^ np.uint64(first[at]), b ^ np.uint64(second[at])
        for _ in range(4):
            a = tables[0, a & np.uint64(255)] ^ (a >> np.uint64(8))
            b = tables[0, b & np.uint64(255)] ^ (b >> np.uint64(8))
    return a ^ ones, b ^ ones


@loop
def _reduced(data, tables):
    """The remainder of eight octets."""
    value = np.uint64(0)
    for k in range(8):
        value ^= tables[7 - k, (data >> np.uint64(8 * k)) & np.uint64(255)]
    return value
