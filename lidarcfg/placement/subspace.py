"""Non-detectable subspaces, into which the beams' cones cut the region (paper, sections III-B and III-C)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import placement as core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.cones import Lidar, cone_rows
from lidarcfg.placement.grid import Labels, compare_labels, count_set, cuboid_number
from lidarcfg.placement.region import Region, check_voxels
from lidarcfg.placement.visibility import UNLIMITED_SIGHT, Visibility

if TYPE_CHECKING:
    import open3d

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

    def mesh(self, *numbers: int) -> "open3d.geometry.TriangleMesh":
        """The surface of the subspaces with these numbers, in metres. Raises ConfigError where there is none."""
        return self.region.mesh(np.isin(self.label, numbers))

    def line_set(self, *numbers: int) -> "open3d.geometry.LineSet":
        """The edges of that surface. Raises ConfigError where there is none."""
        return self.region.line_set(np.isin(self.label, numbers))

    def blind_mesh(self) -> "open3d.geometry.TriangleMesh":
        """The surface of what no LiDAR sees, in metres. Raises ConfigError where every cuboid is seen."""
        return self.region.mesh((self.seen_by == 0) & self.region.included)

    def voxel_grid(self, value: Array, voxel_m: float | None = None) -> "open3d.geometry.VoxelGrid":
        """All cuboids as an Open3D voxel grid, coloured by a value (n,) of their subspace, blue to red.

        In true proportions: see `Region.voxel_grid`, also for `voxel_m`. Raises LidarcfgError where memory does not
        hold them.
        """
        return self.region.voxel_grid(*self._coloured(value), voxel_m)

    def scaled_voxel_grid(self, value: Array) -> "open3d.geometry.VoxelGrid":
        """The same with one voxel a cuboid, and so not in true proportions: see `Region.scaled_voxel_grid`."""
        return self.region.scaled_voxel_grid(*self._coloured(value))

    def _coloured(self, value: Array) -> tuple[NDArray[np.int64], Array]:
        """The indices (N, 3) of all cuboids, and their colours (N, 3)."""
        check_voxels(int(self.cuboids.sum()))
        index = np.argwhere(self.label >= 0)
        span = np.ptp(value) or 1.0
        level = ((value - value.min()) / span)[self.label[tuple(index.T)]]
        return index, np.stack([level, 0.2 + 0 * level, 1 - level], axis=1)


def segment(region: Region, lidars: Sequence[Lidar], visibility: Visibility | None = None) -> Subspaces:
    """Cut a region into its connected subspaces. Raises ConfigError where every cuboid is excluded."""
    sight = visibility.sight(lidars) if visibility else UNLIMITED_SIGHT
    return connect(compare_labels(region, lidars, sight))


def connect(labels: Labels) -> Subspaces:
    """Connect neighbouring cuboids of the same label to subspaces (paper, III-C), in raster order of first cuboids.

    Raises ConfigError where every cuboid is excluded.
    """
    region = labels.region
    if not region.included.any():
        raise ConfigError("the region has no cuboid left: everything is excluded")
    label = np.empty(region.shape, np.int32)
    cuboids, internal, first = core.label_components(labels.grid, labels.links, label)
    index = np.unravel_index(first, region.shape)
    points = np.stack([axis[n] for axis, n in zip(region.centres(), index, strict=True)], axis=1)
    gap = core.beam_gaps(points, cone_rows(labels.lidars))
    if labels.seen is None:
        return Subspaces(region, label, cuboids, internal, gap, first)
    i, j, k = index
    number = cuboid_number(labels.grid, (i, j, k))
    is_seen = labels.seen[:, number >> 6] >> (number & 63).astype(np.uint64) & np.uint64(1)
    gap[is_seen.T == 0] = BLIND
    return Subspaces(region, label, cuboids, internal, gap, first, count_set(region, labels.seen))


class Links:
    """The links of each LiDAR, computed once, for the subspaces of any of them."""

    def __init__(self, region: Region, lidars: Sequence[Lidar], visibility: Visibility | None = None) -> None:
        sights = [visibility.sight([one]) if visibility else UNLIMITED_SIGHT for one in lidars]
        self._each = [compare_labels(region, [one], sight) for one, sight in zip(lidars, sights, strict=True)]

    def subspaces(self, kept: Sequence[int]) -> Subspaces:
        """The subspaces that `segment` finds for these LiDARs alone."""
        ones = [self._each[i] for i in kept]
        links = np.bitwise_and.reduce([one.links for one in ones])
        seen = [one.seen for one in ones if one.seen is not None]
        lidars = [one.lidars[0] for one in ones]
        first = ones[0]
        return connect(Labels(first.region, lidars, first.grid, links, np.concatenate(seen) if seen else None))
