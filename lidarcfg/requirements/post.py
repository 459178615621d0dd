"""Posts: one of a height is seen near the body, and beyond that without long gaps.

Distances and gaps are as `post_visibility` has them, at the worst azimuth. A verdict also looks along azimuths on which
a narrow shadow of the bodies hides a post between the even ones.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from lidarcfg.config.models import validation_error
from lidarcfg.geometry import Array, Flags
from lidarcfg.requirements.evidence import Evidence, MountMargins, sensor_views, with_one_off
from lidarcfg.requirements.judge import Judge, Requirement, TrialRig
from lidarcfg.requirements.kind import Context, Entry, Kind, Lost, Sectors
from lidarcfg.requirements.robustness import Robust, off_by_draws
from lidarcfg.requirements.verdict import RequirementVerdict, Sampling, WorstPlace
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import Share, Standing, lowest_at, shares
from lidarcfg.returns.places import Distances
from lidarcfg.returns.post_visibility import (
    AZIMUTHS,
    LIMIT_M,
    RUN_M,
    STEP_M,
    WIDTH_M,
    PostPlaces,
    PostVisibility,
)
from lidarcfg.returns.silhouettes import Core, Silhouettes, centres_of
from lidarcfg.returns.target import Size, Target, box_target
from lidarcfg.sensors.rig import Distance, Mount
from lidarcfg.world.tracer import Obstacles

BETWEEN_DEG = 0.05  # apart, azimuths between the even ones
BETWEEN_REACH = 5  # of them on both sides of one on which a post is hidden
BETWEEN_DIGITS = 2  # of their degrees
BETWEEN_MOST = 720


class PostKind(Kind):
    """A post 0.1 m wide is seen from a distance to the body on, and beyond it without long gaps."""

    key: ClassVar[str] = "post_height_m"
    post_height_m: Annotated[Size, Field(description="the post's height")]
    first_seen_at_most_m: Annotated[
        Distance | None,
        Field(description="the distance from the body at which it is first seen, at most; this, the next or both"),
    ] = None
    gap_at_most_m: Annotated[Distance | None, Field(description="the longest gap beyond that, at most")] = None
    within_m: Annotated[
        Distances | None,
        Field(description="`[least, greatest]` distance from the body's outline; 0 to 10 by default"),
    ] = None
    sector_deg: Sectors = None
    lost: Lost = None

    @model_validator(mode="after")
    def _check(self) -> "PostKind":
        if self.first_seen_at_most_m is None and self.gap_at_most_m is None:
            raise validation_error("asks for nothing; give first_seen_at_most_m, gap_at_most_m, or both")
        return self

    def resolve(self, entry: Entry, context: Context) -> "PostRequirement":
        """The requirement of a study. Raises ConfigError with file, line and key."""
        lost = entry.lost(self.lost, context)
        site = context.site
        zone = entry.zone(site, self.within_m, self.sector_deg)
        assert zone.body
        posts = PostPlaces.around(zone.body, site.ground_m, self.within_m or (0.0, LIMIT_M), zone)
        if not posts.counts.any():
            raise entry.error("no post stands there; widen the zone", "within_m")
        return PostRequirement(
            name=self.name,
            posts=posts,
            height_m=self.post_height_m,
            first_seen_at_most_m=self.first_seen_at_most_m,
            gap_at_most_m=self.gap_at_most_m,
            obstacles=site.obstacles,
            lost=lost,
            robust=context.robust,
        )


@dataclass(frozen=True)
class PostRequirement(Requirement):
    """A post is seen near the body, and beyond that without long gaps."""

    name: str
    posts: PostPlaces
    height_m: float
    first_seen_at_most_m: float | None
    gap_at_most_m: float | None
    obstacles: Obstacles
    lost: int = 0
    robust: Robust | None = None

    @cached_property
    def target(self) -> Target:
        """The post."""
        return box_target((WIDTH_M, WIDTH_M, self.height_m))

    @property
    def standing(self) -> Standing:
        """The post, where it counts."""
        return Standing(self.target, self.posts.counted)

    def judge_with(self, share: Share | None = None) -> "PostJudge":
        """A judge; `share`: the posts that count, of which others know, too."""
        return PostJudge(self, share)

    def visibility_of(self, seen: Flags, posts: PostPlaces) -> PostVisibility:
        """Where the post is seen, by flags of those posts that count (P,)."""
        return PostVisibility.of(self.height_m, posts, seen)

    def farthest_m(self, seen: Flags) -> Array:
        """(limits,) what each limit is for, at the worst azimuth, if some of the posts that count (P,) are seen."""
        found = self.limits(self.visibility_of(seen, self.posts))
        return np.array([np.nanmax(values_m) for _, _, values_m, _ in found])

    def verdict(self, seen: PostVisibility, along: PostVisibility | None = None) -> RequirementVerdict:
        """The verdict on where a rig sees posts; `along` the even azimuths, if these are between them."""
        found = [self._verdict_by(seen, along, *limit) for limit in self.limits(seen)]
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

    def _verdict_by(
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
        short = np.where(np.isinf(known), 1.0, np.clip((known - limit_m) / seen.limit_m, 0, 1))[seen.known]
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
            kind=PostKind.key,
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


class PostJudge(Judge):
    """Judges rigs by one requirement of a post."""

    def __init__(self, item: PostRequirement, share: Share | None = None) -> None:
        """`share`, if given: the posts that count, of which others know, too."""
        self.item = item
        self._share = share or shares([item.standing], item.obstacles)[0]
        self._silhouettes = Silhouettes(item.obstacles)

    @property
    def work(self) -> int:
        """The number of places at which rigs are measured, for progress."""
        return int(self.item.posts.counts.sum()) * (1 + (self.item.robust.drawn if self.item.robust else 0))

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        whole, *without = self._verdicts(mounts, on_places)
        found = [whole]
        draws = [self._verdicts(off, on_places)[0] for off in off_by_draws(self.item.robust, mounts)]
        if self.item.robust and draws:
            found.append(self.item.robust.quantile_of(draws, lambda one: one.relative_margin))
        worst = min(found, key=lambda one: one.relative_margin)
        breaking = [mount.name for mount, one in zip(mounts, without, strict=True) if not one.passed]
        return replace(worst, breaking=tuple(breaking) if len(mounts) > 1 else ())

    def _verdicts(self, mounts: Sequence[Mount], on_places: OnPlaces) -> list[RequirementVerdict]:
        """The verdicts on a rig with sensors lost, and without each of its sensors."""
        cases = self._seen(self.item.posts, mounts)
        on_places(len(self.item.posts.counted))
        out = [self.item.verdict(one) for one in cases]
        posts = self._between(cases, mounts)
        if posts is None:
            return out
        between = [self.item.verdict(one, along) for one, along in zip(self._seen(posts, mounts), cases, strict=True)]
        return [min(pair, key=lambda one: one.relative_margin) for pair in zip(out, between, strict=True)]

    def _seen(self, posts: PostPlaces, mounts: Sequence[Mount]) -> list[PostVisibility]:
        """Where a rig sees posts with sensors lost, and without each of its sensors."""
        return [self.item.visibility_of(seen, posts) for seen in self._cases(posts.counted, mounts)]

    def _cases(self, places: Array, mounts: Sequence[Mount]) -> list[Flags]:
        """(P,) each: whether a rig sees posts at places (P, 4) with sensors lost, and without each of its sensors."""
        sees = self._sees(places, mounts, max(self.item.lost, 1) + 1)
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

    def _sees(self, places: Array, mounts: Sequence[Mount], wanted: int) -> Flags:
        """(P, sensors) whether each sensor sees posts at places; of more than `wanted` that do, not all."""
        if places is self.item.posts.counted:  # of which what is known is kept
            lowest = self._share.lowest(self._share.known.rig(mounts), 1, wanted)
        else:
            lowest = lowest_at(places, self.item.target, mounts, self.item.obstacles, 1, wanted)
        return np.asarray(lowest.counts > 0)

    def evidence(self, mounts: Sequence[Mount], found: RequirementVerdict) -> Evidence:
        """The evidence for a verdict on a rig, without mounting errors."""
        item = self.item
        seen = self._sees(item.posts.counted, mounts, item.lost + 1).sum(axis=1) > item.lost
        return Evidence(
            found,
            item.posts.body,
            map=item.visibility_of(seen, item.posts),
            views=sensor_views(found, item.target, item.posts.ground_m, mounts, item.obstacles),
            margins=self.margins(mounts),
        )

    def margins(self, mounts: Sequence[Mount]) -> tuple[MountMargins, ...]:
        """What single failures and mounts that are a little off leave, by each of the two limits."""
        item = self.item
        sees = self._sees(item.posts.counted, mounts, len(mounts) + 1)
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
            seen[unsure] = self._sees(places, moved[n : n + 1], 1)[:, 0]
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

    def shortfall(self, rig: TrialRig) -> float:
        """That of a trial; along the even azimuths alone."""
        item = self.item
        counts = self._share.lowest(rig.at, 1, item.lost + 1, threads=1).counts
        return item.verdict(item.visibility_of((counts > 0).sum(axis=1) > item.lost, item.posts)).shortfall
