"""Meshes as the page's JSON holds them."""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array


def packed_mesh(vertices: Array, triangles: NDArray[np.int64]) -> dict[str, Any]:
    """Vertices (V, 3) relative to an origin of their own, so that float32 suffices anywhere."""
    origin = vertices[0]
    return {
        "origin_m": origin.tolist(),
        "vertices": base64.b64encode((vertices - origin).astype("<f4").tobytes()).decode(),
        "triangles": base64.b64encode(triangles.astype("<u4").tobytes()).decode(),
    }


def packed_quads(quads: Array) -> dict[str, Any] | None:
    """The mesh of quads (F, 4, 3), or none."""
    if not len(quads):
        return None
    first = 4 * np.arange(len(quads))[:, None, None]
    return packed_mesh(quads.reshape(-1, 3), (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3))


def packed_triangles(corners: Array) -> dict[str, Any] | None:
    """The mesh of triangles (T, 3, 3), or none."""
    return packed_mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)) if len(corners) else None
