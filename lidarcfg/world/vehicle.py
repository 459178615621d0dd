"""A vehicle: the bodies that travel with the sensors and block their beams, in the vehicle frame."""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import model_validator

from lidarcfg.config import Key, Model, Position, Section, error_at, fault, load
from lidarcfg.errors import ConfigError
from lidarcfg.files import example
from lidarcfg.geometry import Array
from lidarcfg.rig import Mount, Rig
from lidarcfg.sensor import Byte
from lidarcfg.world.bvh import NO_TREE, Tree, build
from lidarcfg.world.meshes import Mesh
from lidarcfg.world.scene import (
    KINDS,
    Box,
    Cylinder,
    MeshFile,
    Plane,
    Scene,
    SceneFile,
    SceneObject,
    Sphere,
    built,
    check_names,
)
from lidarcfg.world.solids import Inside, inside, open_edges, parts, welded
from lidarcfg.world.tracer import shapes_of

MANY = 500_000  # triangles: reading and checking them takes seconds
LEAST_M, TYPICAL_M, MOST_M = 0.05, 5.0, 40.0  # sizes of a vehicle's mesh: a part of one, a car, the longest bus
UNITS = {1.0: "metre", 0.001: "millimetre", 0.01: "centimetre", 0.0254: "inch"}  # by the scale that makes them metres
ORIGIN = 0.0, 0.0, 0.0


class Body(Model):
    """What the parts of a vehicle have beyond the objects of a scene; they do not move."""

    reflectivity: Byte = 20
    motion: None = None
    exclude: bool = False  # cuboids whose centres are inside are no part of the region


class BodyBox(Body, Box):
    """A box of a vehicle."""

    center_m: Position = ORIGIN


class BodySphere(Body, Sphere):
    """A sphere of a vehicle."""

    center_m: Position = ORIGIN


class BodyCylinder(Body, Cylinder):
    """A cylinder of a vehicle."""

    base_m: Position = ORIGIN


class BodyPlane(Body, Plane):
    """A rectangle of a vehicle."""

    center_m: Position = ORIGIN


class BodyMesh(Body, MeshFile):
    """A mesh of a vehicle."""

    position_m: Position = ORIGIN


class VehicleFile(Model):
    """A vehicle, as a study says it: a scene's own keys, in the vehicle frame."""

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
            raise fault(f"has no body; give some of {', '.join(KINDS)}")
        return self


@dataclass(frozen=True)
class Vehicle:
    """The bodies that travel with the sensors."""

    scene: Scene  # of static objects in the vehicle frame
    excluded: tuple[str, ...]  # the names of the closed bodies whose insides are no part of the region
    allow_inside: bool
    file: VehicleFile  # what it was built from, with whole paths
    closed: dict[str, Mesh]  # the welded triangles of closed boxes and meshes
    warnings: tuple[str, ...]  # what looks wrong with its meshes

    @property
    def section(self) -> Section:
        """The same as a part of a rig's file."""
        return Section(self.file.model_dump(exclude_defaults=True))

    def inside(self, name: str, x: Array, y: Array, z: Array) -> Inside:
        """(nx, ny, nz): which points of a grid are inside a body; x, y and z ascend. Nothing is inside an open one."""
        if name in self.closed:
            return inside(self.closed[name], x, y, z)
        for number, item in self.scene.rounds:
            if self.scene.names[number] == name:
                dx, dy = np.meshgrid(x, y, indexing="ij")
                if isinstance(item, Sphere):
                    flat = (dx - item.center_m[0]) ** 2 + (dy - item.center_m[1]) ** 2
                    return np.asarray(flat[..., None] + (z - item.center_m[2]) ** 2 < item.radius_m**2)
                flat = (dx - item.base_m[0]) ** 2 + (dy - item.base_m[1]) ** 2
                upright = (z > item.base_m[2]) & (z < item.base_m[2] + item.height_m)
                return np.asarray((flat < item.radius_m**2)[..., None] & upright)
        return np.zeros((len(x), len(y), len(z)), np.bool_)

    def around(self, point_m: Array) -> str | None:
        """The name of a body that a point (3,) is inside of, if any."""
        x, y, z = (np.array([value], np.float64) for value in point_m)
        return next((name for name in self.scene.names if self.inside(name, x, y, z).any()), None)


