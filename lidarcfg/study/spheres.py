"""The largest spheres inside subspaces' cuboids, with centres on the lattice of half cuboids.

Node 2x + p of the lattice is the lower face of cuboid x where p is 0, and its middle where p is 1. From a node the
nearest point of a face lies on the lattice too, so a Euclidean distance transform of it gives exact radii.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.vsr.metric import volume_m3
from lidarcfg.vsr.subspaces import Subspaces

Labels = NDArray[np.int32]
Node = tuple[int, int, int]  # of the lattice, whose origin is the region's lower corner
SLAB = 250_000  # cuboids transformed together, and BYTES of memory for each
BYTES = 350


class Spheres(NamedTuple):
    """The largest sphere in each subspace."""

    radius_m: Array  # (n,)
    centre: Node  # of the largest of all; of equal ones, the lattice's first


def largest_spheres(subspaces: Subspaces) -> Spheres:
    """The radii of the largest spheres in subspaces.

    The grid is transformed in slabs, each with as many layers on either side as a sphere may reach. Raises
    LidarcfgError where memory does not hold one.
    """
    half = subspaces.region.cuboid_m / 2
    nx, ny, nz = subspaces.region.shape
    walls = np.pad(subspaces.label, 1, constant_values=-1)
    reach = math.ceil(_most_m(subspaces) / (2 * half[0]))
    layers = max(SLAB // (ny * nz), reach, 1)
    together = min(layers + 2 * reach, nx) * ny * nz
    check_memory(f"finding spheres in {together:,} cuboids", BYTES * together, "use larger cuboids")
    radius = np.zeros(len(subspaces))
    centre = (0, 0, 0)
    for first in range(0, nx, layers):
        low = max(first - reach, 0)
        last = min(first + layers, nx)
        before = radius.max()
        i, j, k = _widen(radius, walls[low : last + reach + 2], slice(2 * (first - low), 2 * (last - low)), half)
        if radius.max() > before:
            centre = (i + 2 * first, j, k)
    return Spheres(radius, centre)


def _widen(radius: Array, walls: Labels, own: slice, half: Array) -> Node:
    """Raise radii (n,) to those in a slab's own layers of nodes; which of these has the largest."""
    label = _lattice(walls)
    nearest = ndimage.distance_transform_edt(label >= 0, half, return_distances=False, return_indices=True)[:, own]
    square = np.zeros(nearest.shape[1:])
    for axis, nodes in enumerate((np.arange(len(label))[own], *(np.arange(n) for n in label.shape[1:]))):
        away = (nearest[axis] - nodes.reshape([-1 if n == axis else 1 for n in range(3)])) * half[axis]
        square += away * away
    distance = np.sqrt(square, out=square)
    inside = label[own] >= 0
    np.maximum.at(radius, label[own][inside], distance[inside])
    i, j, k = np.unravel_index(int(distance.argmax()), distance.shape)
    return int(i), int(j), int(k)


def clearance_m(subspaces: Subspaces, centre: Node) -> float:
    """The radius of the largest sphere around a node that no face cuts; 0 on a face."""
    walls = np.pad(subspaces.label, 1, constant_values=-1)
    own = walls[tuple(node // 2 + 1 for node in centre)]
    square = [
        (np.maximum(abs(2 * np.arange(-1, n + 1) + 1 - node) - 1, 0) * half) ** 2
        for n, node, half in zip(subspaces.region.shape, centre, subspaces.region.cuboid_m / 2, strict=True)
    ]  # of the distances to cuboids, along each axis
    nearest = math.inf if own >= 0 else 0.0
    for across, layer in zip(square[0], walls, strict=True):
        others = layer != own
        if across < nearest and others.any():
            nearest = min(nearest, float(((across + square[1])[:, None] + square[2])[others].min()))
    return math.sqrt(nearest)


def _most_m(subspaces: Subspaces) -> float:
    """A radius that no sphere exceeds: by the region's walls, and by the volume of the largest subspace."""
    region = subspaces.region
    by_volume: float = maths.power(0.75 / math.pi * float(volume_m3(subspaces).max()), 1 / 3)
    return min(by_volume, float((region.max_m - region.min_m).min()) / 2)


def _lattice(walls: Labels) -> Labels:
    """(2x + 1, 2y + 1, 2z + 1) the subspaces of nodes, from those of cuboids (x + 2, y + 2, z + 2); −1 on faces."""
    out = walls
    for axis in range(3):
        cuboids = np.moveaxis(out, axis, 0)
        nodes = np.empty((2 * len(cuboids) - 3, *cuboids.shape[1:]), np.int32)
        nodes[1::2] = cuboids[1:-1]
        nodes[::2] = np.where(cuboids[1:] == cuboids[:-1], cuboids[1:], -1)
        out = np.moveaxis(nodes, 0, axis)
    return out
