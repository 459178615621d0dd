"""What rays hit in a scene, in float64: closed forms, and a loop over all triangles of meshes."""

import sys

import numpy as np
from numpy.typing import NDArray
from page import ROOT

sys.path.insert(0, str(ROOT))

from lidarcfg.geometry import Array, rotation
from lidarcfg.world.scene import Scene
from tests.naive.rays import first_triangle

GROUND_HALF_SIZE_M, FACETS_M = 1000.0, 0.001


def facets(scene: Scene) -> tuple[Array, NDArray[np.int64]]:
    """The scene as triangles alone: spheres and cylinders faceted, and two for the ground."""
    assert scene.file.ground
    vertices, triangles = scene.mesh(FACETS_M)
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * GROUND_HALF_SIZE_M
    square[:, 2] = scene.file.ground.z_m
    pair = len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])
    return np.concatenate([vertices, square]), np.concatenate([triangles, pair])


def exact_ranges(scene: Scene, origins: Array, rays: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Ranges (N,) to the scene's true shapes, inf for nothing, and whether what is hit is round (N,).

    Meshes are their triangles; all else is a closed form.
    """
    file = scene.file
    flat, curved = [np.full(len(rays), np.inf)], [np.full(len(rays), np.inf)]
    with np.errstate(divide="ignore", invalid="ignore"):
        if file.ground:
            flat.append(_positive((file.ground.z_m - origins[:, 2]) / rays[:, 2]))
        for box in file.boxes:
            turn = rotation((0.0, 0.0, np.radians(box.yaw_deg)))
            flat.append(_box((origins - box.center_m) @ turn, rays @ turn, np.array(box.size_m) / 2))
        for plane in file.planes:
            turn = rotation(np.radians(plane.rpy_deg))
            flat.append(_rectangle((origins - plane.center_m) @ turn, rays @ turn, np.array(plane.size_m) / 2))
        curved += [_sphere(origins - sphere.center_m, rays, sphere.radius_m) for sphere in file.spheres]
        for cylinder in file.cylinders:
            curved.append(_cylinder(origins - cylinder.base_m, rays, cylinder.radius_m, cylinder.height_m))
    meshes = [scene.names.index(mesh.name) for mesh in file.meshes]
    triangles = scene.triangles[np.isin(scene.triangle_object, meshes)]
    flat.append(first_triangle(scene.vertices_m, triangles, origins, rays)[0])
    nearest_flat, nearest_curved = np.min(flat, axis=0), np.min(curved, axis=0)
    return np.minimum(nearest_flat, nearest_curved), nearest_curved < nearest_flat


def _positive(distance: Array) -> Array:
    return np.where(distance > 0, distance, np.inf)


def _root(a: Array, half_b: Array, c: Array) -> Array:
    """The lesser root of a t² + 2 half_b t + c."""
    inside = half_b**2 - a * c
    return np.where(inside >= 0, _positive((-half_b - np.sqrt(np.maximum(inside, 0))) / a), np.inf)


def _box(p: Array, d: Array, half: Array) -> Array:
    """By slabs."""
    near, far = (-half - p) / d, (half - p) / d
    enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
    return np.where(enter <= leave, _positive(enter), np.inf)


def _rectangle(p: Array, d: Array, half: Array) -> Array:
    distance = -p[:, 2] / d[:, 2]
    at = abs(p[:, :2] + distance[:, None] * d[:, :2])
    return np.where((at <= half).all(axis=1), _positive(distance), np.inf)


def _sphere(p: Array, d: Array, radius: float) -> Array:
    return _root(np.ones(len(p)), (p * d).sum(1), (p * p).sum(1) - radius**2)


def _cylinder(p: Array, d: Array, radius: float, height: float) -> Array:
    """The side between its ends, and the ends."""
    side = _root((d[:, :2] ** 2).sum(1), (p[:, :2] * d[:, :2]).sum(1), (p[:, :2] ** 2).sum(1) - radius**2)
    z = p[:, 2] + side * d[:, 2]
    hits = [np.where((z >= 0) & (z <= height), side, np.inf)]
    for end in (0.0, height):
        distance = _positive((end - p[:, 2]) / d[:, 2])
        at = p[:, :2] + distance[:, None] * d[:, :2]
        hits.append(np.where((at**2).sum(1) <= radius**2, distance, np.inf))
    return np.min(hits, axis=0)
