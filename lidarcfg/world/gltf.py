"""Checks of the nodes in a glTF file (version 2.0): those that readers would show wrongly are refused by name."""

import json
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from lidarcfg.errors import SceneError

SUFFIXES = ".gltf", ".glb"
MAGIC = b"glTF"  # the first bytes of a .glb
HEAD = 20  # bytes of a .glb before its JSON
INSTANCES = "EXT_mesh_gpu_instancing"
SHAPES = "apply them, so that the mesh has the shape that is meant, and export it again"


def read_json(path: Path) -> dict[str, Any]:
    """The JSON of a glTF file. Raises SceneError if there is none, OSError."""
    with path.open("rb") as file:
        head = file.read(HEAD)
        if head.startswith(MAGIC) and len(head) == HEAD:
            text = file.read(struct.unpack("<I", head[12:16])[0])
        else:
            text = head + file.read()
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SceneError.damaged(path, error, "glTF") from None
    if not isinstance(found, dict):
        raise SceneError.damaged(path, "its JSON is no object", "glTF")
    return found


def buffer_files(path: Path) -> list[Path]:
    """The files beside a glTF file that hold its numbers; none for other files."""
    if path.suffix.lower() not in SUFFIXES:
        return []
    uris = [buffer.get("uri", "data:") for buffer in read_json(path).get("buffers", ())]
    return [path.parent / unquote(uri) for uri in uris if not uri.startswith("data:")]


def check_nodes(path: Path, wanted: Collection[str] | None = None) -> frozenset[str]:
    """The names of a glTF file's nodes. Raises SceneError for a wanted node that readers would show wrongly."""
    gltf = read_json(path)
    try:
        nodes = gltf.get("nodes", [])
        names = [str(node.get("name", i)) for i, node in enumerate(nodes)]
        parents = Counter(child for node in nodes for child in node.get("children", ()))
        for i, (name, node) in enumerate(zip(names, nodes, strict=True)):
            if wanted is None or name in wanted:
                for wrong in _mistakes(gltf, node, parents[i]):
                    raise SceneError(f"{path}: node {name!r} {wrong}")
    except (AttributeError, TypeError, ValueError, LookupError) as error:
        raise SceneError.damaged(path, error, "glTF") from None
    return frozenset(names)


def _mistakes(gltf: dict[str, Any], node: dict[str, Any], parents: int) -> Iterator[str]:
    """What is wrong with a node, and what to do."""
    if parents > 1:
        yield f"has {parents} parents; allowed is one: export it again, with a copy under each"
    if "mesh" not in node:
        return
    meshes = gltf.get("meshes", [])
    if not 0 <= node["mesh"] < len(meshes):
        yield f"names mesh {node['mesh']}, of {len(meshes)}; export it again, with its mesh, or without the node"
    if "skin" in node:
        yield f"has a skin, whose bones bend its mesh (in Blender, an Armature modifier); {SHAPES} without skins"
    if any(node.get("weights", meshes[node["mesh"]].get("weights", ()))):
        yield f"has morph targets in use (in Blender, shape keys); {SHAPES}"
    if INSTANCES in node.get("extensions", ()):
        yield f"stands for several by {INSTANCES}; export it again without instancing"
