"""What no LiDAR sees: volumes by the number of LiDARs that see them, and the blind spot around the vehicle.

Blind is what lies outside the range or the horizontal field of view of every LiDAR, or behind something from each of
them. What lies between two beams, or above and below all of them, is not blind.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core, maths
from lidarcfg.geometry import Array
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.region import Region
from lidarcfg.placement.visibility import Visibility

HEIGHTS_M = (0.25, 0.5, 1.0)  # above the region's floor
AZIMUTHS = 360  # directions, evenly spaced
STEP_M = 0.1  # between two points of a direction: a shorter blind stretch may be missed
STEPS_MAX = 2000  # of a direction; in a region larger than this allows, the steps are longer
BISECTIONS = 7  # a step of 0.1 m is cut down to 0.8 mm
CHUNK = 4096  # points tested together
NONE = np.empty(0, np.int64)
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]
SeenPoints = Callable[[Array], Bools]  # of points (N, 3) which are seen by any LiDAR


def seen_by_m3(region: Region, seen_by: NDArray[np.integer] | None, lidars: int) -> Array:
    """(lidars + 1,) the volume of the region that exactly 0, 1, 2 … LiDARs see; seen_by (nx, ny, nz), None: all."""
    count = np.zeros(lidars + 1, np.int64)
    if seen_by is None:
        count[lidars] = np.count_nonzero(region.included)
    else:
        for number in range(1, lidars + 1):
            count[number] = sum(np.count_nonzero(layer == number) for layer in seen_by)
        count[0] = np.count_nonzero(region.included) - count.sum()  # what is excluded is seen by none, too
    volume: Array = count * np.prod(region.cuboid_m, dtype=np.float64)
    return volume


def fraction_below(region: Region, seen_by: NDArray[np.integer], least: int) -> float:
    """The fraction of the region's volume that fewer than `least` LiDARs see; `seen_by` (nx, ny, nz) counts them."""
    below = (seen_by < least) & region.included
    return float(np.count_nonzero(below) / np.count_nonzero(region.included))


@dataclass(frozen=True)
class Directions:
    """Level directions around the vehicle at one height, counter-clockwise from x, and the points looked at."""

    region: Region
    height_m: float  # above the region's floor
    center_m: Array  # (2,) the vehicle's reference point
    outline_m: Array  # (AZIMUTHS,) from there to the body's outline from above; 0 without a body
    start_m: Array  # (AZIMUTHS,) the first and the last point in the region that is not within the outline;
    end_m: Array  # end below start where there is none

    @cached_property
    def step_m(self) -> float:
        """The distance between neighbouring points of a direction."""
        return max(STEP_M, float((self.end_m - self.start_m).max()) / STEPS_MAX)

    def points(self, azimuth: Indices, from_center_m: Array) -> Array:
        """(N, 3) the points of some directions at these distances from the reference point."""
        angle = 2 * math.pi / AZIMUTHS * azimuth
        z = np.full(len(angle), self.region.min_m[2] + self.height_m)
        x = self.center_m[0] + from_center_m * maths.cos(angle)
        y = self.center_m[1] + from_center_m * maths.sin(angle)
        return np.stack([x, y, z], axis=1)

    def counts(self, points: Array) -> Bools:
        """(N,) which points (N, 3) are not excluded from the region."""
        cell = ((points - self.region.min_m) / self.region.cuboid_m).astype(np.int64)
        i, j, k = np.clip(cell, 0, np.array(self.region.shape) - 1).T
        out: Bools = self.region.included[i, j, k]
        return out

    @cached_property
    def last(self) -> Indices:
        """(AZIMUTHS,) the number of the last point of each direction; −1 where there is none."""
        length = self.end_m - self.start_m
        known = length >= 0
        return np.where(known, np.ceil(np.where(known, length, 0.0) / self.step_m), -1).astype(np.int64)

    def at(self, azimuth: Indices, number: Indices) -> Array:
        """(N,) how far points are from the reference point; the last of a direction lies on the region's edge."""
        at: Array = np.minimum(self.start_m[azimuth] + number * self.step_m, self.end_m[azimuth])
        return at


