"""Rays aimed at the very vertices and edges of convex bodies, and how far they get by half-spaces in float64."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from tests.capture_fixtures import scene

BODIES = {
    "cube": "boxes: [{{name: b, center_m: {at}, size_m: [2, 2, 2], reflectivity: 9}}]",
    "box": "boxes: [{{name: b, center_m: {at}, size_m: [4.2, 1.8, 1.5], yaw_deg: 17, reflectivity: 9}}]",
    "ball": "spheres: [{{name: s, center_m: {at}, radius_m: 1, reflectivity: 9}}]",
    "large ball": "spheres: [{{name: s, center_m: {at}, radius_m: 20, reflectivity: 9}}]",
    "cylinder": "cylinders: [{{name: c, base_m: {at}, radius_m: 0.4, height_m: 5, reflectivity: 9}}]",
    "mesh": "meshes: [{{name: m, file: m.ply, position_m: {at}, rpy_deg: [10, 20, 30], reflectivity: 7}}]",
}
PLY = """ply
format ascii 1.0
element vertex {n}
property double x
property double y
property double z
element face {m}
property list uchar int vertex_indices
end_header
"""
GRAZED_M = 1e-3  # how deep a ray must go into a body, so that it does not only graze its outline


class Aimed(NamedTuple):
    """Rays from one place."""

    body: object  # the scene
    start: np.ndarray  # (3,)
    way: np.ndarray  # (N, 3) unit vectors
    range_m: np.ndarray  # (N,) how far each gets


def ellipsoid(folder, points=600):
    """A closed mesh of odd triangles, in a file: the hull of random points on an ellipsoid."""
    point = np.random.default_rng(1).normal(size=(points, 3))
    point *= (2.0, 1.3, 0.8) / np.linalg.norm(point, axis=1)[:, None]
    faces = ConvexHull(point).simplices
    rows = [" ".join(map(repr, row)) for row in point.tolist()] + [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    (folder / "m.ply").write_text(PLY.format(n=points, m=len(faces)) + "\n".join(rows) + "\n")


def aimed(folder, name, place, inside, rng, count):
    """Of `count` rays aimed at a body at `place` (3,), from inside it or from afar, those that surely meet it."""
    ellipsoid(folder)
    body = faceted(scene(folder, BODIES[name].format(at=[float(x) for x in place])))
    vertices, triangles = body.vertices_m, body.triangles
    which, corner = rng.integers(len(triangles), size=count), rng.integers(3, size=count)
    share = rng.choice((0.0, 1 / 3, 0.5, 0.9), (count, 1))  # 0: a vertex
    one, other = vertices[triangles[which, corner]], vertices[triangles[which, (corner + 1) % 3]]
    aim, middle = (1 - share) * one + share * other, vertices.mean(axis=0)
    start = middle + rng.uniform(-0.1, 0.1, 3) * bool(rng.integers(2)) if inside else np.add(middle, (31.0, 4.0, 8.0))
    way = (aim - start) / np.linalg.norm(aim - start, axis=1)[:, None]
    enter, leave, depth = through(half_spaces(vertices[triangles], middle), start, way)
    deep = depth > GRAZED_M
    return Aimed(body, start, way[deep], (leave if inside else enter)[deep])


def faceted(body):
    """The same scene with its sphere or cylinder as a mesh."""
    vertices, triangles = body.mesh(0.001)
    objects = np.zeros(len(triangles), np.int32)
    file = body.file.model_copy(update={"spheres": (), "cylinders": ()})
    return replace(body, file=file, vertices_m=vertices, triangles=triangles, triangle_object=objects)


def half_spaces(corners, middle):
    """(planes, 4) n·p ≤ d of the triangles of a convex body around `middle`, n of unit length."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    has_area = length > 1e-12
    normal, corner = normal[has_area] / length[has_area, None], corners[has_area, 0]
    offset = ((corner - middle) * normal).sum(axis=1)
    normal, offset = normal * np.sign(offset)[:, None], np.abs(offset)
    planes = np.column_stack([normal, offset + normal @ middle])
    return planes[np.unique(planes.round(9), axis=0, return_index=True)[1]]


def through(planes, start, way):
    """Where rays (N, 3) enter and leave the half-spaces' common body, and how deep in it they are halfway."""
    out = np.empty((3, len(way)))
    room = planes[:, 3] - planes[:, :3] @ start
    for i in range(0, len(way), 500):
        rise = way[i : i + 500] @ planes[:, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = room / rise
        enter = np.where(rise < 0, at, -np.inf).max(axis=1)  # the last way in
        leave = np.where(rise > 0, at, np.inf).min(axis=1)  # the first way out
        depth = (room - rise * (np.maximum(enter, 0) + leave)[:, None] / 2).min(axis=1)
        out[:, i : i + 500] = enter, leave, depth
    return out
