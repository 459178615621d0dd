"""Objects that should be seen: boxes, meshes, and those that come with the package."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from lidarcfg import core
from lidarcfg.config.models import Model, Name, Vec3
from lidarcfg.errors import ConfigError
from lidarcfg.files import shipped
from lidarcfg.geometry import Array
from lidarcfg.sensors.rig import one_of
from lidarcfg.world.mesh_source import MeshSource, Triangles
from lidarcfg.world.meshes import Mesh, box_mesh, mesh_from
from lidarcfg.world.scene_file import Box
from lidarcfg.world.solids import merge_vertices, open_edges
from lidarcfg.world.tracer import TRIANGLE

SIZE_MAX_M = 100.0  # of an object

Size = Annotated[float, Field(gt=0, le=SIZE_MAX_M)]


class ObjectFile(Model):
    """An object that must be seen: one of data/objects by its name, a box, or a mesh."""

    name: Name | None = None
    size_m: tuple[Size, Size, Size] | None = None
    mesh: MeshSource | None = None  # a name is relative to the file

    @model_validator(mode="after")
    def _check(self) -> "ObjectFile":
        one_of(self, "name", "size_m", "mesh")
        return self


def _of_name(value: Any) -> Any:
    return {"name": value} if isinstance(value, str) else value


ObjectOrName = Annotated[ObjectFile, BeforeValidator(_of_name, json_schema_input_type=ObjectFile | str)]


@dataclass(frozen=True)
class Target:
    """An object to be detected: centred over its place, with its lowest point on the ground."""

    mesh: Mesh

    @cached_property
    def shape(self) -> core.returns.TargetShape:
        """The object as the core takes it."""
        return core.returns.TargetShape(self.bvh, *self.box_m)

    @cached_property
    def bvh(self) -> core.world.Bvh:
        """The hierarchy over its triangles, relative to its place."""
        corners = self.mesh[0][self.mesh[1]] - self.origin_m
        number = np.arange(len(corners), dtype=np.int32)
        kind = np.full(len(corners), TRIANGLE, np.uint8)
        return core.world.Bvh(corners.reshape(-1, 9), kind, number, np.zeros_like(number))

    @property
    def box_m(self) -> tuple[Array, Array]:
        """(3,) each: the lower and the upper corner of its bounding box, relative to its place."""
        vertices = self.mesh[0]
        return vertices.min(axis=0) - self.origin_m, vertices.max(axis=0) - self.origin_m

    @property
    def size_m(self) -> Array:
        """(3,) of its bounding box."""
        low, high = self.box_m
        return np.asarray(high - low)

    @property
    def origin_m(self) -> Array:
        """(3,) the middle of its lowest points' plane."""
        low = self.mesh[0].min(axis=0)
        high = self.mesh[0].max(axis=0)
        return np.array([*(low + high)[:2] / 2, low[2]])

    def __getstate__(self) -> dict[str, Mesh]:
        return {"mesh": self.mesh}  # the core's objects are made anew


def shipped_objects() -> dict[str, Path]:
    """The objects that come with the package, by name."""
    return {path.stem: path for path in sorted(shipped("data").glob("objects/*.ply"))}


def target_of(item: ObjectFile, folder: Path) -> Target:
    """The object that a file in a folder describes. Raises ConfigError and SceneError."""
    if item.size_m is not None:
        return box_target(item.size_m)
    if item.mesh is not None:
        return mesh_target(folder, item.mesh)
    known = shipped_objects()
    if item.name not in known:
        allowed = ", ".join(known)
        raise ConfigError(f"no object is called {item.name!r}; allowed: {allowed}, a size_m, or a mesh")
    return mesh_target(known[item.name].parent, known[item.name].name)


def box_target(size_m: Vec3) -> Target:
    """The target of a box."""
    return Target(box_mesh(Box(name="box", reflectivity=0, center_m=(0.0, 0.0, 0.0), size_m=size_m)))


def mesh_target(folder: Path, name: str | Triangles) -> Target:
    """The closed mesh in a file. Raises SceneError if it cannot be read, and ConfigError if it is open or too large."""
    found = Target(merge_vertices(mesh_from(name, folder)))
    if (size_m := found.size_m.max()) > SIZE_MAX_M:
        raise ConfigError(f"{name}: is {size_m:g} m large; allowed: up to {SIZE_MAX_M:g} m, as a mesh is in metres")
    if len(edges := open_edges(found.mesh)):
        corners = " to ".join("(" + ", ".join(f"{value:.6g}" for value in corner) + ")" for corner in edges[0])
        what = f"is not closed: {len(edges)} of its edges bound an odd number of triangles, one of them {corners}"
        raise ConfigError(f"{name}: {what}")
    return found
