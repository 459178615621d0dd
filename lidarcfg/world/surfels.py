"""Maps of points as surfels: a small disc at each point, across its normal, drawn as a hexagon of the disc's area."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.clouds.cloud import read_arrays
from lidarcfg.clouds.las import read_xyz
from lidarcfg.clouds.ply_pcd import read_rows
from lidarcfg.errors import CloudError, ConversionError, SceneError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.world.meshes import FILE_MAX, Mesh, check_readable, place_mesh
from lidarcfg.world.scene_file import Surfels

SIDES = 6
CORNER = math.sqrt(2 * math.pi / (SIDES * maths.sin(2 * math.pi / SIDES)))  # a corner's distance, in radii: equal areas
SUFFIXES = ".ply", ".pcd", ".npz", ".las", ".laz"
POINTS_MAX = 1_000_000
POINT_BYTES = 1500  # of memory a point while the tracer's tree is built
NEIGHBOURS = 12  # nearest points, itself included, that a normal is estimated from
NORMAL = "nx", "ny", "nz"

Points = tuple[Array, Array | None]  # (N, 3) places and, where they are known, (N, 3) normals


def surfels_mesh(item: Surfels, folder: Path) -> Mesh:
    """The discs around a file's points, in the world frame. Raises SceneError if it cannot be used."""
    points, normals = read_points(folder / item.file)
    return place_mesh(discs(points, normals, item.radius_m / item.scale), item)


def discs(points: Array, normals: Array, radius: float) -> Mesh:
    """A hexagon around each point (N, 3), across its normal (N, 3), of the area of a disc."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]  # the axis that is most across the normal
    first = np.cross(normals, least)
    first *= CORNER * radius / np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    angle = np.arange(SIDES) * (2 * math.pi / SIDES)
    around = maths.cos(angle)[:, None] * first[:, None] + maths.sin(angle)[:, None] * second[:, None]
    fan = np.array([[0, k, k + 1] for k in range(1, SIDES - 1)])
    triangles = fan + SIDES * np.arange(len(points))[:, None, None]
    return (points[:, None] + around).reshape(-1, 3), triangles.reshape(-1, 3)


def read_points(path: Path) -> tuple[Array, Array]:
    """Positions (N, 3) and unit normals (N, 3) of a file's points; estimates missing normals. Raises SceneError."""
    check_readable(path, FILE_MAX)
    if path.suffix.lower() not in SUFFIXES:
        raise SceneError(f"{path}: is no cloud of points; allowed: {', '.join(SUFFIXES)}")
    try:
        points, normals = _read(path)
    except (CloudError, ConversionError) as error:
        raise SceneError(str(error)) from None
    if not len(points):
        raise SceneError(f"{path}: has no points")
    if len(points) > POINTS_MAX:
        raise SceneError(f"{path}: has {len(points):,} points; allowed: at most {POINTS_MAX:,}; thin it out")
    check_memory(f"{path}: a map of {len(points):,} points", len(points) * POINT_BYTES)
    _check_finite(path, points)
    if normals is None:
        return points, _estimate_normals(path, points)
    _check_finite(path, normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not length.all():
        raise SceneError(f"{path}: the normal of point {length.argmin()} is 0")
    return points, normals / length


def _read(path: Path) -> Points:
    """The positions and normals in a file. Raises CloudError, and ConversionError without laspy."""
    suffix = path.suffix.lower()
    if suffix in (".las", ".laz"):
        return read_xyz(path, POINTS_MAX), None
    if suffix == ".npz":
        arrays = read_arrays(path, ("xyz", "normals"))
        if "xyz" not in arrays:
            raise CloudError(f"{path}: missing: xyz")
        for name, array in arrays.items():
            if array.dtype.kind not in "iuf" or array.ndim != 2 or array.shape != (len(arrays["xyz"]), 3):
                raise CloudError(f"{path}: {name} has the shape {array.shape}; allowed: points × 3, numbers")
        return np.asarray(arrays["xyz"], np.float64), arrays.get("normals")
    rows, _ = read_rows(path)
    names = set(rows.dtype.names or ())
    if absent := [name for name in "xyz" if name not in names]:
        raise CloudError(f"{path}: missing: {', '.join(absent)}")
    return _columns(rows, "xyz"), _columns(rows, NORMAL) if names.issuperset(NORMAL) else None


def _columns(rows: NDArray[Any], names: Iterable[str]) -> Array:
    with np.errstate(invalid="ignore"):  # invalid numbers, which are checked later
        return np.stack([rows[name] for name in names], axis=1, dtype=np.float64)


def _check_finite(path: Path, rows: Array) -> None:
    odd = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(odd):
        raise SceneError(f"{path}: point {odd[0]} is not finite")


def _estimate_normals(path: Path, points: Array) -> Array:
    """(N, 3) the normal of the best plane through each point's nearest neighbours."""
    import open3d as o3d

    if len(points) < 3:
        raise SceneError(f"{path}: has {len(points)} points without normals; allowed: at least 3")
    near = o3d.utility.Vector3dVector(points - points.mean(axis=0))  # map coordinates are large
    cloud = o3d.geometry.PointCloud(near)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS), fast_normal_computation=False)
    return np.array(cloud.normals)
