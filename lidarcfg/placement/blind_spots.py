"""What no LiDAR sees: volumes by how many see them, and how far the blind spot around the vehicle reaches.

Blind is what lies outside the range or the horizontal field of view of every LiDAR, or behind something from each of
them. What lies between two beams, or above and below all of them, is not blind.
"""

# mypy: disallow-untyped-decorators=False
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.region import Region

HEIGHTS_M = (0.25, 0.5, 1.0)  # above the region's floor
AZIMUTHS = 360  # directions, evenly spaced
STEP_M = 0.1  # between two points of a direction: a shorter blind stretch may be missed
STEPS_MAX = 2000  # of a direction; in a region larger than this allows, the steps are longer
BISECTIONS = 7  # a step of 0.1 m is cut down to 0.8 mm
CHUNK = 4096  # points that are looked at together
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]
SeenPoints = Callable[[Array], Bools]  # of points (N, 3) which are seen by any LiDAR


def seen_by_m3(region: Region, seen_by: NDArray[np.integer], lidars: int) -> Array:
    """(lidars + 1,) the volume of the region that exactly 0, 1, 2 … LiDARs see; seen_by (nx, ny, nz)."""
    count = np.bincount(seen_by[region.included], minlength=lidars + 1)
    volume: Array = count * np.prod(region.cuboid_m, dtype=np.float64)
    return volume


def fraction_below(region: Region, seen_by: NDArray[np.integer], least: int) -> float:
    """The fraction of the region's volume that fewer than `least` LiDARs see."""
    of = seen_by[region.included]
    return float(np.count_nonzero(of < least) / of.size)


@dataclass(frozen=True)
class Directions:
    """Level directions around the vehicle at one height, counter-clockwise from x, and the points looked at."""

    region: Region
    height_m: float  # above the region's floor
    center_m: Array  # (2,) the vehicle's reference point
    outline_m: Array  # (AZIMUTHS,) from there to the body's outline from above; 0 without a body
    start_m: Array  # (AZIMUTHS,) the first and the last point in the region that is not within the outline;
    end_m: Array  # end below start where there is none

    @property
    def step_m(self) -> float:
        """Between two points of a direction."""
        return max(STEP_M, float((self.end_m - self.start_m).max()) / STEPS_MAX)

    def points(self, azimuth: Indices, from_center_m: Array) -> Array:
        """(N, 3) the points of some directions at these distances from the reference point."""
        angle = 2 * math.pi / AZIMUTHS * azimuth
        z = np.full(len(angle), self.region.min_m[2] + self.height_m)
        x, y = (c + from_center_m * f(angle) for c, f in zip(self.center_m, (np.cos, np.sin), strict=True))
        return np.stack([x, y, z], axis=1)

    def blind(self, azimuth: Indices, from_center_m: Array, seen: SeenPoints) -> Bools:
        """(N,) which of these points no LiDAR sees; what is excluded from the region is not blind."""
        points = self.points(azimuth, from_center_m)
        cell = ((points - self.region.min_m) / self.region.cuboid_m).astype(np.int64)
        i, j, k = np.clip(cell, 0, np.array(self.region.shape) - 1).T
        out: Bools = self.region.included[i, j, k].copy()
        out[out] = ~seen(points[out])
        return out


@dataclass(frozen=True)
class Order:
    """Points of directions, see `farthest`."""

    azimuth: Indices  # (N,) which direction
    number: Indices  # (N,) the how manieth of it
    distance_m: Array  # (N,) from the body's outline, descending

    def at(self, around: Directions, points: Indices) -> Array:
        """(n,) how far some of the points are from the reference point."""
        return _at(around, self.azimuth[points], self.number[points])


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
    def area_m2(self) -> float:
        """Of what lies between the body's outline and the contour."""
        inner, distance = self.directions.outline_m, np.nan_to_num(self.distance_m)
        return float((((inner + distance) ** 2 - inner**2) * (math.pi / AZIMUTHS)).sum())


