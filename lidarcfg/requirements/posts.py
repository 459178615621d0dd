"""From which distance on a post beside the vehicle is seen, and where it is lost again, azimuth by azimuth.

A post 0.1 m wide stands upright on the ground; it is seen if at least one beam of a revolution returns from it,
whichever way the sensors' heads point at first. Along each azimuth from the middle of the body's bounds, posts stand
every STEP_M from the outline on. Distances are those of the post's middle from the body. A verdict also looks along
azimuths on which a narrow shadow of the bodies hides a post between these.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.requirements.margins import MountMargins, with_one_off
from lidarcfg.requirements.robustness import Robust, misplaced
from lidarcfg.requirements.trial_rig import TrialRig
from lidarcfg.requirements.verdict import RequirementVerdict, Sampling, WorstPlace
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import Share, Standing, lowest_at, shares
from lidarcfg.returns.places import Zone
from lidarcfg.returns.silhouettes import Core, Silhouettes, centres_of
from lidarcfg.returns.target import Target, box_target
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import Obstacles

AZIMUTHS = 360
BETWEEN_DEG = 0.05  # apart, azimuths between these
BETWEEN_REACH = 5  # of them on both sides of one on which a post is hidden
BETWEEN_DIGITS = 2  # of their degrees
BETWEEN_MOST = 720
STEP_M = 0.05  # between two posts of an azimuth
WIDTH_M = 0.1
RUN_M = 0.5  # without a gap: from its beginning on, a post counts as seen
LIMIT_M = 10.0  # from the body: as far out gaps count

Flags = NDArray[np.bool_]
Counts = NDArray[np.int32]


@dataclass(frozen=True)
class PostPlaces:
    """Where posts stand: N steps along each of A azimuths from the outline outwards."""

    body: Footprint
    ground_m: float
    within_m: tuple[float, float]  # of the body
    zone: Zone | None
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
        zone: Zone | None = None,
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
    limit_m: float  # from the body
    places: PostPlaces
    seen: Flags  # (A, N)

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
    limit_m: float = LIMIT_M,
    on_places: OnPlaces = no_progress,
) -> PostVisibility:
    """Where a post of a height is seen by a rig's sensors, also with any `lost` of them lost, place by place."""
    target = box_target((WIDTH_M, WIDTH_M, height_m))
    counted = posts.counted
    lowest = lowest_at(counted, target, mounts, obstacles, 1, lost + 1)
    on_places(len(counted))
    seen = np.zeros(posts.counts.shape, np.bool_)
    seen[posts.counts] = (lowest.counts > 0).sum(axis=1) > lost
    return PostVisibility(height_m, limit_m, posts, seen)


