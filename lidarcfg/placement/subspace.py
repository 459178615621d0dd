"""Non-detectable subspaces, into which the beams' cones cut the region (paper, sections III-B and III-C)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import placement as core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.components import components
from lidarcfg.placement.cones import Lidar, cone_rows
from lidarcfg.placement.grid import Words, count_set, cuboid_number, linked
from lidarcfg.placement.region import Region, check_voxels
from lidarcfg.placement.sight import UNLIMITED_SIGHT

if TYPE_CHECKING:
    import open3d

    from lidarcfg.placement.visibility import Visibility

BLIND = -1  # the gap index of a LiDAR that does not see a subspace


@dataclass(frozen=True)
class Subspaces:
    """The connected subspaces of a region; number j in `label` is row j of the others."""

    region: Region
    label: NDArray[np.int32]  # (nx, ny, nz), −1 for excluded cuboids
    cuboids: NDArray[np.int64]  # (n,) in each
    internal: NDArray[np.int64]  # (n, 3) faces inside each, across x, y and z
    gap: NDArray[np.int64]  # (n, lidars) the beam gap of each: the number of the LiDAR's cones at or below it, or BLIND
    first: NDArray[np.int64]  # (n,) the first cuboid of each, as an index into the flat region
    seen: NDArray[np.integer] | None = None  # (nx, ny, nz) by how many LiDARs, 0 if excluded; None: by all

    def __len__(self) -> int:
        return len(self.cuboids)

    @property
    def seen_by(self) -> NDArray[np.integer]:
        """(nx, ny, nz) by how many LiDARs each cuboid is seen; 0 where it is excluded."""
        if self.seen is not None:
            return self.seen
        lidars = self.gap.shape[1]
        count: NDArray[np.integer] = self.region.included * np.array(lidars, np.min_scalar_type(lidars))
        return count

    def without_cuboids(self) -> "Subspaces":
        """A copy without the arrays of cuboids, to save memory: `label` is empty, and `seen` is unknown."""
        return replace(self, label=np.empty((0, 0, 0), np.int32), seen=None)

    def voxel_grid(self, value: Array) -> "open3d.geometry.VoxelGrid":
        """All cuboids as an Open3D voxel grid, coloured by a value (n,) of their subspace, blue to red.

        See Region.voxel_grid for cuboids that are not cubes. Raises LidarcfgError where memory does not hold them.
        """
        check_voxels(int(self.cuboids.sum()))
        index = np.argwhere(self.label >= 0)
        span = np.ptp(value) or 1.0
        level = ((value - value.min()) / span)[self.label[tuple(index.T)]]
        return self.region.voxel_grid(index, np.stack([level, 0.2 + 0 * level, 1 - level], axis=1))


def segment(region: Region, lidars: Sequence[Lidar], visibility: "Visibility | None" = None) -> Subspaces:
    """Cut a region into its connected subspaces. Raises ConfigError where every cuboid is excluded."""
    if not region.included.any():
        raise ConfigError("the region has no cuboid left: everything is excluded")
    grid, links, seen = linked(region, lidars, visibility.sight(lidars) if visibility else UNLIMITED_SIGHT)
    return _subspaces(region, grid, links, lidars, seen)


class Links:
    """The links of each LiDAR, computed once, for the subspaces of any of them."""

    def __init__(self, region: Region, lidars: Sequence[Lidar], visibility: "Visibility | None" = None) -> None:
        self._region = region
        self._lidars = lidars
        sights = [visibility.sight([one]) if visibility else UNLIMITED_SIGHT for one in lidars]
        each = [linked(region, [one], sight) for one, sight in zip(lidars, sights, strict=True)]
        self._grid = each[0][0]
        self._links = np.stack([links for _, links, _ in each])  # (lidars, rows, 3)
        seen = [words for _, _, words in each if words is not None]
        self._seen = np.concatenate(seen) if seen else None  # (lidars, rows)

    def subspaces(self, kept: Sequence[int]) -> Subspaces:
        """The result of `segment` for these LiDARs alone."""
        which = list(kept)
        links = np.bitwise_and.reduce(self._links[which])
        seen = None if self._seen is None else self._seen[which]
        return _subspaces(self._region, self._grid, links, [self._lidars[i] for i in which], seen)


def _subspaces(
    region: Region, grid: core.Grid, links: Words, lidars: Sequence[Lidar], seen_words: Words | None
) -> Subspaces:
    """The subspaces by their links (rows, 3), and by what the LiDARs see (lidars, rows) if sight is limited."""
    label, cuboids, internal, first = components(grid, links)
    index = np.unravel_index(first, region.shape)
    points = np.stack([axis[n] for axis, n in zip(region.centres(), index, strict=True)], axis=1)
    gap = core.beam_gaps(points, cone_rows(lidars))
    if seen_words is None:
        return Subspaces(region, label, cuboids, internal, gap, first)
    i, j, k = index
    number = cuboid_number(grid, (i, j, k))
    gap[(seen_words[:, number >> 6] >> (number & 63).astype(np.uint64) & np.uint64(1)).T == 0] = BLIND
    return Subspaces(region, label, cuboids, internal, gap, first, count_set(region, seen_words))
