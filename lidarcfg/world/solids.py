"""Closed bodies: which points are inside, and which edges are open where a mesh is not closed.

Vertices are one where they are equal to the last bit, and parts may touch along edges: trimesh would also merge what is
only near, split parts at edges of four triangles, and call a mesh with such edges open.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import world
from lidarcfg.geometry import Array, Flags
from lidarcfg.world.meshes import Mesh

Index = NDArray[np.int64]
PLACE = np.dtype((np.void, 24))  # the bits of three float64


def merge_vertices(mesh: Mesh) -> Mesh:
    """The mesh with vertices at the same place made one, without triangles of fewer than three places, or again."""
    vertices, triangles = mesh
    corners_at, number = unique_vertices(vertices)
    corners = number[triangles]
    a, b, c = corners.T
    return corners_at, _once(corners[(a != b) & (b != c) & (c != a)], len(corners_at))


def _once(triangles: Index, count: int) -> Index:
    """The triangles without those that are there already, with the same side out, of so many vertices.

    Where two bodies touch, a triangle is there with either side out.
    """
    least = triangles.argmin(axis=1)
    a, b, c = (np.take_along_axis(triangles, (least[:, None] + k) % 3, axis=1)[:, 0] for k in range(3))
    edge = a * count + b
    order = np.lexsort((c, edge))  # stable: the first of equal ones comes first
    again = order[1:][(np.diff(edge[order]) == 0) & (np.diff(c[order]) == 0)]
    return np.delete(triangles, again, axis=0) if len(again) else triangles


def unique_vertices(vertices: Array) -> tuple[Array, Index]:
    """The distinct vertices among (V, 3), and the number of each vertex among them: equal to the last bit."""
    places = np.ascontiguousarray(vertices + 0.0).view(PLACE)[:, 0]  # -0 is 0
    _, first, number = np.unique(places, return_index=True, return_inverse=True)
    return vertices[first], number


def open_edges(mesh: Mesh) -> Array:
    """(E, 2, 3) the edges that bound an odd number of triangles of a mesh, vertices merged; none if closed."""
    vertices, triangles = mesh
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, counts = np.unique(edges[:, 0] * len(vertices) + edges[:, 1], return_counts=True)
    odd = unique[counts % 2 == 1]
    found: Array = vertices[np.stack(np.divmod(odd, len(vertices)), axis=1)] if len(odd) else np.empty((0, 2, 3))
    return found


def connected_components(mesh: Mesh) -> list[Mesh]:
    """The components of a mesh, its vertices merged: they share no vertex."""
    from scipy.sparse import coo_array, csgraph

    vertices, triangles = mesh
    ends = triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = coo_array((np.ones(ends.shape[1], np.bool_), tuple(ends)), shape=(len(vertices), len(vertices)))
    _, component = csgraph.connected_components(graph, directed=False)
    component = component[triangles[:, 0]]
    return [(vertices, triangles[component == label]) for label in np.unique(component)]


def inside_grid(closed: Sequence[Mesh], x: Array, y: Array, z: Array) -> Flags:
    """(nx, ny, nz): which points of a grid are inside any component of a closed mesh; x, y and z ascend.

    A line along x enters and leaves a closed part an even number of times: whether it passes through a triangle is
    told edge by edge, by the same numbers for both neighbours, so that it cannot pass between them.
    """
    found = np.zeros((len(x), len(y), len(z)), np.bool_)
    odd = np.empty((len(y), len(z), len(x) + 1), np.bool_)
    for vertices, triangles in closed:
        odd[:] = False
        world.toggle_lines(vertices, triangles, _lines(vertices[triangles], y, z), x, y, z, odd)
        found |= np.logical_xor.accumulate(odd[..., :-1], axis=2).transpose(2, 0, 1)
    return found


def _lines(corners: Array, y: Array, z: Array) -> Index:
    """(T, 4): which lines along x may cross triangles (T, 3, 3): from and to an index of y, and of z."""
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    ends = [(np.searchsorted(at, low[:, n]), np.searchsorted(at, high[:, n], "right")) for n, at in ((1, y), (2, z))]
    return np.stack([*ends[0], *ends[1]], axis=1)


def inside_points(closed: Sequence[Mesh], points: Array) -> Flags:
    """(N,): which points (N, 3) are inside any component of a closed mesh, as `inside_grid` has it."""
    found = np.zeros(len(points), np.bool_)
    for vertices, triangles in closed:
        odd = np.zeros(len(points), np.bool_)
        world.toggle_points(vertices, triangles, points, odd)
        found |= odd
    return found


def contains_box(closed: Sequence[Mesh], low: Array, high: Array) -> bool:
    """Whether the box from low (3,) to high (3,) is certainly inside the components of a closed mesh.

    One corner is, and no triangle's bounds touch it.
    """
    for vertices, triangles in closed:
        corners = vertices[triangles]
        away = (corners.min(axis=1) > high) | (corners.max(axis=1) < low)
        if not away.any(axis=1).all():
            return False
    return bool(inside_points(closed, np.array([low]))[0])
