"""What bounds a LiDAR's sight: planes through edges of obstacles, and quadrics.

A straight line leaves what a LiDAR sees, or comes into it, only at

- an obstacle's surface;
- the plane through the LiDAR and a silhouette edge: one whose two triangles lie on one side of that plane, or that has
  not just two triangles; behind a sphere the cone that touches it; behind an upright cylinder the cones over its rims
  and the planes that touch its side;
- a sphere around the LiDAR with its least or greatest range as radius;
- a half-plane from its axis where its field of view ends.
"""

from typing import NamedTuple

import numpy as np

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.visibility import Visibility
from lidarcfg.world.obstacles import Obstacles
from lidarcfg.world.solids import unique_vertices
from lidarcfg.world.tracer import CYLINDER, SPHERE, TRIANGLE

FLAT = 1e-12  # of the lengths that span a tetrahedron: with less volume it may have either sign


class Outline(NamedTuple):
    """The shapes that may cast shadows."""

    triangles: Array  # (T, 3, 3)
    edges: Array  # (E, 2, 3) of the triangles
    beside: Array  # (E, 2, 3) the third corners of the two triangles at each; NaN where they are not two
    rounds: Array  # (R, 5) spheres and upright cylinders: centre or base, radius, height (NaN: a sphere)
    ground_m: float  # its height; inf: none


class Quadrics(NamedTuple):
    """Surfaces xᵀ M x + 2 b·x + c = 0, and a sphere around all of each that matters."""

    m: Array  # (Q, 3, 3)
    b: Array  # (Q, 3)
    c: Array  # (Q,)
    centre: Array  # (Q, 3)
    radius: Array  # (Q,) inf: anywhere


def outline(obstacles: Obstacles) -> Outline:
    """The outline of obstacles. Corners are one if their coordinates are equal to the last bit."""
    tree, origin_m = obstacles.tree, obstacles.origin_m
    shapes = tree.shapes.reshape(-1, 9)
    triangles = shapes[tree.kind == TRIANGLE].reshape(-1, 3, 3) + origin_m
    found, number = unique_vertices(triangles.reshape(-1, 3) + 0.0)
    order = np.lexsort(found.T[::-1])
    corners, number = found[order], np.argsort(order)[number].reshape(-1, 3)
    ends = np.sort(number[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    third = number[:, [2, 0, 1]].ravel()
    order = np.argsort(ends[:, 1] * len(corners) + ends[:, 0], kind="stable")
    ends, third = ends[order], third[order]
    new = np.ones(len(ends), np.bool_)
    new[1:] = (ends[1:] != ends[:-1]).any(axis=1)
    first = np.flatnonzero(new)
    beside = np.full((len(first), 2, 3), np.nan)
    two = np.diff(np.append(first, len(ends))) == 2
    beside[two] = corners[third[first[two][:, None] + [0, 1]]]
    rounds = shapes[:, :5] + np.append(origin_m, (0.0, 0.0))
    rounds[tree.kind == SPHERE, 4] = np.nan
    return Outline(
        triangles,
        corners[ends[first]],
        beside,
        rounds[(tree.kind == SPHERE) | (tree.kind == CYLINDER)],
        obstacles.ground_m,
    )


def silhouette(shape: Outline, position_m: Array) -> Array:
    """(E, 2, 3) the edges, relative to a LiDAR, behind which its sight may begin or end."""
    edges, beside = shape.edges - position_m, shape.beside - position_m
    normal = np.cross(edges[:, 0], edges[:, 1])
    volume = np.einsum("ej,eij->ei", normal, beside)
    flat = FLAT * np.linalg.norm(normal, axis=1)[:, None] * np.linalg.norm(beside, axis=2)
    through = (volume[:, 0] > flat[:, 0]) & (volume[:, 1] < -flat[:, 1])
    through |= (volume[:, 0] < -flat[:, 0]) & (volume[:, 1] > flat[:, 1])
    return np.concatenate([edges[~through], _tangents(shape.rounds, position_m)])


def _tangents(rounds: Array, position_m: Array) -> Array:
    """(E, 2, 3) the lines on the sides of cylinders that a LiDAR sees edge on, relative to it."""
    out = []
    for x, y, z, radius, height in rounds[rounds[:, 4] >= 0.0] - np.append(position_m, (0.0, 0.0)):
        distance = np.hypot(x, y)
        if distance > radius:
            away, turn = maths.atan2(y, x), maths.asin(radius / distance)
            length = np.sqrt((distance - radius) * (distance + radius))
            for angle in (away - turn, away + turn):
                u, v = length * maths.cos(angle), length * maths.sin(angle)
                out.append([[u, v, z], [u, v, z + height]])
    return np.array(out).reshape(-1, 2, 3)


def quadrics(shape: Outline, lidar: Lidar, visibility: Visibility) -> Quadrics:
    """The quadrics that may bound a LiDAR's sight, relative to it."""
    nothing, flat = np.zeros(3), np.zeros((3, 3))
    upright = np.array((0.0, 0.0, 0.5))
    limits = visibility.limits([lidar])[0]
    rows: list[tuple[Array, Array, float, Array, float]] = []
    rows += [(np.eye(3), nothing, -square, nothing, np.inf) for square in limits[:2] if 0.0 < square < np.inf]
    rows += [(flat, normal, 0.0, nothing, np.inf) for normal in limits[2:8].reshape(2, 3) if normal.any()]
    if np.isfinite(shape.ground_m):
        rows.append((flat, upright, lidar.position_m[2] - shape.ground_m, nothing, np.inf))
    for x, y, z, radius, height in shape.rounds - np.append(lidar.position_m, (0.0, 0.0)):
        centre = np.array((x, y, z))
        square = centre @ centre - radius**2
        if np.isnan(height):
            if square > 0.0:
                rows.append((np.outer(centre, centre) - square * np.eye(3), nothing, 0.0, centre, radius))
            continue
        for rim in (centre, np.array((x, y, z + height))):
            m, b = (_over_rim(rim, radius), nothing) if rim[2] != 0.0 else (flat, upright)  # a rim seen edge on
            rows.append((m, b, 0.0, rim, radius))
    columns = [np.array([row[i] for row in rows], np.float64) for i in range(5)]
    shapes = [(-1, 3, 3), (-1, 3), (-1,), (-1, 3), (-1,)]
    return Quadrics(*(column.reshape(shape) for column, shape in zip(columns, shapes, strict=True)))


def _over_rim(rim: Array, radius: float) -> Array:
    """(3, 3) the cone from the origin over a horizontal circle at height h: |h (x, y) − z (cx, cy)|² = (z R)²."""
    x, y, h = rim.tolist()
    return np.array([[h * h, 0.0, -h * x], [0.0, h * h, -h * y], [-h * x, -h * y, x * x + y * y - radius * radius]])
