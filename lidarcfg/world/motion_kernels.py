"""Where things that move are at each time, in compiled loops: a rotation, row by row, and a position."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit

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
    turns_rad: Array  # (K, 3) from each pose to the next, as a rotation vector in the frame that turns


@njit(cache=True, nogil=True)
def matrix(R):
    """A matrix (3, 3), row by row: nine numbers stay in registers where an array does not."""
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@njit(cache=True, nogil=True)
def times(m, x, y, z):
    """A matrix times a vector."""
    return m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z


@njit(cache=True, nogil=True)
def back(m, x, y, z):
    """A matrix's transpose times a vector."""
    return m[0] * x + m[3] * y + m[6] * z, m[1] * x + m[4] * y + m[7] * z, m[2] * x + m[5] * y + m[8] * z


@njit(cache=True, nogil=True)
def product(m, n):
    """Of two matrices."""
    a, b, c = times(m, n[0], n[3], n[6]), times(m, n[1], n[4], n[7]), times(m, n[2], n[5], n[8])
    return a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]


@njit(cache=True, nogil=True)
def _arc(seconds, speed_m_s, rate_rad_s, heading_rad):
    """Along a circle at a constant speed, from the origin at time 0, where it heads that far from x."""
    half = seconds * rate_rad_s / 2
    c, s = math.cos(half), math.sin(half)
    chord_m = speed_m_s * seconds * (s / half if half != 0 else 1.0)
    cos_0, sin_0 = math.cos(heading_rad), math.sin(heading_rad)
    turned, up = 1 - 2 * s * s, 1.0
    x, y = chord_m * (c * cos_0 - s * sin_0), chord_m * (s * cos_0 + c * sin_0)
    return (turned, -2 * s * c, 0.0, 2 * s * c, turned, 0.0, 0.0, 0.0, up), (x, y, 0.0)


@njit(cache=True, nogil=True)
def _between(paths, k, seconds):
    """Between pose k and the next: in a straight line, and about one axis, evenly."""
    part = (seconds - paths.times_s[k]) / (paths.times_s[k + 1] - paths.times_s[k])
    x, y, z = part * paths.turns_rad[k, 0], part * paths.turns_rad[k, 1], part * paths.turns_rad[k, 2]
    angle = math.sqrt(x * x + y * y + z * z)
    a = math.sin(angle) / angle if angle > 0 else 1.0
    b = 2 * (math.sin(angle / 2) / angle) ** 2 if angle > 0 else 0.5
    above = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    middle = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    below = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    p, q = paths.positions_m[k], paths.positions_m[k + 1]
    position = p[0] + part * (q[0] - p[0]), p[1] + part * (q[1] - p[1]), p[2] + part * (q[2] - p[2])
    return product(matrix(paths.rotations[k]), above + middle + below), position


@njit(cache=True, nogil=True)
def pose_at(paths, p, seconds):
    """Rotation (9 numbers) and position of motion p; before the first and after the last pose, as if it went on."""
    kind, u, v, w = paths.kind[p], paths.values[p, 0], paths.values[p, 1], paths.values[p, 2]
    if kind == ARC:
        return _arc(seconds, u, v, w)
    if kind == POSES:
        low, high = paths.first[p], paths.first[p + 1] - 2
        while low < high:  # the last pose but one that is not later
            k = (low + high + 1) // 2
            if paths.times_s[k] <= seconds:
                low = k
            else:
                high = k - 1
        return _between(paths, low, seconds)
    return UPRIGHT, (u * seconds, v * seconds, w * seconds)


@njit(cache=True, nogil=True)
def poses(paths, p, seconds, R, t):
    """Write those at many times (n,) to R (n, 3, 3) and t (n, 3)."""
    for i in range(len(seconds)):
        m, place = pose_at(paths, p, seconds[i])
        for k in range(3):
            R[i, 0, k], R[i, 1, k], R[i, 2, k], t[i, k] = m[k], m[3 + k], m[6 + k], place[k]
