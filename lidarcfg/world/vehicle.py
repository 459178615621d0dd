"""A vehicle: the bodies that travel with the sensors and block their beams, in the vehicle frame."""

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
    Sphere,
    built,
    check_names,
)
from lidarcfg.world.solids import Inside, inside, open_edges, welded
from lidarcfg.world.tracer import shapes_of

EDGES_SHOWN = 3
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

    @property
    def section(self) -> Section:
        """The same as a part of a rig's file."""
        return Section(self.file.model_dump(exclude_defaults=True))

    def inside(self, name: str, x: Array, y: Array, z: Array) -> Inside:
        """(nx, ny, nz): which points of a grid are inside a body; x, y and z ascend. Nothing is inside an open one."""
        index = self.scene.names.index(name)
        for number, item in self.scene.rounds:
            if number == index:
                dx, dy = np.meshgrid(x, y, indexing="ij")
                if isinstance(item, Sphere):
                    flat = (dx - item.center_m[0]) ** 2 + (dy - item.center_m[1]) ** 2
                    return np.asarray(flat[..., None] + (z - item.center_m[2]) ** 2 < item.radius_m**2)
                flat = (dx - item.base_m[0]) ** 2 + (dy - item.base_m[1]) ** 2
                upright = (z > item.base_m[2]) & (z < item.base_m[2] + item.height_m)
                return np.asarray((flat < item.radius_m**2)[..., None] & upright)
        mesh = mesh_of(self.scene, index)
        if len(open_edges(mesh)):
            return np.zeros((len(x), len(y), len(z)), np.bool_)
        return inside(mesh, x, y, z)

    def around(self, point_m: Array) -> str | None:
        """The name of a body that a point (3,) is inside of, if any."""
        x, y, z = (np.array([value], np.float64) for value in point_m)
        return next((name for name in self.scene.names if self.inside(name, x, y, z).any()), None)


def vehicle(file: VehicleFile, path: Path, at: Key = ("vehicle",)) -> Vehicle:
    """The vehicle that stands in a file under a key. Raises ConfigError for a bad mesh, and to exclude an open one."""
    scene = built(SceneFile(name="vehicle", **{kind: getattr(file, kind) for kind in KINDS}), path, at)
    excluded = []
    for kind in KINDS:
        for i, item in enumerate(getattr(file, kind)):
            if item.exclude:
                if kind not in ("spheres", "cylinders"):
                    edges = open_edges(mesh_of(scene, scene.names.index(item.name)))
                    if len(edges):
                        raise error_at(path, (*at, kind, i, "exclude"), _open(item.name, edges))
                excluded.append(item.name)
    meshes = (mesh.model_copy(update={"file": str((path.parent / mesh.file).resolve())}) for mesh in file.meshes)
    return Vehicle(scene, tuple(excluded), file.allow_inside, file.model_copy(update={"meshes": tuple(meshes)}))


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


def _open(name: str, edges: Array) -> str:
    """That a body is open, and where."""
    shown = "; ".join(
        " to ".join("(" + ", ".join(f"{value:.6g}" for value in corner) + ")" for corner in edge)
        for edge in edges[:EDGES_SHOWN]
    )
    more = f" and {len(edges) - EDGES_SHOWN} more" if len(edges) > EDGES_SHOWN else ""
    return (
        f"{name!r} is not closed, so that nothing is inside: {len(edges)} of its edges bound an odd number of "
        f"triangles, {shown}{more}; close the mesh, or leave exclude out"
    )


def obstacles(scenes: Sequence[Scene], origin_m: Array) -> Tree:
    """The tree over the static objects of scenes, relative to a point (3,)."""
    if not scenes:
        return NO_TREE
    columns = []
    for scene in scenes:
        static = np.array([motion is None for motion in scene.motions])
        columns.append(shapes_of(scene, static, origin_m))
    return build(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))
