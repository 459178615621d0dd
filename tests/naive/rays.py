"""Rays against triangles and moving shapes, one by one in float64: no tree, no packets, no transformed frames."""

import math

import numpy as np
from numba import njit

BESIDE = 1e-12  # of a triangle, by which a ray may pass beside it


@njit(cache=True)
def cross(a, b):
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True)
def first_triangle(vertices, triangles, origins, rays):
    """Range to the first of triangles (T, 3) that each ray (N, 3) hits, inf for none, and which: Möller, Trumbore 1997."""
    ranges, which = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for t in range(len(triangles)):
        a = vertices[triangles[t, 0]]
        e, f = vertices[triangles[t, 1]] - a, vertices[triangles[t, 2]] - a
        for n in range(len(rays)):
            p = cross(rays[n], f)
            determinant = (e * p).sum()
            if determinant == 0:
                continue
            s = origins[n] - a
            u = (s * p).sum() / determinant
            q = cross(s, e)
            v = (rays[n] * q).sum() / determinant
            distance = (f * q).sum() / determinant
            if u >= -BESIDE and v >= -BESIDE and u + v <= 1 + BESIDE and 0 < distance < ranges[n]:
                ranges[n], which[n] = distance, t
    return ranges, which


def sphere(origin, ray, centre, radius):
    """Range to a sphere by the plain quadratic, inf for none; good where radius and distance are alike."""
    o = np.subtract(origin, centre)
    half_b, c = o @ ray, o @ o - radius**2
    square = half_b**2 - c
    roots = [-half_b + side * math.sqrt(square) for side in (-1, 1)] if square >= 0 else []
    return min((root for root in roots if root > 0), default=math.inf)


def box(origin, ray, centre, size, yaw):
    """Range to a box that is rotated about the vertical, by its six faces, inf for none."""
    c, s = math.cos(yaw), math.sin(yaw)
    into = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    o, d, half = into @ np.subtract(origin, centre), into @ ray, np.asarray(size) / 2
    found = math.inf
    for axis in range(3):
        for side in (-1, 1):
            if d[axis]:
                far = (side * half[axis] - o[axis]) / d[axis]
                at = o + far * d
                inside = all(abs(at[k]) <= half[k] for k in range(3) if k != axis)
                found = far if inside and 0 < far < found else found
    return found
