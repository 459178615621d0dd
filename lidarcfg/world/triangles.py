"""Triangles to cast rays at. Open3D says in float32 which one a ray meets.

In float32 neighbours leave cracks, and of rays aimed at their very edges some pass through. So Open3D is given
triangles that are larger by a hair on every side. A ray that meets such a rim, and in float64 not the triangle itself,
is cast once more, moved past the edge: there it meets the neighbour, or whatever is behind.
"""

# mypy: disallow-untyped-decorators=False
import math

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.world.kernels import Nearest, Rays, narrowed, turned_by
from lidarcfg.world.turns import Turns

HAIR_M = 2e-4  # beyond what float32 is off by within a sensor's range
SHARE = 0.02  # of a small triangle's longest edge, which is less than HAIR_M
RIM = 1.5  # hairs: what is met nearer to an edge is looked at
PAST = 2.0  # hairs beyond an edge, for a second look
MOVES_MAX = 4  # past the rims of so many triangles, as where some meet in a corner
SHARP = 0.1  # the sine of a corner's angle; one that is sharper is not moved out further
FLAT = 1e-12  # of its longest edge: a triangle of less height has no area, and nothing meets it
GRAZING_M = 0.01  # a plane's range further than this from float32's is rounding's
FEW = 2048  # rays, which Open3D casts on one core
HAIR, EDGE, OBJECT = 4, 5, 6  # columns of a facet
BESIDE = 1e-9  # of a triangle: by so much a ray may pass beside it, lest it slip through in float64

Index = NDArray[np.int64]


class Triangles:
    """Triangles in a frame whose origin is near; from either side alike."""

    def __init__(self, vertices_m: Array, triangles: Index, objects: NDArray[np.int32], turns: Turns) -> None:
        """`triangles` (T, 3) are indices of vertices (V, 3); objects (T,) say what they are of."""
        import open3d as o3d

        self._vertices_m, self._triangles, self._turns = vertices_m, triangles, turns
        self.facets, corners = measured(vertices_m, triangles, objects)
        self._scene = o3d.t.geometry.RaycastingScene()
        if len(triangles):
            tensor = o3d.core.Tensor.from_numpy
            index = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(tensor(corners), tensor(index))

    def cast(self, rays: Rays, pick: Index, place_m: Array, R: Array, nearest: Nearest) -> None:
        """Keep what the rays `pick` (M,) meet, if it is nearer than what is known.

        The triangles' frame stands at place_m (3,) of the rays'; that is turned by R (M or 1, 3, 3) in the one in
        which normals are asked for.
        """
        start_m = rays.origins_m
        for left in range(MOVES_MAX, -1, -1):
            again, moved_m = self._look(start_m, rays, pick, place_m, R, nearest, left == 0)
            if not len(again):
                break
            which, R = pick[again], R if len(R) == 1 else R[again]
            rays = Rays(rays.origins_m[which] - place_m, rays.directions[which], rays.at[which])
            start_m, pick, place_m = moved_m, np.arange(len(which)), np.zeros(3)

    def _look(
        self, start_m: Array, rays: Rays, pick: Index, place_m: Array, R: Array, nearest: Nearest, last: bool
    ) -> tuple[Index, Array]:
        """The same of rays that are cast from `start_m` (N, 3), beside their origins; what `met` says of the others."""
        hits = self._hits(narrowed(start_m, rays.directions, pick, place_m))
        mesh = self.facets, self._vertices_m, self._triangles
        again, moved_m = met(start_m, rays, pick, place_m, R, *hits, *mesh, last, nearest)
        return again, moved_m

    def _hits(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]:
        """How far (M,) rays (M, 6) get, the triangles (M,) that they hit, and where on these (M, 2), by Open3D."""
        import open3d as o3d

        tensor = o3d.core.Tensor.from_numpy(rays)
        if len(rays) <= FEW:
            found = self._scene.cast_rays(tensor, nthreads=1)
        else:
            with self._turns.alone():
                found = self._scene.cast_rays(tensor)
        return found["t_hit"].numpy(), found["primitive_ids"].numpy(), found["primitive_uvs"].numpy()


@njit(cache=True, nogil=True, error_model="numpy")
def measured(vertices_m: Array, triangles: Index, objects: NDArray[np.int32]) -> tuple[Array, NDArray[np.float32]]:
    """Facets (T, 8) of triangles (T, 3), and the corners of larger ones.

    A facet is all that is asked for together: the plane, n·p = d; the hair; the rim in barycentric coordinates; the
    object; and nothing. The corners (3 T, 3) are of triangles with every edge moved out by a hair, by less towards a
    sharp corner. A triangle without area becomes a point there.
    """
    count = len(triangles)
    facets, larger = np.zeros((count, 8)), np.empty((3 * count, 3), np.float32)
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
            facets[t, k] = normal[k] / doubled
            facets[t, 3] += facets[t, k] * corners[0, k]
        hair_m = min(SHARE * longest, HAIR_M)
        facets[t, HAIR], facets[t, EDGE], facets[t, OBJECT] = hair_m, RIM * hair_m * longest / doubled, objects[t]
        for c in range(3):
            behind = (c + 2) % 3
            _cross(units[behind], units[c], across)
            by_m = 0.0 if flat else hair_m / max(_length(across), SHARP)
            for k in range(3):
                larger[3 * t + c, k] = corners[0 if flat else c, k] + (units[behind, k] - units[c, k]) * by_m
    return facets, larger


