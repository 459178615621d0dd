"""Non-detectable subspaces: what the beams' cones cut the region into (paper, section III-B and III-C)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement import flood, rows
from lidarcfg.placement.cones import Lidar, beam_gap_table, cone_rows
from lidarcfg.placement.region import Region

if TYPE_CHECKING:
    import open3d


@dataclass(frozen=True)
class Subspaces:
    """The connected subspaces of a region; number j in `label` is row j of the others."""

    region: Region
    label: NDArray[np.int32]  # (nx, ny, nz), −1 for excluded cuboids
    cuboids: NDArray[np.int64]  # (n,) in each
    internal: NDArray[np.int64]  # (n, 3) faces inside each, across x, y and z
    gap: NDArray[np.int64]  # (n, lidars) the beam gap each lies in: cones of that LiDAR at or below it
    first: NDArray[np.int64]  # (n,) the first cuboid of each, as an index into the flat region

    def __len__(self) -> int:
        return len(self.cuboids)

    def voxel_grid(self, value: Array) -> "open3d.geometry.VoxelGrid":
        """All cuboids as an Open3D voxel grid, coloured by a value (n,) of their subspace, blue to red.

        See Region.voxel_grid for cuboids that are not cubes.
        """
        index = np.argwhere(self.label >= 0)
        span = np.ptp(value) or 1.0
        level = ((value - value.min()) / span)[self.label[tuple(index.T)]]
        return self.region.voxel_grid(index, np.stack([level, 0.2 + 0 * level, 1 - level], axis=1))


def segment(region: Region, lidars: Sequence[Lidar]) -> Subspaces:
    """Cut a region into its connected subspaces. Raises ConfigError where every cuboid is excluded."""
    if not region.included.any():
        raise ConfigError("the region has no cuboid left: everything is excluded")
    grid, work = rows.linked(region, lidars)
    label, cuboids, internal, first = flood.components(grid, region.shape, work.links)
    index = np.unravel_index(first, region.shape)
    points = np.stack([axis[n] for axis, n in zip(region.centres(), index, strict=True)], axis=1)
    return Subspaces(region, label, cuboids, internal, beam_gap_table(points, cone_rows(lidars)), first)
