"""A vehicle: the bodies that travel with the sensors and block their beams, in the vehicle frame."""

import os
import shlex
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import model_validator

from lidarcfg.config.document import Key
from lidarcfg.config.kinds import OTHERS, YAML_SUFFIXES
from lidarcfg.config.models import Given, Model, Position, Section, error_at, load_or_check, validation_error
from lidarcfg.core import world
from lidarcfg.errors import ConfigError, SceneError
from lidarcfg.files import example, loaded
from lidarcfg.geometry import Array, Flags
from lidarcfg.sensors.rig import NO_VEHICLE, Mount, Rig
from lidarcfg.sensors.sensor import Byte
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.gltf import SUFFIXES as GLTF
from lidarcfg.world.mesh_frame import axes_warnings, gltf_note, gltf_rpy_deg, place_warnings, unit_warnings
from lidarcfg.world.mesh_source import Triangles
from lidarcfg.world.meshes import Mesh, read_mesh
from lidarcfg.world.robot import read_robot
from lidarcfg.world.robot_body import ground_notes, shaped_links
from lidarcfg.world.scene import Scene, build_scene, is_robot
from lidarcfg.world.scene_file import KINDS, Box, Cylinder, MeshFile, Plane, SceneFile, SceneObject, Sphere, check_names
from lidarcfg.world.solids import (
    connected_components,
    contains_box,
    inside_grid,
    inside_points,
    merge_vertices,
    open_edges,
)
from lidarcfg.world.tracer import NO_SHAPES, Tracer, shapes_of

if TYPE_CHECKING:
    import open3d

MANY_TRIANGLES = 500_000  # triangles: reading and checking them takes seconds
FEWER_TRIANGLES = 100_000  # are enough for a vehicle: docs/vehicles.md
ORIGIN = 0.0, 0.0, 0.0


class BodyKeys(Model):
    """The keys of a vehicle's body besides those of a scene's object; it does not move."""

    reflectivity: Byte = 20
    category: None = None
    motion: None = None
    exclude: bool = False  # cuboids whose centres are inside are no part of the region


class BodyBox(BodyKeys, Box):
    """A box of a vehicle."""

    center_m: Position = ORIGIN


class BodySphere(BodyKeys, Sphere):
    """A sphere of a vehicle."""

    center_m: Position = ORIGIN


class BodyCylinder(BodyKeys, Cylinder):
    """A cylinder of a vehicle."""

    base_m: Position = ORIGIN


class BodyPlane(BodyKeys, Plane):
    """A rectangle of a vehicle."""

    center_m: Position = ORIGIN


class BodyMesh(BodyKeys, MeshFile):
    """A mesh of a vehicle."""

    position_m: Position = ORIGIN
    without: tuple[str, ...] | None = None  # links of a URDF that are no part of the body; by default its LiDARs


class VehicleFile(Model):
    """A vehicle in a file: the keys of a scene's objects, in the vehicle frame."""

    kind: ClassVar[str] = "vehicle"
    boxes: tuple[BodyBox, ...] = ()
    spheres: tuple[BodySphere, ...] = ()
    cylinders: tuple[BodyCylinder, ...] = ()
    planes: tuple[BodyPlane, ...] = ()
    meshes: tuple[BodyMesh, ...] = ()
    allow_inside: bool = False  # sensors may be inside closed bodies

    @model_validator(mode="after")
    def _check(self) -> "VehicleFile":
        check_names(self)
        if not any(getattr(self, kind) for kind in KINDS):
            raise validation_error(f"has no body; give some of {', '.join(KINDS)}")
        return self


