"""A scene: the surroundings of the vehicle in the world frame, from a YAML file."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config.document import Key
from lidarcfg.config.models import (
    COORDINATE_MAX_M,
    FileName,
    Metres,
    Model,
    Name,
    Position,
    Positive,
    Vec3,
    errors_at,
    load,
    validation_error,
)
from lidarcfg.errors import SceneError
from lidarcfg.files import example
from lidarcfg.geometry import Array
from lidarcfg.sensors.sensor import Byte
from lidarcfg.world.categories import Category
from lidarcfg.world.gltf import buffers
from lidarcfg.world.height_field import height_field_mesh
from lidarcfg.world.meshes import Mesh, box_mesh, cylinder_mesh, joined, placed, plane_mesh, read_mesh, sphere_mesh
from lidarcfg.world.models import model_objects
from lidarcfg.world.motion import Motion
from lidarcfg.world.surfels import surfels_mesh

DRAWN_M = 0.01  # tolerance of the facets that spheres and cylinders are drawn with
GROUND = "ground"
KINDS = ("boxes", "spheres", "cylinders", "planes", "meshes")  # of objects, of a scene and of a vehicle
FILES = ("meshes", "height_fields", "models", "surfels")  # of a scene, whose triangles are made from files
NO_MESH = np.empty((0, 3)), np.empty((0, 3), np.int64)
PLACES = ("center_m", "base_m", "position_m")  # the key of an object's position, by kind

Size = Annotated[float, Field(gt=0, le=COORDINATE_MAX_M)]


class Ground(Model):
    """An infinite horizontal plane."""

    z_m: Metres = 0.0
    category: Category = "ground"  # what data sets call it: world/categories.py
    reflectivity: Byte  # as the sensor is calibrated: 0-100 diffuse in per cent, 101-255 retro-reflectors


class SceneObject(Model):
    """An object of any kind."""

    name: Name
    reflectivity: Byte
    category: Category | None = None
    motion: Motion | None = None  # from its place at time 0, in the world's axes; it rotates about its place


class Box(SceneObject):
    """A box, rotated about the vertical."""

    center_m: Position
    size_m: tuple[Size, Size, Size]  # along its own x, y, z
    yaw_deg: float = 0.0


class Sphere(SceneObject):
    """A sphere."""

    center_m: Position
    radius_m: Size


class Cylinder(SceneObject):
    """A vertical, closed cylinder."""

    base_m: Position  # centre of the lower end
    radius_m: Size
    height_m: Size


class Plane(SceneObject):
    """A rectangle in its own xy plane, seen from both sides."""

    center_m: Position
    size_m: tuple[Size, Size]
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)


class MeshFile(SceneObject):
    """A triangle mesh in a file that Open3D reads."""

    file: FileName  # relative to the scene's file
    position_m: Position
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)
    scale: Positive = 1.0


class HeightField(SceneObject):
    """Ground of a grid of heights: columns run along x, rows against y, as a map whose top is y."""

    file: FileName | None = None  # .png in grey or .npy, relative to the scene's file
    heights_m: Annotated[tuple[tuple[Metres, ...], ...], Field(min_length=2)] | None = None  # rows, in place of a file
    cell_m: Size
    position_m: Position  # of the last row's first height, at a height of 0
    scale: Positive = 1.0  # metres per unit of the file

    @model_validator(mode="after")
    def _check(self) -> "HeightField":
        if (self.file is None) == (self.heights_m is None):
            raise validation_error(
                "conflicts with file; give only one of them" if self.file else "missing; or give a file", "heights_m"
            )
        if self.heights_m and self.scale != 1.0:
            raise validation_error("belongs to a file; heights_m are metres", "scale")
        rows = self.heights_m or ()
        for i, row in enumerate(rows):
            if len(row) != max(len(rows[0]), 2):
                allowed = f"{len(rows[0])}, as in the first row" if i else "at least 2"
                raise validation_error(f"has {len(row)} heights; allowed: {allowed}", "heights_m", i)
        return self


class GltfModel(MeshFile):
    """A glTF file each of whose nodes becomes an object NAME/NODE; its y up becomes z up."""

    nodes: tuple[str, ...] | None = None  # only these
    materials: dict[str, Byte] = Field(default_factory=dict)  # by name; all others have the model's reflectivity


class Surfels(MeshFile):
    """A disc at each point of a file, across its normal, which is in the file or estimated from neighbours."""

    radius_m: Size


class Weather(Model):
    """Uniform fog and rain; simulate/echoes.py models their effect on a beam."""

    fog_visibility_m: Annotated[float, Field(ge=1)] | None = None  # meteorological
    rain_mm_h: Positive | None = None


class GeoOrigin(Model):
    """The place of the world's origin on Earth; x points east and y north."""

    latitude_deg: Annotated[float, Field(ge=-89, le=89)] = 0.0
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0


