"""glTF files: each node becomes an object; read by trimesh."""

import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from difflib import get_close_matches
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lidarcfg.errors import SceneError
from lidarcfg.geometry import product, transform
from lidarcfg.world.gltf import SUFFIXES, check_nodes
from lidarcfg.world.meshes import FILE_MAX, Mesh, check_mesh, check_readable, join_meshes, place_mesh
from lidarcfg.world.scene_file import GltfModel

if TYPE_CHECKING:
    import trimesh


Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # of y up: -z becomes y
SHOWN = 8  # names in a message
SEVERAL = "from_gltf_primitive"  # trimesh's mark of a mesh that is one of a node's several
# What trimesh raises for damaged files: of JSON and numpy, of keys, indices and names that are not there, its asserts.
ERRORS = (
    *(ValueError, LookupError, NameError, TypeError, AttributeError, struct.error),
    *(AssertionError, RecursionError, MemoryError, OverflowError, NotImplementedError, OSError),
)


class NodeMesh(NamedTuple):
    """The triangles of one material of a node."""

    node: str
    material: str  # empty where the file names none
    mesh: Mesh  # in the file's units, z up


def model_objects(item: GltfModel, folder: Path) -> list[tuple[GltfModel, Mesh]]:
    """The nodes of a model as objects in the world frame, in the order of their names.

    A node of several materials is several objects, NODE/MATERIAL. Raises SceneError.
    """
    path = folder / item.file
    parts = read_nodes(path, item.nodes)
    shown = sorted({part.node for part in parts})
    for name in sorted(set(item.nodes or ()) & (check_nodes(path, ()) - set(shown))):
        raise SceneError(f"{path}: node {name!r} has no triangles; it has {_listed(shown)}")
    _check_known(path, "node", item.nodes or (), shown)
    _check_known(path, "material", item.materials, sorted({part.material for part in parts} - {""}))
    wanted = None if item.nodes is None else set(item.nodes)
    materials = Counter(part.node for part in parts)
    out: list[tuple[GltfModel, Mesh]] = []
    for part in parts:
        if wanted is None or part.node in wanted:
            values = {
                "name": f"{item.name}/{part.node}" + f"/{part.material}" * (materials[part.node] > 1),
                "reflectivity": item.materials.get(part.material, item.reflectivity),
            }
            out.append((item.model_copy(update=values), place_mesh(part.mesh, item)))
    return out


def read_nodes(path: Path, wanted: Collection[str] | None = None) -> list[NodeMesh]:
    """The triangles of a glTF file by node and material, transformed by its nodes. Raises SceneError.

    Nodes that are not wanted are not checked, and may be wrong.
    """
    import trimesh

    check_readable(path, FILE_MAX)
    if path.suffix.lower() not in SUFFIXES:
        raise SceneError(f"{path}: is no glTF file; allowed: {', '.join(SUFFIXES)}")
    check_nodes(path, wanted)
    try:
        found = sorted(_geometries(path, trimesh.load_scene(path, process=False)), key=itemgetter(0, 1, 2))
    except ERRORS as error:
        raise SceneError.damaged(path, error, "glTF") from None
    if not found:
        raise SceneError(f"{path}: no triangles in any of its nodes")
    groups = groupby(found, itemgetter(0, 1))
    return [NodeMesh(node, material, join_meshes([one[-1] for one in own])) for (node, material), own in groups]


def _geometries(path: Path, scene: "trimesh.Scene") -> Iterator[tuple[str, str, str, Mesh]]:
    """Node, material, trimesh's name and triangles of every geometry."""
    for name in scene.graph.nodes_geometry:
        T_scene_node, geometry = scene.graph[name]
        shape = scene.geometry[str(geometry)]
        if not len(getattr(shape, "faces", ())):  # lines or points
            continue
        node = scene.graph.transforms.parents[name] if shape.metadata.get(SEVERAL) else name
        material = getattr(getattr(shape.visual, "material", None), "name", None) or ""
        vertices = transform(product(Z_UP, T_scene_node), np.array(shape.vertices, np.float64))
        mesh = vertices, np.array(shape.faces, np.int64)
        check_mesh(f"{path}: node {node!r}", mesh)
        if not np.ptp(mesh[0], axis=0).any():
            raise SceneError(f"{path}: node {node!r} is a single point; if the file is compressed, export it without")
        yield str(node), material, str(geometry), mesh


def _check_known(path: Path, what: str, given: Iterable[str], known: Sequence[str]) -> None:
    """Raises SceneError for a name that the file does not have."""
    if unknown := [name for name in given if name not in known]:
        close = get_close_matches(unknown[0], known, 1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise SceneError(f"{path}: has no {what} {unknown[0]!r}; {hint}it has {_listed(known)}")


def _listed(names: Sequence[str]) -> str:
    """The first names, quoted, for a message."""
    return ", ".join(map(repr, names[:SHOWN])) + " …" * (len(names) > SHOWN) or "none"
