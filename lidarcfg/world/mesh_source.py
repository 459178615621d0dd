"""A mesh as one of our files gives it: the name of a mesh file, or the triangles themselves."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PlainSerializer, PlainValidator, SerializationInfo, WithJsonSchema

from lidarcfg.config.models import path_from, shown, validation_error
from lidarcfg.errors import SceneError, a_thing
from lidarcfg.geometry import Array

KEYS = ("vertices_m", "triangles")
Mesh = tuple[Array, NDArray[np.int64]]  # vertices (V, 3) in metres, triangles (T, 3)


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles that are in no file."""

    vertices_m: Array  # (V, 3)
    triangles: NDArray[np.int64]  # (T, 3) indices of vertices

    @classmethod
    def of(cls, mesh: Any) -> "Triangles":
        """Those of Open3D's `TriangleMesh`, tensor or legacy, or of vertices and triangles. Raises SceneError."""
        if isinstance(mesh, cls):
            return mesh
        if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):  # open3d.t.geometry.TriangleMesh
            corners, faces = (
                getattr(mesh, part)[key].cpu().numpy() if key in getattr(mesh, part) else np.empty((0, 3))
                for part, key in (("vertex", "positions"), ("triangle", "indices"))
            )
            return cls._checked(corners, faces)
        if hasattr(mesh, "vertices") and hasattr(mesh, "triangles"):
            return cls._checked(np.asarray(mesh.vertices), np.asarray(mesh.triangles))
        if isinstance(mesh, tuple) and len(mesh) == 2:
            return cls._checked(*mesh)
        allowed = "Open3D's TriangleMesh, or vertices (V, 3) and triangles (T, 3)"
        raise SceneError(f"{a_thing(mesh)} is no mesh; allowed: {allowed}")

    @classmethod
    def _checked(cls, vertices_m: ArrayLike, triangles: ArrayLike) -> "Triangles":
        try:
            corners = np.array(vertices_m, np.float64)
            faces = np.array(triangles)
        except (ValueError, TypeError):
            raise SceneError("the mesh has vertices or triangles that are not all of three numbers") from None
        if not faces.size:
            raise SceneError("the mesh has no triangles")
        if corners.ndim != 2 or corners.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            shapes = f"{corners.shape} and {faces.shape}"
            raise SceneError(f"vertices and triangles have shapes {shapes}; allowed: (V, 3) and (T, 3)")
        if faces.dtype.kind not in "iu":
            raise SceneError("triangles are not whole numbers; allowed: indices of vertices")
        check_mesh("the mesh", (corners, faces.astype(np.int64)))
        return cls(corners, faces.astype(np.int64))

    @property
    def _bytes(self) -> tuple[bytes, bytes]:
        return self.vertices_m.tobytes(), self.triangles.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Triangles) and self._bytes == other._bytes

    def __hash__(self) -> int:
        return hash(self._bytes)

    def __str__(self) -> str:
        return f"a mesh of {len(self.triangles):,} triangles"


def _from(value: Any) -> str | Triangles:
    """The validator: a name, or triangles as files or Python give them."""
    if isinstance(value, str):
        if not value:
            raise validation_error("'' is too short; allowed: at least 1 character")
        return value
    if value is None or isinstance(value, int | float):
        raise validation_error(f"{shown(value)} is no mesh; allowed: the name of a file, or {' and '.join(KEYS)}")
    try:
        if isinstance(value, Mapping):
            if value.keys() != set(KEYS):
                raise SceneError(f"has the keys {', '.join(map(str, value))}; allowed: {' and '.join(KEYS)}")
            return Triangles.of(tuple(value[key] for key in KEYS))
        return Triangles.of(value)
    except SceneError as error:
        raise validation_error(str(error)) from None


def _plain(value: str | Triangles, info: SerializationInfo) -> Any:
    """The serializer: what a file has."""
    if isinstance(value, str):
        return path_from(value, info)
    return {key: tuple(map(tuple, getattr(value, key).tolist())) for key in KEYS}  # as files are read


_ROWS = {"type": "array", "minItems": 1, "items": {"type": "array", "minItems": 3, "maxItems": 3}}
_NAME = {"type": "string", "minLength": 1}
_INLINE = {
    "type": "object",
    "properties": {
        "vertices_m": {**_ROWS, "items": {**_ROWS["items"], "items": {"type": "number"}}},  # type: ignore[dict-item]
        "triangles": {**_ROWS, "items": {**_ROWS["items"], "items": {"type": "integer", "minimum": 0}}},  # type: ignore[dict-item]
    },
    "required": list(KEYS),
    "additionalProperties": False,
}
MeshSource = Annotated[
    str | Triangles,
    PlainValidator(_from),
    PlainSerializer(_plain),
    WithJsonSchema({"anyOf": [_NAME, _INLINE]}),
]


def check_mesh(what: str, mesh: Mesh) -> None:
    """Raises SceneError for vertices that are not finite, and for triangles with missing vertices."""
    vertices, triangles = mesh
    if not np.isfinite(vertices).all():
        raise SceneError(f"{what}: vertex {np.argwhere(~np.isfinite(vertices))[0][0]} is not finite")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        bad = triangles[(triangles < 0) | (triangles >= len(vertices))][0]
        raise SceneError(f"{what}: a triangle names vertex {bad}; there are {len(vertices)}")