@dataclass(frozen=True)
class Points:
    """The points that are tested for visibility; see `looked_at`."""

    azimuth: Indices  # (N,) which direction
    number: Indices  # (N,) the point's number in its direction, counted outwards
    distance_m: Array  # (N,) from the body's outline
    xyz: Array  # (N, 3)


@dataclass(frozen=True)
class Contour:
    """For each azimuth the distance from the body beyond which at least one LiDAR sees everything, at one height."""

    directions: Directions
    distance_m: Array  # (AZIMUTHS,) from the body's outline; NaN where the direction has no part of the region
    reaches_edge: Bools  # (AZIMUTHS,) blind at the region's edge, so that the distance is that to the edge

    @property
    def azimuth_deg(self) -> Array:
        """(AZIMUTHS,) counter-clockwise from x."""
        return np.arange(AZIMUTHS, dtype=np.float64) * (360.0 / AZIMUTHS)

    @property
    def largest_m(self) -> float:
        """Over all azimuths; 0 where the region has none of them."""
        return float(np.nan_to_num(self.distance_m).max())

    @property
    def largest_at_deg(self) -> float:
        """The azimuth of the largest distance."""
        return float(self.azimuth_deg[int(np.nan_to_num(self.distance_m).argmax())])

    @property
    def largest_reaches_edge(self) -> bool:
        """Whether the largest distance ends at the region's edge."""
        return bool(self.reaches_edge[int(np.nan_to_num(self.distance_m).argmax())])

    @property
    def area_m2(self) -> float:
        """The area between the body's outline and the contour."""
        inner = self.directions.outline_m
        distance = np.nan_to_num(self.distance_m)
        return float((((inner + distance) ** 2 - inner**2) * (math.pi / AZIMUTHS)).sum())


@dataclass(frozen=True)
class BlindSpots:
    """The volume of a region by the number of LiDARs that see it, and the blind-spot contours around the vehicle."""

    seen_by_m3: Array  # (LiDARs + 1,) the volume that exactly 0, 1, 2 … LiDARs see
    contours: tuple[Contour, ...]  # by height, ascending; none where every LiDAR sees everything

    @property
    def volume_m3(self) -> float:
        """The volume that no LiDAR sees."""
        return float(self.seen_by_m3[0])


