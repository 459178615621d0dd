"""From which distance on a post beside the vehicle is seen, and where it is lost again, azimuth by azimuth.

A post 0.1 m wide stands upright on the ground; it is seen if at least one beam of a revolution returns from it,
whichever way the sensors' heads point at first. Along each azimuth from the middle of the body's bounds, posts stand
every STEP_M from the outline on. Distances are those of the post's middle from the body.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from lidarcfg import maths
from lidarcfg.geometry import Array, Flags
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.places import StandZone
from lidarcfg.returns.target import box_target
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import Obstacles

AZIMUTHS = 360
STEP_M = 0.05  # between two posts of an azimuth
WIDTH_M = 0.1
RUN_M = 0.5  # without a gap: from its beginning on, a post counts as seen
LIMIT_M = 10.0  # from the body: as far out gaps count


@dataclass(frozen=True)
class PostPlaces:
    """Where posts stand: N steps along each of A azimuths from the outline outwards."""

    body: Footprint
    ground_m: float
    within_m: tuple[float, float]  # of the body
    zone: StandZone | None
    azimuth_deg: Array  # (A,) counter-clockwise from ahead
    places: Array  # (A, N, 4) x, y, the ground's z, heading
    distance_m: Array  # (A, N) from the body
    from_middle_m: Array  # (A, N)
    counts: Flags  # (A, N) which are within the limits

    @cached_property
    def counted(self) -> Array:
        """(P, 4) the places that are within the limits."""
        return np.ascontiguousarray(self.places[self.counts])

    @classmethod
    def around(
        cls,
        body: Footprint,
        ground_m: float,
        within_m: tuple[float, float] = (0.0, LIMIT_M),
        zone: StandZone | None = None,
        azimuth_deg: Array | None = None,
    ) -> "PostPlaces":
        """Around a body, at distances from it, in a zone's sector; along AZIMUTHS, or others (A,)."""
        if azimuth_deg is None:
            return cls.around(body, ground_m, within_m, zone, np.linspace(0.0, 360.0, AZIMUTHS, endpoint=False))
        azimuth: Array = np.radians(azimuth_deg)
        way = np.stack([maths.cos(azimuth), maths.sin(azimuth)], axis=1)
        low, high = body.bounds_m
        diagonal_m = math.dist(low, high)
        beyond = body.middle_m + way * diagonal_m
        lines = shapely.linestrings(np.stack([np.broadcast_to(body.middle_m, beyond.shape), beyond], axis=1))
        inside = shapely.intersection(lines, body.shape)
        start_m = np.zeros(len(azimuth))
        corners, number = shapely.get_coordinates(inside, return_index=True)
        np.maximum.at(start_m, number, np.linalg.norm(corners - body.middle_m, axis=1))
        steps = np.arange(1, math.ceil((within_m[1] + diagonal_m / 2) / STEP_M) + 1)
        from_middle_m = start_m[:, None] + STEP_M * steps
        at = body.middle_m + from_middle_m[..., None] * way[:, None]
        distance_m = body.to_points_m(at.reshape(-1, 2)).reshape(from_middle_m.shape)
        counts = (distance_m >= max(within_m[0], WIDTH_M / 2)) & (distance_m <= within_m[1] + 1e-9)
        if zone:
            counts &= zone.allows(at.reshape(-1, 2)).reshape(counts.shape)
        columns = at[..., 0], at[..., 1], ground_m, azimuth[:, None]
        places = np.stack([np.broadcast_to(column, counts.shape) for column in columns], axis=-1)
        last = int(np.flatnonzero(counts.any(axis=0)).max(initial=0)) + 1
        some = (places[:, :last], distance_m[:, :last], from_middle_m[:, :last], counts[:, :last])
        return cls(body, ground_m, within_m, zone, azimuth_deg, *some)

    def along(self, azimuth_deg: Array) -> "PostPlaces":
        """The same along other azimuths (A,)."""
        return PostPlaces.around(self.body, self.ground_m, self.within_m, self.zone, azimuth_deg)

    @property
    def area(self) -> BaseGeometry:
        """Where a post's middle may be; a sector does not narrow it."""
        least_m, most_m = self.within_m
        return self.body.shape.buffer(most_m).difference(self.body.shape.buffer(max(least_m, WIDTH_M / 2)))

    def standing(self, at_m: Array) -> Array:
        """(n, 4) places of posts at those of some positions (P, 2) that are within the limits."""
        distance_m = self.body.to_points_m(at_m)
        some = (distance_m >= max(self.within_m[0], WIDTH_M / 2)) & (distance_m <= self.within_m[1])
        if self.zone:
            some &= self.zone.allows(at_m)
        x, y = at_m[some].T
        middle_x, middle_y = self.body.middle_m
        azimuth = maths.atan2(y - middle_y, x - middle_x)
        return np.stack([x, y, np.full(len(x), self.ground_m), azimuth], axis=1)


