"""Labels and subspaces: cones of beams cut the region into non-detectable subspaces (paper, sections III-B and III-C).

Two neighbouring cuboids lie in one subspace if no cone passes between them, that is if every digit of their base-n
labels is the same; a LiDAR that does not see a cuboid has one digit for it, whatever its beams. The labels of a region
are rows of bits, 64 cuboids along x to a word. Each row of up to 64 cuboids has three words, its links: whether each
cuboid and the one before it along x, y and z have the same digits. The links of several LiDARs are those of each,
joined by `and`.

Rows are numbered ((k + 1)(ny + 2) + j + 1) · chunks + c, so that every neighbour exists; a cuboid is row · 64 + bit.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import vsr as core
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.vsr.cones import FIRST, Lidar, cone_rows, gaps_at
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.visibility import UNLIMITED_SIGHT, Sight, Visibility
from lidarcfg.world.cuboids import check_voxels

Words = NDArray[np.uint64]
Counts = NDArray[np.int64]
BEAMS_MAX = 1_000_000  # of all LiDARs together
LARGE = 2**14  # rows from which on what LiDARs see is found on threads
WORDS = 16  # a row that an evaluation needs at least, besides three for each LiDAR
BLIND = -1  # the gap index of a LiDAR that does not see a subspace


def grid_of(region: Region, weights: tuple[Array, NDArray[np.integer]] | None = None) -> core.Grid:
    """The grid of a region; `weights` as `zones.Weights` has them: (n,), and by cuboid 1 + which of them."""
    weight, number = weights or (np.empty(0), np.empty(0, np.uint8))
    included = pack(region.included).ravel()
    weighted = np.zeros((len(weight), included.size), np.uint64)
    for n in range(len(weight)):
        weighted[-1 - n] = pack(np.equal(number, n + 1)).ravel()
    return core.Grid(*region.centres(), included, region.cuboid_m.tolist(), weight[::-1].copy(), weighted)


def pack(bits: NDArray[np.bool_]) -> Words:
    """(nz + 2, ny + 2, chunks) the words of flags by cuboid (nx, ny, nz), 64 along x, with a margin of none."""
    nx, ny, nz = bits.shape
    words = np.zeros((nz + 2, ny + 2, -(-nx // 64)), np.uint64)
    for chunk in range(words.shape[2]):
        bytes_ = np.zeros((nz, ny, 8), np.uint8)
        found = np.packbits(bits[64 * chunk : 64 * chunk + 64], axis=0, bitorder="little")
        bytes_[..., : len(found)] = found.transpose(2, 1, 0)
        words[1:-1, 1:-1, chunk] = bytes_.view("<u8")[..., 0]
    return words


def count_set(region: Region, words: Words) -> NDArray[np.integer]:
    """(nx, ny, nz) in how many of several words (n, rows) each cuboid is set."""
    _, ny, nz = region.shape
    out = np.empty(region.shape, np.min_scalar_type(len(words)))
    chunks = words.reshape(len(words), nz + 2, ny + 2, -1)[:, 1:-1, 1:-1].astype("<u8", copy=False)
    for j in range(ny):
        for chunk in range(chunks.shape[3]):
            bytes_ = np.ascontiguousarray(chunks[:, :, j, chunk]).view(np.uint8).reshape(len(words), nz, 8)
            count = np.unpackbits(bytes_, axis=2, bitorder="little").sum(axis=0, dtype=out.dtype)
            part = out[64 * chunk : 64 * chunk + 64, j]
            part[:] = count.T[: len(part)]
    return out


def cuboid_number(grid: core.Grid, index: tuple[Counts, Counts, Counts]) -> Counts:
    """(N,) the numbers of cuboids by their indices along x, y and z, (N,) each."""
    i, j, k = index
    row = ((k + 1) * (grid.shape[1] + 2) + j + 1) * grid.chunks + (i >> 6)
    number: Counts = row << 6 | i & 63
    return number


def check_grid(grid: core.Grid, lidars: int, beams: int, threads: int = 1) -> None:
    """Raises LidarcfgError where there are too many beams, or memory does not hold evaluations on that many threads."""
    if lidars * beams > BEAMS_MAX:
        what = f"{lidars} sensors of up to {beams:,} beams are {lidars * beams:,} to compare cuboids with"
        raise LidarcfgError(f"{what}; allowed: at most {BEAMS_MAX:,}")
    layer = grid.rows // (grid.shape[2] + 2)
    needed = 8.0 * threads * ((WORDS + 3 * lidars) * grid.rows + 2 * layer * lidars * beams)
    what = f"comparing {64 * grid.rows:,} cuboids with {lidars * beams:,} beams on {threads} threads"
    check_memory(what, needed, "use larger cuboids or fewer beams")


class Labels(NamedTuple):
    """Which neighbouring cuboids of a region have the same label, for some LiDARs."""

    region: Region
    lidars: Sequence[Lidar]
    grid: core.Grid  # the region as rows of bits
    links: Words  # (rows, 3) whether a cuboid and the one before it along x, y and z have the same label
    seen: Words | None  # (lidars, rows) the cuboids that each LiDAR sees; None: all


def segment(region: Region, lidars: Sequence[Lidar], visibility: Visibility | None = None) -> "Subspaces":
    """Cut a region into its connected subspaces. Raises ConfigError where every cuboid is excluded."""
    labels = compare_labels(region, lidars, visibility.sight(lidars) if visibility else UNLIMITED_SIGHT)
    return connect(labels)


def compare_labels(region: Region, lidars: Sequence[Lidar], sight: Sight = UNLIMITED_SIGHT) -> Labels:
    """Compare the labels of neighbouring cuboids (paper, III-B): equal where no cone passes between their centres.

    Raises LidarcfgError where there are too many beams, or where memory does not hold the comparison.
    """
    grid = grid_of(region)
    cones = cone_rows(lidars)  # a beam that spins is a cone about its LiDAR's axis (II-A)
    check_grid(grid, len(cones), cones.shape[1] - FIRST)
    seen = _seen(grid, cones, sight) if len(sight.limits) else None  # beyond the paper: what bodies hide
    links = np.empty((grid.rows, 3), np.uint64)
    core.links(grid, cones, np.empty((0, grid.rows), np.uint64) if seen is None else seen, links)
    return Labels(region, lidars, grid, links, seen)


def _seen(grid: core.Grid, cones: Array, sight: Sight) -> Words:
    """(lidars, rows) the words of which cuboids each LiDAR sees, computed on threads where the grid is large."""
    if grid.rows <= LARGE or len(cones) <= 1:
        return core.seen(grid, cones, sight)

    def of_one(lidar: int) -> Words:
        one = slice(lidar, lidar + 1)
        return core.seen(grid, cones[one], Sight(sight.limits[one], sight.obstacles))

    with ThreadPoolExecutor() as pool:
        return np.concatenate(list(pool.map(of_one, range(len(cones)))))


def beam_gaps(region: Region, lidar: Lidar) -> Counts:
    """(nx, ny, nz) the beam gap index of each cuboid: how many of a LiDAR's cones lie at or below its centre."""
    points = np.stack(np.meshgrid(*region.centres(), indexing="ij"), axis=-1)
    return gaps_at(points.reshape(-1, 3), lidar).reshape(region.shape)


if TYPE_CHECKING:
    import open3d


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
        """All cuboids with one voxel each, and so not in true proportions: see `Region.scaled_voxel_grid`."""
        return self.region.scaled_voxel_grid(*self._coloured(value))

    def _coloured(self, value: Array) -> tuple[NDArray[np.int64], Array]:
        """The indices (N, 3) of all cuboids, and their colours (N, 3)."""
        check_voxels(int(self.cuboids.sum()))
        index = np.argwhere(self.label >= 0)
        span = np.ptp(value) or 1.0
        level = ((value - value.min()) / span)[self.label[tuple(index.T)]]
        return index, np.stack([level, 0.2 + 0 * level, 1 - level], axis=1)


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