@dataclass(frozen=True)
class Solid:
    """A closed body: points can be inside."""

    name: str
    low_m: Array  # (3,) of its bounds
    high_m: Array  # (3,)
    shape: Mesh | Sphere | Cylinder

    @cached_property
    def components(self) -> list[Mesh]:
        """The connected components of a mesh; they are closed."""
        assert isinstance(self.shape, tuple)
        return connected_components(self.shape)

    def inside(self, points_m: Array) -> Flags:
        """(N,): which points (N, 3) are inside."""
        if isinstance(self.shape, tuple):
            near: Flags = np.asarray(((points_m >= self.low_m) & (points_m <= self.high_m)).all(axis=1))
            if near.any():
                near[near] = inside_points(self.components, points_m[near])
            return near
        middle = 0.5 * (self.low_m + self.high_m)
        axes = slice(3) if isinstance(self.shape, Sphere) else slice(2)
        flat = ((points_m - middle)[:, axes] ** 2).sum(axis=1) < self.shape.radius_m**2
        return np.asarray(flat & (points_m[:, 2] > self.low_m[2]) & (points_m[:, 2] < self.high_m[2]))

    def contains_box(self, low_m: Array, high_m: Array) -> bool:
        """Whether the box from `low_m` (3,) to `high_m` (3,) is certainly inside."""
        if isinstance(self.shape, tuple):
            inside_bounds = bool((low_m >= self.low_m).all() and (high_m <= self.high_m).all())
            return inside_bounds and contains_box(self.components, low_m, high_m)
        corners = np.array(list(product(*zip(low_m, high_m, strict=True))))
        return bool(self.inside(corners).all())


@dataclass(frozen=True)
class Vehicle:
    """The bodies that travel with the sensors."""

    scene: Scene  # of static objects in the vehicle frame
    excluded: tuple[str, ...]  # the names of the closed bodies whose insides are no part of the region
    allow_inside: bool
    file: VehicleFile  # what it was built from, with whole paths
    closed: dict[str, Mesh]  # closed boxes and meshes by name, their vertices merged
    warnings: tuple[str, ...]  # what looks wrong with its meshes

    def __repr__(self) -> str:
        return f"<Vehicle: {', '.join(self.scene.names)}>"

    @classmethod
    def from_meshes(
        cls,
        meshes: "Mapping[str, open3d.t.geometry.TriangleMesh | open3d.geometry.TriangleMesh]",
        allow_inside: bool = False,
    ) -> "Vehicle":
        """The vehicle of Open3D's meshes by their names, in metres in the vehicle frame; a copy.

        The insides of closed ones are no part of a study's region. Raises SceneError for what is no mesh.
        """
        bodies = []
        for name, mesh in meshes.items():
            own = Triangles.of(mesh)
            closed = not len(open_edges(merge_vertices((own.vertices_m, own.triangles))))
            bodies.append({"name": name, "file": own, "exclude": closed})
        section = Section({"meshes": tuple(bodies), "allow_inside": allow_inside})
        return vehicle(section.checked(VehicleFile), Path(), ())

    @property
    def section(self) -> Section:
        """The vehicle as the section of a rig's file."""
        return Section(self.file.model_dump(exclude_defaults=True))

    @cached_property
    def tracer(self) -> Tracer:
        """A tracer of its bodies."""
        vertices = self.scene.mesh()[0]
        return Tracer(self.scene, 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))

    @cached_property
    def footprint(self) -> Footprint:
        """The footprint of its bodies."""
        return Footprint.of(self.scene.mesh())

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """The closed bodies."""
        found: list[Solid] = []
        rounds = dict(self.scene.rounds)
        for index, name in enumerate(self.scene.names):
            item = rounds.get(index)
            if isinstance(item, Sphere):
                centre = np.array(item.center_m)
                radius = item.radius_m
                found.append(Solid(name, centre - radius, centre + radius, item))
            elif item:
                base = np.array(item.base_m)
                radius = item.radius_m
                high = base + np.array((radius, radius, item.height_m))
                found.append(Solid(name, base - (radius, radius, 0), high, item))
            elif name in self.closed:
                mesh = self.closed[name]
                found.append(Solid(name, mesh[0].min(axis=0), mesh[0].max(axis=0), mesh))
        return tuple(found)

    def inside(self, name: str, x: Array, y: Array, z: Array) -> Flags:
        """(nx, ny, nz) which points of a grid are inside a body; x, y and z ascend. Nothing is inside an open body."""
        found = np.zeros((len(x), len(y), len(z)), np.bool_)
        solid = next((solid for solid in self.solids if solid.name == name), None)
        if solid:
            a, b, c = (
                slice(np.searchsorted(at, low), np.searchsorted(at, high, "right"))
                for at, low, high in zip((x, y, z), solid.low_m, solid.high_m, strict=True)
            )
            if isinstance(solid.shape, tuple):
                found[a, b, c] = inside_grid(solid.components, x[a], y[b], z[c])
            else:
                grid = np.stack(np.meshgrid(x[a], y[b], z[c], indexing="ij"), axis=-1)
                found[a, b, c] = solid.inside(grid.reshape(-1, 3)).reshape(grid.shape[:3])
        return found

    def body_at(self, point_m: Array) -> str | None:
        """The name of a body that contains a point (3,), or None."""
        points = np.asarray(point_m, np.float64)[None]
        return next((solid.name for solid in self.solids if solid.inside(points)[0]), None)

    def depth_m(self, points_m: Array) -> Array:
        """(N,) the depth of points (N, 3) in closed bodies, from the nearest side of the body's bounds; 0 outside."""
        out = np.zeros(len(points_m))
        for solid in self.solids:
            depth = np.minimum(points_m - solid.low_m, solid.high_m - points_m).min(axis=1)
            some = np.flatnonzero(depth > 0.0)
            if len(some):
                out[some] = np.maximum(out[some], np.where(solid.inside(points_m[some]), depth[some], 0.0))
        return out

    def body_containing(self, low_m: Array, high_m: Array) -> str | None:
        """The name of a body that certainly contains the box from low (3,) to high (3,), or None."""
        return next((solid.name for solid in self.solids if solid.contains_box(low_m, high_m)), None)


