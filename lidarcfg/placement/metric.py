"""How large a subspace is: the paper's volume-to-surface ratio, and the largest sphere inside."""

# mypy: disallow-untyped-decorators=False
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.jit import inner, njit
from lidarcfg.placement.flood import Labels
from lidarcfg.placement.subspace import Subspaces

PIECE = 4_000_000  # cuboids whose spheres are found at a time, where the region's shape allows
CUBOID_BYTES = 8 * (3 * 4 + 4 + 1)  # of memory: eight nodes, each with its nearest face, its subspace and a flag
ADVICE = "use larger cuboids"
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
    that lattice too, so a distance transform over the lattice's nodes finds all. Raises LidarcfgError where memory
    does not hold it.
    """
    return _spheres(subspaces)[0]


def largest_sphere(subspaces: Subspaces) -> tuple[float, Node]:
    """The radius in metres and the centre of the largest sphere inside any subspace's cuboids."""
    radius, node = _spheres(subspaces)
    largest = np.flatnonzero(radius == radius.max())
    i, j, k = min(map(tuple, node[largest].tolist()))  # of equal ones the first in the lattice
    return float(radius.max()), (i, j, k)


def _spheres(subspaces: Subspaces) -> tuple[Array, Counts]:
    """The largest sphere inside each subspace: radius (n,) and centre (n, 3)."""
    label, cuboid_m = subspaces.label, subspaces.region.cuboid_m
    square, node = np.full(len(subspaces), -1.0), np.zeros((len(subspaces), 3), np.int64)
    for piece, core, first in _pieces(label.shape, cuboid_m):
        check_memory("the largest spheres of so many cuboids", CUBOID_BYTES * float(label[piece].size), ADVICE)
        owner = _owners(label, np.array([one.start for one in piece]), np.array([one.stop for one in piece]))
        nearest = ndimage.distance_transform_edt(
            owner >= 0, sampling=cuboid_m / 2, return_distances=False, return_indices=True
        )
        _largest(owner, nearest, cuboid_m / 2, core, first, square, node)
    return np.sqrt(square), node


def _pieces(shape: tuple[int, ...], cuboid_m: Array) -> Iterator[tuple[tuple[slice, slice, slice], Counts, Counts]]:
    """Parts of a region whose spheres are found one after another: cuboids, and of their nodes those to find from.

    No sphere is larger than half the region's shortest side, so a part as much longer than its nodes' on either side
    has all faces that can be nearest. The nodes are (2, 3): from, to; behind them the part's own first node (3,).
    """
    size_m: Array = np.array(shape) * cuboid_m
    axis = int(np.argmax(size_m))
    beyond = math.ceil(size_m.min() / 2 / cuboid_m[axis]) + 1
    layers = PIECE * shape[axis] // math.prod(shape) - 2 * beyond
    step = min(max(layers, beyond), shape[axis])
    for start in range(0, shape[axis], step):
        stop = min(start + step, shape[axis])
        whole = [slice(0, n) for n in shape]
        whole[axis] = slice(max(start - beyond, 0), min(stop + beyond, shape[axis]))
        core = np.array([np.zeros(3), 2 * np.array(shape) + 1], np.int64)
        core[:, axis] = 2 * start, 2 * stop + 1
        yield (whole[0], whole[1], whole[2]), core, 2 * np.array([one.start for one in whole])


@njit(cache=True, nogil=True)
def _owners(label: Labels, low: Counts, high: Counts) -> Labels:
    """By node of the cuboids from low to high: the subspace that it is inside of, −1 on a face."""
    a, b, c = 2 * (high - low) + 1
    owner = np.full((a, b, c), -1, np.int32)
    for i in range(a):
        for j in range(b):
            for k in range(c):
                x, y, z = i + 2 * low[0], j + 2 * low[1], k + 2 * low[2]
                if not _on_face(label, x, y, z):
                    owner[i, j, k] = label[x // 2, y // 2, z // 2]
    return owner


@njit(cache=True, nogil=True)
def _largest(
    owner: Labels, nearest: Labels, half: Array, core: Counts, first: Counts, square: Array, node: Counts
) -> None:
    """Write the largest squared distance from a face, and from where, by subspace; summed up as SciPy does."""
    for i in range(core[0, 0] - first[0], core[1, 0] - first[0]):
        for j in range(core[0, 1] - first[1], core[1, 1] - first[1]):
            for k in range(core[0, 2] - first[2], core[1, 2] - first[2]):
                one = owner[i, j, k]
                if one >= 0:
                    x = (nearest[0, i, j, k] - i) * half[0]
                    y = (nearest[1, i, j, k] - j) * half[1]
                    z = (nearest[2, i, j, k] - k) * half[2]
                    distance = x * x + y * y + z * z
                    if distance > square[one]:
                        square[one] = distance
                        node[one, 0], node[one, 1], node[one, 2] = i + first[0], j + first[1], k + first[2]


def clearance_m(subspaces: Subspaces, centre: Node) -> float:
    """The radius of the largest sphere around a node of the half cuboids' lattice that no face cuts; 0 on a face."""
    return float(_clearance(subspaces.label, centre, subspaces.region.cuboid_m / 2))


@inner(makes_arrays=True)
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
    counts = _profiles(subspaces, number)
    index = np.array([count @ np.arange(len(count)) / count.sum() for count in counts])
    centre: Array = subspaces.region.min_m + (index + 0.5) * subspaces.region.cuboid_m
    return centre


def bounds_m(subspaces: Subspaces, number: int) -> tuple[Array, Array]:
    """The box around a subspace: its lower and upper corner, (3,) each."""
    layers = [np.flatnonzero(count) for count in _profiles(subspaces, number)]
    low, edge = subspaces.region.min_m, subspaces.region.cuboid_m
    first, last = (np.array([layer[end] for layer in layers]) for end in (0, -1))
    return low + first * edge, low + (last + 1) * edge


def _profiles(subspaces: Subspaces, number: int) -> list[Counts]:
    """A subspace's cuboids by layer along x, y and z."""
    inside = subspaces.label == number
    return [inside.sum(axis=tuple({0, 1, 2} - {axis}), dtype=np.int64) for axis in range(3)]
