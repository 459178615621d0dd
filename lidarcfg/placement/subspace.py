"""Non-detectable subspaces: what the beams' cones cut the region into (paper, section III-B and III-C)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, rotation
from lidarcfg.placement import kernels
from lidarcfg.placement.region import Region
from lidarcfg.rig import Rig

if TYPE_CHECKING:
    import open3d


@dataclass(frozen=True)
class Lidar:
    """What placement knows of a LiDAR: cones about an axis. Its spin changes none of them."""

    position_m: Array  # (3,)
    axis: Array  # (3,) unit, the sensor's z in the vehicle frame
    sin_elevation: Array  # (beams,) ascending


@dataclass(frozen=True)
class Subspaces:
    """The connected subspaces of a region; number j in `label` is row j of the others."""

    region: Region
    label: NDArray[np.int32]  # (nx, ny, nz), −1 where the region leaves a cuboid out
    cuboids: NDArray[np.int64]  # (n,) in each
    internal: NDArray[np.int64]  # (n, 3) faces inside each, across x, y and z
    gap: NDArray[np.int32]  # (n, lidars) the beam gap each lies in: cones of that LiDAR at or below it

    def __len__(self) -> int:
        return len(self.cuboids)

    def voxel_grid(self, value: Array) -> "open3d.geometry.VoxelGrid":
        """All cuboids as an Open3D voxel grid, coloured by a value (n,) of their subspace, blue to red.

        See Region.voxel_grid for cuboids that are no cubes.
        """
        index = np.argwhere(self.label >= 0)
        span = np.ptp(value) or 1.0
        level = ((value - value.min()) / span)[self.label[tuple(index.T)]]
        return self.region.voxel_grid(index, np.stack([level, 0.2 + 0 * level, 1 - level], axis=1))


def lidar(position_m: Sequence[float], rpy_rad: Sequence[float], sin_elevation: Array) -> Lidar:
    """The cones of a sensor at this pose in the vehicle frame."""
    return Lidar(np.asarray(position_m, np.float64), rotation(rpy_rad)[:, 2].copy(), sin_elevation)


def rig_lidars(rig: Rig) -> tuple[Lidar, ...]:
    """The cones of a rig's sensors."""
    return tuple(lidar(m.position_m, m.rpy_rad, m.sensor.sin_elevation) for m in rig.mounts)


def beam_gaps(region: Region, lidar: Lidar) -> NDArray[np.int32]:
    """The digit of one LiDAR: how many of its cones lie at or below each cuboid's centre, (nx, ny, nz)."""
    return kernels.beam_gaps(*region.centres(), lidar.position_m, lidar.axis, lidar.sin_elevation)


def signatures(region: Region, gaps: Sequence[NDArray[np.int32]], bases: Sequence[int]) -> NDArray[np.int64]:
    """The base-n number d_1 d_2 … d_n of each cuboid, (nx, ny, nz), from the LiDARs' digits and bases.

    Where a number would not fit into 63 bits, the ones that occur are numbered anew first.
    """
    number = np.zeros(region.shape, np.int64)
    count = 1
    for gap, base in zip(gaps, bases, strict=True):
        if count * base > 2**63 - 1:
            number = np.unique(number, return_inverse=True)[1].reshape(region.shape)
            count = int(number.max()) + 1
        number = number * base + gap
        count *= base
    return number


def segment(region: Region, lidars: Sequence[Lidar]) -> Subspaces:
    """Cut a region into its connected subspaces. Raises ConfigError where no cuboid is left in it."""
    if not region.included.any():
        raise ConfigError("the region has no cuboid left: everything is excluded")
    gaps = [beam_gaps(region, lidar) for lidar in lidars]
    number = signatures(region, gaps, [lidar.sin_elevation.size + 1 for lidar in lidars])
    label, first, cuboids, internal = kernels.components(number, region.included)
    gap = np.array([gap.ravel()[first] for gap in gaps], np.int32).reshape(len(gaps), len(first)).T
    return Subspaces(region, label, cuboids, internal, gap)
