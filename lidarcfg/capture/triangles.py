"""Triangles to cast rays at. Open3D says in float32 which one a ray meets.

In float32 neighbours leave cracks, and of rays aimed at their very edges some pass through. So Open3D is given
triangles that are larger by a hair on every side. A ray that meets such a rim, and in float64 not the triangle itself,
is cast once more, moved past the edge: there it meets the neighbour, or whatever is behind.
"""

# mypy: disallow-untyped-decorators=False
import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lidarcfg.capture.ray_kernels import narrowed
from lidarcfg.geometry import Array

HAIR_M = 2e-4  # beyond what float32 is off by within a sensor's range
SHARE = 0.02  # of a small triangle's longest edge, which is less than HAIR_M
RIM = 1.5  # hairs: what is met nearer to an edge is looked at
PAST = 2.0  # hairs beyond an edge, for a second look
MOVES_MAX = 4  # past the rims of so many triangles, as where some meet in a corner
SHARP = 0.1  # the sine of a corner's angle; one that is sharper is not moved out further
FLAT = 1e-12  # of its longest edge: a triangle of less height has no area, and nothing meets it
GRAZING_M = 0.01  # a plane's range further than this from float32's is rounding's
BESIDE = 1e-9  # of a triangle: by so much a ray may pass beside it, lest it slip through in float64

Index = NDArray[np.int64]


class Triangles:
    """Triangles in a frame whose origin is near; from either side alike."""

    def __init__(self, vertices_m: Array, triangles: Index) -> None:
        """`triangles` (T, 3) are indices of vertices (V, 3)."""
        import open3d as o3d

        self._vertices_m, self._triangles = vertices_m, triangles
        self.planes, self._hair_m, self._rim, corners = measured(vertices_m, triangles)
        self._scene = o3d.t.geometry.RaycastingScene()
        if len(triangles):
            tensor = o3d.core.Tensor.from_numpy
            index = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(tensor(corners), tensor(index))

    def cast(
        self, origins_m: Array, directions: Array, pick: Index, place_m: Array
    ) -> tuple[Array, NDArray[np.uint32]]:
        """How far the rays `pick` (M,) of (N, 3) get, inf for nothing, and the triangles (M,) that they meet.

        Directions are unit vectors; origins are in a frame in which that of the triangles stands at place_m (3,).
        """
        range_m, triangle, rows, moved_m = self._look(origins_m, origins_m, directions, pick, place_m)
        for _ in range(MOVES_MAX):
            if not len(rows):
                break
            rays = moved_m, origins_m[pick[rows]] - place_m, directions[pick[rows]]
            range_m[rows], triangle[rows], again, moved_m = self._look(*rays, np.arange(len(rows)), np.zeros(3))
            rows = rows[again]
        return range_m, triangle

    def _look(
        self, start_m: Array, origins_m: Array, directions: Array, pick: Index, place_m: Array
    ) -> tuple[Array, NDArray[np.uint32], Index, Array]:
        """The same of rays that are cast from `start_m` (N, 3), beside their origins, and what `met` says of them."""
        import open3d as o3d

        narrow = narrowed(start_m, directions, pick, place_m)
        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(narrow))
        hit_m, triangle, uv = (found[key].numpy() for key in ("t_hit", "primitive_ids", "primitive_uvs"))
        rays = start_m, origins_m, directions, pick, place_m
        range_m, again, moved_m = met(
            *rays, hit_m, triangle, uv, self.planes, self._rim, self._hair_m, self._vertices_m, self._triangles
        )
        return range_m, triangle, again, moved_m


