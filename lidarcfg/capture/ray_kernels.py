"""The loops of casting: where beams point, rays brought into a part's own frame, what of a part they meet first."""

import math

import numpy as np
from numba import njit

SMALL = 0.02  # radians, up to which four terms of sine and cosine are exact


@njit(cache=True, nogil=True)
def may_meet(azimuth, tables):
    """By tables (K, sectors, L), of firings (N, L): the numbers (M,) of those that may meet anything; what (K, M)."""
    kinds, sectors, lasers = tables.shape
    flat, scale = azimuth.ravel(), sectors / (2 * math.pi)
    rows, what, count = np.empty(flat.size, np.int64), np.empty((kinds, flat.size), np.bool_), 0
    for i in range(flat.size):
        sector, laser, any_ = int(flat[i] * scale) % sectors, i % lasers, False
        for k in range(kinds):
            what[k, count] = tables[k, sector, laser]
            any_ |= what[k, count]
        if any_:
            rows[count] = i
            count += 1
    return rows[:count], what[:, :count].copy()


@njit(cache=True, nogil=True)
def beams(azimuth, rows, elevation, azimuth_offset, left_m, up_m, R, t):
    """Origins and unit vectors (M, 3) of the firings `rows` (M,) of (N, L), in the frame into which R and t lead.

    The tables (L,) are the lasers'; R (M or 1, 3, 3) and t (M or 1, 3) are one each or one for all.
    """
    lasers = azimuth.shape[1]
    cos_w, sin_w = np.cos(elevation), np.sin(elevation)
    cos_o, sin_o = np.cos(azimuth_offset), np.sin(azimuth_offset)
    origins, directions = np.empty((len(rows), 3)), np.empty((len(rows), 3))
    n, begin, cos_h, sin_h = -1, -lasers, 1.0, 0.0
    for i in range(len(rows)):
        if rows[i] >= begin + lasers:  # another sequence
            n = rows[i] // lasers
            begin, cos_h, sin_h = n * lasers, math.cos(azimuth[n, 0]), math.sin(azimuth[n, 0])
        k = rows[i] - begin
        turned = azimuth[n, k] - azimuth[n, 0]
        if abs(turned) < SMALL:  # a little since the sequence's first firing
            square = turned * turned
            sin_d = turned * (1 - square * (1 / 6) * (1 - square * (1 / 20) * (1 - square * (1 / 42))))
            cos_d = 1 - square * 0.5 * (1 - square * (1 / 12) * (1 - square * (1 / 30)))
            c, s = cos_h * cos_d - sin_h * sin_d, sin_h * cos_d + cos_h * sin_d
        else:
            c, s = math.cos(azimuth[n, k]), math.sin(azimuth[n, k])
        c, s = c * cos_o[k] - s * sin_o[k], s * cos_o[k] + c * sin_o[k]
        x, y, z = left_m[k] * s, left_m[k] * c, up_m[k]
        u, v, w = cos_w[k] * c, -cos_w[k] * s, sin_w[k]
        a, b = min(i, len(R) - 1), min(i, len(t) - 1)
        for j in range(3):
            origins[i, j] = R[a, j, 0] * x + R[a, j, 1] * y + R[a, j, 2] * z + t[b, j]
            directions[i, j] = R[a, j, 0] * u + R[a, j, 1] * v + R[a, j, 2] * w
    return origins, directions