def vehicle_file(given: Any) -> Any:
    """A validator: in a dict, a `Vehicle` may stand where its keys would."""
    return given.file if isinstance(given, Vehicle) else given


def vehicle(file: VehicleFile, path: Path, at: Key = ("vehicle",)) -> Vehicle:
    """The vehicle under a key of a file. Raises ConfigError for an invalid mesh, and for an open body to exclude."""
    began = time.perf_counter()
    scene = build_scene(SceneFile(name="vehicle", **{kind: getattr(file, kind) for kind in KINDS}), path, at)
    closed = dict[str, Mesh]()
    warnings = list[str]()
    for kind in ("boxes", "planes", "meshes"):
        for i, item in enumerate(getattr(file, kind)):
            mesh = object_mesh(scene, scene.names.index(item.name))
            if not len(mesh[1]):
                raise error_at(
                    path, (*at, kind, i, "file"), f"{item.name!r} has no triangle with three different corners"
                )
            edges = open_edges(mesh)
            if len(edges) == 0:
                closed[item.name] = mesh
            elif item.exclude:
                raise error_at(
                    path, (*at, kind, i, "exclude"), f"{_describe_open(item, edges)}; close the mesh, or remove exclude"
                )
            elif kind == "meshes":
                solid = sum(not len(open_edges(part)) for part in connected_components(mesh))
                what = f"{_describe_open(item, edges)}; {solid} closed parts; it still blocks beams"
                warnings.append(_warning(path, (*at, kind, i), what))
            if kind == "meshes":
                looks = unit_warnings(item, mesh) + _left_out(item, path.parent)
                if len(file.meshes) == 1 and not is_robot(item):  # whose axes and place are given
                    looks += axes_warnings(item, mesh) + place_warnings(item, mesh)
                warnings += [_warning(path, (*at, kind, i, "file"), what) for what in looks]
    if len(scene.triangles) > MANY_TRIANGLES:
        seconds = time.perf_counter() - began
        what = f"the vehicle has {len(scene.triangles):,} triangles; reading them took {seconds:.1f} s"
        largest = np.bincount(scene.triangle_object).argmax()
        item = scene.items[largest]
        if isinstance(item, MeshFile) and isinstance(item.file, str):
            command = f"lidarcfg init study --vehicle {shlex.quote(str(path.parent / item.file))}"
            what += f"; with fewer: {command} --triangles {FEWER_TRIANGLES} -o new/study.yaml"
        warnings.append(_warning(path, at, what))
    excluded = tuple(item.name for kind in KINDS for item in getattr(file, kind) if item.exclude)
    whole = file.model_copy(update={"meshes": tuple(_whole(mesh, path.parent) for mesh in file.meshes)})
    return Vehicle(scene, excluded, file.allow_inside, whole, closed, tuple(warnings))


