"""A scene: what stands around the vehicle, from a YAML file, as triangles in the world frame.

Round things, up to a radius of 26 m, are cut into facets that stay within `FACET_ERROR_M` of them.
"""

import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config import Model, Positive, Vec3, error_at, fault, load
from lidarcfg.errors import SceneError
from lidarcfg.files import example
from lidarcfg.geometry import Array, pose, transform
from lidarcfg.sensor import Byte
from lidarcfg.world.motion import Motion

FACET_ERROR_M = 0.001  # half a range step of the finest sensor
COORDINATE_MAX_M = 1e8  # metres; UTM reaches 1e7
GROUND = "ground"
PLACES = ("center_m", "base_m", "position_m")  # what places an object, whatever its kind

Metres = Annotated[float, Field(ge=-COORDINATE_MAX_M, le=COORDINATE_MAX_M)]
Size = Annotated[float, Field(gt=0, le=COORDINATE_MAX_M)]
Position = tuple[Metres, Metres, Metres]
Mesh = tuple[Array, NDArray[np.int64]]  # vertices (V, 3) in metres, triangles (T, 3)


class Ground(Model):
    """The horizontal plane that everything stands on, without end."""

    z_m: Metres = 0.0
    reflectivity: Byte  # as the sensor is calibrated: 0-100 diffuse in per cent, 101-255 retro-reflectors


class Thing(Model):
    """What all objects have."""

    name: Annotated[str, Field(min_length=1)]
    reflectivity: Byte
    motion: Motion | None = None  # from its place at time 0, in the world's axes; it turns about its place


class Box(Thing):
    """A box, turned about the vertical."""

    center_m: Position
    size_m: tuple[Size, Size, Size]  # along its own x, y, z
    yaw_deg: float = 0.0


class Sphere(Thing):
    """A ball."""

    center_m: Position
    radius_m: Size


class Cylinder(Thing):
    """A vertical, closed cylinder."""

    base_m: Position  # centre of the lower end
    radius_m: Size
    height_m: Size


class Plane(Thing):
    """A rectangle in its own xy plane, seen from both sides."""

    center_m: Position
    size_m: tuple[Size, Size]
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)


class MeshFile(Thing):
    """A triangle mesh in a file that Open3D reads."""

    file: Annotated[str, Field(min_length=1)]  # relative to the scene's file
    position_m: Position
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)
    scale: Positive = 1.0


class Weather(Model):
    """What hangs in the air everywhere; `returns.py` says what it does to a beam."""

    fog_visibility_m: Annotated[float, Field(ge=1)] | None = None  # meteorological
    rain_mm_h: Positive | None = None


class GeoOrigin(Model):
    """Where on Earth the world's origin is; x points east and y north."""

    latitude_deg: Annotated[float, Field(ge=-89, le=89)] = 0.0
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0