@njit(cache=True, nogil=True)
def posed(seconds, times_s, positions_m, rotations, turns_rad):
    """R (n, 3, 3) and t (n, 3) at times (n,) between poses (K): in a straight line, and about one axis, evenly.

    The turns (K - 1, 3) from each rotation (K, 3, 3) to the next are rotation vectors in the frame that turns.
    """
    R, t = np.empty((len(seconds), 3, 3)), np.empty((len(seconds), 3))
    part = np.empty((3, 3))
    for i in range(len(seconds)):
        k = min(max(np.searchsorted(times_s, seconds[i], "right") - 1, 0), len(times_s) - 2)
        share = (seconds[i] - times_s[k]) / (times_s[k + 1] - times_s[k])
        x, y, z = share * turns_rad[k, 0], share * turns_rad[k, 1], share * turns_rad[k, 2]
        angle = math.sqrt(x * x + y * y + z * z)
        a = math.sin(angle) / angle if angle > 0 else 1.0
        b = 2 * (math.sin(angle / 2) / angle) ** 2 if angle > 0 else 0.5
        part[0] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
        part[1] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
        part[2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
        for j in range(3):
            t[i, j] = positions_m[k, j] + share * (positions_m[k + 1, j] - positions_m[k, j])
            for m in range(3):
                R[i, j, m] = (
                    rotations[k, j, 0] * part[0, m] + rotations[k, j, 1] * part[1, m] + rotations[k, j, 2] * part[2, m]
                )
    return R, t


@njit(cache=True, nogil=True)
def chained(outer_R, outer_t, R, t, inner_R, inner_t):
    """Rotations (M, 3, 3) and places (M, 3) of frames in frames that move by R (M or 1, 3, 3) and t (M or 1, 3)."""
    count = max(len(R), len(t)) if min(len(R), len(t)) else 0
    turns, places = np.empty((count, 3, 3)), np.empty((count, 3))
    both, middle = np.empty((3, 3)), np.empty(3)
    for i in range(count):
        turn, place = R[min(i, len(R) - 1)], t[min(i, len(t) - 1)]
        for j in range(3):
            middle[j] = place[j]
            for k in range(3):
                both[j, k] = turn[j, 0] * inner_R[0, k] + turn[j, 1] * inner_R[1, k] + turn[j, 2] * inner_R[2, k]
                middle[j] += turn[j, k] * inner_t[k]
        for j in range(3):
            places[i, j] = outer_t[j]
            for k in range(3):
                turns[i, j, k] = outer_R[j, 0] * both[0, k] + outer_R[j, 1] * both[1, k] + outer_R[j, 2] * both[2, k]
                places[i, j] += outer_R[j, k] * middle[k]
    return turns, places


@njit(cache=True, nogil=True)
def wire(range_m, offset_m, least_m, most_m, unit_m, most):
    """Ranges (N, L, R) of lasers with offsets (L,) in whole units, 0 for what is not measured or more than `most`."""
    out = np.zeros(range_m.shape, np.uint16)
    for n in range(range_m.shape[0]):
        for k in range(range_m.shape[1]):
            for r in range(range_m.shape[2]):
                if least_m <= range_m[n, k, r] <= most_m:
                    units = np.rint((range_m[n, k, r] - offset_m[k]) / unit_m)
                    if 0 <= units <= most:
                        out[n, k, r] = int(units)
    return out


@njit(cache=True, nogil=True)
def local_rays(origins_m, directions, rows, R, t):
    """Origins and directions (M, 6) of the rays `rows` (M,) of (N, 3), in a frame that stands at t and is turned by R.

    R (M or 1, 3, 3) and t (M or 1, 3) are one each or one for all. The same in float32 besides.
    """
    out, narrow = np.empty((len(rows), 6)), np.empty((len(rows), 6), np.float32)
    for i in range(len(rows)):
        turn, place, n = R[min(i, len(R) - 1)], t[min(i, len(t) - 1)], rows[i]
        x, y, z = origins_m[n, 0] - place[0], origins_m[n, 1] - place[1], origins_m[n, 2] - place[2]
        u, v, w = directions[n, 0], directions[n, 1], directions[n, 2]
        for k in range(3):
            out[i, k] = turn[0, k] * x + turn[1, k] * y + turn[2, k] * z
            out[i, 3 + k] = turn[0, k] * u + turn[1, k] * v + turn[2, k] * w
        for k in range(6):
            narrow[i, k] = out[i, k]
    return out, narrow


@njit(cache=True, nogil=True, error_model="numpy")
def keep_nearer(rays, rows, hit_m, triangle, planes, objects, grazing_m, range_m, object_):
    """Of rays (M, 6) that hit a triangle (M,) at hit_m (M,): those nearer than `range_m` (N,) are kept there.

    How far it is, is for the triangle's plane (n·p = d) to say, unless that is further than `grazing_m` from the hit,
    as where it is seen edge on. `objects` is one a triangle, or one for all. Returns (M,) what was kept.
    """
    kept = np.zeros(len(rows), np.bool_)
    for i in range(len(rows)):
        far_m = float(hit_m[i])
        if not far_m < np.inf:
            continue
        a, b, c, d = planes[triangle[i]]
        rise = a * rays[i, 3] + b * rays[i, 4] + c * rays[i, 5]
        exact_m = (d - (a * rays[i, 0] + b * rays[i, 1] + c * rays[i, 2])) / rise
        if abs(exact_m - far_m) < grazing_m:
            far_m = max(exact_m, 0.0)  # a ray that starts on the plane, by float32
        if far_m < range_m[rows[i]]:
            range_m[rows[i]] = far_m
            object_[rows[i]] = objects[triangle[i] if len(objects) > 1 else 0]
            kept[i] = True
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def keep_ground(origins_m, directions, rows, z_m, object_number, range_m, object_):
    """The same for the horizontal plane at `z_m`, without end and from both sides."""
    kept = np.zeros(len(rows), np.bool_)
    for i in range(len(rows)):
        n = rows[i]
        far_m = (z_m - origins_m[n, 2]) / directions[n, 2]
        if 0 < far_m < range_m[n]:
            range_m[n] = far_m
            object_[n] = object_number
            kept[i] = True
    return kept


@njit(cache=True, nogil=True)
def of_objects(values, object_):
    """The values (objects,) of the objects (N,) met, 0 where it is -1, nothing."""
    out = np.zeros(len(object_), values.dtype)
    for i in range(len(object_)):
        if object_[i] >= 0:
            out[i] = values[object_[i]]
    return out
