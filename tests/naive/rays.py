"""Rays against triangles and shapes, one by one, in float64 and exactly: no tree, no packets, no transformed frames."""

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from tests.naive.vectors import cross, dot, minus

BESIDE = 1e-12  # of a triangle, by which a ray may pass beside it


def first_triangle(vertices, triangles, origins, rays):
    """Range to the first of triangles (T, 3) that each ray (N, 3) hits, inf for none, and which: Möller, Trumbore 1997."""
    ranges = np.full(len(rays), np.inf)
    which = np.full(len(rays), -1)
    dx, dy, dz = np.ascontiguousarray(rays.T)
    for t, corners in enumerate(triangles):
        a = vertices[corners[0]]
        e = vertices[corners[1]] - a
        f = vertices[corners[2]] - a
        px = dy * f[2] - dz * f[1]
        py = dz * f[0] - dx * f[2]
        pz = dx * f[1] - dy * f[0]
        determinant = e[0] * px + e[1] * py + e[2] * pz
        sx, sy, sz = (origins - a).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (sx * px + sy * py + sz * pz) / determinant
            qx = sy * e[2] - sz * e[1]
            qy = sz * e[0] - sx * e[2]
            qz = sx * e[1] - sy * e[0]
            v = (dx * qx + dy * qy + dz * qz) / determinant
            distance = (f[0] * qx + f[1] * qy + f[2] * qz) / determinant
            hit = (determinant != 0) & (u >= -BESIDE) & (v >= -BESIDE) & (u + v <= 1 + BESIDE)
        nearer = hit & (u <= 1 + BESIDE) & (0 < distance) & (distance < ranges)
        ranges[nearer] = distance[nearer]
        which[nearer] = t
    return ranges, which


class Exact(NamedTuple):
    """A ray and a triangle in whole numbers of any length, rounded at the very end."""

    hit: bool  # inside or on an edge, ahead
    range_m: float | None  # to the plane, also where it is not hit; None: parallel to it, or no plane
    sine: float  # of the angle between ray and plane
    beside_m: float  # the distance of the ray's line from the nearest edge's line


def exact(corners, origin, ray):
    """What is true of a ray and a triangle (3, 3): the signs of three volumes say whether it is hit."""
    points, scale = whole([*corners.ravel(), *origin])
    d, ray_scale = whole(ray)
    a, b, c = (minus(points[k : k + 3], points[9:]) for k in (0, 3, 6))
    n = cross(minus(b, a), minus(c, a))
    volumes = [dot(d, cross(p, q)) for p, q in ((a, b), (b, c), (c, a))]
    along = dot(n, d)
    height = dot(n, a)
    range_m = float(Fraction(height, along) * Fraction(ray_scale, scale)) if along else None
    inside = any(volumes) and (min(volumes) >= 0 or max(volumes) <= 0)
    beside = [
        abs(volume) / length / scale
        for volume, (p, q) in zip(volumes, ((a, b), (b, c), (c, a)), strict=True)
        if (length := norm(cross(d, minus(q, p))))
    ]
    sine = abs(along) / (norm(n) * norm(d)) if along else 0.0
    return Exact(bool(inside and along and range_m > 0), range_m, sine, min(beside, default=math.inf))


def whole(values):
    """Floats as whole numbers, and by how much they are larger."""
    ratios = [float(value).as_integer_ratio() for value in values]
    scale = max(ratio[1] for ratio in ratios)
    return [number * (scale // divisor) for number, divisor in ratios], scale


def norm(p):
    """To the last digits of a double, however long the numbers are."""
    return math.isqrt(dot(p, p) << 128) / (1 << 64)


def sphere(origin, ray, centre, radius):
    """Range to a sphere by the plain quadratic, inf for none; good where radius and distance are alike."""
    o = np.subtract(origin, centre)
    half_b = o @ ray
    c = o @ o - radius**2
    square = half_b**2 - c
    roots = [-half_b + side * math.sqrt(square) for side in (-1, 1)] if square >= 0 else []
    return min((root for root in roots if root > 0), default=math.inf)


def box(origin, ray, centre, size, yaw):
    """Range to a box that is rotated about the vertical, by its six faces, inf for none."""
    c, s = math.cos(yaw), math.sin(yaw)
    into = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    o = into @ np.subtract(origin, centre)
    d = into @ ray
    half = np.asarray(size) / 2
    found = math.inf
    for axis in range(3):
        for side in (-1, 1):
            if d[axis]:
                far = (side * half[axis] - o[axis]) / d[axis]
                at = o + far * d
                inside = all(abs(at[k]) <= half[k] for k in range(3) if k != axis)
                found = far if inside and 0 < far < found else found
    return found
