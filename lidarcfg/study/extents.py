"""Where subspaces are: their boxes and centroids."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Counts, Subspaces

Lines = NDArray[np.int32]


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
