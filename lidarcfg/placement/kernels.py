"""The compiled loops of placement: arrays in, arrays out. Each has a plain twin in tests/naive.py."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Labels = NDArray[np.int32]
Counts = NDArray[np.int64]


@njit(cache=True, nogil=True)
def beam_gaps(x: Array, y: Array, z: Array, position: Array, axis: Array, sine: Array) -> NDArray[np.int32]:
    """How many cones of one LiDAR lie at or below each cuboid's centre: (nx, ny, nz), 0 … beams.

    x, y, z: centres along each axis; position (3,); axis (3,) unit; sine (beams,) of elevations, ascending.
    A centre is at or above beam k when a·(p − t) >= sin(elevation_k) |p − t|; on the apex that holds for all.
    """
    out = np.empty((x.size, y.size, z.size), np.int32)
    for i in range(x.size):
        dx = x[i] - position[0]
        for j in range(y.size):
            dy = y[j] - position[1]
            flat, along = dx * dx + dy * dy, dx * axis[0] + dy * axis[1]
            for k in range(z.size):
                dz = z[k] - position[2]
                height, distance = along + dz * axis[2], np.sqrt(flat + dz * dz)
                low, high = 0, sine.size
                while low < high:
                    middle = (low + high) // 2
                    if height >= sine[middle] * distance:
                        low = middle + 1
                    else:
                        high = middle
                out[i, j, k] = low
    return out


@njit(cache=True, nogil=True)
def _root(parent: Labels, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _join(parent: Labels, i: int, j: int) -> None:
    a, b = _root(parent, i), _root(parent, j)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b


@njit(cache=True, nogil=True)
def components(signature: Counts, included: NDArray[np.bool_]) -> tuple[Labels, Counts, Counts, Counts]:
    """6-connected components of equal signature, by union-find in raster order.

    signature, included (nx, ny, nz). Returns labels (nx, ny, nz), numbered in raster order and −1 where left
    out; first (n,), each component's first cuboid in raster order; cuboids (n,) in each; and internal (n, 3),
    the faces inside each across x, y and z.
    """
    nx, ny, nz = signature.shape
    parent = np.empty(signature.size, np.int32)
    here = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                parent[here] = here
                if included[i, j, k]:
                    mine = signature[i, j, k]
                    if k > 0 and included[i, j, k - 1] and signature[i, j, k - 1] == mine:
                        _join(parent, here, here - 1)
                    if j > 0 and included[i, j - 1, k] and signature[i, j - 1, k] == mine:
                        _join(parent, here, here - nz)
                    if i > 0 and included[i - 1, j, k] and signature[i - 1, j, k] == mine:
                        _join(parent, here, here - ny * nz)
                here += 1

    labels = np.empty((nx, ny, nz), np.int32)
    flat = labels.ravel()
    inside = included.ravel()
    first = np.empty(parent.size, np.int64)
    count = 0
    for here in range(parent.size):  # a root comes before all that it is the root of
        if not inside[here]:
            flat[here] = -1
        elif parent[here] == here:
            flat[here] = count
            first[count] = here
            count += 1
        else:
            flat[here] = flat[_root(parent, here)]

    cuboids = np.zeros(count, np.int64)
    internal = np.zeros((count, 3), np.int64)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                label = labels[i, j, k]
                if label >= 0:
                    cuboids[label] += 1
                    internal[label, 0] += i > 0 and labels[i - 1, j, k] == label
                    internal[label, 1] += j > 0 and labels[i, j - 1, k] == label
                    internal[label, 2] += k > 0 and labels[i, j, k - 1] == label
    return labels, first[:count].copy(), cuboids, internal


@njit(cache=True, nogil=True)
def detected_positions(
    labels: Labels, size: tuple[int, int, int], threshold: int, layers: int
) -> tuple[int, int]:
    """At how many places a box of cuboids touches more than `threshold` components, and how many there are.

    labels (nx, ny, nz), −1 left out; size in cuboids; the box's lowest layer is one of the first `layers`.
    A place counts when the whole box lies inside the grid and on no cuboid that is left out.
    """
    nx, ny, nz = labels.shape
    seen = np.empty(threshold + 1, np.int32)
    places = detected = 0
    for i in range(nx - size[0] + 1):
        for j in range(ny - size[1] + 1):
            for k in range(min(nz - size[2] + 1, layers)):
                free, found = True, 0
                for a in range(i, i + size[0]):
                    for b in range(j, j + size[1]):
                        for c in range(k, k + size[2]):
                            label = labels[a, b, c]
                            free = free and label >= 0
                            if not free:
                                break
                            if found <= threshold:
                                new = True
                                for s in range(found):
                                    new = new and seen[s] != label
                                if new:
                                    seen[found] = label
                                    found += 1
                        if not free:
                            break
                    if not free:
                        break
                places += free
                detected += free and found > threshold
    return detected, places
