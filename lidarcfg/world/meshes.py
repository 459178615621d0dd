"""Triangle meshes: of the shapes in a scene, and read from files."""

import math
import re
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg import maths
from lidarcfg.config.models import COORDINATE_MAX_M, Vec3
from lidarcfg.errors import SceneError
from lidarcfg.files import example
from lidarcfg.geometry import Array, pose, transform
from lidarcfg.inputs import check_regular
from lidarcfg.world.gltf import SUFFIXES, check_nodes
from lidarcfg.world.mesh_source import Mesh as Mesh
from lidarcfg.world.mesh_source import Triangles
from lidarcfg.world.mesh_source import check_mesh as check_mesh
from lidarcfg.world.scene_file import Box, Cylinder, MeshFile, Plane, Sphere

_CLOUD = "a point cloud has no surfaces; give it under surfels, with a radius, in a scene"
NO_MESHES = {  # by suffix: what the file is instead, and what to do
    ".xodr": "an OpenDRIVE map has lanes and no triangles; export a mesh of it, for example an OBJ with libOpenDRIVE",
    **dict.fromkeys((".pcd", ".las", ".laz", ".npz"), _CLOUD),
    **dict.fromkeys((".xyz", ".pts", ".e57", ".bin"), f"{_CLOUD}, as PLY, PCD, LAS or npz"),
    **dict.fromkeys((".tif", ".tiff", ".asc"), "heights are no mesh; give them under height_fields, as PNG or npy"),
    **dict.fromkeys(
        (".step", ".stp", ".iges", ".igs"), "a CAD model has no triangles; export a mesh of it, for example an STL"
    ),
    **dict.fromkeys((".3ds", ".blend", ".fbx"), "a format that is not read; export the mesh as glTF, OBJ or STL"),
    ".urdf": "a robot; a vehicle or a scene names it under meshes",
    **dict.fromkeys((".png", ".npy"), "heights are no mesh; give them under height_fields, in a scene"),
}

FIRST_BYTES = {b"ply": (".ply",), b"glTF": (".glb", ".gltf")}  # of a file, and the suffixes that it may have
FILE_MAX = 500_000_000  # bytes of a mesh's file: ten million triangles


def box_mesh(box: Box) -> Mesh:
    """Eight corners, twelve triangles."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([corner for a, b, c, d in faces for corner in ((a, b, c), (a, c, d))])
    T_world_box = pose(box.center_m, (0.0, 0.0, math.radians(box.yaw_deg)))
    return transform(T_world_box, corners * box.size_m), triangles


def plane_mesh(plane: Plane) -> Mesh:
    """Four corners, two triangles."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    T_world_plane = pose(plane.center_m, np.radians(plane.rpy_deg))
    return transform(T_world_plane, corners * (*plane.size_m, 1.0)), np.array([[0, 1, 2], [0, 2, 3]])


def cylinder_mesh(cylinder: Cylinder, tolerance_m: float) -> Mesh:
    """Two rings and the centres of its ends, within a tolerance of the cylinder."""
    radius = cylinder.radius_m
    height = cylinder.height_m
    profile = np.array([[0, 0], [radius, 0], [radius, height], [0, height]])
    return lathe(profile, _facets(radius, tolerance_m), cylinder.base_m)


