"""The region of interest: a box cut into equal cuboids, some of them excluded."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from lidarcfg.config.models import COORDINATE_MAX_M, Model, Position, validation_error
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.world.cuboids import check_voxels, crease_lines, surface_mesh, voxel_grid
from lidarcfg.world.vehicle import Vehicle

if TYPE_CHECKING:
    import open3d


CUBOIDS_MAX = 2**31 - 1  # labels are int32
CUBOID_BYTES = 11  # of memory to evaluate one, measured
CUBOID_ADDRESSES = 110  # bytes of address space reserved for one, most of them never used
NEAREST_M = 1e-9  # least distance of centres
NEAREST = 1e-12  # the same relative to the coordinates
Edge = Annotated[float, Field(gt=0, le=COORDINATE_MAX_M)]
Edges = tuple[Edge, Edge, Edge]
AXES = "xyz"
NEAR = 5000  # counts of cuboids below and above that are tried for round sizes


class BoxFile(Model):
    """A box: min <= p < max."""

    min_m: Position
    max_m: Position

    @model_validator(mode="after")
    def _check(self) -> "BoxFile":
        for axis in range(3):
            if not self.min_m[axis] < self.max_m[axis]:
                what = f"{self.max_m[axis]:g} is not above min_m's {self.min_m[axis]:g}"
                raise validation_error(what, "max_m", axis)
        return self


class RegionFile(BoxFile):
    """The region in a study file."""

    cuboid_m: Edges
    exclude: tuple[BoxFile, ...] = ()

    @model_validator(mode="after")
    def _check_division(self) -> "RegionFile":
        total = 1
        for axis in range(3):
            length = self.max_m[axis] - self.min_m[axis]
            edge = self.cuboid_m[axis]
            count = max(round(length / edge), 1) if length / edge <= CUBOIDS_MAX else CUBOIDS_MAX + 1
            total *= count
            if total > CUBOIDS_MAX:
                raise validation_error(f"makes more than the {CUBOIDS_MAX:,} cuboids allowed", "cuboid_m")
            far = max(abs(self.min_m[axis]), abs(self.max_m[axis]))
            least = max(NEAREST_M, NEAREST * far)
            if edge < least:
                what = f"{edge:g} is too little for coordinates up to {far:g}; allowed: at least {least:g}"
                raise validation_error(what, "cuboid_m", axis)
            if abs(count * edge - length) > 1e-9 * length + math.ulp(far):  # the corners are rounded, too
                near = " and ".join(f"{size:.12g}" for size in _sizes(length, edge))
                what = f"{edge:g} does not divide the region's {length:g} along {AXES[axis]}"
                raise validation_error(f"{what}; sizes that do: {near}", "cuboid_m", axis)
        return self


def _sizes(length: float, edge: float) -> list[float]:
    """Up to two sizes that divide a length, the nearest below and above an edge: round numbers if some are near."""
    middle = max(round(length / edge), 1)
    counts = range(max(middle // 2, middle - NEAR, 1), min(2 * middle, middle + NEAR) + 2)
    sizes = sorted((length / count for count in counts), key=lambda size: (not _is_round(size), abs(size - edge)))
    sides = (next((size for size in sizes if (size < edge) == below), None) for below in (True, False))
    return [size for size in sides if size is not None]


def _is_round(size: float) -> bool:
    """Whether two significant digits represent the number."""
    return abs(float(f"{size:.2g}") - size) <= 1e-9 * size


class Cut(NamedTuple):
    """The part of a region that bodies exclude."""

    bodies: Vehicle
    packed: NDArray[np.uint8]  # which cuboids counted before, eight to a byte
    shape: tuple[int, ...]

    @property
    def included(self) -> NDArray[np.bool_]:
        """(nx, ny, nz) which cuboids counted before."""
        return np.unpackbits(self.packed, count=math.prod(self.shape)).view(np.bool_).reshape(self.shape)


@dataclass(frozen=True)
class Region:
    """A grid of equal cuboids; `included` says which of them count."""

    min_m: Array  # (3,) the grid's lower corner in the vehicle frame
    max_m: Array  # (3,) its upper corner
    included: NDArray[np.bool_]  # (nx, ny, nz)
    cut: Cut | None = None  # None: nothing was cut out

    @classmethod
    def from_boxes(
        cls,
        min_m: ArrayLike,
        max_m: ArrayLike,
        cuboid_m: ArrayLike,
        exclude: tuple[tuple[ArrayLike, ArrayLike], ...] = (),
    ) -> "Region":
        """The box from min to max cut into cuboids; those whose centre is in an excluded box are excluded.

        A centre c lies in an excluded box when min <= c < max on every axis.
        """
        low, high = np.asarray(min_m, np.float64), np.asarray(max_m, np.float64)
        shape = np.rint((high - low) / np.asarray(cuboid_m, np.float64)).astype(int)
        region = cls(low, high, np.ones(shape, bool))
        for box_min, box_max in exclude:
            inside = [
                (least <= centre) & (centre < most)
                for least, most, centre in zip(np.asarray(box_min), np.asarray(box_max), region.centres(), strict=True)
            ]
            region.included[np.ix_(*inside)] = False
        return region

    @classmethod
    def from_file(cls, file: RegionFile) -> "Region":
        """The region that a study file describes. Raises LidarcfgError where memory does not hold its evaluation."""
        boxes = tuple((box.min_m, box.max_m) for box in file.exclude)
        cuboids = math.prod(round((file.max_m[axis] - file.min_m[axis]) / file.cuboid_m[axis]) for axis in range(3))
        reserved = CUBOID_ADDRESSES * cuboids
        check_memory(f"a region of {cuboids:,} cuboids", CUBOID_BYTES * cuboids, "use larger cuboids", reserved)
        return cls.from_boxes(file.min_m, file.max_m, file.cuboid_m, boxes)

    def without(self, bodies: Vehicle) -> "Region":
        """The region without the cuboids whose centres are inside of a vehicle's excluded bodies."""
        included = self.included.copy()
        for name in bodies.excluded:
            included[bodies.inside(name, *self.centres())] = False
        return Region(self.min_m, self.max_m, included, Cut(bodies, np.packbits(self.included), self.shape))

    def halved(self) -> "Region":
        """The same region with every cuboid divided into eight; bodies are excluded again on the finer grid."""
        coarse = self.cut.included if self.cut else self.included
        fine = Region(self.min_m, self.max_m, coarse.repeat(2, 0).repeat(2, 1).repeat(2, 2))
        return fine.without(self.cut.bodies) if self.cut else fine

    @classmethod
    def from_voxel_grid(cls, grid: "open3d.geometry.VoxelGrid", cuboid_m: ArrayLike | None = None) -> "Region":
        """The region of an Open3D voxel grid: only its voxels count.

        Open3D's voxels are cubes. With `cuboid_m` (3,) the grid is taken for a copy in which every axis was
        scaled so that the cuboids became its cubes, and is scaled back. Raises LidarcfgError where there is none, or
        where memory does not hold all from the first to the last.
        """
        voxels = grid.get_voxels()
        if not voxels:
            raise ConfigError("the voxel grid has no voxels; at least one is needed")
        index = np.array([voxel.grid_index for voxel in voxels], np.int64)
        first, last = index.min(axis=0), index.max(axis=0)
        cuboids = math.prod((last - first + 1).tolist())
        if cuboids > CUBOIDS_MAX:
            what = f"the voxels span {cuboids:,} cuboids"
            raise ConfigError(f"{what}; allowed: at most {CUBOIDS_MAX:,}")
        check_memory(f"a region of {cuboids:,} cuboids", CUBOID_BYTES * cuboids, "use larger voxels")
        scale = np.ones(3) if cuboid_m is None else np.asarray(cuboid_m, np.float64) / grid.voxel_size
        included = np.zeros(last - first + 1, bool)
        included[tuple((index - first).T)] = True
        low = (np.asarray(grid.origin) + first * grid.voxel_size) * scale
        return cls(low, low + included.shape * (grid.voxel_size * scale), included)

    @cached_property
    def excluded_lines(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Which lines along x, y and z have an excluded cuboid: (ny, nz), (nx, nz), (nx, ny)."""
        x, y, z = (np.asarray(~self.included.all(axis=axis)) for axis in range(3))
        return x, y, z

    @property
    def shape(self) -> tuple[int, int, int]:
        """Cuboids along x, y and z."""
        nx, ny, nz = self.included.shape
        return nx, ny, nz

    @property
    def cuboid_m(self) -> Array:
        """(3,) a cuboid's edges."""
        return (self.max_m - self.min_m) / self.shape

    def centres(self) -> tuple[Array, Array, Array]:
        """The cuboids' centres along x, y and z: (nx,), (ny,), (nz,)."""
        x, y, z = (
            low + (np.arange(n) + 0.5) * edge
            for low, edge, n in zip(self.min_m, self.cuboid_m, self.shape, strict=True)
        )
        return x, y, z

    def mesh(self, chosen: NDArray[np.bool_]) -> "open3d.geometry.TriangleMesh":
        """The surface of some cuboids (nx, ny, nz), in metres. Raises ConfigError where there are none."""
        return surface_mesh(self.min_m, self.cuboid_m, chosen)

    def line_set(self, chosen: NDArray[np.bool_]) -> "open3d.geometry.LineSet":
        """The edges of the surface of some cuboids (nx, ny, nz), in metres. Raises ConfigError where there are none."""
        return crease_lines(self.min_m, self.cuboid_m, chosen)

    def voxel_grid(self, index: ArrayLike, rgb: ArrayLike, voxel_m: float | None = None) -> "open3d.geometry.VoxelGrid":
        """Cuboids (N, 3) by their indices as an Open3D voxel grid with colours (N, 3) in 0..1, in true proportions.

        Open3D's voxels are cubes, of the cuboids' least edge unless `voxel_m` gives another. A voxel belongs to the
        cuboid in which its middle lies, so where the edges are no multiples of it, cuboids differ by a voxel. Raises
        LidarcfgError where memory does not hold them, and for an edge that is not above 0.
        """
        edge = float(self.cuboid_m.min()) if voxel_m is None else float(voxel_m)
        if not edge > 0:
            raise ConfigError(f"voxel_m is {edge:g}; allowed: above 0")
        chosen = np.asarray(index, np.int64).reshape(-1, 3)
        shape = np.ceil((self.max_m - self.min_m) / edge - 1e-9).astype(np.int64)
        per_cuboid = float(np.prod(self.cuboid_m / edge))
        check_voxels(math.ceil(len(chosen) * max(per_cuboid, 1.0)))
        number = np.full(self.shape, -1, np.int64)
        number[tuple(chosen.T)] = np.arange(len(chosen))
        of = [
            np.clip(((np.arange(n) + 0.5) * edge / size).astype(np.int64), 0, most - 1)
            for n, size, most in zip(shape, self.cuboid_m, self.shape, strict=True)
        ]
        owner = number[np.ix_(*of)]
        voxels = np.argwhere(owner >= 0)
        colours = np.asarray(rgb, np.float64).reshape(-1, 3)[owner[tuple(voxels.T)]]
        return voxel_grid(self.min_m, voxels, edge, colours, self.min_m + shape * edge)

    def scaled_voxel_grid(self, index: ArrayLike, rgb: ArrayLike) -> "open3d.geometry.VoxelGrid":
        """Cuboids (N, 3) by their indices as an Open3D voxel grid with a voxel for each, and colours (N, 3) in 0..1.

        Open3D's voxels are cubes: unless the cuboids are, the grid is a copy in which y and z are scaled so
        that they become cubes of the cuboids' x edge. `from_voxel_grid` with `cuboid_m` undoes it. Raises LidarcfgError
        where memory does not hold them.
        """
        chosen = np.asarray(index, np.int64).reshape(-1, 3)
        check_voxels(len(chosen))
        edge = float(self.cuboid_m[0])
        scale = edge / self.cuboid_m
        colours = np.asarray(rgb, np.float64).reshape(-1, 3)
        return voxel_grid(self.min_m * scale, chosen, edge, colours, self.max_m * scale)


def cuboids_needed(size_m: tuple[float, ...], cuboid_m: Array) -> tuple[int, int, int]:
    """The number of cuboids that an object of this size needs along x, y and z: rounded up, at least one."""
    x, y, z = (
        int(min(max(np.ceil(size / float(edge) - 1e-9), 1.0), CUBOIDS_MAX))
        for size, edge in zip(size_m, cuboid_m, strict=True)
    )
    return x, y, z
