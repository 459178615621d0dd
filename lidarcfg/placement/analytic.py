"""The analytic measure: volume to surface of the subspaces themselves, not of their cuboids.

Straight lines run through the region along x, y and z, LINES_PER_EDGE² of them to a cuboid's face. Where a line crosses
a cone is known in closed form, and so is the cone's normal n there. What lies between two crossings has the same digits
all along; it hands its length to its subspace's volume, and at either end |n·e|, e the line's direction, to its
surface; the walls of the region and of exclusions count 1. The three directions' lines add up to the area, for
|n_x|² + |n_y|² + |n_z|² = 1 and an area's projection along e is |n·e| of it. Every crossing counts, so it makes no odds
how many cones pass between two centres, nor where an apex lies: a line through it just ends one piece there.

Where something limits what a LiDAR sees, lines are cut where its sight begins and ends too, with the normal of what
bounds it (boundaries.py), and its cones cut only what it sees. Bodies end the region at their own surfaces.

Which pieces belong together is the grid's to say (`segment`): a piece belongs to the subspaces of its own digits whose
centres lie in its own cuboids, or, where it is too thin to hold one, in the cuboids around; if these are several,
they are one, joined by what is thinner than a cuboid. See docs/measure.md.
"""

import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import analytic as core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory, memory_bytes
from lidarcfg.placement.boundaries import Boundaries, Counts, Flags, Lattice, axes_from
from lidarcfg.placement.cones import Lidar, cone_rows
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.region import Region
from lidarcfg.placement.subspace import Subspaces, segment
from lidarcfg.placement.visibility import Visibility

CUBOIDS_MAX = 50_000_000  # in the finest grid tried
CUBOID_BYTES = 30  # of memory for one of it


class Sheaf(NamedTuple):
    """A grid as lines along one axis see it: arrays with that axis first, then the other two in cyclic order."""

    axis: int
    label: NDArray[np.int32]
    within: Flags  # of the region, or cut by a body that is not
    low: Array  # (3,)
    edge: Array  # (3,)
    cones: Array  # (lidars, 6 + beams) position, axis and sines; NaN where a LiDAR has fewer beams


class Sums(NamedTuple):
    """What lines along one axis add up, by subspace."""

    volume: Array  # (n,)
    shadow: Array  # (n,)
    surface: Array  # (n,)
    parent: Counts  # (n,) the union-find of subspaces that are one


class Seen(NamedTuple):
    """The lines' view of the n subspaces of a grid."""

    volume: Array  # (3, n) m³, by the axis of the lines
    shadow: Array  # (3, n) m², the pieces of lines times the area of each: a convex body's projections
    surface: Array  # (n,) m²
    whole: Counts  # (n,) the number of the subspace that each is part of

    def joined(self) -> "Seen":
        """The sums of whole subspaces; those of parts that belong to another one are 0."""
        n = self.whole.size

        def total(rows: Array) -> Array:
            return np.array([np.bincount(self.whole, row, n) for row in rows], np.float64)

        return Seen(total(self.volume), total(self.shadow), total(self.surface[None])[0], np.arange(n))

    @property
    def volume_m3(self) -> Array:
        """(n,) the mean over the axes, weighted by shadow²: lines across a slab measure it best."""
        weight = self.shadow**2
        mean: Array = (self.volume * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), np.finfo(float).tiny)
        return mean

    @property
    def surface_m2(self) -> Array:
        """(n,) at least 2 |shadow|, as for any body: where lines are few, all of them may graze a subspace."""
        surface: Array = np.maximum(self.surface, 2.0 * np.linalg.norm(self.shadow, axis=0))
        return surface


def integrate(
    subspaces: Subspaces,
    lidars: Sequence[Lidar],
    visibility: Visibility | None = None,
    boundaries: Boundaries | None = None,
) -> Seen:
    """Volumes and surfaces of the subspaces that the cones themselves bound, and the bounds of what LiDARs see.

    boundaries: of these LiDARs, if known; they are the same on every grid.
    """
    region = subspaces.region
    n = len(subspaces)
    beams = np.array([lidar.sin_elevation.size for lidar in lidars], np.int64)
    volume = np.zeros((3, n))
    shadow = np.zeros((3, n))
    surface = np.zeros(n)
    whole = np.arange(n, dtype=np.int64)
    uncut = region.cut.included if region.cut else region.included
    boundaries = boundaries or Boundaries(region, lidars, visibility)
    with ThreadPoolExecutor() as pool:
        sweeps: list[Future[None]] = []  # each while the next axis's lines are cut
        for axis in range(3):
            order = axes_from(axis)
            cones = np.full((len(lidars), 6 + beams.max(initial=0)), np.nan)
            for m, lidar in enumerate(lidars):
                cones[m, :3] = lidar.position_m[order]
                cones[m, 3:6] = lidar.axis[order]
                cones[m, 6 : 6 + beams[m]] = lidar.sin_elevation
            label = np.ascontiguousarray(subspaces.label.transpose(order))
            within = np.ascontiguousarray(uncut.transpose(order))
            lattice = Lattice(axis, region.min_m[order], region.cuboid_m[order], label.shape)
            flips = boundaries.flips(lattice, pool)
            sheaf = Sheaf(axis, label, within, lattice.low, lattice.edge, cones)
            sums = Sums(volume[axis], shadow[axis], surface, whole)
            for one in sweeps:  # they add to the same surfaces
                one.result()
            sweeps.append(pool.submit(core.sweep_lines, sheaf, subspaces.gap, cone_rows(lidars), flips, sums))
        sweeps[-1].result()
    for j in range(n):  # a part's number is above its whole's
        whole[j] = whole[whole[j]]
    return Seen(volume, shadow, surface, whole)


