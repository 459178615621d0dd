"""The analytic measure: volume to surface of the subspaces themselves, and not of their cuboids.

Straight lines run through the region along x, y and z, LINES² of them to a cuboid's face. Where a line crosses a
cone is known in closed form, and so is the cone's normal n there. What lies between two crossings has the same digits
all along; it hands its length to its subspace's volume, and at either end |n·e|, e the line's direction, to its
surface; the walls of the region and of exclusions count 1. The three directions' lines add up to the area, for
|n_x|² + |n_y|² + |n_z|² = 1 and an area's projection along e is |n·e| of it. Every crossing counts, so it makes no odds
how many cones pass between two centres, nor where an apex lies: a line through it just ends one piece there.

Which pieces belong together is the grid's to say (`segment`): a piece belongs to the subspaces of its own digits whose
centres lie in its own cuboids, or, where it is too thin to hold one, in the cuboids around; if these are several,
they are one, joined by what is thinner than a cuboid. See docs/measure.md.
"""

# mypy: disallow-untyped-decorators=False
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.cones import Lidar, beam_gap, cone_rows
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.region import Region
from lidarcfg.placement.subspace import Subspaces, segment

Counts = NDArray[np.int64]
Labels = NDArray[np.int32]

LINES = 2  # to a cuboid's edge
CUBOIDS_MAX = 50_000_000  # in the finest grid tried
GOLDEN = (5**0.5 - 1) / 2  # the lines' lattice is in step with no cone
PLANE = 1e-9  # a flatter cone, by the sine, is a plane
SLIVER = 1e-9  # of an edge: a shorter piece is rounding's, between cones that coincide


@njit(cache=True, nogil=True, error_model="numpy")
def crossings(u: float, v: float, cones: Array, low: float, high: float, at: Array, weight: Array) -> int:
    """Where the line at (u, v) crosses cones between low and high: `at`, ascending, and |n·e| there; how many.

    cones (lidars, 6 + beams): position and axis in the line's frame (along, u, v), and sines of elevations.
    """
    count = 0
    for cone in cones:
        du, dv, slope = u - cone[1], v - cone[2], cone[3]
        height, distance2 = du * cone[4] + dv * cone[5], du * du + dv * dv  # at the LiDAR's foot on the line
        for beam in range(6, cone.size):
            sine = 0.0 if abs(cone[beam]) < PLANE else cone[beam]
            if not abs(sine) < 1.0:  # a cone closed to its axis
                continue
            root = np.sqrt(height * height + distance2 * (slope * slope - sine * sine))
            for _ in range(1 if sine == 0.0 else 2):
                s = (slope * distance2 * sine - height * root) / (height * sine + slope * root)
                root = -root
                if distance2 == 0.0:
                    s = 0.0
                here = cone[0] + s
                if not low < here < high or (slope * s + height) * sine < 0.0:  # NaN, or the mirrored cone
                    continue
                towards = 0.0
                if distance2 > 0.0:
                    towards = abs(slope - sine * s / np.sqrt(s * s + distance2)) / np.sqrt(1.0 - sine * sine)
                place = count
                while place > 0 and at[place - 1] > here:
                    at[place], weight[place] = at[place - 1], weight[place - 1]
                    place -= 1
                at[place], weight[place] = here, towards
                count += 1
    return count


@njit(cache=True, nogil=True)
def _joined(owner: int, one: int, gap: Counts, digits: Counts, parent: Counts) -> int:
    """The owner of a piece of these digits that touches subspace `one`; both are one from now on if both own it."""
    if one < 0 or one == owner:
        return owner
    for m in range(digits.size):
        if gap[one, m] != digits[m]:
            return owner
    if owner < 0:
        return one
    a, b = owner, one
    while parent[a] != a:
        a = parent[a]
    while parent[b] != b:
        b = parent[b]
    parent[max(a, b)] = min(a, b)
    return owner