@njit(cache=True, nogil=True, error_model="numpy")
def measured(vertices_m: Array, triangles: Index) -> tuple[Array, Array, NDArray[np.float32], NDArray[np.float32]]:
    """Of triangles (T, 3): planes (T, 4), n·p = d; hairs (T,); rims (T,) in barycentric coordinates; larger corners.

    The corners (3 T, 3) are of triangles with every edge moved out by a hair, by less towards a sharp corner. A
    triangle without area becomes a point there.
    """
    count = len(triangles)
    planes, hair_m, rim = np.empty((count, 4)), np.empty(count), np.empty(count, np.float32)
    larger = np.empty((3 * count, 3), np.float32)
    corners, edges, units = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    normal, across = np.empty(3), np.empty(3)
    for t in range(count):
        longest = 0.0
        for c in range(3):
            for k in range(3):
                corners[c, k] = vertices_m[triangles[t, c], k]
        for c in range(3):  # from each corner to the next
            for k in range(3):
                edges[c, k] = corners[(c + 1) % 3, k] - corners[c, k]
            length = _length(edges[c])
            for k in range(3):
                units[c, k] = edges[c, k] / length if length > 0 else 0.0
            longest = max(longest, length)
        _cross(edges[2], edges[0], normal)
        doubled = _length(normal)
        flat = doubled <= FLAT * longest**2
        if flat:
            doubled = 1.0
        for k in range(3):
            planes[t, k] = normal[k] / doubled
        planes[t, 3] = planes[t, 0] * corners[0, 0] + planes[t, 1] * corners[0, 1] + planes[t, 2] * corners[0, 2]
        hair_m[t] = min(SHARE * longest, HAIR_M)
        rim[t] = RIM * hair_m[t] * longest / doubled
        for c in range(3):
            behind = (c + 2) % 3
            _cross(units[behind], units[c], across)
            by_m = 0.0 if flat else hair_m[t] / max(_length(across), SHARP)
            for k in range(3):
                larger[3 * t + c, k] = corners[0 if flat else c, k] + (units[behind, k] - units[c, k]) * by_m
    return planes, hair_m, rim, larger


@njit(cache=True, nogil=True)
def _length(vector: Array) -> float:
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))


@njit(cache=True, nogil=True, error_model="numpy")
def met(
    start_m: Array,
    origins_m: Array,
    directions: Array,
    pick: Index,
    place_m: Array,
    hit_m: NDArray[np.float32],
    triangle: NDArray[np.uint32],
    uv: NDArray[np.float32],
    planes: Array,
    rim: NDArray[np.float32],
    hair_m: Array,
    vertices_m: Array,
    triangles: Index,
) -> tuple[Array, Index, Array]:
    """How far (M,) the rays `pick` (M,) get that were cast from `start_m` (N, 3) and hit triangles (M,) at hit_m (M,).

    That is for the triangle's plane (n·p = d) to say, unless it is further than GRAZING_M from the hit, as where it is
    seen edge on. And which of the rays hit the rim of their triangle, but in float64 pass beside it, and where to
    start them anew, past its edge: in the triangles' frame, which stands at place_m (3,). uv (M, 2) says where they
    hit, rim (T,) how near to an edge that must be to be looked at; hair_m is (T,).
    """
    range_m, rows, moved_m, count = np.empty(len(pick)), np.empty(len(pick), np.int64), np.empty((len(pick), 3)), 0
    corners, normal, out = np.empty((3, 3)), np.empty(3), np.empty(3)
    place_x, place_y, place_z = place_m
    for i in range(len(pick)):
        range_m[i] = hit_m[i]
        if not hit_m[i] < np.inf:
            continue
        n, t = pick[i], triangle[i]
        x, y, z = origins_m[n, 0] - place_x, origins_m[n, 1] - place_y, origins_m[n, 2] - place_z
        u, v, w = directions[n, 0], directions[n, 1], directions[n, 2]
        away_m = planes[t, 3] - (planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z)
        exact_m = away_m / (planes[t, 0] * u + planes[t, 1] * v + planes[t, 2] * w)
        if abs(exact_m - hit_m[i]) < GRAZING_M:
            range_m[i] = max(exact_m, 0.0)  # a ray that starts on the plane, by float32
        if min(uv[i, 0], uv[i, 1], 1 - uv[i, 0] - uv[i, 1]) >= rim[t]:
            continue
        for k in range(3):  # relative to the ray's start
            corners[k] = vertices_m[triangles[t, k]] - (start_m[n] - place_m)
        _cross(corners[1] - corners[0], corners[2] - corners[0], normal)
        rise = normal[0] * u + normal[1] * v + normal[2] * w
        least, edge = -BESIDE, -1  # the share of the corner across an edge is negative beyond it
        for k in range(3):
            _cross(corners[(k + 1) % 3], corners[(k + 2) % 3], out)
            share = (out[0] * u + out[1] * v + out[2] * w) / rise
            if share < least:
                least, edge = share, k
        if edge < 0:
            continue
        _cross(corners[(edge + 2) % 3] - corners[(edge + 1) % 3], normal, out)
        step = PAST * hair_m[t] / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
        for k in range(3):
            moved_m[count, k] = start_m[n, k] - place_m[k] + out[k] * step
        rows[count] = i
        count += 1
    return range_m, rows[:count], moved_m[:count]


@njit(cache=True, nogil=True)
def _cross(a: Array, b: Array, out: Array) -> None:
    """Write a × b to out (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
