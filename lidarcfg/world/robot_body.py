"""The body of a robot: the shapes of its links, placed in the vehicle frame, as one mesh.

A link has the shapes that are seen (visual), or without any those that collide. Links that are LiDARs are left out.
Joints that move are at zero.
"""

import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.errors import ConversionError, SceneError
from lidarcfg.geometry import Array, transform
from lidarcfg.world.frame_tree import listed
from lidarcfg.world.mesh_source import Mesh
from lidarcfg.world.meshes import box_mesh, cylinder_mesh, join_meshes, read_mesh, sphere_mesh
from lidarcfg.world.robot import ZEROS, Element, Robot, origin, read_robot, vector
from lidarcfg.world.scene_file import Box, Cylinder, Sphere

TOLERANCE_M = 0.001  # of the facets of cylinders and spheres
LEVEL_M = 0.02  # from the ground, which is the vehicle frame's z = 0 elsewhere
TRIANGLES_MAX = 10_000_000
SHAPES = ("box", "cylinder", "sphere", "mesh")
ONES = (1.0, 1.0, 1.0)
UNSAID: dict[str, Any] = {"name": "shape", "reflectivity": 0}  # of a shape: its body's counts
PACKAGE = re.compile(r"(?:package|model)://([^/]+)/(.+)")
VARIABLES = {"ROS_PACKAGE_PATH": "", "AMENT_PREFIX_PATH": "share"}  # of ROS, and the folder below with packages


@dataclass(frozen=True)
class RobotBody:
    """The body of a robot."""

    mesh: Mesh  # in the vehicle frame, in metres
    links: tuple[str, ...]  # of which it is
    without: tuple[str, ...]  # links with shapes that were left out
    base: str  # the link that is the vehicle frame
    files: tuple[Path, ...]  # of its meshes


def robot_body(path: Path, without: Sequence[str] | None = None) -> RobotBody:
    """The body of the robot in a URDF `without` some links, by default without its LiDARs. Raises SceneError."""
    try:
        return _body(read_robot(path), without)
    except OSError as error:
        raise SceneError.from_os(path, error) from None
    except ConversionError as error:
        raise SceneError(str(error)) from None


def _body(robot: Robot, without: Sequence[str] | None) -> RobotBody:
    left_out = robot.lidars if without is None else tuple(without)
    for name in left_out:
        if name not in robot.links:
            raise SceneError(f"{robot.path}: has no link {name!r}; its links: {listed(tuple(robot.links))}")
    shaped = shaped_links(robot)
    kept = tuple(name for name in shaped if name not in left_out)
    dropped = tuple(name for name in shaped if name in left_out)
    if not kept:
        if not robot.links:
            raise SceneError(f"{robot.path}: has no link; a robot has at least one")
        only = f" but of {listed(dropped)}, which are left out" if dropped else ""
        raise SceneError(f"{robot.path}: has no shapes{only}; a body needs a visual or a collision with a geometry")
    known: dict[Path, Mesh] = {}
    parts: list[Mesh] = []
    count = 0
    for name in kept:
        T_base_link = robot.pose(name).matrix
        for shape in _shapes(robot.links[name]):
            where = f"{robot.path}: link {name!r}"
            vertices, triangles = _mesh(where, robot.path, shape, known)
            count += len(triangles)
            if count > TRIANGLES_MAX:
                raise SceneError(f"{where}: with it the body has more than {TRIANGLES_MAX:,} triangles")
            vertices_m = transform(T_base_link @ origin(where, shape).matrix, vertices)
            if not (abs(vertices_m) <= COORDINATE_MAX_M).all():
                raise SceneError(f"{where}: reaches beyond {COORDINATE_MAX_M:g} m")
            parts.append((vertices_m, triangles))
    return RobotBody(join_meshes(parts), kept, dropped, robot.base, tuple(known))


def body_notes(body: RobotBody) -> list[str]:
    """What is to be said of a body: links that were left out, and where the ground is."""
    notes = []
    if body.without:
        notes.append(f"left out of the body, as LiDARs: {', '.join(body.without)}")
    return notes + ground_notes(body.mesh[0])


def ground_notes(vertices_m: Array) -> list[str]:
    """What is said where the ground is not at z = 0 of the vehicle frame, by the lowest of a body's vertices (V, 3)."""
    lowest_m = float(vertices_m[:, 2].min())
    if abs(lowest_m) <= LEVEL_M:
        return []
    return [f"its lowest point is at z = {lowest_m:.3f} m: the ground is there, though a scene's is mostly at 0"]


def shaped_links(robot: Robot) -> tuple[str, ...]:
    """The links that have shapes."""
    return tuple(name for name, link in robot.links.items() if _shapes(link))


