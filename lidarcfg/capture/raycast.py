"""How far each ray gets: Open3D's RaycastingScene, in a local frame that float32 is fine enough for."""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.scene import Scene
from lidarcfg.geometry import Array

# The ground reaches this far from the local origin. As two triangles: measured at 2 m height, ranges to
# 100 m are 0.0014 mm off (median; at most 0.02 mm), and smaller tiles are slower and no better.
GROUND_HALF_SIZE_M = 1000.0
NOTHING = -1


class Raycaster:
    """A scene to cast rays in, near `origin_m` (3,) of the world.

    Coordinates relative to that origin are taken in float64 and only then rounded to float32.
    """

    def __init__(self, scene: Scene, origin_m: Array) -> None:
        import open3d as o3d

        self._origin_m = np.array(origin_m, np.float64)
        vertices = scene.vertices_m - self._origin_m
        triangles, self._triangle_object = scene.triangles, scene.triangle_object
        if scene.file.ground:
            square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * GROUND_HALF_SIZE_M
            square[:, 2] = scene.file.ground.z_m - self._origin_m[2]
            triangles = np.concatenate([triangles, len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])])
            vertices = np.concatenate([vertices, square])
            self._triangle_object = np.concatenate([self._triangle_object, np.zeros(2, np.int32)])
        self._reflectivity = scene.reflectivity
        self._scene = o3d.t.geometry.RaycastingScene()
        tensor = o3d.core.Tensor.from_numpy
        self._scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(triangles.astype(np.uint32)))

    def cast(self, origins_m: Array, directions: Array) -> tuple[Array, NDArray[np.uint8], NDArray[np.int32]]:
        """Rays (N, 3) from points of the world along unit vectors: what each meets first.

        Returns range (N,) in metres (inf: nothing), reflectivity (N,), object (N,) (-1: nothing).
        """
        import open3d as o3d

        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3] = origins_m - self._origin_m
        rays[:, 3:] = directions
        hits = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        range_m = hits["t_hit"].numpy().astype(np.float64)
        hit = np.isfinite(range_m)
        objects = np.full(len(rays), NOTHING, np.int32)
        objects[hit] = self._triangle_object[hits["primitive_ids"].numpy()[hit]]
        reflectivity = np.where(hit, self._reflectivity[objects], 0).astype(np.uint8)
        return range_m, reflectivity, objects
