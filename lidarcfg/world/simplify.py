"""A mesh of fewer triangles, and how far its surface is from the one that it stands for."""

import numpy as np

from lidarcfg.errors import SceneError
from lidarcfg.geometry import Array
from lidarcfg.world.meshes import Mesh
from lidarcfg.world.solids import merge_vertices, open_edges

SAMPLES = 100_000  # points of each surface whose distances from the other are measured


def simplify(mesh: Mesh, triangles: int) -> Mesh:
    """A mesh of no more triangles, by Open3D's quadric decimation; closed, if the mesh is.

    Raises SceneError if it has no more triangles already, or cannot have so few and stay closed.
    """
    import open3d as o3d

    vertices, faces = merge_vertices(mesh)
    if len(faces) <= triangles:
        raise SceneError(f"has {len(faces):,} triangles, which are no more than {triangles:,} already")
    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    fewer = whole.simplify_quadric_decimation(triangles)
    found = merge_vertices((np.array(fewer.vertices, np.float64), np.array(fewer.triangles, np.int64)))
    if not len(found[1]) or (len(open_edges(found)) and not len(open_edges((vertices, faces)))):
        raise SceneError(f"is closed, and of {triangles:,} triangles it would not be; allowed: more of them")
    return found


def greatest_distance(one: Mesh, other: Mesh) -> float:
    """The greatest distance from either surface to the other, at SAMPLES points of each, in their vertices' unit."""
    return float(max(_distances(one, other).max(), _distances(other, one).max()))


def _distances(mesh: Mesh, other: Mesh) -> Array:
    """(SAMPLES,) of points of a mesh, uniform in area, from another."""
    import open3d as o3d

    middle = mesh[0].mean(axis=0)  # distances are of float32
    scene = o3d.t.geometry.RaycastingScene()
    corners, triangles = (other[0] - middle).astype(np.float32), other[1].astype(np.uint32)
    scene.add_triangles(o3d.core.Tensor.from_numpy(corners), o3d.core.Tensor.from_numpy(triangles))
    points = o3d.core.Tensor.from_numpy((_points(mesh) - middle).astype(np.float32))
    return np.asarray(scene.compute_distance(points).numpy(), np.float64)


def _points(mesh: Mesh) -> Array:
    """(SAMPLES, 3) points of a mesh, uniform in area."""
    rng = np.random.default_rng(0)
    corners = mesh[0][mesh[1]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    drawn = np.searchsorted(np.cumsum(area), rng.uniform(0, area.sum(), SAMPLES)).clip(max=len(area) - 1)
    weights = rng.dirichlet((1, 1, 1), SAMPLES)
    return np.asarray((weights[:, :, None] * corners[drawn]).sum(axis=1))