def sphere_mesh(sphere: Sphere, tolerance_m: float) -> Mesh:
    """Rings from pole to pole, within a tolerance of the sphere."""
    facets = _facets(sphere.radius_m, tolerance_m / 2)  # half along the rings, half across
    angle = np.linspace(0, math.pi, facets // 2 + 1)
    profile = sphere.radius_m * np.stack([maths.sin(angle), -maths.cos(angle)], axis=1)
    profile[[0, -1], 0] = 0.0  # sin(pi) is not 0, and would leave a hole of 1e-16 m
    return lathe(profile, facets, sphere.center_m)


def lathe(profile: Array, facets: int, position_m: Vec3) -> Mesh:
    """The surface of revolution of a profile (N, 2) of radius and height about the vertical through `position_m`."""
    azimuth = np.arange(facets) * (2 * math.pi / facets)
    radius = profile[:, :1]
    height = profile[:, 1:]
    rings = np.stack([radius * maths.cos(azimuth), radius * maths.sin(azimuth), height + 0 * azimuth], axis=-1)
    index = np.arange(len(profile) * facets).reshape(len(profile), facets)
    a = index[:-1].ravel()
    b = np.roll(index, -1, axis=1)[:-1].ravel()
    c = np.roll(index, -1, axis=1)[1:].ravel()
    d = index[1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return rings.reshape(-1, 3) + position_m, triangles


def _facets(radius_m: float, tolerance_m: float) -> int:
    """The number of sides of a polygon within a tolerance of its circle; even, 16 to 512."""
    half: float = maths.acos(max(1 - tolerance_m / radius_m, 0.0))
    return min(max(2 * math.ceil(math.pi / half / 2), 16), 512)


def place_mesh(mesh: Mesh, item: MeshFile) -> Mesh:
    """The mesh in the world frame. Raises SceneError if its scale makes it too large."""
    vertices, triangles = mesh
    far = np.flatnonzero((abs(vertices) > COORDINATE_MAX_M / item.scale).any(axis=1))
    if len(far):
        what = f"vertex {far[0]} is beyond {COORDINATE_MAX_M:g} m with the scale {item.scale:g}"
        raise SceneError(f"{item.file}: {what}")
    return transform(pose(item.position_m, np.radians(item.rpy_deg)), vertices * item.scale), triangles


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes joined as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    triangles = [mesh[1] + start for mesh, start in zip(meshes, first, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(triangles)


def read_mesh(path: Path) -> Mesh:
    """The mesh in a file. Raises SceneError if there is none or it is invalid."""
    check_readable(path, FILE_MAX)
    if path.suffix.lower() in NO_MESHES:
        raise SceneError(f"{path}: {NO_MESHES[path.suffix.lower()]}")
    _check_suffix(path)
    if path.suffix.lower() in SUFFIXES:
        check_nodes(path)
    plain = _ply_mesh(path) if path.suffix.lower() == ".ply" else None
    if path.suffix.lower() == ".dae":
        plain = _collada_mesh(path)
    if plain:
        check_mesh(str(path), plain)
        return plain
    import open3d as o3d

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(path)
    vertices = np.array(mesh.vertices, np.float64)
    triangles = np.array(mesh.triangles, np.int64)
    if not len(triangles):
        cloud = f"; {_CLOUD}" if len(vertices) else ""
        raise SceneError(f"{path}: no triangles that Open3D can read{cloud}")
    check_mesh(str(path), (vertices, triangles))
    return vertices, triangles


def _check_suffix(path: Path) -> None:
    """Raises SceneError for a file that is another format than its suffix says."""
    with path.open("rb") as file:
        head = file.read(4)
    for first, suffixes in FIRST_BYTES.items():
        if head.startswith(first) and path.suffix.lower() not in suffixes:
            raise SceneError(f"{path}: it begins like a {suffixes[0]} file; name it {path.stem}{suffixes[0]}")


def mesh_from(source: str | Triangles, folder: Path) -> Mesh:
    """The mesh that a file in a folder names or holds. Raises SceneError."""
    if isinstance(source, Triangles):
        return source.vertices_m, source.triangles
    return read_mesh(example(folder / source))


def ply_file(mesh: Mesh) -> bytes:
    """A mesh as a binary PLY file, of float64."""
    import plyfile

    vertices = np.ascontiguousarray(mesh[0], "<f8").view([(axis, "<f8") for axis in "xyz"])[:, 0]
    faces = np.zeros(len(mesh[1]), [("vertex_indices", "<i4", (3,))])
    faces["vertex_indices"] = mesh[1]
    named = [(vertices, "vertex"), (faces, "face")]
    out = BytesIO()
    plyfile.PlyData([plyfile.PlyElement.describe(*one) for one in named], byte_order="<").write(out)
    return out.getvalue()


def _ply_mesh(path: Path) -> Mesh | None:
    """The mesh in a binary PLY file of triangles, without loading Open3D for a second; None for other PLY files.

    These are whole: of damaged ones RPly in Open3D would print a line to stderr. Raises SceneError.
    """
    import plyfile

    try:
        with path.open("rb") as file:
            binary = re.match(rb"ply\r?\nformat binary_", file.read(20))
        mesh = _triangles(path) if binary else None
        if mesh is None:
            _read_ply(path)
    except (plyfile.PlyParseError, ValueError, OverflowError, MemoryError) as error:
        raise SceneError.damaged(path, error) from None
    return mesh


def _collada_mesh(path: Path) -> Mesh:
    """The mesh in a Collada file in metres, its nodes in their places, with the axes of the file. Raises SceneError."""
    import trimesh

    try:
        import collada
    except ImportError:
        raise SceneError(f"{path}: pycollada is not installed; pip install 'lidarcfg[convert]'") from None
    try:
        scene = trimesh.load_scene(path)
        mesh = scene.to_mesh()
        vertices = np.array(mesh.vertices, np.float64)
        triangles = np.array(mesh.faces, np.int64)
        metres = trimesh.units.unit_conversion(scene.units or "meters", "meters")
    except (collada.DaeError, SyntaxError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise SceneError.damaged(path, error, "Collada") from None
    if not len(triangles):
        raise SceneError(f"{path}: no triangles")
    return vertices * metres, triangles


def _triangles(path: Path) -> Mesh | None:
    """The mesh in a binary PLY file; None if not all of its faces are triangles."""
    import plyfile

    try:
        data = _read_ply(path, known_list_len={"face": {"vertex_indices": 3}})
        vertices = np.stack([np.asarray(data["vertex"][axis], np.float64) for axis in "xyz"], axis=1)
        triangles = data["face"]["vertex_indices"]
    except (plyfile.PlyParseError, LookupError):
        return None
    return (vertices, triangles.astype(np.int64)) if triangles.ndim == 2 and len(triangles) else None


def _read_ply(path: Path, **options: Any) -> Any:
    """A PLY file by plyfile, which refuses comments that are not ASCII: they are read as question marks."""
    import plyfile

    with np.errstate(over="ignore"):  # what is too large for its type is inf, and refused as such
        try:
            return plyfile.PlyData.read(str(path), **options)
        except UnicodeDecodeError:
            head, end, body = path.read_bytes().partition(b"end_header")
            plain = head.decode("ascii", "replace").encode("ascii", "replace")
            return plyfile.PlyData.read(BytesIO(plain + end + body), **options)


def check_readable(path: Path, most: int) -> None:
    """Raises SceneError unless the path is a readable regular file of at most `most` bytes.

    Open3D reports a file that it cannot open as one without triangles.
    """
    try:
        check_regular(path, most)
        path.open("rb").close()
    except OSError as error:
        raise SceneError.from_os(path, error) from None
    except ValueError as error:
        raise SceneError(f"{str(path)!r}: {error}") from None
