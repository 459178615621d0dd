"""How large a subspace is: the paper's volume-to-surface ratio, and the largest sphere inside."""

# mypy: disallow-untyped-decorators=False
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.flood import Labels
from lidarcfg.placement.subspace import Subspaces

Counts = NDArray[np.int64]
Node = tuple[int, int, int]  # a point of the lattice of half cuboids, whose origin is the region's lower corner


def volume_m3(subspaces: Subspaces) -> Array:
    """(n,) the cuboids' volume (paper, eq. 8)."""
    return _volume(subspaces.cuboids, subspaces.region.cuboid_m)


def surface_m2(subspaces: Subspaces) -> Array:
    """(n,) the cuboids' outer faces: S = 2 Σ_axis (n − internal faces) · face area (paper, algorithm 1).

    Faces against another subspace, an excluded cuboid or the region's wall all count. (The printed algorithm
    skips the last cuboid and counts along one axis; this is its intent.)
    """
    return _surface(subspaces.cuboids, subspaces.internal, subspaces.region.cuboid_m)


def vsr_m(subspaces: Subspaces) -> Array:
    """(n,) volume-to-surface ratio, a length (paper, eq. 7)."""
    return vsr_of_counts(subspaces.cuboids, subspaces.internal, subspaces.region.cuboid_m)


def vsr_of_counts(cuboids: Counts, internal: Counts, cuboid_m: Array) -> Array:
    """(n,) the same from cuboids (n,), the faces inside (n, 3) and a cuboid's edges (3,)."""
    return _volume(cuboids, cuboid_m) / _surface(cuboids, internal, cuboid_m)


def _volume(cuboids: Counts, cuboid_m: Array) -> Array:
    ex, ey, ez = cuboid_m
    volume: Array = cuboids * (ex * ey * ez)
    return volume


def _surface(cuboids: Counts, internal: Counts, cuboid_m: Array) -> Array:
    ex, ey, ez = cuboid_m
    outer = cuboids[:, None] - internal
    surface: Array = 2.0 * (outer[:, 0] * (ey * ez) + outer[:, 1] * (ex * ez) + outer[:, 2] * (ex * ey))
    return surface


def inscribed_radii_m(subspaces: Subspaces) -> Array:
    """(n,) the radius of the largest sphere inside each subspace's cuboids.

    Exact among all centres on the lattice of half cuboids: from such a point the nearest point of a face lies on
    that lattice too, so one distance transform over the lattice's nodes finds all.
    """
    owner, distance = _distances(subspaces)
    radius = np.zeros(len(subspaces))
    np.maximum.at(radius, owner[owner >= 0], distance[owner >= 0])
    return radius


def largest_sphere(subspaces: Subspaces) -> tuple[float, Node]:
    """The radius in metres and the centre of the largest sphere inside any subspace's cuboids."""
    _, distance = _distances(subspaces)
    i, j, k = np.unravel_index(int(distance.argmax()), distance.shape)
    return float(distance[i, j, k]), (int(i), int(j), int(k))


def _distances(subspaces: Subspaces) -> tuple[Labels, Array]:
    """By node: the subspace that it is inside of, −1 on a face or outside; and how far it is from such a node."""
    label = np.pad(subspaces.label, 1, constant_values=-1)
    low = np.full([2 * n + 1 for n in subspaces.label.shape], np.iinfo(np.int32).max)
    high = np.full_like(low, -1)  # the least and the greatest label of the up to eight cuboids around a node
    for corner in np.ndindex(2, 2, 2):
        around = label
        for axis, side in enumerate(corner):
            index = (np.arange(low.shape[axis]) + 1 + side) // 2
            around = np.take(around, index, axis=axis)
        np.minimum(low, around, out=low)
        np.maximum(high, around, out=high)
    owner: Labels = np.where(low == high, low, -1).astype(np.int32)
    distance: Array = ndimage.distance_transform_edt(owner >= 0, sampling=subspaces.region.cuboid_m / 2)
    return owner, distance


def clearance_m(subspaces: Subspaces, centre: Node) -> float:
    """The radius of the largest sphere around a node of the half cuboids' lattice that no face cuts; 0 on a face."""
    return float(_clearance(subspaces.label, centre, subspaces.region.cuboid_m / 2))


@njit(cache=True, nogil=True)
def _on_face(label: Labels, a: int, b: int, c: int) -> bool:
    """Whether the up to eight cuboids around a node are not all of one subspace."""
    nx, ny, nz = label.shape
    if min(a, b, c) <= 0 or a >= 2 * nx or b >= 2 * ny or c >= 2 * nz:
        return True
    one = label[a // 2, b // 2, c // 2]
    on = one < 0
    for i in range((a - 1) // 2, a // 2 + 1):
        for j in range((b - 1) // 2, b // 2 + 1):
            for k in range((c - 1) // 2, c // 2 + 1):
                on = on or label[i, j, k] != one
    return bool(on)


@njit(cache=True, nogil=True)
def _clearance(label: Labels, centre: Node, half: Array) -> float:
    """The distance of a node from the nearest one on a face, summed up as SciPy's transform does."""
    nx, ny, nz = label.shape
    nearest = np.inf
    for i in range(2 * nx + 1):
        along_x = (i * half[0]) * (i * half[0])
        if along_x >= nearest:
            break
        for j in range(2 * ny + 1):
            across = along_x + (j * half[1]) * (j * half[1])
            if across >= nearest:
                break
            for k in range(2 * nz + 1):
                square = across + (k * half[2]) * (k * half[2])
                if square >= nearest:
                    break
                for a in (centre[0] - i, centre[0] + i):
                    for b in (centre[1] - j, centre[1] + j):
                        for c in (centre[2] - k, centre[2] + k):
                            if _on_face(label, a, b, c):
                                nearest = min(nearest, square)
    return float(np.sqrt(nearest))


def centroid_m(subspaces: Subspaces, number: int) -> Array:
    """(3,) the mean of a subspace's cuboids' centres."""
    index = np.argwhere(subspaces.label == number).mean(axis=0)
    centre: Array = subspaces.region.min_m + (index + 0.5) * subspaces.region.cuboid_m
    return centre


def bounds_m(subspaces: Subspaces, number: int) -> tuple[Array, Array]:
    """The box around a subspace: its lower and upper corner, (3,) each."""
    index = np.argwhere(subspaces.label == number)
    low, edge = subspaces.region.min_m, subspaces.region.cuboid_m
    return low + index.min(axis=0) * edge, low + (index.max(axis=0) + 1) * edge