def directions(region: Region, center_m: Array, outline_m: Array, height_m: float) -> Directions:
    """The directions about a point (2,) at a height above the region's floor, beyond an outline (AZIMUTHS,)."""
    angle = 2 * math.pi / AZIMUTHS * np.arange(AZIMUTHS)
    enter, leave = np.zeros(AZIMUTHS), np.full(AZIMUTHS, np.inf)
    for axis, along in enumerate((maths.cos(angle), maths.sin(angle))):
        walls = np.array([region.min_m[axis], region.max_m[axis]]) - center_m[axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = walls[:, None] / np.where(abs(along) < 1e-12, 0.0, along)
        inside = walls[0] <= 0 <= walls[1]  # for a direction along the walls
        enter = np.maximum(enter, np.where(abs(along) < 1e-12, 0.0 if inside else np.inf, np.fmin(first, second)))
        leave = np.minimum(leave, np.where(abs(along) < 1e-12, np.inf, np.fmax(first, second)))
    start = np.maximum(enter, outline_m)
    return Directions(region, height_m, center_m, outline_m, start, np.where(start <= leave, leave, -np.inf))


def seen_by_any(visibility: Visibility, lidars: Sequence[Lidar]) -> SeenPoints:
    """Which points at least one of the LiDARs sees."""

    def seen(points: Array) -> Bools:
        out = np.zeros(len(points), np.bool_)
        for lidar in lidars:
            rest = np.flatnonzero(~out)
            out[rest] = visibility.seen_points(points[rest], lidar)
        return out

    return seen


def looked_at(around: Directions) -> Points:
    """The included points of all directions, farthest from the body's outline first, in groups of CHUNK.

    Within a group they are sorted by direction: visibility is computed fastest for points in one direction.
    """
    counts = around.last + 1
    azimuth = np.repeat(np.arange(AZIMUTHS), counts)
    number = np.arange(len(azimuth)) - np.repeat(np.cumsum(counts) - counts, counts)
    at = around.at(azimuth, number)
    kept = np.flatnonzero(around.counts(around.points(azimuth, at)))
    distance = at - around.outline_m[azimuth]
    outside_in = kept[np.argsort(-distance[kept], kind="stable")]
    order = np.concatenate(
        [np.sort(outside_in[first : first + CHUNK]) for first in range(0, len(kept), CHUNK)] or [kept]
    )
    return Points(azimuth[order], number[order], distance[order], around.points(azimuth[order], at[order]))


def contour(around: Directions, seen: SeenPoints) -> Contour:
    """The blind-spot contour: the last blind point of each direction, refined by bisection.

    It is too large by at most step_m / 2**BISECTIONS. It is too small where a blind stretch shorter than step_m lies
    between two points.
    """
    points = looked_at(around)
    blind = ~seen(points.xyz)
    farthest = np.full(AZIMUTHS, -1)
    np.maximum.at(farthest, points.azimuth[blind], points.number[blind])
    end = _refined(around, np.arange(AZIMUTHS), farthest, seen)
    distance = np.where(farthest < 0, 0.0, end - around.outline_m)
    edge = (farthest >= 0) & (farthest == around.last)
    return Contour(around, np.where(around.last < 0, np.nan, distance), edge)


def largest_m(
    around: Directions, points: Points, seen: SeenPoints, limit: float = math.inf, first: Indices = NONE
) -> tuple[float, int]:
    """The largest distance of `contour`, and the number of its point; 0 and −1 where nothing is blind.

    Stops at the first blind point at least `limit` away and returns its distance; the points `first` are tested first.
    """
    far = points.distance_m
    some = first[far[first] >= limit]
    blind = some[~seen(points.xyz[some])]
    if len(blind):
        return float(far[blind[0]]), int(blind[0])
    found = NONE
    best = -math.inf
    for begin in range(0, len(far), CHUNK):
        some = np.arange(begin, min(begin + CHUNK, len(far)))
        some = some[far[some] > best - around.step_m]  # what is nearer by a step cannot end farther out
        if not len(some):
            break
        found = np.concatenate([found, some[~seen(points.xyz[some])]])
        best = float(far[found].max(initial=-math.inf))
        if best >= limit:
            return best, int(found[far[found].argmax()])
    if not len(found):
        return 0.0, -1
    ends = _refined(around, points.azimuth[found], points.number[found], seen) - around.outline_m[points.azimuth[found]]
    return float(ends.max()), int(found[ends.argmax()])


def _refined(around: Directions, azimuth: Indices, number: Indices, seen: SeenPoints) -> Array:
    """(N,) distances from the reference point at which blind stretches end, between these points and the next ones."""
    near, far = around.at(azimuth, number), around.at(azimuth, number + 1)
    open_ = (number >= 0) & (far > near)
    for _ in range(BISECTIONS):
        middle = (near + far) / 2
        points = around.points(azimuth[open_], middle[open_])
        blind = around.counts(points) & ~seen(points)
        near[open_] = np.where(blind, middle[open_], near[open_])
        far[open_] = np.where(blind, far[open_], middle[open_])
    return far


def outline_m(center_m: Array, vertices_m: Array, triangles: Indices) -> Array:
    """(AZIMUTHS,) from a point (2,) to the outline from above of vertices (V, 3) and triangles (T, 3); 0 beside it."""
    out = np.zeros(AZIMUTHS)
    core.visibility.trace_outline(vertices_m[:, :2] - center_m, triangles, out)
    return out