@njit(cache=True, nogil=True)
def _length(vector: Array) -> float:
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))


@njit(cache=True, nogil=True, error_model="numpy")
def met(
    start_m: Array,
    rays: Rays,
    pick: Index,
    place_m: Array,
    R: Array,
    hit_m: NDArray[np.float32],
    triangle: NDArray[np.uint32],
    uv: NDArray[np.float32],
    facets: Array,
    vertices_m: Array,
    triangles: Index,
    last: bool,
    nearest: Nearest,
) -> tuple[Index, Array]:
    """Keep what the rays `pick` (M,) met that were cast from `start_m` (N, 3) and hit triangles (M,) at hit_m (M,).

    How far that is, is for the triangle's plane to say, unless it is further than GRAZING_M from the hit, as where it
    is seen edge on. But rays that hit the rim of their triangle, where uv (M, 2) says, and in float64 pass beside it,
    are not kept unless this look is the last: which these are, and where to start them anew, past the edge, in the
    triangles' frame.
    """
    rows, moved_m, count = np.empty(len(pick), np.int64), np.empty((len(pick), 3)), 0
    corners, normal, out = np.empty((3, 3)), np.empty(3), np.empty(3)
    place_x, place_y, place_z = place_m
    for i in range(len(pick)):
        if not hit_m[i] < np.inf:
            continue
        n, t = pick[i], triangle[i]
        u, v, w = rays.directions[n, 0], rays.directions[n, 1], rays.directions[n, 2]
        if min(uv[i, 0], uv[i, 1], 1 - uv[i, 0] - uv[i, 1]) < facets[t, EDGE] and not last:
            for k in range(3):  # relative to the ray's start
                corners[k] = vertices_m[triangles[t, k]] - (start_m[n] - place_m)
            if _beside(corners, (u, v, w), normal, out):
                step = PAST * facets[t, HAIR] / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
                for k in range(3):
                    moved_m[count, k] = start_m[n, k] - place_m[k] + out[k] * step
                rows[count] = i
                count += 1
                continue
        x, y, z = rays.origins_m[n, 0] - place_x, rays.origins_m[n, 1] - place_y, rays.origins_m[n, 2] - place_z
        exact_m, far_m = plane_m(facets, t, x, y, z, u, v, w), float(hit_m[i])
        if abs(exact_m - far_m) < GRAZING_M:
            far_m = max(exact_m, 0.0)  # a ray that starts on the plane, by float32
        keep(nearest, rays.at[n], far_m, facets, t, R, i)
    return rows[:count], moved_m[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def plane_m(facets: Array, t: int, x: float, y: float, z: float, u: float, v: float, w: float) -> float:
    """How far the plane of triangle t is from a point along a unit vector."""
    a, b, c = facets[t, 0], facets[t, 1], facets[t, 2]
    return float((facets[t, 3] - (a * x + b * y + c * z)) / (a * u + b * v + c * w))


@njit(cache=True, nogil=True)
def keep(nearest: Nearest, at: int, far_m: float, facets: Array, t: int, R: Array, i: int) -> None:
    """Keep triangle t, so far away, if it is nearer than what is known; matrix i of R turns its normal."""
    if far_m < nearest.range_m[at]:
        nearest.range_m[at], nearest.object[at] = far_m, facets[t, OBJECT]
        if len(nearest.normal):
            normal = turned_by(R, i, facets[t, 0], facets[t, 1], facets[t, 2])
            nearest.normal[at, 0], nearest.normal[at, 1], nearest.normal[at, 2] = normal


@njit(cache=True, nogil=True, error_model="numpy")
def _beside(corners: Array, way: tuple[float, float, float], normal: Array, out: Array) -> bool:
    """Whether a ray from the origin passes beside a triangle (3, 3); if so, which way (3,) leads out past its edge."""
    _cross(corners[1] - corners[0], corners[2] - corners[0], normal)
    rise = normal[0] * way[0] + normal[1] * way[1] + normal[2] * way[2]
    least, edge = -BESIDE, -1  # the share of the corner across an edge is negative beyond it
    for k in range(3):
        _cross(corners[(k + 1) % 3], corners[(k + 2) % 3], out)
        share = (out[0] * way[0] + out[1] * way[1] + out[2] * way[2]) / rise
        if share < least:
            least, edge = share, k
    _cross(corners[(edge + 2) % 3] - corners[(edge + 1) % 3], normal, out)
    return edge >= 0


@njit(cache=True, nogil=True)
def _cross(a: Array, b: Array, out: Array) -> None:
    """Write a × b to out (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