class SceneFile(Model):
    """A scene file."""

    kind: ClassVar[str] = "scene"
    name: Name
    ground: Ground | None = None
    boxes: tuple[Box, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    planes: tuple[Plane, ...] = ()
    meshes: tuple[MeshFile, ...] = ()
    height_fields: tuple[HeightField, ...] = ()
    models: tuple[GltfModel, ...] = ()
    surfels: tuple[Surfels, ...] = ()
    geo_origin: GeoOrigin = GeoOrigin()
    weather: Weather = Weather()

    @model_validator(mode="after")
    def _check(self) -> "SceneFile":
        check_names(self)
        return self


def check_names(file: Model) -> None:
    """A model's validator: objects of all kinds have different names, and none has the ground's."""
    names = {GROUND}
    for kind in dict.fromkeys((*KINDS, *FILES)):
        for i, item in enumerate(getattr(file, kind, ())):
            if item.name in names:
                raise validation_error(
                    f"{item.name!r} is an object already; each name may be given once", kind, i, "name"
                )
            names.add(item.name)


Placed = tuple[Ground | SceneObject, Mesh]  # an object and its triangles in the world frame


@dataclass(frozen=True)
class Scene:
    """Everything that a ray can hit. Object 0 is the ground, if there is one.

    Boxes, planes and meshes are triangles; ground, spheres and cylinders are not.
    """

    file: SceneFile  # what it was built from
    names: tuple[str, ...]  # (objects,)
    reflectivity: NDArray[np.uint8]  # (objects,)
    vertices_m: Array  # (V, 3) in the world frame
    triangles: NDArray[np.int64]  # (T, 3) indices of vertices
    triangle_object: NDArray[np.int32]  # (T,) index of the object, ascending
    motions: tuple[Motion | None, ...]  # (objects,) None: static
    places_m: Array  # (objects, 3) the origin of each object's own frame at time 0, about which it rotates
    items: tuple[Ground | SceneObject, ...] = ()  # (objects,) what each was made from
    path: Path | None = field(default=None, compare=False)  # of the scene's file

    @property
    def rounds(self) -> list[tuple[int, Sphere | Cylinder]]:
        """The spheres and cylinders, with the index of each object."""
        first = int(self.file.ground is not None) + len(self.file.boxes)
        return list(enumerate((*self.file.spheres, *self.file.cylinders), first))

    def mesh(self, tolerance_m: float = DRAWN_M) -> Mesh:
        """All objects but the ground as vertices (V, 3) and triangles (T, 3), for drawing.

        Facets are within the tolerance of spheres and cylinders, up to radii of some 26,000 times the tolerance.
        """
        parts = [(self.vertices_m, self.triangles)]
        parts += [sphere_mesh(sphere, tolerance_m) for sphere in self.file.spheres]
        parts += [cylinder_mesh(cylinder, tolerance_m) for cylinder in self.file.cylinders]
        return joined(parts)


def load_scene(path: str | Path) -> Scene:
    """The scene in a YAML file. Raises ConfigError, also for a mesh that cannot be used, and SceneError if empty."""
    path = example(path)
    file = load(path, SceneFile)
    return replace(built(file, path), path=path)


def files_of(file: Model, folder: Path) -> list[Path]:
    """The files that a scene or a vehicle in a folder names, with those that these need."""
    paths = [folder / item.file for kind in FILES for item in getattr(file, kind, ()) if item.file]
    return [one for path in paths for one in (path, *buffers(path))]


def built(file: SceneFile, path: Path, at: Key = ()) -> Scene:
    """The scene of a file's values; `path` and `at` are their file and key. Raises as load_scene does."""
    objects: list[Placed] = [(file.ground, NO_MESH)] if file.ground else []
    objects += [(box, box_mesh(box)) for box in file.boxes]
    objects += [(item, NO_MESH) for item in (*file.spheres, *file.cylinders)]
    objects += [(plane, plane_mesh(plane)) for plane in file.planes]
    taken = {getattr(item, "name", GROUND) for item, _ in objects}
    for kind in FILES:
        for i, item in enumerate(getattr(file, kind)):
            with errors_at(path, *at, kind, i, "file"):
                objects += _unlike(_from_file(item, path.parent), taken)
    if not objects:
        raise SceneError(f"{path}: the scene is empty; give a ground or an object")
    vertices_m, triangles = joined([mesh for _, mesh in objects])
    return Scene(
        file=file,
        names=tuple(getattr(item, "name", GROUND) for item, _ in objects),
        reflectivity=np.array([item.reflectivity for item, _ in objects], np.uint8),
        vertices_m=vertices_m,
        triangles=triangles,
        triangle_object=np.repeat(np.arange(len(objects), dtype=np.int32), [len(mesh[1]) for _, mesh in objects]),
        motions=tuple(getattr(item, "motion", None) for item, _ in objects),
        places_m=np.array([_place_m(item) for item, _ in objects]),
        items=tuple(item for item, _ in objects),
    )


def _unlike(made: list[Placed], taken: set[str]) -> list[Placed]:
    """The objects made from a file; adds their names to `taken`. Raises SceneError if one is taken already."""
    for item, _ in made:
        name = getattr(item, "name", GROUND)
        if name in taken:
            raise SceneError(f"{name!r} would be two objects; each name may be given once")
        taken.add(name)
    return made


def _from_file(item: SceneObject, folder: Path) -> list[Placed]:
    """The objects that are made from a file, with their triangles. Raises SceneError."""
    if isinstance(item, HeightField):
        return [(item, height_field_mesh(item, folder))]
    if isinstance(item, Surfels):
        return [(item, surfels_mesh(item, folder))]
    if isinstance(item, GltfModel):
        return list(model_objects(item, folder))
    assert isinstance(item, MeshFile)
    return [(item, placed(read_mesh(folder / item.file), item))]


def _place_m(item: Ground | SceneObject) -> Position:
    """The position of an object in its file; the ground has none."""
    return next((getattr(item, key) for key in PLACES if hasattr(item, key)), (0.0, 0.0, 0.0))
