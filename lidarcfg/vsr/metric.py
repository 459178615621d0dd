"""How large subspaces are: the paper's volume-to-surface ratio (VSR), and where they are."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array
from lidarcfg.vsr.cones import Lidar
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Subspaces, compare_labels, connect
from lidarcfg.vsr.visibility import UNLIMITED_SIGHT, Visibility

Counts = NDArray[np.int64]
Lines = NDArray[np.int32]


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


def max_vsr(region: Region, lidars: Sequence[Lidar], visibility: Visibility | None = None) -> float:
    """The paper's cost of a rig: the largest VSR of its subspaces, in metres (eq. 10)."""
    sight = visibility.sight(lidars) if visibility else UNLIMITED_SIGHT  # beyond the paper: what bodies hide
    labels = compare_labels(region, lidars, sight)  # equal where no cone passes between two neighbours
    subspaces = connect(labels)  # no beam enters them
    return float(vsr_m(subspaces).max())


def vsr_of_counts(cuboids: Counts, internal: Counts, cuboid_m: Array) -> Array:
    """(n,) VSR from cuboids (n,), the faces inside (n, 3) and a cuboid's edges (3,)."""
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


@dataclass(frozen=True)
class Extent:
    """The extent of a subspace, by its cuboids."""

    region: Region
    lines: tuple[Lines, Lines, Lines]  # of its cuboids on each line along x, y and z: (ny, nz), (nx, nz), (nx, ny)

    @cached_property
    def counts(self) -> tuple[Counts, Counts, Counts]:
        """The number of its cuboids by layer along x, y and z."""
        across_x, _, across_z = self.lines
        x, y = (across_z.sum(axis=axis, dtype=np.int64) for axis in (1, 0))
        return x, y, across_x.sum(axis=0, dtype=np.int64)

    @property
    def low(self) -> Counts:
        """(3,) the first layers that it has a cuboid in."""
        return np.array([np.flatnonzero(count)[0] for count in self.counts])

    @property
    def high(self) -> Counts:
        """(3,) the layers behind the last ones."""
        return np.array([np.flatnonzero(count)[-1] + 1 for count in self.counts])

    @property
    def bounds_m(self) -> tuple[Array, Array]:
        """The box around it: its lower and upper corner, (3,) each."""
        low = self.region.min_m
        edge = self.region.cuboid_m
        return low + self.low * edge, low + self.high * edge

    @property
    def centroid_m(self) -> Array:
        """(3,) the mean of its cuboids' centres."""
        index = np.array([count @ np.arange(len(count)) / count.sum() for count in self.counts])
        centre: Array = self.region.min_m + (index + 0.5) * self.region.cuboid_m
        return centre


def extents(subspaces: Subspaces, numbers: Sequence[int]) -> list[Extent]:
    """The extents of some subspaces."""
    place = np.full(len(subspaces) + 1, -1)
    place[list(numbers)] = np.arange(len(numbers))
    nx, ny, nz = subspaces.region.shape
    lines = [np.zeros((len(numbers), *shape), np.int32) for shape in ((ny, nz), (nx, nz), (nx, ny))]
    core.vsr.count_lines(subspaces.label, place, *lines)
    return [Extent(subspaces.region, (x, y, z)) for x, y, z in zip(*lines, strict=True)]
