"""Objects that must be seen: boxes, meshes, and those that come with the package."""

from pathlib import Path

from lidarcfg.config.models import Vec3
from lidarcfg.errors import ConfigError
from lidarcfg.files import shipped
from lidarcfg.requirements.file import ObjectFile
from lidarcfg.simulate.returns import Target
from lidarcfg.world.mesh_source import Triangles
from lidarcfg.world.meshes import box_mesh, mesh_from
from lidarcfg.world.scene_file import Box
from lidarcfg.world.solids import merge_vertices, open_edges


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
    """The closed mesh in a file. Raises SceneError if it cannot be read, and ConfigError if it is open."""
    found = Target(merge_vertices(mesh_from(name, folder)))
    if len(edges := open_edges(found.mesh)):
        corners = " to ".join("(" + ", ".join(f"{value:.6g}" for value in corner) + ")" for corner in edges[0])
        what = f"is not closed: {len(edges)} of its edges bound an odd number of triangles, one of them {corners}"
        raise ConfigError(f"{name}: {what}")
    return found