class Level(NamedTuple):
    """Max VSR on one grid."""

    max_vsr_m: float
    pieces: float  # of lines, in the worst subspace


def level(
    region: Region,
    lidars: Sequence[Lidar],
    visibility: Visibility | None = None,
    boundaries: Boundaries | None = None,
) -> Level:
    """Max VSR on one grid. Faces have at most √3 times the area: what is below half the largest is not the worst."""
    subspaces = segment(region, lidars, visibility)
    parts = integrate(subspaces, lidars, visibility, boundaries)
    seen = parts.joined()
    faces = np.zeros(len(subspaces))
    np.maximum.at(faces, parts.whole, vsr_m(subspaces))
    counts = (seen.surface > 0.0) & (faces > 0.5 * faces.max())
    vsr = np.divide(seen.volume_m3, seen.surface_m2, out=np.zeros(faces.size), where=counts)
    worst = int(vsr.argmax())
    area = region.cuboid_m.prod() / region.cuboid_m / core.LINES_PER_EDGE**2  # of a line along each axis
    return Level(float(vsr[worst]), float((seen.shadow[:, worst] / area).sum()))


@dataclass(frozen=True)
class Analytic:
    """Max VSR of the subspaces themselves."""

    max_vsr_m: float
    error_m: float  # the truth lies within this of it, in 95 of 100 cases
    tolerance: float  # asked for, relative
    cuboid_m: list[float]  # (3,) of the finest grid tried
    cuboids: int  # in it
    seconds: float

    @property
    def reached(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error_m <= self.tolerance * self.max_vsr_m


def analytic(
    region: Region,
    lidars: Sequence[Lidar],
    tolerance: float,
    visibility: Visibility | None = None,
    cuboids_max: int = CUBOIDS_MAX,
) -> Analytic:
    """Max VSR to a relative tolerance: the edges are halved until the error bar is within it, or no grid is left.

    The region is the union of its cuboids on every grid. Raises ConfigError where the first halving makes more
    than cuboids_max cuboids already.
    """
    if not tolerance > 0.0:
        raise ConfigError(f"tolerance {tolerance:g}; allowed: above 0")
    if 8 * region.included.size > cuboids_max:
        raise ConfigError(
            f"the tolerance needs cuboids with half the edges, that is {8 * region.included.size:,} cuboids; "
            f"allowed: at most {cuboids_max:,}"
        )
    finer = f"the first grid for a tolerance, of {8 * region.included.size:,} cuboids,"
    check_memory(finer, CUBOID_BYTES * 8 * region.included.size, "use larger cuboids, or no tolerance")
    started = time.perf_counter()
    limited = bool(visibility or region.cut)
    boundaries = Boundaries(region, lidars, visibility)
    coarse = level(region, lidars, visibility, boundaries)
    while True:
        region = region.halved()
        fine = level(region, lidars, visibility, boundaries)
        found = Analytic(
            fine.max_vsr_m,
            error_bar(coarse, fine, limited),
            tolerance,
            region.cuboid_m.tolist(),
            region.included.size,
            time.perf_counter() - started,
        )
        finer_bytes = CUBOID_BYTES * 8 * region.included.size
        if found.reached or 8 * region.included.size > cuboids_max or finer_bytes > memory_bytes():
            return found
        coarse = fine


def error_bar(coarse: Level, fine: Level, limited: bool = False) -> float:
    """The error of fine.max_vsr_m in metres, estimated from the result on cuboids with edges twice as long.

    Twice the change by the last halving, plus the error of a lattice with this many pieces. The latter counts double
    where sight is limited or bodies bound the region, as surfaces then end at more edges. Calibrated, not proved:
    docs/measure.md says how often it holds.
    """
    lattice: float = (2.0 if limited else 1.0) * fine.max_vsr_m / maths.power(max(fine.pieces, 1.0), 0.75)
    return 2.0 * abs(fine.max_vsr_m - coarse.max_vsr_m) + lattice