def _shapes(link: Element) -> list[Element]:
    """What of a link is seen, or without that what collides."""
    for kind in ("visual", "collision"):
        if found := [one for one in link.iterfind(kind) if one.find("geometry") is not None]:
            return found
    return []


def _mesh(where: str, path: Path, shape: Element, known: dict[Path, Mesh]) -> Mesh:
    """The triangles of a visual or a collision in its own frame; `known` keeps files that were read."""
    geometry = shape.find("geometry")
    found = [] if geometry is None else [one for one in geometry if one.tag in SHAPES]
    if len(found) != 1:
        tags = ", ".join(f"<{one.tag[:40]}>" for one in geometry or ()) or "nothing"
        raise SceneError(f"{where}: its geometry is {tags}; allowed: one of {', '.join(SHAPES)}")
    element = found[0]
    if element.tag == "mesh":
        return _scaled(where, path, element, known)
    if element.tag == "box":
        size_m = vector(where, element, "size", ZEROS)
        _check_sizes(where, element, "size", size_m)
        return box_mesh(Box(**UNSAID, center_m=ZEROS, size_m=size_m))
    radius_m = _length(where, element, "radius")
    if element.tag == "sphere":
        return sphere_mesh(Sphere(**UNSAID, center_m=ZEROS, radius_m=radius_m), TOLERANCE_M)
    height_m = _length(where, element, "length")
    base_m = 0.0, 0.0, -height_m / 2
    return cylinder_mesh(Cylinder(**UNSAID, base_m=base_m, radius_m=radius_m, height_m=height_m), TOLERANCE_M)


def _length(where: str, element: Element, key: str) -> float:
    """A length in an attribute. Raises SceneError unless it is above 0."""
    try:
        value = float(element.get(key, "nan"))
    except ValueError:
        value = math.nan
    _check_sizes(where, element, key, (value,))
    return value


def _check_sizes(where: str, element: Element, key: str, sizes_m: Sequence[float]) -> None:
    if not all(0 < size <= COORDINATE_MAX_M for size in sizes_m):
        given = f"{key} {element.get(key, '')[:60]!r}"
        what = f"{element.tag}: {given} is not allowed; allowed: above 0, up to {COORDINATE_MAX_M:g} m"
        raise SceneError(f"{where}: {what}")


def _scaled(where: str, path: Path, element: Element, known: dict[Path, Mesh]) -> Mesh:
    """The triangles of a mesh's file, scaled; a scale that mirrors turns them over."""
    file = mesh_file(where, path, element)
    if file not in known:
        try:
            known[file] = read_mesh(file)
        except SceneError as error:
            raise SceneError(f"{where}: {error}") from None
    vertices, triangles = known[file]
    scale = vector(where, element, "scale", ONES)
    if not all(scale):
        raise SceneError(f"{where}: mesh: scale {element.get('scale', '')!r} is flat; allowed: other than 0")
    return vertices * scale, triangles if math.prod(scale) > 0 else triangles[:, ::-1]


def mesh_file(where: str, path: Path, mesh: Element) -> Path:
    """The file that a mesh of a URDF at `path` names. Raises SceneError if it is not there."""
    name = mesh.get("filename", "").replace("\\", "/")
    if not name:
        raise SceneError(f"{where}: mesh: has no filename")
    if package := PACKAGE.fullmatch(name):
        return _in_package(where, path, *package.groups())
    if name.startswith("file://"):
        name = unquote(name.removeprefix("file://"))
    if "://" in name:
        raise SceneError(f"{where}: mesh {name[:200]!r} is not fetched; allowed: package://, file:// and paths")
    file = path.parent / name
    if not file.is_file():
        raise SceneError(f"{where}: mesh {str(file)!r}: no such file")
    return file


def _in_package(where: str, path: Path, package: str, name: str) -> Path:
    """A file in a package of ROS. Raises SceneError."""
    folders = [folder for folder in _packages(path, package) if folder.is_dir()]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    if folders:
        raise SceneError(f"{where}: mesh {str(folders[0] / name)!r}: no such file")
    looked = f"a folder of that name above {path.name} or beside those, or in {' or '.join(VARIABLES)}"
    raise SceneError(f"{where}: package {package!r} is not found; looked for {looked}")


def _packages(path: Path, package: str) -> Iterator[Path]:
    """Where a package may be: above the URDF, beside those folders, and where ROS looks for it."""
    for folder in path.resolve().parents:
        if folder.name == package:
            yield folder
        yield folder / package
        yield folder / "share" / package
    for variable, below in VARIABLES.items():
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(root) / below / package
            if Path(root).name == package:
                yield Path(root)
