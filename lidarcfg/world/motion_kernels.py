"""Poses of whatever moves, at any time, in compiled loops: a rotation, row by row, and a position."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, outer

STANDING, VELOCITY, ARC, POSES = range(4)  # kinds of motion
UPRIGHT = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class Paths(NamedTuple):
    """P motions, the timed poses of all of them in one table of K rows."""

    kind: NDArray[np.uint8]  # (P,)
    values: Array  # (P, 3) the velocity in m/s; or speed (m/s), yaw rate (rad/s) and heading (rad) of an arc
    first: NDArray[np.int64]  # (P + 1,) row of each one's first pose
    times_s: Array  # (K,)
    positions_m: Array  # (K, 3)
    rotations: Array  # (K, 3, 3)
    rotation_vectors_rad: Array  # (K, 3) from each pose to the next, in the rotating frame


@inner()
def matrix(R):
    """A matrix (3, 3) as nine numbers, row by row: they stay in registers, an array does not."""
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@inner()
def column(R, n):
    """Matrix n of R (9, N)."""
    return R[0, n], R[1, n], R[2, n], R[3, n], R[4, n], R[5, n], R[6, n], R[7, n], R[8, n]


@inner()
def times(m, x, y, z):
    """A matrix times a vector."""
    return m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z


@inner()
def back(m, x, y, z):
    """A matrix's transpose times a vector."""
    return m[0] * x + m[3] * y + m[6] * z, m[1] * x + m[4] * y + m[7] * z, m[2] * x + m[5] * y + m[8] * z


@inner()
def product(m, n):
    """Of two matrices."""
    a, b, c = times(m, n[0], n[3], n[6]), times(m, n[1], n[4], n[7]), times(m, n[2], n[5], n[8])
    return a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]


@inner()
def _arc(seconds, speed_m_s, rate_rad_s, heading_rad):
    """Along a circle at a constant speed, from the origin at time 0, where it heads that far from x."""
    half = seconds * rate_rad_s / 2
    c, s = math.cos(half), math.sin(half)
    chord_m = speed_m_s * seconds * (s / half if half != 0 else 1.0)
    cos_0, sin_0 = math.cos(heading_rad), math.sin(heading_rad)
    yawed, up = 1 - 2 * s * s, 1.0
    x, y = chord_m * (c * cos_0 - s * sin_0), chord_m * (s * cos_0 + c * sin_0)
    return (yawed, -2 * s * c, 0.0, 2 * s * c, yawed, 0.0, 0.0, 0.0, up), (x, y, 0.0)


@inner()
def _between(times_s, positions_m, rotations, rotation_vectors_rad, k, seconds):
    """Between pose k and the next: along a straight line and about one axis, both at a constant rate."""
    part = (seconds - times_s[k]) / (times_s[k + 1] - times_s[k])
    x, y, z = part * rotation_vectors_rad[k, 0], part * rotation_vectors_rad[k, 1], part * rotation_vectors_rad[k, 2]
    angle = math.sqrt(x * x + y * y + z * z)
    a = math.sin(angle) / angle if angle > 0 else 1.0
    b = 2 * (math.sin(angle / 2) / angle) ** 2 if angle > 0 else 0.5
    above = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    middle = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    below = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    x, y, z = positions_m[k, 0], positions_m[k, 1], positions_m[k, 2]
    u, v, w = positions_m[k + 1, 0] - x, positions_m[k + 1, 1] - y, positions_m[k + 1, 2] - z
    start = (
        rotations[k, 0, 0], rotations[k, 0, 1], rotations[k, 0, 2], rotations[k, 1, 0], rotations[k, 1, 1],
        rotations[k, 1, 2], rotations[k, 2, 0], rotations[k, 2, 1], rotations[k, 2, 2],
    )  # fmt: skip
    return product(start, above + middle + below), (x + part * u, y + part * v, z + part * w)


@outer()
def poses(paths, p, seconds, first, count, R, t):
    """Write rotations and positions of motion p at times `first` to `first` + count to R (9, n) and t (3, n).

    Before the first and after the last timed pose, the first and last segments are extrapolated.
    """
    kind, u, v, w = paths.kind[p], paths.values[p, 0], paths.values[p, 1], paths.values[p, 2]
    times_s, positions_m, rotations = paths.times_s, paths.positions_m, paths.rotations
    start, end = paths.first[p], paths.first[p + 1] - 2
    for n in range(count):
        now = seconds[first + n]
        if kind == ARC:
            m, place = _arc(now, u, v, w)
        elif kind == POSES:
            low, high = start, end
            while low < high:  # the last pose but one that is not later
                k = (low + high + 1) // 2
                low, high = (k, high) if times_s[k] <= now else (low, k - 1)
            m, place = _between(times_s, positions_m, rotations, paths.rotation_vectors_rad, low, now)
        else:
            m, place = UPRIGHT, (u * now, v * now, w * now)
        for k in range(9):
            R[k, n] = m[k]
        for k in range(3):
            t[k, n] = place[k]
