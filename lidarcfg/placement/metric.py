"""How large a subspace is: the paper's volume-to-surface ratio, and the largest sphere inside."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lidarcfg.geometry import Array
from lidarcfg.placement.subspace import Subspaces

Counts = NDArray[np.int64]


def volume_m3(subspaces: Subspaces) -> Array:
    """(n,) the cuboids' volume (paper, eq. 8)."""
    return _volume(subspaces.cuboids, subspaces.region.cuboid_m)


def surface_m2(subspaces: Subspaces) -> Array:
    """(n,) the cuboids' outer faces: S = 2 Σ_axis (n − internal faces) · face area (paper, algorithm 1).

    Faces against another subspace, an excluded cuboid or the region's wall all count. (The printed algorithm
    skips the last cuboid and counts along one axis; this is what it intends.)
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
    inside = (low == high) & (low >= 0)  # a node of no face
    distance = ndimage.distance_transform_edt(inside, sampling=subspaces.region.cuboid_m / 2)
    radius = np.zeros(len(subspaces))
    np.maximum.at(radius, low[inside], distance[inside])
    return radius


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
