"""The loops of casting: where beams point, rays brought into a part's own frame, what of a part they meet first."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit

NOTHING = -1  # for an object
SMALL = 0.02  # radians, up to which four terms of sine and cosine are exact


class Rays(NamedTuple):
    """N rays in some frame."""

    origins_m: Array  # (N, 3)
    directions: Array  # (N, 3) of unit length
    at: NDArray[np.int64]  # (N,) where what they meet is kept


class Nearest(NamedTuple):
    """What is known of what rays meet first."""

    range_m: Array  # inf: nothing
    object: NDArray[np.int32]  # -1: nothing
    normal: NDArray[np.float32]  # (…, 3) of the surface, towards either side; 0: nothing; (0, 3): not asked for


@njit(cache=True, nogil=True)
def _matrix(R, i):
    """Matrix i of R (n, 3, 3), or the only one, row by row: nine numbers stay in registers where an array does not."""
    i = min(i, len(R) - 1)
    return R[i, 0, 0], R[i, 0, 1], R[i, 0, 2], R[i, 1, 0], R[i, 1, 1], R[i, 1, 2], R[i, 2, 0], R[i, 2, 1], R[i, 2, 2]


@njit(cache=True, nogil=True)
def _times(m, x, y, z):
    """A matrix times a vector."""
    return m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z


@njit(cache=True, nogil=True)
def turned_by(R, i, x, y, z):
    """A vector turned by matrix i of R (n, 3, 3), or the only one."""
    return _times(_matrix(R, i), x, y, z)


@njit(cache=True, nogil=True)
def _product(m, n):
    """Of two matrices."""
    a, b, c = _times(m, n[0], n[3], n[6]), _times(m, n[1], n[4], n[7]), _times(m, n[2], n[5], n[8])
    return a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]


@njit(cache=True, nogil=True)
def _write(out, i, m):
    """To matrix i of out (n, 3, 3)."""
    for k in range(3):
        out[i, 0, k], out[i, 1, k], out[i, 2, k] = m[k], m[3 + k], m[6 + k]


@njit(cache=True, nogil=True)
def may_meet(azimuth, tables, lists):
    """By tables (K, sectors, L), of firings (N, L): the numbers (M,) of those that may meet anything; what (K, M).

    And which of the lists (sectors, L) is theirs, (M,); none are if there are none, (0, 0).
    """
    kinds, sectors, lasers = tables.shape
    scale, sector, listed = sectors / (2 * math.pi), np.empty(lasers, np.int64), lists.size > 0
    rows, what, count = np.empty(azimuth.size, np.int64), np.empty((kinds, azimuth.size), np.bool_), 0
    which = np.empty(azimuth.size if listed else 0, lists.dtype)
    for n in range(len(azimuth)):
        for k in range(lasers):
            sector[k] = min(int(azimuth[n, k] * scale), sectors - 1)
        for k in range(lasers):
            any_ = False
            for kind in range(kinds):
                here = tables[kind, sector[k], k]
                what[kind, count] = here
                any_ |= here
            if listed:
                which[count] = lists[sector[k], k]
            rows[count] = n * lasers + k
            count += any_
    return rows[:count], what[:, :count].copy(), which[:count]


@njit(cache=True, nogil=True)
def turned(turns, offset_ns, turns_per_ns, first_ns):
    """Times and azimuths (P, S, L) of firings that come so much (S, L) after their packets' stamps (P,).

    `turns` (P,) is how far the head has turned then, in whole turns.
    """
    shape = len(turns), *offset_ns.shape
    time_ns, azimuth_rad = np.empty(shape, np.int64), np.empty(shape)
    for p in range(shape[0]):
        for s in range(shape[1]):
            for k in range(shape[2]):
                turn = turns[p] + offset_ns[s, k] * turns_per_ns
                time_ns[p, s, k] = first_ns[p] + offset_ns[s, k]
                azimuth_rad[p, s, k] = (turn - math.floor(turn)) * (2 * math.pi)
    return time_ns, azimuth_rad


@njit(cache=True, nogil=True)
def beams(azimuth, rows, elevation, azimuth_offset, left_m, up_m, R, t):
    """Origins and unit vectors (M, 3) of the firings `rows` (M,) of (N, L), in the frame into which R and t lead.

    The tables (L,) are the lasers'; R (M or 1, 3, 3) and t (M or 1, 3) are one each or one for all.
    """
    lasers = azimuth.shape[1]
    cos_w, sin_w = np.cos(elevation), np.sin(elevation)
    cos_o, sin_o = np.cos(azimuth_offset), np.sin(azimuth_offset)
    c, s, turned = np.empty(lasers), np.empty(lasers), np.empty(lasers)
    origins, directions = np.empty((len(rows), 3)), np.empty((len(rows), 3))
    begin = -lasers
    for i in range(len(rows)):
        if rows[i] >= begin + lasers:  # another sequence
            n = rows[i] // lasers
            begin, most = n * lasers, 0.0
            for k in range(lasers):
                turned[k] = azimuth[n, k] - azimuth[n, 0]
                most = max(most, abs(turned[k]))
            if most < SMALL:  # a little since the sequence's first firing
                cos_h, sin_h = math.cos(azimuth[n, 0]), math.sin(azimuth[n, 0])
                for k in range(lasers):
                    square = turned[k] * turned[k]
                    sin_d = turned[k] * (1 - square * (1 / 6) * (1 - square * (1 / 20) * (1 - square * (1 / 42))))
                    cos_d = 1 - square * 0.5 * (1 - square * (1 / 12) * (1 - square * (1 / 30)))
                    c[k], s[k] = cos_h * cos_d - sin_h * sin_d, sin_h * cos_d + cos_h * sin_d
            else:
                for k in range(lasers):
                    c[k], s[k] = math.cos(azimuth[n, k]), math.sin(azimuth[n, k])
            for k in range(lasers):
                c[k], s[k] = c[k] * cos_o[k] - s[k] * sin_o[k], s[k] * cos_o[k] + c[k] * sin_o[k]
        k = rows[i] - begin
        x, y, z = left_m[k] * s[k], left_m[k] * c[k], up_m[k]
        u, v, w = cos_w[k] * c[k], -cos_w[k] * s[k], sin_w[k]
        if i < len(R):
            turn = _matrix(R, i)
        if i < len(t):
            place = t[i, 0], t[i, 1], t[i, 2]
        x, y, z = _times(turn, x, y, z)
        origins[i, 0], origins[i, 1], origins[i, 2] = x + place[0], y + place[1], z + place[2]
        directions[i, 0], directions[i, 1], directions[i, 2] = _times(turn, u, v, w)
    return origins, directions


@njit(cache=True, nogil=True)
def posed(seconds, times_s, positions_m, rotations, turns_rad):
    """R (n, 3, 3) and t (n, 3) at times (n,) between poses (K): in a straight line, and about one axis, evenly.

    The turns (K - 1, 3) from each rotation (K, 3, 3) to the next are rotation vectors in the frame that turns.
    """
    R, t = np.empty((len(seconds), 3, 3)), np.empty((len(seconds), 3))
    k = 0
    for i in range(len(seconds)):
        while k < len(times_s) - 2 and seconds[i] >= times_s[k + 1]:
            k += 1
        while k > 0 and seconds[i] < times_s[k]:
            k -= 1
        share = (seconds[i] - times_s[k]) / (times_s[k + 1] - times_s[k])
        x, y, z = share * turns_rad[k, 0], share * turns_rad[k, 1], share * turns_rad[k, 2]
        angle = math.sqrt(x * x + y * y + z * z)
        a = math.sin(angle) / angle if angle > 0 else 1.0
        b = 2 * (math.sin(angle / 2) / angle) ** 2 if angle > 0 else 0.5
        above = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
        middle = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
        below = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
        _write(R, i, _product(_matrix(rotations, k), above + middle + below))
        for j in range(3):
            t[i, j] = positions_m[k, j] + share * (positions_m[k + 1, j] - positions_m[k, j])
    return R, t


@njit(cache=True, nogil=True)
def arced(seconds, speed_m_s, rate_rad_s, heading_rad):
    """The same along a circle at a constant speed, from the origin at time 0, where it heads that far from x."""
    R, t = np.zeros((len(seconds), 3, 3)), np.zeros((len(seconds), 3))
    cos_0, sin_0 = math.cos(heading_rad), math.sin(heading_rad)
    for i in range(len(seconds)):
        half = seconds[i] * rate_rad_s / 2
        c, s = math.cos(half), math.sin(half)
        chord_m = speed_m_s * seconds[i] * (s / half if half != 0 else 1.0)
        t[i, 0], t[i, 1] = chord_m * (c * cos_0 - s * sin_0), chord_m * (s * cos_0 + c * sin_0)
        R[i, 0, 0] = R[i, 1, 1] = 1 - 2 * s * s
        R[i, 1, 0], R[i, 0, 1], R[i, 2, 2] = 2 * s * c, -2 * s * c, 1.0
    return R, t


@njit(cache=True, nogil=True)
def chained(outer_R, outer_t, R, t, inner_R, inner_t):
    """Rotations and places of frames in frames that move by R (M or 1, 3, 3) and t (M or 1, 3): as many of each."""
    count, outer, inner = max(len(R), len(t)) if min(len(R), len(t)) else 0, _matrix(outer_R, 0), _matrix(inner_R, 0)
    turns, places = np.empty((min(len(R), count), 3, 3)), np.empty((count, 3))
    for i in range(count):
        if i < len(R):
            both = _product(outer, _matrix(R, i))
            _write(turns, i, _product(both, inner))
            x, y, z = _times(both, inner_t[0], inner_t[1], inner_t[2])
        if i < len(t):
            u, v, w = _times(outer, t[i, 0], t[i, 1], t[i, 2])
        places[i, 0], places[i, 1], places[i, 2] = x + u + outer_t[0], y + v + outer_t[1], z + w + outer_t[2]
    return turns, places


@njit(cache=True, nogil=True)
def local_rays(origins_m, directions, rows, R, t):
    """The rays `rows` (M,) of (N, 3), in a frame that stands at t (M or 1, 3) and is turned by R (M or 1, 3, 3)."""
    origins, along = np.empty((len(rows), 3)), np.empty((len(rows), 3))
    for i in range(len(rows)):
        k, n, m = min(i, len(t) - 1), rows[i], _matrix(R, i)
        back = m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]
        x, y, z = origins_m[n, 0] - t[k, 0], origins_m[n, 1] - t[k, 1], origins_m[n, 2] - t[k, 2]
        origins[i, 0], origins[i, 1], origins[i, 2] = _times(back, x, y, z)
        u, v, w = directions[n, 0], directions[n, 1], directions[n, 2]
        along[i, 0], along[i, 1], along[i, 2] = _times(back, u, v, w)
    return origins, along


@njit(cache=True, nogil=True)
def narrowed(origins_m, directions, pick, place_m):
    """The rays `pick` (M,) of (N, 3) as (M, 6) in float32, relative to a place (3,)."""
    out = np.empty((len(pick), 6), np.float32)
    x, y, z = place_m
    for i in range(len(pick)):
        n = pick[i]
        out[i, 0], out[i, 1], out[i, 2] = origins_m[n, 0] - x, origins_m[n, 1] - y, origins_m[n, 2] - z
        out[i, 3], out[i, 4], out[i, 5] = directions[n, 0], directions[n, 1], directions[n, 2]
    return out


@njit(cache=True, nogil=True)
def bounds(points, pick):
    """Low and high corners (2, 3) of the box around the points `pick` (M,) of (N, 3)."""
    out = np.empty((2, 3))
    out[0], out[1] = np.inf, -np.inf
    for n in pick:
        for k in range(3):
            out[0, k], out[1, k] = min(out[0, k], points[n, k]), max(out[1, k], points[n, k])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def ground(rays, may_meet, z_m, nearest):
    """Keep what rays (N,) meet of the horizontal plane at `z_m`, object 0, if they may (N,): the first that is known.

    The plane has no end and two sides.
    """
    for i in range(len(rays.at)):
        far_m = (z_m - rays.origins_m[i, 2]) / rays.directions[i, 2]
        if may_meet[i] and 0 < far_m < np.inf:
            nearest.range_m[rays.at[i]], nearest.object[rays.at[i]] = far_m, 0
            if len(nearest.normal):
                nearest.normal[rays.at[i]] = 0, 0, 1


@njit(cache=True, nogil=True)
def of_objects(values, object_):
    """The values (objects,) of the objects (N,) met, 0 where it is -1, nothing."""
    out = np.zeros(len(object_), values.dtype)
    for i in range(len(object_)):
        if object_[i] >= 0:
            out[i] = values[object_[i]]
    return out
