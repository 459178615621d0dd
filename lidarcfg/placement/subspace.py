"""Non-detectable subspaces: what the beams' cones cut the region into (paper, section III-B and III-C)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, up
from lidarcfg.placement import kernels
from lidarcfg.placement.region import Region, excluded, word_dtype
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
    gap: NDArray[np.int64]  # (n, lidars) the beam gap each lies in: cones of that LiDAR at or below it

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
    return Lidar(np.asarray(position_m, np.float64), up(rpy_rad), sin_elevation)


def rig_lidars(rig: Rig) -> tuple[Lidar, ...]:
    """The cones of a rig's sensors."""
    return tuple(lidar(m.position_m, m.rpy_rad, m.sensor.sin_elevation) for m in rig.mounts)


def thresholds(sin_elevation: Array) -> Array:
    """(beams + 2,): −inf, sin |sin| of each beam, inf; what the kernels compare with."""
    return np.concatenate([[-np.inf], sin_elevation * np.abs(sin_elevation), [np.inf]])


def bits_needed(sines: Sequence[Array]) -> list[int]:
    """How many bits the beam gap index of each LiDAR takes, from its sines of elevation (beams,)."""
    return [sine.size.bit_length() for sine in sines]


def pack(region: Region, lidars: Sequence[Lidar]) -> NDArray[Any]:
    """The label of each cuboid, padded (see kernels): the paper's base-n number, in bits instead of a base.

    Where a further digit would not fit, the labels that occur are numbered anew first: labels tell apart what the
    base-n numbers do, for any number of LiDARs and beams.
    """
    bits = bits_needed([lidar.sin_elevation for lidar in lidars])
    words = region.frame(word_dtype(sum(bits)))
    outside = excluded(words.dtype)
    used = 0
    for lidar, need in zip(lidars, bits, strict=True):
        if used + need > 63:
            values, words = np.unique(words, return_inverse=True)
            used = len(values).bit_length()
            words = words.astype(np.uint64) | (values & outside)[words]
        pose = np.concatenate([lidar.position_m, lidar.axis])[None]
        kernels.pack_gaps(region.centres(), pose, thresholds(lidar.sin_elevation)[None], 0, used, words)
        used += need
    return words


def beam_gaps(region: Region, lidar: Lidar) -> NDArray[np.int64]:
    """The digit of one LiDAR: how many of its cones lie at or below each cuboid's centre, (nx, ny, nz)."""
    words = pack(region, [lidar]).reshape([n + 2 for n in region.shape])
    gap: NDArray[np.int64] = (words & ~excluded(words.dtype))[1:-1, 1:-1, 1:-1].astype(np.int64)
    return gap


def segment(region: Region, lidars: Sequence[Lidar]) -> Subspaces:
    """Cut a region into its connected subspaces. Raises ConfigError where no cuboid is left in it."""
    if not region.included.any():
        raise ConfigError("the region has no cuboid left: everything is excluded")
    words = pack(region, lidars)
    label, first, cuboids, internal = kernels.components(words, excluded(words.dtype), region.shape)
    points = np.stack(
        [axis[n] for axis, n in zip(region.centres(), np.unravel_index(first, region.shape), strict=True)],
        axis=1,
    )
    gap = np.stack([gaps_at(points, lidar) for lidar in lidars], axis=1) if lidars else np.zeros((len(first), 0), int)
    return Subspaces(region, label, cuboids, internal, gap)


def gaps_at(points_m: Array, lidar: Lidar) -> NDArray[np.int64]:
    """(N,) how many of a LiDAR's cones lie at or below points (N, 3); the kernels' comparison, term by term."""
    dx, dy, dz = (points_m - lidar.position_m).T
    height = (dx * lidar.axis[0] + dy * lidar.axis[1]) + dz * lidar.axis[2]
    square = (dx * dx + dy * dy) + dz * dz
    limit = lidar.sin_elevation * np.abs(lidar.sin_elevation)
    gap: NDArray[np.int64] = ((height * np.abs(height))[:, None] >= limit * square[:, None]).sum(axis=1)
    return gap
