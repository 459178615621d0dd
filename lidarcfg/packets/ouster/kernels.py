"""The loops of Ouster's packets: pixels to fields and points and back, and the packet's CRC."""

import math

import numpy as np

from lidarcfg.jit import njit

NO_FIELD = -1


@njit(cache=True, nogil=True)
def measured(range_m, reflectivity, limits, signal_scale, out):
    """Fields of N firings from what they measured (N, R): `out` (3 R, N) gets range, reflectivity and signal of each.

    What is measured, and the beam's start ahead of the axis, is written in the packet's unit. Limits are least and
    greatest length, that start, unit and how many of it there may be. Of two returns that are alike the second is none.
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
                photons = min(np.rint(signal_scale * bright / (length_m * length_m)), 65535.0)
            if r == 1 and out[0, n] == units and out[1, n] == bright:
                units, bright, photons = 0.0, 0, 0.0
            out[3 * r, n], out[3 * r + 1, n], out[3 * r + 2, n] = units, bright, photons


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
                word, shift, mask = bits[rows[f], 0], np.uint32(bits[rows[f], 1]), bits[rows[f], 2]
                for i in range(pixels):
                    value = np.uint32(fields[f, n + i] & mask)
                    words[p, at + i * pixel_words + word] |= np.uint32(value << shift)


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
def count_returns(words, valid, ranges, first_word, column_words, pixel_words, pixels):
    """How many ranges, at the rows `ranges` (R, 4) of a layout's bits, are not zero in valid columns (P, C)."""
    total = 0
    for p in range(len(words)):
        for c in range(valid.shape[1]):
            if valid[p, c]:
                for r in range(len(ranges)):
                    at = first_word + c * column_words + ranges[r, 0]
                    mask = np.uint32(ranges[r, 2] << ranges[r, 1])
                    for i in range(pixels):
                        total += (words[p, at + i * pixel_words] & mask) != 0
    return total


@njit(cache=True, nogil=True)
def points(words, valid, measurement, time_ns, ranges, bright, place, beams, frame, kinds, out):
    """Write the points of packets, column by column, a pixel's first return before its second.

    `ranges` and `bright` (R, 4) are rows of the layout's bits, `place` says where pixels are: first word, words of a
    column, of a pixel. `beams` is the unit vector (3, L) of each pixel at encoder angle 0, and its ring (L,); `frame`
    the columns in a revolution, the beam's start (2,) ahead and up, and T_sensor_lidar (4, 4). `kinds` (R,) are the
    types of the returns. Out: xyz, time, laser, ring, intensity, type.
    """
    first_word, column_words, pixel_words = place
    unit, ring = beams
    per_turn, start_m, T = frame
    xyz, out_time, laser, out_ring, intensity, kind = out
    lasers, returns = unit.shape[1], len(ranges)
    start_length_m = math.sqrt(start_m[0] ** 2 + start_m[1] ** 2)
    turned = np.empty((3, lasers))
    units, gray = np.empty((returns, lasers), np.int64), np.empty((returns, lasers), np.uint8)
    n = 0
    for p in range(len(words)):
        for c in range(valid.shape[1]):
            if not valid[p, c]:
                continue
            angle = 2 * math.pi * (1 - measurement[p, c] / per_turn)
            cos_a, sin_a = math.cos(angle), math.sin(angle)
            x0, y0, z0 = _turn(unit, cos_a, sin_a, start_m[0], start_m[1], T, turned)
            at = first_word + c * column_words
            for r in range(returns):
                _bits(words[p], at, pixel_words, ranges[r], units[r])
                _bits(words[p], at, pixel_words, bright[r], gray[r])
            now_ns = time_ns[p, c]
            for i in range(lasers):
                for r in range(returns):
                    if units[r, i]:
                        length_m = units[r, i] * 0.001 - start_length_m
                        xyz[n, 0] = turned[0, i] * length_m + x0
                        xyz[n, 1] = turned[1, i] * length_m + y0
                        xyz[n, 2] = turned[2, i] * length_m + z0
                        intensity[n], kind[n] = gray[r, i], kinds[r]
                        out_time[n], laser[n], out_ring[n] = now_ns, i, ring[i]
                        n += 1


@njit(cache=True, nogil=True)
def _turn(unit, cos_a, sin_a, ahead_m, up_m, T, turned):
    """Write unit vectors (3, L) of the sensor's frame for a column at an encoder angle; where its beams start there."""
    x = T[0, 0] * cos_a + T[0, 1] * sin_a, T[0, 1] * cos_a - T[0, 0] * sin_a, T[0, 2]
    y = T[1, 0] * cos_a + T[1, 1] * sin_a, T[1, 1] * cos_a - T[1, 0] * sin_a, T[1, 2]
    z = T[2, 0] * cos_a + T[2, 1] * sin_a, T[2, 1] * cos_a - T[2, 0] * sin_a, T[2, 2]
    for i in range(unit.shape[1]):
        u, v, w = unit[0, i], unit[1, i], unit[2, i]
        turned[0, i] = x[0] * u + x[1] * v + x[2] * w
        turned[1, i] = y[0] * u + y[1] * v + y[2] * w
        turned[2, i] = z[0] * u + z[1] * v + z[2] * w
    return (
        x[0] * ahead_m + x[2] * up_m + T[0, 3],
        y[0] * ahead_m + y[2] * up_m + T[1, 3],
        z[0] * ahead_m + z[2] * up_m + T[2, 3],
    )


@njit(cache=True, nogil=True)
def _bits(words, at, pixel_words, row, out):
    """Write the values (L,) of a field of a column's pixels."""
    start, shift, mask, dropped = at + row[0], row[1], row[2], row[3]
    for i in range(len(out)):
        out[i] = ((np.int64(words[start + i * pixel_words]) >> shift) & mask) << dropped


@njit(cache=True, nogil=True)
def crc64(packets, count, tables, out):
    """CRC-64 of the first `count` bytes of each packet: eight at a time, by the tables (8, 256) of the polynomial."""
    ones = np.uint64(0xFFFFFFFFFFFFFFFF)
    eight, low = np.uint64(8), np.uint64(255)
    for p in range(len(packets)):
        value = ones
        whole = count // 8 * 8
        for i in range(0, whole, 8):
            data = np.uint64(0)
            for k in range(8):
                data |= np.uint64(packets[p, i + k]) << np.uint64(8 * k)
            data ^= value
            value = np.uint64(0)
            for k in range(8):
                value ^= tables[7 - k, (data >> np.uint64(8 * k)) & low]
        for i in range(whole, count):
            value = tables[0, (value ^ np.uint64(packets[p, i])) & low] ^ (value >> eight)
        out[p] = value ^ ones
