"""A scene: the surroundings of the vehicle in the world frame, from a YAML file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.config.document import Key
from lidarcfg.config.models import Given, Model, Position, Section, errors_at, load_or_check
from lidarcfg.errors import SceneError
from lidarcfg.files import example
from lidarcfg.geometry import Array
from lidarcfg.world.gltf import buffer_files
from lidarcfg.world.gltf_models import model_objects
from lidarcfg.world.height_field import height_field_mesh
from lidarcfg.world.mesh_source import Triangles
from lidarcfg.world.meshes import (
    Mesh,
    box_mesh,
    cylinder_mesh,
    join_meshes,
    mesh_from,
    place_mesh,
    plane_mesh,
    sphere_mesh,
)
from lidarcfg.world.motion import Motion
from lidarcfg.world.robot import SUFFIXES as ROBOTS
from lidarcfg.world.robot_body import robot_body
from lidarcfg.world.scene_file import (
    FILES,
    GROUND,
    Cylinder,
    GltfModel,
    Ground,
    HeightField,
    MeshFile,
    SceneFile,
    SceneObject,
    Sphere,
    Surfels,
)
from lidarcfg.world.surfels import surfels_mesh

if TYPE_CHECKING:
    import open3d

DRAWN_M = 0.01  # tolerance of the facets that spheres and cylinders are drawn with
REFLECTIVITY = 20  # of objects that say none, in per cent
NO_MESH = np.empty((0, 3)), np.empty((0, 3), np.int64)
POSITION_KEYS = ("center_m", "base_m", "position_m")  # the key of an object's position, by kind

ObjectMesh = tuple[Ground | SceneObject, Mesh]  # an object and its triangles in the world frame


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

    def __repr__(self) -> str:
        return f"<Scene {self.file.name}: {len(self.names):,} objects, {len(self.triangles):,} triangles>"

    path: Path | None = field(default=None, compare=False)  # of the scene's file

    @classmethod
    def from_meshes(
        cls,
        meshes: "Mapping[str, open3d.t.geometry.TriangleMesh | open3d.geometry.TriangleMesh]",
        reflectivity: int | Mapping[str, int] = REFLECTIVITY,
        ground_reflectivity: int | None = None,
        name: str = "meshes",
    ) -> "Scene":
        """The scene of Open3D's meshes by their names, in metres in the world frame; a copy.

        One reflectivity for all, or those by name that differ. With `ground_reflectivity` there is a ground at z = 0.
        Raises SceneError for what is no mesh, and ConfigError.
        """
        own = reflectivity if isinstance(reflectivity, Mapping) else dict.fromkeys(meshes, reflectivity)
        if unknown := own.keys() - meshes.keys():
            raise SceneError(f"reflectivity: no mesh is called {min(unknown)!r}; allowed: {', '.join(meshes)}")
        listed = tuple(
            {
                "name": key,
                "file": Triangles.of(mesh),
                "position_m": (0.0, 0.0, 0.0),
                "reflectivity": own.get(key, REFLECTIVITY),
            }
            for key, mesh in meshes.items()
        )
        ground = {} if ground_reflectivity is None else {"ground": {"reflectivity": ground_reflectivity}}
        file = Section({"name": name, "meshes": listed, **ground}).checked(SceneFile)
        return build_scene(file, Path(name))

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
        return join_meshes(parts)


def load_scene(given: Given) -> Scene:
    """The scene in a YAML file, or of a dict with its keys.

    Raises ConfigError, also for a mesh that cannot be used, and SceneError if it is empty.
    """
    file, path = load_or_check(given, SceneFile)
    return replace(build_scene(file, path), path=None if isinstance(given, Mapping) else path)


def no_scene() -> Scene:
    """A scene in which there is nothing to hit."""
    vertices_m, triangles = NO_MESH
    return Scene(
        file=SceneFile(name="nothing"),
        names=(),
        reflectivity=np.empty(0, np.uint8),
        vertices_m=vertices_m,
        triangles=triangles,
        triangle_object=np.empty(0, np.int32),
        motions=(),
        places_m=np.empty((0, 3)),
    )


def files_of(file: Model, folder: Path) -> list[Path]:
    """The files that a scene or a vehicle in a folder names, with those that these need."""
    items = [item for kind in FILES for item in getattr(file, kind, ()) if isinstance(item.file, str)]
    paths = [(item, example(folder / item.file)) for item in items]
    return [one for item, path in paths for one in (path, *_needed(item, path))]


def _needed(item: SceneObject, path: Path) -> Sequence[Path]:
    """The files that the file of an object needs."""
    return robot_body(path, _without(item)).files if is_robot(item) else buffer_files(path)


def build_scene(file: SceneFile, path: Path, at: Key = ()) -> Scene:
    """The scene of a file's values; `path` and `at` are their file and key. Raises as load_scene does."""
    objects: list[ObjectMesh] = [(file.ground, NO_MESH)] if file.ground else []
    objects += [(box, box_mesh(box)) for box in file.boxes]
    objects += [(item, NO_MESH) for item in (*file.spheres, *file.cylinders)]
    objects += [(plane, plane_mesh(plane)) for plane in file.planes]
    taken = {getattr(item, "name", GROUND) for item, _ in objects}
    for kind in FILES:
        for i, item in enumerate(getattr(file, kind)):
            with errors_at(path, *at, kind, i, "file"):
                objects += _check_new_names(_from_file(item, path.parent), taken)
    if not objects:
        raise SceneError(f"{path}: the scene is empty; give a ground or an object")
    vertices_m, triangles = join_meshes([mesh for _, mesh in objects])
    return Scene(
        file=file,
        names=tuple(getattr(item, "name", GROUND) for item, _ in objects),
        reflectivity=np.array([item.reflectivity for item, _ in objects], np.uint8),
        vertices_m=vertices_m,
        triangles=triangles,
        triangle_object=np.repeat(np.arange(len(objects), dtype=np.int32), [len(mesh[1]) for _, mesh in objects]),
        motions=tuple(getattr(item, "motion", None) for item, _ in objects),
        places_m=np.array([_position_m(item) for item, _ in objects]),
        items=tuple(item for item, _ in objects),
    )