@njit(cache=True, nogil=True)
def _owner(label: Labels, gap: Counts, digits: Counts, first: int, last: int, j: int, k: int, parent: Counts) -> int:
    """The subspace of a piece in the cuboids first … last of line (j, k); −1: none has its digits."""
    owner = -1
    for i in range(first, last + 1):
        owner = _joined(owner, label[i, j, k], gap, digits, parent)
    if owner < 0:
        n, nu, nv = label.shape
        for i in range(max(first - 1, 0), min(last + 2, n)):
            for b in range(max(j - 1, 0), min(j + 2, nu)):
                for c in range(max(k - 1, 0), min(k + 2, nv)):
                    owner = _joined(owner, label[i, b, c], gap, digits, parent)
    return owner


class Sums(NamedTuple):
    """What lines along one axis add up, by subspace."""

    volume: Array  # (n,)
    shadow: Array  # (n,)
    surface: Array  # (n,)
    parent: Counts  # (n,) the union-find of subspaces that are one


class Sheaf(NamedTuple):
    """A grid as lines along one axis see it: arrays with that axis first, then the other two in cyclic order."""

    axis: int
    label: Labels
    low: Array  # (3,)
    edge: Array  # (3,)
    cones: Array  # (lidars, 6 + beams) position, axis and sines; NaN where a LiDAR has fewer beams


@njit(cache=True, nogil=True)
def _sweep(sheaf: Sheaf, gap: Counts, rows: Array, sums: Sums) -> None:
    """Add what the lines see of subspaces whose beam gaps are `gap` (n, lidars); rows: cone_rows."""
    label, low, edge, cones = sheaf.label, sheaf.low, sheaf.edge, sheaf.cones
    volume, shadow, surface, parent = sums
    point = np.empty(3)
    n, nu, nv = label.shape
    at, weight = np.empty(2 * cones.size), np.empty(2 * cones.size)
    digits = np.empty(len(cones), np.int64)
    area = edge[1] * edge[2] / LINES**2
    lines = LINES**2 * nu * nv
    for number in range(lines):
        across_u, across_v = nu * (number + 0.5) / lines, nv * ((number * GOLDEN + 0.5) % 1.0)
        j, k = int(across_u), int(across_v)
        u, v = low[1] + across_u * edge[1], low[2] + across_v * edge[2]
        start = 0
        while start < n:
            end = start
            while end < n and label[end, j, k] >= 0:
                end += 1
            here, wall, face = low[0] + start * edge[0], low[0] + end * edge[0], 1.0
            count = crossings(u, v, cones, here, wall, at, weight) if end > start else -1
            for c in range(count + 1):
                there, other = (at[c], weight[c]) if c < count else (wall, 1.0)
                if there - here > SLIVER * edge[0]:
                    point[sheaf.axis], point[(sheaf.axis + 1) % 3], point[(sheaf.axis + 2) % 3] = (
                        0.5 * (here + there),
                        u,
                        v,
                    )
                    for m in range(len(rows)):
                        digits[m] = beam_gap(point[0], point[1], point[2], rows[m])
                    first = max(int((here - low[0]) / edge[0]), start)
                    last = min(int((there - low[0]) / edge[0]), end - 1)
                    owner = _owner(label, gap, digits, first, last, j, k, parent)
                    if owner >= 0:
                        volume[owner] += (there - here) * area
                        shadow[owner] += area
                        surface[owner] += (face + other) * area
                here, face = there, other
            start = end + 1


class Seen(NamedTuple):
    """What the lines see of the n subspaces of a grid."""

    volume: Array  # (3, n) m³, by the axis of the lines
    shadow: Array  # (3, n) m², the pieces of lines times the area of each: a convex body's projections
    surface: Array  # (n,) m²
    whole: Counts  # (n,) the number of the subspace that each is part of

    def joined(self) -> "Seen":
        """The same by wholes; 0 for all that is part of another."""
        n = self.whole.size

        def total(rows: Array) -> Array:
            return np.array([np.bincount(self.whole, row, n) for row in rows], np.float64)

        return Seen(total(self.volume), total(self.shadow), total(self.surface[None])[0], np.arange(n))

    @property
    def volume_m3(self) -> Array:
        """(n,) the mean of the axes', weighted by shadow²: a slab is best seen by lines across it."""
        weight = self.shadow**2
        mean: Array = (self.volume * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), np.finfo(float).tiny)
        return mean

    @property
    def surface_m2(self) -> Array:
        """(n,) no less than 2 |shadow|, which is true of any body: few lines may all graze what they cross."""
        surface: Array = np.maximum(self.surface, 2.0 * np.linalg.norm(self.shadow, axis=0))
        return surface


