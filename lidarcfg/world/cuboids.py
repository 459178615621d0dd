"""Sets of cuboids of a grid as Open3D's meshes, lines and voxels."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory

if TYPE_CHECKING:
    import open3d

VOXEL_BYTES = 300  # of memory for one of Open3D's, and to make it
Chosen = NDArray[np.bool_]  # (nx, ny, nz) which cuboids


def check_voxels(count: int) -> None:
    """Raises LidarcfgError where memory does not hold `count` voxels of Open3D."""
    check_memory(f"a grid of {count:,} voxels", VOXEL_BYTES * count, "use larger cuboids")


def voxel_grid(
    low: Array, index: NDArray[np.int64], edge: float, rgb: Array, high: Array
) -> "open3d.geometry.VoxelGrid":
    """Open3D's grid from a corner to another, of cubes with indices (N, 3) and colours (N, 3)."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud()
    cloud.points = o3d.utility.Vector3dVector(low + (index + 0.5) * edge)
    cloud.colors = o3d.utility.Vector3dVector(rgb)
    return o3d.geometry.VoxelGrid.create_from_point_cloud_within_bounds(cloud, edge, low, high)


def surface_mesh(min_m: Array, cuboid_m: Array, chosen: Chosen) -> "open3d.geometry.TriangleMesh":
    """The surface of some cuboids (nx, ny, nz) of a grid from `min_m` (3,): two triangles for each outer face.

    Normals point outwards. Raises ConfigError where there are none.
    """
    _check(chosen)
    import open3d as o3d

    shape = tuple(n + 1 for n in chosen.shape)
    faces = []
    for axis in range(3):
        padded = np.pad(chosen, [(1, 1) if a == axis else (0, 0) for a in range(3)]).astype(np.int8)
        step = np.diff(padded, axis=axis)  # 1 where the set begins along the axis, −1 where it ends
        second = (axis + 1) % 3
        third = (axis + 2) % 3
        for sign in (1, -1):
            corner = np.argwhere(step == sign)
            quad = np.repeat(corner[:, None], 4, axis=1)
            quad[:, (1, 2), second] += 1
            quad[:, (2, 3), third] += 1
            faces.append(quad[:, ::-1] if sign == 1 else quad)
    corners = np.concatenate(faces)
    flat = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), shape)
    known, index = np.unique(flat, return_inverse=True)
    index = index.reshape(flat.shape)
    triangles = np.concatenate([index[:, (0, 1, 2)], index[:, (0, 2, 3)]]).astype(np.int32)
    vertices = min_m + np.stack(np.unravel_index(known, shape), axis=1) * cuboid_m
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))
    return mesh.compute_triangle_normals()


def crease_lines(min_m: Array, cuboid_m: Array, chosen: Chosen) -> "open3d.geometry.LineSet":
    """The edges at which the surface of some cuboids (nx, ny, nz) of a grid turns, one line a cuboid's edge.

    Raises ConfigError where there are none.
    """
    _check(chosen)
    import open3d as o3d

    shape = tuple(n + 1 for n in chosen.shape)
    starts = []
    ends = []
    for axis in range(3):
        second = (axis + 1) % 3
        third = (axis + 2) % 3
        full = np.pad(chosen, [(0, 0) if a == axis else (1, 1) for a in range(3)])
        around = np.stack([_shifted(full, {second: i, third: j}) for i in (0, 1) for j in (0, 1)])
        flat = (around[0] == around[1]) & (around[2] == around[3])  # the surface is level across the edge, or absent
        flat |= (around[0] == around[2]) & (around[1] == around[3])
        corner = np.argwhere(~flat)
        starts.append(corner)
        ends.append(corner + np.eye(3, dtype=int)[axis])
    lines = np.stack([np.concatenate(starts), np.concatenate(ends)], axis=1)
    flat_index = np.ravel_multi_index(tuple(np.moveaxis(lines, -1, 0)), shape)
    known, index = np.unique(flat_index, return_inverse=True)
    points = min_m + np.stack(np.unravel_index(known, shape), axis=1) * cuboid_m
    return o3d.geometry.LineSet(
        o3d.utility.Vector3dVector(points), o3d.utility.Vector2iVector(index.reshape(-1, 2).astype(np.int32))
    )


def _shifted(full: Chosen, by: dict[int, int]) -> Chosen:
    """All but the first or the last layer along some axes."""
    which = [slice(by[a], full.shape[a] - 1 + by[a]) if a in by else slice(None) for a in range(3)]
    return full[tuple(which)]


def _check(chosen: Chosen) -> None:
    if not chosen.any():
        raise ConfigError("there is no cuboid to draw; at least one is needed")