@dataclass(frozen=True)
class PostRequirement:
    """A post is seen near the body, and beyond that without long gaps."""

    name: str
    posts: PostPlaces
    height_m: float
    first_seen_at_most_m: float | None
    gap_at_most_m: float | None
    limit_m: float  # from the body
    obstacles: Obstacles
    lost: int = 0
    robust: Robust | None = None

    @cached_property
    def target(self) -> Target:
        """The post."""
        return box_target((WIDTH_M, WIDTH_M, self.height_m))

    def judged_by(self, seen: Flags) -> RequirementVerdict:
        """The verdict on a rig that sees some of the posts that count (P,)."""
        return self.judged_as(self.visibility_of(seen, self.posts))

    def visibility_of(self, seen: Flags, posts: PostPlaces) -> PostVisibility:
        """Where the post is seen, by flags of those posts that count (P,)."""
        flags = np.zeros(posts.counts.shape, np.bool_)
        flags[posts.counts] = seen
        return PostVisibility(self.height_m, self.limit_m, posts, flags)

    def farthest_m(self, seen: Flags) -> Array:
        """(limits,) what each limit is for, at the worst azimuth, if some of the posts that count (P,) are seen."""
        found = self.limits(self.visibility_of(seen, self.posts))
        return np.array([np.nanmax(values_m) for _, _, values_m, _ in found])

    def judged_as(self, seen: PostVisibility, along: PostVisibility | None = None) -> RequirementVerdict:
        """The verdict on where a rig sees posts; `along` the even azimuths, if these are between them."""
        found = [self._verdict(seen, along, *limit) for limit in self.limits(seen)]
        return min(found, key=lambda one: one.relative_margin)

    def limits(self, seen: PostVisibility) -> list[tuple[str, float, Array, Array]]:
        """What is limited, the limit, and (A,) each: the values by azimuth, and the distances at which they are."""
        out = []
        if self.first_seen_at_most_m is not None:
            out.append(("first seen", self.first_seen_at_most_m, seen.first_seen_m, seen.first_seen_m))
        if self.gap_at_most_m is not None:
            gap_m = np.where(np.isinf(seen.first_seen_m), np.inf, seen.longest_gap_m)  # never seen: nothing but a gap
            out.append(("longest gap", self.gap_at_most_m, gap_m, seen.longest_gap_at_m))
        return out

    def _verdict(
        self,
        seen: PostVisibility,
        along: PostVisibility | None,
        what: str,
        limit_m: float,
        values_m: Array,
        at_m: Array,
    ) -> RequirementVerdict:
        """The verdict by one of the two limits."""
        known = np.where(seen.known, values_m, -1.0)
        worst = int(known.argmax())
        value_m = float(known[worst])
        at = float(at_m[worst])
        row = seen.places.distance_m[worst]
        number = int(abs(row - at).argmin()) if math.isfinite(at) else len(row) - 1
        place = seen.places.places[worst, number]
        short = np.where(np.isinf(known), 1.0, np.clip((known - limit_m) / self.limit_m, 0, 1))[seen.known]
        count = int(seen.places.counts.sum())
        if along is None:
            note = f"{what} decides; {seen.summary}"
            shortfall = float(short.mean())
        else:
            note = f"{what} decides, in a narrow shadow between the azimuths; along these {along.summary}"
            shortfall = float(short.mean()) / (len(along.azimuth_deg) + 1)
            count += int(along.places.counts.sum())
        return RequirementVerdict(
            name=self.name,
            kind="post_height_m",
            passed=value_m <= limit_m + 1e-9,
            unit="m",
            demanded=limit_m,
            reached=value_m,
            at_most=True,
            shortfall=shortfall if value_m > limit_m + 1e-9 else 0.0,
            worst=WorstPlace(float(place[0]), float(place[1]), None, float(row[number])),
            sampling=Sampling(count, (STEP_M, STEP_M), STEP_M, azimuths_deg=360.0 / AZIMUTHS, shadows=True),
            notes=(note,),
        )