class SceneFile(Model):
    """A scene, as its file says it."""

    name: Annotated[str, Field(min_length=1)]
    ground: Ground | None = None
    boxes: tuple[Box, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    planes: tuple[Plane, ...] = ()
    meshes: tuple[MeshFile, ...] = ()
    geo_origin: GeoOrigin = GeoOrigin()
    weather: Weather = Weather()

    @model_validator(mode="after")
    def _check(self) -> "SceneFile":
        names = {GROUND}
        for kind in ("boxes", "spheres", "cylinders", "planes", "meshes"):
            for i, thing in enumerate(getattr(self, kind)):
                if thing.name in names:
                    raise fault(f"{thing.name!r} is an object already; each name may stand once", kind, i, "name")
                names.add(thing.name)
        return self


@dataclass(frozen=True)
class Scene:
    """Everything that a ray can hit. Object 0 is the ground (without triangles), if there is one."""

    file: SceneFile  # what it was built from
    names: tuple[str, ...]  # (objects,)
    reflectivity: NDArray[np.uint8]  # (objects,)
    vertices_m: Array  # (V, 3) in the world frame
    triangles: NDArray[np.int64]  # (T, 3) indices of vertices
    triangle_object: NDArray[np.int32]  # (T,) index of the object, ascending
    motion: tuple[Motion | None, ...]  # (objects,) None: it does not move
    place_m: Array  # (objects, 3) what a moving object turns about, at time 0


def load_scene(path: str | Path) -> Scene:
    """The scene in a YAML file. Raises ConfigError, also for a mesh that cannot be used, and SceneError if empty."""
    path = example(path)
    file = load(path, SceneFile)
    things: list[tuple[Ground | Thing, Mesh]] = []
    if file.ground:
        things.append((file.ground, (np.empty((0, 3)), np.empty((0, 3), np.int64))))
    things += [(box, box_mesh(box)) for box in file.boxes]
    things += [(sphere, sphere_mesh(sphere)) for sphere in file.spheres]
    things += [(cylinder, cylinder_mesh(cylinder)) for cylinder in file.cylinders]
    things += [(plane, plane_mesh(plane)) for plane in file.planes]
    for i, item in enumerate(file.meshes):
        try:
            things.append((item, placed(read_mesh(path.parent / item.file), item)))
        except SceneError as error:
            raise error_at(path, ("meshes", i, "file"), error) from None
    if not things:
        raise SceneError(f"{path}: the scene is empty; give a ground or an object")

    meshes = [mesh for _, mesh in things]
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return Scene(
        file=file,
        names=tuple(getattr(thing, "name", GROUND) for thing, _ in things),
        reflectivity=np.array([thing.reflectivity for thing, _ in things], np.uint8),
        vertices_m=np.concatenate([vertices for vertices, _ in meshes]),
        triangles=np.concatenate([mesh[1] + start for mesh, start in zip(meshes, first, strict=False)]),
        triangle_object=np.repeat(np.arange(len(meshes), dtype=np.int32), [len(mesh[1]) for mesh in meshes]),
        motion=tuple(getattr(thing, "motion", None) for thing, _ in things),
        place_m=np.array([_place_m(thing) for thing, _ in things]),
    )


def _place_m(thing: Ground | Thing) -> Position:
    """Where its file puts an object; the ground moves nowhere."""
    return next((getattr(thing, key) for key in PLACES if hasattr(thing, key)), (0.0, 0.0, 0.0))


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


def cylinder_mesh(cylinder: Cylinder) -> Mesh:
    """A lathe of two rings."""
    radius, height = cylinder.radius_m, cylinder.height_m
    profile = np.array([[0, 0], [radius, 0], [radius, height], [0, height]])
    return lathe(profile, _facets(radius, FACET_ERROR_M), cylinder.base_m)


def sphere_mesh(sphere: Sphere) -> Mesh:
    """A lathe of rings from pole to pole."""
    facets = _facets(sphere.radius_m, FACET_ERROR_M / 2)  # half along the rings, half across
    angle = np.linspace(0, math.pi, facets // 2 + 1)
    profile = sphere.radius_m * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    return lathe(profile, facets, sphere.center_m)


def lathe(profile: Array, facets: int, position_m: Vec3) -> Mesh:
    """The profile (N, 2) of radius and height turned about the vertical through `position_m`."""
    turn = np.arange(facets) * (2 * math.pi / facets)
    radius, height = profile[:, :1], profile[:, 1:]
    rings = np.stack([radius * np.cos(turn), radius * np.sin(turn), height + 0 * turn], axis=-1)
    index = np.arange(len(profile) * facets).reshape(len(profile), facets)
    a, b = index[:-1].ravel(), np.roll(index, -1, axis=1)[:-1].ravel()
    c, d = np.roll(index, -1, axis=1)[1:].ravel(), index[1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return rings.reshape(-1, 3) + position_m, triangles


def _facets(radius_m: float, error_m: float) -> int:
    """How many sides keep a polygon's chords that near to its circle; even, 16 to 512."""
    half = math.acos(max(1 - error_m / radius_m, 0.0))
    return min(max(2 * math.ceil(math.pi / half / 2), 16), 512)


def placed(mesh: Mesh, item: MeshFile) -> Mesh:
    """The mesh in the world frame. Raises SceneError if its scale makes it too large."""
    vertices, triangles = mesh
    far = np.flatnonzero((abs(vertices) > COORDINATE_MAX_M / item.scale).any(axis=1))
    if len(far):
        what = f"vertex {far[0]} is beyond {COORDINATE_MAX_M:g} m with the scale {item.scale:g}"
        raise SceneError(f"{item.file}: {what}")
    return transform(pose(item.position_m, np.radians(item.rpy_deg)), vertices * item.scale), triangles


def read_mesh(path: Path) -> Mesh:
    """The mesh in a file. Raises SceneError if there is none, or not a sound one."""
    import open3d as o3d

    _check_readable(path)
    with _silence(), o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(path)
    vertices = np.array(mesh.vertices, np.float64)
    triangles = np.array(mesh.triangles, np.int64)
    if not len(triangles):
        raise SceneError(f"{path}: no triangles that Open3D can read")
    if not np.isfinite(vertices).all():
        raise SceneError(f"{path}: vertex {np.argwhere(~np.isfinite(vertices))[0][0]} is not finite")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        bad = triangles[(triangles < 0) | (triangles >= len(vertices))][0]
        raise SceneError(f"{path}: a triangle names vertex {bad}; there are {len(vertices)}")
    return vertices, triangles


def _check_readable(path: Path) -> None:
    """Raises SceneError, as Open3D does not tell a file that it cannot open from one without triangles."""
    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode):
            path.open("rb").close()
    except OSError as error:
        raise SceneError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    except ValueError as error:
        raise SceneError(f"{str(path)!r}: {error}") from None
    if not stat.S_ISREG(mode):
        raise SceneError(f"{path}: is {'a directory' if stat.S_ISDIR(mode) else 'not a regular file'}")


@contextmanager
def _silence() -> Iterator[None]:
    """Nothing on stdout or stderr: mesh readers in C print there what the caller learns from the mesh."""
    keep = [os.dup(1), os.dup(2)]
    with open(os.devnull, "wb") as nothing:
        os.dup2(nothing.fileno(), 1)
        os.dup2(nothing.fileno(), 2)
    try:
        yield
    finally:
        for target, saved in zip((1, 2), keep, strict=True):
            os.dup2(saved, target)
            os.close(saved)
