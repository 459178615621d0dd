"""Triangles to cast rays at. Open3D says in float32 which one a ray meets.

In float32 neighbours leave cracks, and of rays aimed at their very edges some pass through. So Open3D is given
triangles that are larger by a hair on every side. A ray that meets such a rim, and in float64 not the triangle itself,
is cast once more, moved past the edge: there it meets the neighbour, or whatever is behind.
"""

# mypy: disallow-untyped-decorators=False
import numpy as np
from numba import njit
from numpy.typing import NDArray

from lidarcfg.geometry import Array

HAIR_M = 2e-4  # beyond what float32 is off by within a sensor's range
SHARE = 0.02  # of a small triangle's longest edge, which is less than HAIR_M
RIM = 1.5  # hairs: what is met nearer to an edge is looked at
PAST = 2.0  # hairs beyond an edge, for a second look
MOVES_MAX = 4  # past the rims of so many triangles, as where some meet in a corner
SHARP = 0.1  # the sine of a corner's angle; one that is sharper is not moved out further
FLAT = 1e-12  # of its longest edge: a triangle of less height has no area, and nothing meets it
BESIDE = 1e-9  # of a triangle: by so much a ray may pass beside it, lest it slip through in float64

Index = NDArray[np.int64]


class Triangles:
    """Triangles in a frame whose origin is near; from either side alike."""

    def __init__(self, vertices_m: Array, triangles: Index) -> None:
        """`triangles` (T, 3) are indices of vertices (V, 3)."""
        import open3d as o3d

        self._vertices_m, self._triangles = vertices_m, triangles
        corners = vertices_m[triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        doubled = np.linalg.norm(normal, axis=1)
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        flat = doubled <= FLAT * longest**2
        doubled[flat] = 1.0
        normal /= doubled[:, None]
        self.planes = np.column_stack([normal, np.einsum("ij,ij->i", normal, corners[:, 0])])  # (T, 4) n·p = d
        self._hair_m = np.minimum(SHARE * longest, HAIR_M)
        self._rim = (RIM * self._hair_m * longest / doubled).astype(np.float32)  # (T,) in barycentric coordinates
        corners = enlarged(corners, self._hair_m)
        corners[flat] = corners[flat, :1]
        self._scene = o3d.t.geometry.RaycastingScene()
        if len(triangles):
            tensor = o3d.core.Tensor.from_numpy
            index = np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(tensor(corners.reshape(-1, 3).astype(np.float32)), tensor(index))

    def cast(self, rays: Array, narrow: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """How far (N,) rays (N, 6) along unit vectors get, inf for nothing, and the triangles (N,) that they meet."""
        hit_m, triangle, uv = self._cast(narrow)
        hit, met, rows = hit_m, triangle, np.arange(len(rays))
        for _ in range(MOVES_MAX):
            which, rays = beside(rays, hit, met, uv, self._rim, self._hair_m, self._vertices_m, self._triangles)
            if not len(which):
                break
            rows = rows[which]
            hit, met, uv = self._cast(rays.astype(np.float32))
            hit_m[rows], triangle[rows] = hit, met
        return hit_m, triangle

    def _cast(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]:
        import open3d as o3d

        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        return found["t_hit"].numpy(), found["primitive_ids"].numpy(), found["primitive_uvs"].numpy()


def enlarged(corners: Array, by_m: Array) -> Array:
    """Triangles (T, 3, 3) with every edge moved out by_m (T,) in its plane; by less towards a sharp corner."""
    ahead, behind = (_unit(corners - np.roll(corners, step, axis=1)) for step in (-1, 1))
    sine = np.linalg.norm(np.cross(ahead, behind), axis=2, keepdims=True)
    moved: Array = corners + (ahead + behind) * (by_m[:, None, None] / np.maximum(sine, SHARP))
    return moved


def _unit(vectors: Array) -> Array:
    """The same of unit length; what has none stays."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = vectors / np.where(length > 0, length, 1.0)
    return unit


@njit(cache=True, nogil=True, error_model="numpy")
def beside(
    rays: Array,
    hit_m: NDArray[np.float32],
    triangle: NDArray[np.uint32],
    uv: NDArray[np.float32],
    rim: NDArray[np.float32],
    hair_m: Array,
    vertices_m: Array,
    triangles: Index,
) -> tuple[Index, Array]:
    """Which rays (N, 6) hit the rim of their triangle and pass beside it in float64, and the same moved past its edge.

    uv (N, 2) says where they hit, rim (T,) how near to an edge that must be to be looked at; hair_m is (T,).
    """
    rows, moved, count = np.empty(len(rays), np.int64), np.empty_like(rays), 0
    corners, normal, out = np.empty((3, 3)), np.empty(3), np.empty(3)
    for i in range(len(rays)):
        if not hit_m[i] < np.inf or min(uv[i, 0], uv[i, 1], 1 - uv[i, 0] - uv[i, 1]) >= rim[triangle[i]]:
            continue
        ray = rays[i]
        for c in range(3):  # relative to the ray's origin
            corners[c] = vertices_m[triangles[triangle[i], c]] - ray[:3]
        _cross(corners[1] - corners[0], corners[2] - corners[0], normal)
        rise = normal[0] * ray[3] + normal[1] * ray[4] + normal[2] * ray[5]
        least, edge = -BESIDE, -1  # the share of the corner across an edge is negative beyond it
        for c in range(3):
            _cross(corners[(c + 1) % 3], corners[(c + 2) % 3], out)
            share = (out[0] * ray[3] + out[1] * ray[4] + out[2] * ray[5]) / rise
            if share < least:
                least, edge = share, c
        if edge < 0:
            continue
        _cross(corners[(edge + 2) % 3] - corners[(edge + 1) % 3], normal, out)
        rows[count], moved[count] = i, ray
        moved[count, :3] += out * (PAST * hair_m[triangle[i]] / np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2))
        count += 1
    return rows[:count], moved[:count]


@njit(cache=True, nogil=True)
def _cross(a: Array, b: Array, out: Array) -> None:
    """Write a × b to out (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