def _left_out(item: BodyMesh, folder: Path) -> list[str]:
    """What is said of the links of a robot that were left out without being named."""
    if item.without is not None or not is_robot(item):
        return []
    robot = read_robot(folder / str(item.file))
    left_out = [name for name in shaped_links(robot) if name in robot.lidars]
    return [f"left out of the body, as LiDARs: {', '.join(left_out)}; without: [] keeps them"] if left_out else []


def _whole(mesh: BodyMesh, folder: Path) -> BodyMesh:
    """A body with the absolute path of its file, if it has one."""
    if not isinstance(mesh.file, str):
        return mesh
    return mesh.model_copy(update={"file": os.path.realpath(example(folder / mesh.file))})


def load_vehicle(given: Given) -> Vehicle:
    """The vehicle in a YAML file or of a dict with its keys, or one whose only body is a mesh file.

    Raises ConfigError.
    """
    if not isinstance(given, str | Path) or Path(given).suffix in YAML_SUFFIXES:
        file, path = load_or_check(given, VehicleFile)
        return vehicle(file, path, ())
    path = example(given)
    body = BodyMesh(name="body", file=path.name)
    notes: list[str] = []
    if path.suffix.lower() in GLTF:
        with suppress(SceneError):  # which is told where the mesh is made
            body = body.model_copy(update={"rpy_deg": gltf_rpy_deg(read_mesh(path))})
            notes.append(f"{path}: {gltf_note(body.rpy_deg)}")
    made = vehicle(VehicleFile(meshes=(body,)), path)
    if is_robot(body):
        notes += [f"{path}: {note}" for note in ground_notes(made.scene.vertices_m)]
    return replace(made, warnings=(*notes, *made.warnings))


def rig_vehicle(rig: Rig) -> Vehicle | None:
    """The vehicle that a rig's file names, if it names one. Raises ConfigError with file, line and key."""
    section = rig.vehicle
    return vehicle(section.checked(VehicleFile), Path(section.path), section.at) if section else None


def resolve_vehicle(rig: Rig | None, given: Vehicle | Given | None) -> Vehicle | None:
    """The vehicle that is given, or the rig's if that is None; no vehicle if it is `none`. Raises ConfigError."""
    if given is None:
        return rig_vehicle(rig) if rig else None
    if isinstance(given, str | Path) and str(given) == NO_VEHICLE:
        return None
    return loaded(given, load_vehicle, Vehicle)


def check_outside(bodies: Vehicle, mounts: Iterable[Mount], path: Path | None = None) -> None:
    """Raises ConfigError if a sensor is in a closed body, unless the vehicle allows it; `path` is the rig's file."""
    for i, mount in enumerate(mounts):
        body = None if bodies.allow_inside else bodies.body_at(np.array(mount.position_m))
        if body:
            what = f"{mount.name} is inside the vehicle's {body!r}; move it, or set allow_inside: true"
            raise error_at(path, ("sensors", i), what) if path else ConfigError(what)


def object_mesh(scene: Scene, index: int) -> Mesh:
    """The triangles of one of a scene's objects, with vertices at the same place merged."""
    return merge_vertices((scene.vertices_m, scene.triangles[scene.triangle_object == index]))


def _describe_open(item: SceneObject, edges: Array) -> str:
    """A message that says that a body is open, and where."""
    shown = " to ".join("(" + ", ".join(f"{value:.6g}" for value in corner) + ")" for corner in edges[0])
    source = f" of {item.file}" if isinstance(item, MeshFile) else ""
    return (
        f"{item.name!r}{source} is not closed, so that nothing is inside: {len(edges)} of its edges bound an odd "
        f"number of triangles, the first from {shown}"
    )


def _warning(path: Path, key: Key, what: str) -> str:
    """A warning at a key of a vehicle's file, or at the mesh that is the file; without a place if made in Python."""
    if not path.name:
        return what
    return f"{path}: {what}" if path.suffix.lower() in OTHERS else str(error_at(path, key, what))


def static_bvh(scenes: Sequence[Scene], origin_m: Array) -> world.Bvh:
    """The hierarchy over the static objects of scenes, relative to a point (3,)."""
    columns = [NO_SHAPES]
    for scene in scenes:
        static = np.array([motion is None for motion in scene.motions])
        columns.append(shapes_of(scene, static, origin_m))
    return world.Bvh(*(np.concatenate(column) for column in zip(*columns, strict=True)))
