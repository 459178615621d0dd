"""The loops of casting: rays brought into a part's own frame, and what of a part they meet before all else."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def local_rays(origins_m, directions, rows, R, t):  # type: ignore[no-untyped-def]  # numba infers them
    """Origins and directions (M, 6) of the rays `rows` (M,) of (N, 3), in a frame that stands at t and is turned by R.

    R (M or 1, 3, 3) and t (M or 1, 3) are one each or one for all.
    """
    out = np.empty((len(rows), 6))
    for i in range(len(rows)):
        turn, place, n = R[min(i, len(R) - 1)], t[min(i, len(t) - 1)], rows[i]
        x, y, z = origins_m[n, 0] - place[0], origins_m[n, 1] - place[1], origins_m[n, 2] - place[2]
        u, v, w = directions[n, 0], directions[n, 1], directions[n, 2]
        for k in range(3):
            out[i, k] = turn[0, k] * x + turn[1, k] * y + turn[2, k] * z
            out[i, 3 + k] = turn[0, k] * u + turn[1, k] * v + turn[2, k] * w
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def keep_nearer(  # type: ignore[no-untyped-def]  # numba infers them
    rays, rows, hit_m, triangle, planes, objects, grazing_m, range_m, object_
):
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
            far_m = exact_m
        if far_m < range_m[rows[i]]:
            range_m[rows[i]] = far_m
            object_[rows[i]] = objects[triangle[i] if len(objects) > 1 else 0]
            kept[i] = True
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def keep_ground(origins_m, directions, rows, z_m, object_number, range_m, object_):  # type: ignore[no-untyped-def]
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