def integrate(subspaces: Subspaces, lidars: Sequence[Lidar]) -> Seen:
    """Volumes and surfaces of the subspaces that the cones themselves bound."""
    region, n = subspaces.region, len(subspaces)
    beams = np.array([lidar.sin_elevation.size for lidar in lidars], np.int64)
    volume, shadow, surface = np.zeros((3, n)), np.zeros((3, n)), np.zeros(n)
    whole = np.arange(n, dtype=np.int64)
    for axis in range(3):
        order = [axis, (axis + 1) % 3, (axis + 2) % 3]
        cones = np.full((len(lidars), 6 + beams.max(initial=0)), np.nan)
        for m, lidar in enumerate(lidars):
            cones[m, :3], cones[m, 3:6] = lidar.position_m[order], lidar.axis[order]
            cones[m, 6 : 6 + beams[m]] = lidar.sin_elevation
        label, low, edge = subspaces.label.transpose(order), region.min_m[order], region.cuboid_m[order]
        sheaf = Sheaf(axis, label, low, edge, cones)
        _sweep(sheaf, subspaces.gap, cone_rows(lidars), Sums(volume[axis], shadow[axis], surface, whole))
    for j in range(n):  # a part's number is above its whole's
        whole[j] = whole[whole[j]]
    return Seen(volume, shadow, surface, whole)


class Level(NamedTuple):
    """Max VSR by one grid."""

    max_vsr_m: float
    pieces: float  # of lines, in the worst subspace


def level(region: Region, lidars: Sequence[Lidar]) -> Level:
    """Max VSR by one grid. Faces have at most √3 of the area, so what has half the largest by faces is no worst."""
    subspaces = segment(region, lidars)
    parts = integrate(subspaces, lidars)
    seen, faces = parts.joined(), np.zeros(len(subspaces))
    np.maximum.at(faces, parts.whole, vsr_m(subspaces))
    counts = (seen.surface > 0.0) & (faces > 0.5 * faces.max())
    vsr = np.divide(seen.volume_m3, seen.surface_m2, out=np.zeros(faces.size), where=counts)
    worst = int(vsr.argmax())
    area = region.cuboid_m.prod() / region.cuboid_m / LINES**2  # of a line along each axis
    return Level(float(vsr[worst]), float((seen.shadow[:, worst] / area).sum()))


def halved(region: Region) -> Region:
    """The same region with every cuboid cut into eight."""
    return Region(region.min_m, region.max_m, region.included.repeat(2, 0).repeat(2, 1).repeat(2, 2))


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


def analytic(region: Region, lidars: Sequence[Lidar], tolerance: float, cuboids_max: int = CUBOIDS_MAX) -> Analytic:
    """Max VSR to a relative tolerance: the edges are halved until the error bar is within it, or no grid is left.

    The region is the union of its cuboids on every grid. Raises ConfigError where the first halving makes more
    than cuboids_max cuboids already.
    """
    if not tolerance > 0.0:
        raise ConfigError(f"tolerance {tolerance:g}; allowed: above 0")
    if 8 * region.included.size > cuboids_max:
        raise ConfigError(
            f"a tolerance wants half the region's edges, and {8 * region.included.size:,} cuboids; "
            f"allowed: at most {cuboids_max:,}"
        )
    started = time.perf_counter()
    coarse = level(region, lidars)
    while True:
        region = halved(region)
        fine = level(region, lidars)
        found = Analytic(
            fine.max_vsr_m,
            error_bar(coarse, fine),
            tolerance,
            region.cuboid_m.tolist(),
            region.included.size,
            time.perf_counter() - started,
        )
        if found.reached or 8 * region.included.size > cuboids_max:
            return found
        coarse = fine


def error_bar(coarse: Level, fine: Level) -> float:
    """How far the truth may be from fine.max_vsr_m, in metres, by the same on edges twice as long.

    Twice what the last halving changed, and what a lattice of so many lines may err by. Calibrated, not proved: see
    docs/measure.md for how often it holds.
    """
    lattice: float = fine.max_vsr_m / max(fine.pieces, 1.0) ** 0.75
    return 2.0 * abs(fine.max_vsr_m - coarse.max_vsr_m) + lattice