class PostJudge:
    """Judges rigs by one requirement of a post."""

    is_slow = False

    def __init__(self, item: PostRequirement, share: Share | None = None) -> None:
        """`share`, if given: the posts that count, of which others know, too."""
        self.item = item
        self._share = share or shares([Standing(item.target, item.posts.counted)], item.obstacles)[0]
        self._silhouettes = Silhouettes(item.obstacles)

    def visibility(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> PostVisibility:
        """Where a rig sees the post, also with sensors lost."""
        item = self.item
        return post_visibility(item.posts, item.height_m, mounts, item.obstacles, item.lost, item.limit_m, on_places)

    @property
    def work(self) -> int:
        """The number of places at which rigs are measured, for progress."""
        return int(self.item.posts.counts.sum()) * (1 + (self.item.robust.drawn if self.item.robust else 0))

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        whole, *without = self._verdicts(mounts, on_places)
        found = [whole]
        if self.item.robust and self.item.robust.drawn:
            errors = self.item.robust.errors(len(mounts))
            draws = [self._verdicts(misplaced(mounts, one), on_places)[0] for one in errors]
            draws.sort(key=lambda one: one.relative_margin, reverse=True)
            found.append(draws[self.item.robust.drawn - 1 - self.item.robust.spare])
        worst = min(found, key=lambda one: one.relative_margin)
        breaking = [mount.name for mount, one in zip(mounts, without, strict=True) if not one.passed]
        return replace(worst, breaking=tuple(breaking) if len(mounts) > 1 else ())

    def _verdicts(self, mounts: Sequence[Mount], on_places: OnPlaces) -> list[RequirementVerdict]:
        """The verdicts on a rig with sensors lost, and without each of its sensors."""
        cases = self._seen(self.item.posts, mounts)
        on_places(len(self.item.posts.counted))
        out = [self.item.judged_as(one) for one in cases]
        posts = self._between(cases, mounts)
        if posts is None:
            return out
        between = [self.item.judged_as(one, along) for one, along in zip(self._seen(posts, mounts), cases, strict=True)]
        return [min(pair, key=lambda one: one.relative_margin) for pair in zip(out, between, strict=True)]

    def _seen(self, posts: PostPlaces, mounts: Sequence[Mount]) -> list[PostVisibility]:
        """Where a rig sees posts with sensors lost, and without each of its sensors."""
        return [self.item.visibility_of(seen, posts) for seen in self._cases(posts.counted, mounts)]

    def _cases(self, places: Array, mounts: Sequence[Mount]) -> list[Flags]:
        """(P,) each: whether a rig sees posts at places (P, 4) with sensors lost, and without each of its sensors."""
        sees = self._counts(places, mounts, max(self.item.lost, 1) + 1) > 0
        number = sees.sum(axis=1)
        return [number > self.item.lost, *(number > column for column in sees.T)]

    def _between(self, cases: Sequence[PostVisibility], mounts: Sequence[Mount]) -> PostPlaces | None:
        """Posts along azimuths on which a narrow shadow hides one, in any of the cases, and not beside."""
        core = Core.of(WIDTH_M, self.item.height_m, self.item.posts.ground_m)
        at_m = self._silhouettes.places(centres_of(mounts), core, self.item.posts.area, RUN_M)
        places = self.item.posts.standing(at_m)
        hidden = np.zeros(len(places), np.bool_)
        for seen, along in zip(self._cases(places, mounts), cases, strict=True):
            hidden |= ~seen & along.is_seen_beside(places)
        hidden_deg = np.degrees(places[hidden, 3])[:, None]
        near_deg = BETWEEN_DEG * (np.rint(hidden_deg / BETWEEN_DEG) + np.arange(-BETWEEN_REACH, BETWEEN_REACH + 1))
        azimuth_deg = np.unique(np.round(np.concatenate([hidden_deg, near_deg], axis=1) % 360, BETWEEN_DIGITS))
        if len(azimuth_deg) > BETWEEN_MOST:
            azimuth_deg = azimuth_deg[np.linspace(0, len(azimuth_deg) - 1, BETWEEN_MOST).astype(np.intp)]
        posts = self.item.posts.along(azimuth_deg)
        return posts if posts.counts.any() else None

    def _counts(self, places: Array, mounts: Sequence[Mount], wanted: int) -> Counts:
        """(P, sensors) whether each sensor gets a return from posts at places; below 0: `wanted` others do."""
        if places is self.item.posts.counted:  # of which what is known is kept
            return self._share.lowest(self._share.known.rig(mounts), 1, wanted).counts
        return lowest_at(places, self.item.target, mounts, self.item.obstacles, 1, wanted).counts

    def margins(self, mounts: Sequence[Mount]) -> tuple[MountMargins, ...]:
        """What single failures and mounts that are a little off leave, by each of the two limits."""
        item = self.item
        sees = self._counts(item.posts.counted, mounts, len(mounts) + 1) > 0
        number = sees.sum(axis=1)
        whole = item.farthest_m(number > item.lost)
        without = np.full((len(mounts), len(whole)), np.nan)
        off = np.zeros((len(mounts), 6, len(whole)))
        if len(mounts) > 1:
            without[:] = [item.farthest_m(number > column) for column in sees.T]
        for n, axis, moved in with_one_off(mounts):
            others = number - sees[:, n]
            seen = others > item.lost
            unsure = np.flatnonzero(others == item.lost)  # where the sensor that is off decides
            places = np.ascontiguousarray(item.posts.counted[unsure])
            seen[unsure] = lowest_at(places, item.target, moved[n : n + 1], item.obstacles, 1, 1).counts[:, 0] > 0
            off[n, axis] = np.maximum(off[n, axis], item.farthest_m(seen))
        return tuple(
            MountMargins(
                what=f"{what.capitalize()} at the worst azimuth, in metres",
                unit="m",
                demanded=limit_m,
                at_most=True,
                whole=whole[k],
                without=without[:, k],
                off=off[..., k],
            )
            for k, (what, limit_m, *_) in enumerate(item.limits(item.visibility_of(number > item.lost, item.posts)))
        )

    def bounds(self, rig: TrialRig, stops: bool = True) -> Iterator[float]:
        """The shortfall of a search's trial; 0 before, as a bound."""
        if stops:
            yield 0.0
        counts = self._share.lowest(rig.at, 1, self.item.lost + 1, threads=1).counts
        yield self.item.judged_by((counts > 0).sum(axis=1) > self.item.lost).shortfall

    def learn(self) -> None:
        """Learns nothing."""