def _check_new_names(made: list[ObjectMesh], taken: set[str]) -> list[ObjectMesh]:
    """The objects made from a file; adds their names to `taken`. Raises SceneError if one is taken already."""
    for item, _ in made:
        name = getattr(item, "name", GROUND)
        if name in taken:
            raise SceneError(f"{name!r} would be two objects; each name may be given once")
        taken.add(name)
    return made


def _from_file(item: SceneObject, folder: Path) -> list[ObjectMesh]:
    """The objects that are made from a file, with their triangles. Raises SceneError."""
    if isinstance(item, HeightField):
        return [(item, height_field_mesh(item, folder))]
    if isinstance(item, Surfels):
        return [(item, surfels_mesh(item, folder))]
    if isinstance(item, GltfModel):
        return list(model_objects(item, folder))
    assert isinstance(item, MeshFile)
    return [(item, place_mesh(_mesh_of(item, folder), item))]


def is_robot(item: SceneObject) -> bool:
    """Whether an object is a robot in a URDF."""
    return Path(str(getattr(item, "file", ""))).suffix.lower() in ROBOTS


def _mesh_of(item: MeshFile, folder: Path) -> Mesh:
    """The triangles of a mesh, or the body of a robot, in its own frame. Raises SceneError."""
    if is_robot(item):
        return robot_body(folder / str(item.file), _without(item)).mesh
    return mesh_from(item.file, folder)


def _without(item: SceneObject) -> tuple[str, ...] | None:
    """The links that are no part of a robot's body, where a vehicle says so."""
    return getattr(item, "without", None)


def _position_m(item: Ground | SceneObject) -> Position:
    """The position of an object in its file; the ground has none."""
    return next((getattr(item, key) for key in POSITION_KEYS if hasattr(item, key)), (0.0, 0.0, 0.0))