def vehicle(file: VehicleFile, path: Path, at: Key = ("vehicle",)) -> Vehicle:
    """The vehicle that stands in a file under a key. Raises ConfigError for a bad mesh, and to exclude an open one."""
    began = time.perf_counter()
    scene = built(SceneFile(name="vehicle", **{kind: getattr(file, kind) for kind in KINDS}), path, at)
    closed, warnings = {}, []
    for kind in ("boxes", "planes", "meshes"):
        for i, item in enumerate(getattr(file, kind)):
            mesh = mesh_of(scene, scene.names.index(item.name))
            edges = open_edges(mesh)
            if len(edges) == 0:
                closed[item.name] = mesh
            elif item.exclude:
                raise error_at(
                    path, (*at, kind, i, "exclude"), f"{_open(item, edges)}; close the mesh, or leave exclude out"
                )
            elif kind == "meshes":
                solid = sum(not len(open_edges(part)) for part in parts(mesh))
                warnings.append(f"{_open(item, edges)}; {solid} closed parts; beams are blocked all the same")
            if kind == "meshes":
                warnings += _oddities(item, mesh)
    if len(scene.triangles) > MANY:
        seconds = time.perf_counter() - began
        warnings.append(
            f"{path}: the vehicle has {len(scene.triangles):,} triangles; reading them took {seconds:.1f} s"
        )
    excluded = tuple(item.name for kind in KINDS for item in getattr(file, kind) if item.exclude)
    meshes = (mesh.model_copy(update={"file": str((path.parent / mesh.file).resolve())}) for mesh in file.meshes)
    whole = file.model_copy(update={"meshes": tuple(meshes)})
    return Vehicle(scene, excluded, file.allow_inside, whole, closed, tuple(warnings))


def load_vehicle(path: str | Path) -> Vehicle:
    """The vehicle in a YAML file of its keys, or the body in a mesh file. Raises ConfigError."""
    path = example(path)
    if path.suffix in (".yaml", ".yml"):
        return vehicle(load(path, VehicleFile), path, ())
    return vehicle(VehicleFile(meshes=(BodyMesh(name="body", file=path.name),)), path)


def rig_vehicle(rig: Rig) -> Vehicle | None:
    """The vehicle that a rig's file names, if it names one. Raises ConfigError with file, line and key."""
    section = rig.vehicle
    return vehicle(section.checked(VehicleFile), Path(section.path), section.at) if section else None


def check_outside(bodies: Vehicle, mounts: Iterable[Mount]) -> None:
    """Raises ConfigError if a sensor is inside a closed body, unless the vehicle allows it."""
    for mount in mounts:
        body = None if bodies.allow_inside else bodies.around(np.array(mount.position_m))
        if body:
            raise ConfigError(f"{mount.name} is inside the vehicle's {body!r}; move it, or say allow_inside: true")


def mesh_of(scene: Scene, index: int) -> Mesh:
    """The triangles of one of a scene's objects, welded."""
    return welded((scene.vertices_m, scene.triangles[scene.triangle_object == index]))


def _open(item: SceneObject, edges: Array) -> str:
    """That a body is open, and where."""
    shown = " to ".join("(" + ", ".join(f"{value:.6g}" for value in corner) + ")" for corner in edges[0])
    source = f" of {item.file}" if isinstance(item, MeshFile) else ""
    return (
        f"{item.name!r}{source} is not closed, so that nothing is inside: {len(edges)} of its edges bound an odd "
        f"number of triangles, the first from {shown}"
    )


def _oddities(item: MeshFile, mesh: Mesh) -> list[str]:
    """What looks wrong with the size of a vehicle's mesh: the unit of its file may be another one."""
    size_m = np.ptp(mesh[0], axis=0)
    if LEAST_M <= size_m.max() <= MOST_M or size_m.max() == 0:
        return []
    scale = min(UNITS, key=lambda one: abs(math.log(size_m.max() / item.scale * one / TYPICAL_M)))
    if scale == item.scale:
        return []
    size = " × ".join(f"{value:.4g}" for value in size_m)
    return [f"{item.name!r} of {item.file} is {size} m large; if its unit is the {UNITS[scale]}, say scale: {scale:g}"]


def obstacles(scenes: Sequence[Scene], origin_m: Array) -> Tree:
    """The tree over the static objects of scenes, relative to a point (3,)."""
    if not scenes:
        return NO_TREE
    columns = []
    for scene in scenes:
        static = np.array([motion is None for motion in scene.motions])
        columns.append(shapes_of(scene, static, origin_m))
    return build(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))
