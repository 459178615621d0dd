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

    from lidarcfg.placement.visibility import Visibility

BLIND = -1  # the gap index of a LiDAR that does not see a subspace


@dataclass(frozen=True)
class Subspaces:
    """The connected subspaces of a region; number j in `label` is row j of the others."""

    region: Region
    label: NDArray[np.int32]  # (nx, ny, nz), −1 for excluded cuboids
    cuboids: NDArray[np.int64]  # (n,) in each
    internal: NDArray[np.int64]  # (n, 3) faces inside each, across x, y and z
    gap: NDArray[np.int64]  # (n, lidars) the beam gap each lies in: cones of that LiDAR at or below it, or BLIND
    first: NDArray[np.int64]  # (n,) the first cuboid of each, as an index into the flat region
    seen: NDArray[np.bool_] | None = None  # (lidars, nx, ny, nz) what each LiDAR sees; None: all that counts

    def __len__(self) -> int:
        return len(self.cuboids)

    @property
    def seen_by(self) -> NDArray[np.int64]:
        """(nx, ny, nz) by how many LiDARs each cuboid is seen; 0 where it is excluded."""
        if self.seen is None:
            return self.region.included * np.int64(self.gap.shape[1])
        count: NDArray[np.int64] = self.seen.sum(axis=0, dtype=np.int64)
        return count

    def voxel_grid(self, value: Array) -> "open3d.geometry.VoxelGrid":
        """All cuboids as an Open3D voxel grid, coloured by a value (n,) of their subspace, blue to red.

        See Region.voxel_grid for cuboids that are not cubes.
        """
        index = np.argwhere(self.label >= 0)
        span = np.ptp(value) or 1.0
        level = ((value - value.min()) / span)[self.label[tuple(index.T)]]
        return self.region.voxel_grid(index, np.stack([level, 0.2 + 0 * level, 1 - level], axis=1))


def segment(region: Region, lidars: Sequence[Lidar], visibility: "Visibility | None" = None) -> Subspaces:
    """Cut a region into its connected subspaces. Raises ConfigError where every cuboid is excluded."""
    if not region.included.any():
        raise ConfigError("the region has no cuboid left: everything is excluded")
    grid, work = rows.linked(region, lidars, visibility.sight(lidars) if visibility else rows.EVERYTHING)
    label, cuboids, internal, first = flood.components(grid, region.shape, work.links)
    index = np.unravel_index(first, region.shape)
    points = np.stack([axis[n] for axis, n in zip(region.centres(), index, strict=True)], axis=1)
    gap, seen = beam_gap_table(points, cone_rows(lidars)), None
    if visibility:
        seen = rows.unpacked(region, work.seen)
        gap[~seen.reshape(len(lidars), -1)[:, first].T] = BLIND
    return Subspaces(region, label, cuboids, internal, gap, first, seen)