def directions(region: Region, center_m: Array, outline_m: Array, height_m: float) -> Directions:
    """The directions about a point (2,) at a height above the region's floor, beyond an outline (AZIMUTHS,)."""
    angle = 2 * math.pi / AZIMUTHS * np.arange(AZIMUTHS)
    enter, leave = np.zeros(AZIMUTHS), np.full(AZIMUTHS, np.inf)
    for axis, along in enumerate((np.cos(angle), np.sin(angle))):
        walls = np.array([region.min_m[axis], region.max_m[axis]]) - center_m[axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = walls[:, None] / np.where(abs(along) < 1e-12, 0.0, along)
        inside = walls[0] <= 0 <= walls[1]  # for a direction along the walls
        enter = np.maximum(enter, np.where(abs(along) < 1e-12, 0.0 if inside else np.inf, np.fmin(first, second)))
        leave = np.minimum(leave, np.where(abs(along) < 1e-12, np.inf, np.fmax(first, second)))
    start = np.maximum(enter, outline_m)
    return Directions(region, height_m, center_m, outline_m, start, np.where(start <= leave, leave, -np.inf))


def contour(around: Directions, seen: SeenPoints) -> Contour:
    """The blind-spot contour: points every `step_m` from the region's edge inwards, the last blind one refined.

    It is too large by at most step_m / 2**BISECTIONS, and too small where a blind stretch shorter than step_m was
    missed.
    """
    known = around.end_m >= around.start_m
    azimuth, number = _points(around)
    blind = around.blind(azimuth, _at(around, azimuth, number), seen)
    farthest = np.full(AZIMUTHS, -1)
    np.maximum.at(farthest, azimuth[blind], number[blind])
    distance = _refined(around, np.arange(AZIMUTHS), farthest, seen) - around.outline_m
    distance = np.where(farthest < 0, 0.0, distance)
    edge = (farthest >= 0) & (farthest == _last(around))
    return Contour(around, np.where(known, distance, np.nan), edge)


def farthest(around: Directions) -> Order:
    """The points of all directions, those that are farthest from the body's outline first."""
    azimuth, number = _points(around)
    distance = _at(around, azimuth, number) - around.outline_m[azimuth]
    order = np.argsort(-distance, kind="stable")
    return Order(azimuth[order], number[order], distance[order])


def largest_m(
    around: Directions, order: Order, seen: SeenPoints, limit: float = math.inf, first: Indices | None = None
) -> tuple[float, int]:
    """The largest distance of `contour`, and the point of `order` that shows it; −1 where nothing is blind.

    Or, as soon as some point from `limit` up is found blind, its distance; those in `first` are looked at first.
    """
    if first is not None and len(first := first[order.distance_m[first] >= limit]):
        blind = first[around.blind(order.azimuth[first], order.at(around, first), seen)]
        if len(blind):
            return float(order.distance_m[blind[0]]), int(blind[0])
    found = np.empty(0, np.int64)
    for begin in range(0, len(order.azimuth), CHUNK):
        some = np.arange(begin, min(begin + CHUNK, len(order.azimuth)))
        if len(found):  # what is nearer by a step cannot end farther out
            some = some[order.distance_m[some] > order.distance_m[found[0]] - around.step_m]
        blind = some[around.blind(order.azimuth[some], order.at(around, some), seen)]
        found = np.concatenate([found, blind])
        if len(found) and order.distance_m[found[0]] >= limit:
            return float(order.distance_m[found[0]]), int(found[0])
        if len(some) < CHUNK:
            break
    if not len(found):
        return 0.0, -1
    ends = _refined(around, order.azimuth[found], order.number[found], seen) - around.outline_m[order.azimuth[found]]
    return float(ends.max()), int(found[ends.argmax()])


def _last(around: Directions) -> Indices:
    """(AZIMUTHS,) the number of the last point of each direction; −1 where there is none."""
    length = around.end_m - around.start_m
    known = length >= 0
    return np.where(known, np.ceil(np.where(known, length, 0.0) / around.step_m), -1).astype(np.int64)


def _points(around: Directions) -> tuple[Indices, Indices]:
    """(N,) direction and number of every point, by direction, outwards."""
    counts = _last(around) + 1
    azimuth = np.repeat(np.arange(AZIMUTHS), counts)
    return azimuth, np.arange(len(azimuth)) - np.repeat(np.cumsum(counts) - counts, counts)


def _at(around: Directions, azimuth: Indices, number: Indices) -> Array:
    """(N,) how far points are from the reference point; the last of a direction lies on the region's edge."""
    at: Array = np.minimum(around.start_m[azimuth] + number * around.step_m, around.end_m[azimuth])
    return at


def _refined(around: Directions, azimuth: Indices, number: Indices, seen: SeenPoints) -> Array:
    """(N,) how far from the reference point what is blind at these points ends, towards the next one."""
    near, far = _at(around, azimuth, number), _at(around, azimuth, number + 1)
    open_ = (number >= 0) & (far > near)
    for _ in range(BISECTIONS):
        middle = (near + far) / 2
        blind = around.blind(azimuth[open_], middle[open_], seen)
        near[open_] = np.where(blind, middle[open_], near[open_])
        far[open_] = np.where(blind, far[open_], middle[open_])
    return far


def outline_m(center_m: Array, vertices_m: Array, triangles: Indices) -> Array:
    """(AZIMUTHS,) from a point (2,) to the outline from above of vertices (V, 3) and triangles (T, 3); 0 beside it."""
    flat = vertices_m[:, :2] - center_m
    edges = np.concatenate([triangles[:, (0, 1)], triangles[:, (1, 2)], triangles[:, (2, 0)]])
    out = np.zeros(AZIMUTHS)
    _widen(flat[edges[:, 0]], flat[edges[:, 1]], out)
    return out


@njit(cache=True, nogil=True)
def _widen(ends: Array, others: Array, out: Array) -> None:
    """Raise `out` (directions,) to where the rays from the origin cross the segments between points (E, 2) each."""
    step = 2 * math.pi / out.size
    for e in range(len(ends)):
        (px, py), (qx, qy) = ends[e], others[e]
        first = math.atan2(py, px)
        turn = math.atan2(px * qy - py * qx, px * qx + py * qy)  # from one end to the other, less than half around
        low, high = min(first, first + turn), max(first, first + turn)
        for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
            cosine, sine = math.cos(k * step), math.sin(k * step)
            across = cosine * (qy - py) - sine * (qx - px)
            if across != 0.0:
                distance = (px * qy - py * qx) / across
            else:  # the segment lies along the ray
                distance = max(cosine * px + sine * py, cosine * qx + sine * qy)
            out[k % out.size] = max(out[k % out.size], distance)
