"""Non-detectable subspaces: what the beams' cones cut the region into (paper, section III-B and III-C)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement import kernels, runs
from lidarcfg.placement.lidar import Lidar, bits_needed, gaps_at, thresholds
from lidarcfg.placement.region import Region, excluded, word_dtype

if TYPE_CHECKING:
    import open3d


RUNS_FROM = 300_000  # cuboids; from here on runs are faster than looking at each: see docs/benchmarks.md


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
    if region.included.size >= RUNS_FROM:
        label, cuboids, internal, first = runs.label(runs.Grid.of(region), lidars)
    else:
        words = pack(region, lidars)
        label, first, cuboids, internal = kernels.components(words, excluded(words.dtype), region.shape)
    points = np.stack(
        [axis[n] for axis, n in zip(region.centres(), np.unravel_index(first, region.shape), strict=True)],
        axis=1,
    )
    gap = np.stack([gaps_at(points, lidar) for lidar in lidars], axis=1) if lidars else np.zeros((len(first), 0), int)
    return Subspaces(region, label, cuboids, internal, gap)