@dataclass(frozen=True)
class PostVisibility:
    """Where a post of one height is seen around the vehicle, by azimuth; NaN where no place of an azimuth counts."""

    height_m: float
    places: PostPlaces
    seen: Flags  # (A, N)

    @classmethod
    def of(cls, height_m: float, places: PostPlaces, counted: Flags) -> "PostVisibility":
        """By whether the post is seen at the places that count (P,)."""
        seen = np.zeros(places.counts.shape, np.bool_)
        seen[places.counts] = counted
        return cls(height_m, places, seen)

    @property
    def limit_m(self) -> float:
        """How far from the body it is looked for."""
        return self.places.within_m[1]

    @property
    def at_m(self) -> Array:
        """(P, 2) the places that count."""
        return self.places.counted[:, :2]

    @property
    def azimuth_deg(self) -> Array:
        """(A,) counter-clockwise from ahead."""
        return self.places.azimuth_deg

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        """(A,) the number of the post at which the first RUN_M without a gap begins; the number of posts: nowhere."""
        count = self.seen.shape[1]
        run = min(round(RUN_M / STEP_M), count)
        seen = self.seen | ~self.places.counts  # what does not count is no gap
        windows = np.lib.stride_tricks.sliding_window_view(seen, run, axis=1).all(axis=2)
        windows = windows & self.places.counts[:, : windows.shape[1]]
        first: NDArray[np.int64] = np.where(windows.any(axis=1), windows.argmax(axis=1), count)
        return first

    @property
    def known(self) -> Flags:
        """(A,) the azimuths with any place that counts."""
        return np.asarray(self.places.counts.any(axis=1))

    @property
    def first_seen_m(self) -> Array:
        """(A,) the distance from the body at which the first RUN_M without a gap begins; inf: nowhere."""
        never = self._first >= self.seen.shape[1]
        at = np.take_along_axis(self.places.distance_m, np.where(never, 0, self._first)[:, None], axis=1)[:, 0]
        begins = self._first == self.places.counts.argmax(axis=1)  # at the nearest post: seen from the body on
        at = np.where(begins, self._nearest_m, at)
        return np.where(self.known, np.where(never, np.inf, at), np.nan)

    @property
    def _nearest_m(self) -> Array:
        """(A,) how near the body a place may be: 0 where the first one touches it."""
        first = self.places.counts.argmax(axis=1)
        at = np.take_along_axis(self.places.distance_m, first[:, None], axis=1)[:, 0]
        return np.where(first == 0, 0.0, at)

    @cached_property
    def gaps(self) -> Flags:
        """(A, N) the posts beyond the first that is seen that are not seen."""
        beyond = np.arange(self.seen.shape[1]) > self._first[:, None]
        return np.asarray(beyond & self.places.counts & ~self.seen)

    @cached_property
    def _longest(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(A,) each: the number of posts in the longest gap, and that of its first post."""
        length = np.zeros(len(self.gaps), np.int64)
        first = np.zeros(len(self.gaps), np.int64)
        running = np.zeros(len(self.gaps), np.int64)
        for n in range(self.gaps.shape[1]):
            running = np.where(self.gaps[:, n], running + 1, 0)
            first = np.where(running > length, n - running + 1, first)
            length = np.maximum(length, running)
        return length, first

    @property
    def longest_gap_m(self) -> Array:
        """(A,) the longest stretch beyond the first sight where the post is not seen; 0: none."""
        return np.where(self.known, self._longest[0] * STEP_M, np.nan)

    @property
    def longest_gap_at_m(self) -> Array:
        """(A,) the distance from the body at which it begins; NaN: there is none."""
        at = np.take_along_axis(self.places.distance_m, self._longest[1][:, None], axis=1)[:, 0]
        return np.where(self._longest[0] > 0, at, np.nan)

    @property
    def seen_to_m(self) -> Array:
        """(A,) the distance from the body up to which it has no gap after the first sight; 0: it is never seen."""
        rows = np.arange(len(self.gaps))
        ends = np.where(self.gaps.any(axis=1), self.gaps.argmax(axis=1), self.gaps.shape[1]) - 1
        at = self.places.distance_m[rows, np.clip(ends, 0, None)]
        at = np.where(self.gaps.any(axis=1), at, self.limit_m)
        return np.where(self.known, np.where(np.isinf(self.first_seen_m), 0.0, at), np.nan)

    def is_seen_beside(self, places: Array) -> Flags:
        """(P,) whether a post along an azimuth next to a place (P, 4), as far out, is seen or out of the limits."""
        count = len(self.azimuth_deg)
        turn = np.degrees(places[:, 3]) % 360 * (count / 360)
        from_middle_m = np.linalg.norm(places[:, :2] - self.places.body.middle_m, axis=1)
        fine = self.seen | ~self.places.counts
        found = np.zeros(len(places), np.bool_)
        for side in (0, 1):
            row = (turn.astype(np.intp) + side) % count
            number = np.rint((from_middle_m - self.places.from_middle_m[row, 0]) / STEP_M).astype(np.intp)
            found |= (number < 0) | (number >= fine.shape[1]) | fine[row, np.clip(number, 0, fine.shape[1] - 1)]
        return found

    @property
    def summary(self) -> str:
        """Where it is seen, in words."""
        finite = self.first_seen_m[np.isfinite(self.first_seen_m)]
        everywhere = len(finite) == int(self.known.sum())
        first = (
            f"first seen at most {finite.max():.2f} m from the body" if everywhere else "never seen at some azimuths"
        )
        beyond = f"longest gap beyond {np.nanmax(self.longest_gap_m):.2f} m, {self.gap_share:.2%} of the area are gaps"
        return f"{first}, {beyond}, seen without gaps to {np.nanmin(self.seen_to_m):.2f} m"

    @property
    def gap_share(self) -> float:
        """The share of gaps in the area beyond the first sight, by azimuth, up to the limit."""
        beyond = (np.arange(self.seen.shape[1]) > self._first[:, None]) & self.places.counts
        area = float(self.places.from_middle_m[beyond].sum())
        return float(self.places.from_middle_m[self.gaps].sum()) / area if area else 0.0


def post_visibility(
    posts: PostPlaces,
    height_m: float,
    mounts: Sequence[Mount],
    obstacles: Obstacles,
    lost: int = 0,
) -> PostVisibility:
    """Where a post of a height is seen by a rig's sensors, also with any `lost` of them lost, place by place."""
    target = box_target((WIDTH_M, WIDTH_M, height_m))
    counts = lowest_at(posts.counted, target, mounts, obstacles, 1, lost + 1).counts
    return PostVisibility.of(height_m, posts, (counts > 0).sum(axis=1) > lost)
