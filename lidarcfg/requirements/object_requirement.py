"""Whether an object gets its returns wherever it stands in a zone, also with sensors lost or mounts slightly off."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array
from lidarcfg.requirements.allowed_rigs import ROUNDING, AllowedRigs
from lidarcfg.requirements.evidence import Evidence, sensor_views
from lidarcfg.requirements.kind import NO_PLACES, Judge, Requirement
from lidarcfg.requirements.margins import MountMargins, with_one_off
from lidarcfg.requirements.place_counts import LOWEST, Counts, Measured, PlaceCounts, lowest_of, positions, reached
from lidarcfg.requirements.refinement import Refined, Refinement
from lidarcfg.requirements.robustness import Robust, cases, misplaced
from lidarcfg.requirements.trial_rig import TrialRig
from lidarcfg.requirements.verdict import RequirementVerdict, Sampling, WorstPlace
from lidarcfg.returns.counts import LOW_M, ClusterRule, Lowest, OnPlaces, count_clusters, no_progress
from lidarcfg.returns.known import Share, Standing, lowest_at, shares
from lidarcfg.returns.places import FINEST_M, FINEST_RAD, Stand
from lidarcfg.returns.scanners import Poses, poses_of, scanners_of
from lidarcfg.returns.silhouettes import Core, Silhouettes, centres_of
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.tracer import Obstacles

KEY = "object"
REFINED_WORK = 4  # of a refined place, by that of one of the base grid: they lie where it takes long to count
CAP_MIN = 16  # returns of a sensor at a place; more are counted only if nothing is lower anywhere
CAP_FACTOR = 4  # by which the cap grows then
CAP_MAX = 1 << 23
TRIAL_PLACES = 1000  # of the base grid, at which the trials of a search are judged at first
QUICK = 64  # of those, at which many rigs are judged at first
TRIAL_GROWTH = 10  # of that number, until all are looked at
MISSED_MOST = 256  # places of the base grid, found at a time
JOINT_MAX = 256  # combinations of phases that are all tried for clusters

FIRST_PLACES = 32  # of a search's trial, after which it is first asked whether it is refuted already
GROWTH = 4  # of the number of places, until it is asked again
FADING = 0.9  # of what a place counted for in earlier batches of trials

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class ObjectRequirement(Requirement):
    """An object gets a number of returns wherever it stands in a zone."""

    name: str
    target: Target
    stand: Stand
    returns: int
    obstacles: Obstacles
    sensors: int | None = None  # the number of sensors that get them, each alone; None: all together
    at_least: float = 1.0  # fraction of the base grid's positions, each at its worst heading
    lost: int = 0  # sensors that fail
    cluster_m: float | None = None  # they are of one cluster with this tolerance
    robust: Robust | None = None

    def judge_with(self, share: Share | None = None) -> "ObjectJudge":
        """A judge; `share`: the places where it counts, of which what is known is kept."""
        return ObjectJudge(self, share)

    @property
    def standing(self) -> Standing:
        """The object at the base grid's places."""
        return Standing(self.target, self.stand.base)

    def standing_in_trials(self, more: Array) -> Standing:
        """The object at some of a large grid's places, spread over it; places `more` (n, 4) have joined."""
        own = self.trial_places
        return Standing(self.target, np.concatenate([own, more]) if len(more) else own)

    @property
    def trial_places(self) -> Array:
        """(P, 4) the places at which the trials of a search are judged at first; of a fraction, all."""
        return self.stand.thinned(TRIAL_PLACES) if self.at_least == 1 else self.stand.base

    @property
    def sums(self) -> "ObjectRequirement | None":
        """Itself, unless clusters count."""
        return self if self.cluster_m is None else None

    def in_order(self) -> Array:
        """(P, 4) the places of trials; the first are spread evenly."""
        places = self.trial_places
        first = self.stand.spread(places) if self.at_least == 1 else np.zeros(len(places))
        return np.ascontiguousarray(places[np.argsort(first, kind="stable")])

    @property
    def quick(self) -> int | None:
        """How many of them tell most; None: all."""
        return QUICK if self.at_least == 1 else None

    def short(self, places: Array, counts: NDArray[np.int32]) -> Array:
        """(n,) the relative shortfalls, with the sensors lost whose loss is the worst; of a fraction the best."""
        got = reached(counts, self.lost, self.sensors)
        if self.at_least < 1:
            by_position = np.sort(positions(places, got)[1])[::-1]
            got = by_position[: math.ceil(self.at_least * len(by_position) - 1e-9)]
        return np.asarray(1 - got / self.returns)

    def out_of_reach(self, rigs: AllowedRigs) -> str | None:
        """Why no rig can meet it, if that is certain: some place is out of range, or too few beams reach some."""
        return self._beyond_range(rigs) or self._too_few_beams(rigs)

    def _beyond_range(self, rigs: AllowedRigs) -> str | None:
        """Whether some place is farther from all bounds than any sensor's range."""
        if self.at_least < 1:
            return None
        at = self.stand.base[:, :3]
        distance_m = rigs.distance_m(at)
        low, high = self.target.box_m
        radius_m = math.hypot(*np.maximum(abs(low), abs(high)))
        far = int(distance_m.argmax())
        most_m = rigs.range_m
        if distance_m[far] <= most_m + rigs.start_m + radius_m + ROUNDING:
            return None
        x, y = at[far, :2]
        far_m = f"({x:.2f}, {y:.2f}) is {distance_m[far]:.1f} m from the bounds of all sensors"
        return f"{far_m}, and no range exceeds {most_m:g} m"

    def _too_few_beams(self, rigs: AllowedRigs) -> str | None:
        """Whether at a place that counts fewer beams than are demanded can hit the ball around the object's box.

        With a fraction of positions, those nearest to the bounds count.
        """
        low, high = self.target.box_m
        radius_m = 0.5 * math.dist(low, high)
        at = np.unique(self.stand.base[:, :3], axis=0)
        nearest = np.sort(rigs.distance_m(at + 0.5 * (low + high)))
        distance_m = nearest[math.ceil(self.at_least * len(at) - 1e-9) - 1]
        most = int(reached(rigs.most_returns(radius_m, distance_m), self.lost, self.sensors)[0])
        if most >= self.returns:
            return None
        who = "the sensors together get" if self.sensors is None else f"{self.sensors} of the sensors get, each alone,"
        return f"{who} at most {most:,} returns from {distance_m:.1f} m away"

    @property
    def wanted(self) -> int:
        """How many sensors with more returns than matter make the others' counts needless."""
        return max(self.lost, 1) + (self.sensors or 1)

    @property
    def first_cap(self) -> int:
        """Returns beyond which they are counted only if nothing is lower anywhere."""
        return max(2 * self.returns, CAP_MIN)


@dataclass(frozen=True)
class RefinedOf:
    """The measurements of a rig's mounts."""

    mounts: tuple[Mount, ...]
    cap: int
    refined: Refined


@dataclass(frozen=True)
class Clustered:
    """The clusters that a rig gets at the base grid's places, which take long to find."""

    mounts: tuple[Mount, ...]
    cap: int
    measured: Measured


class ObjectJudge(Judge):
    """Judges rigs by one object requirement: a verdict, or for searches ever greater lower bounds of the shortfall."""

    def __init__(self, item: ObjectRequirement, share: Share | None = None) -> None:
        """`share`: the places where it counts, of which what is known is kept; without it those of the base grid."""
        self.item = item
        self._obstacles = item.obstacles
        self._robust = item.robust if item.robust and item.robust.drawn else None
        self._share = share or shares([item.standing], item.obstacles)[0]
        self.places = self._share.places  # (P, 4)
        self._latest: Clustered | None = None
        self._weight = np.zeros(len(self.places))  # what places counted for in earlier batches of trials
        self._of_batch = np.zeros(len(self.places))  # and in this one
        self._order: Rows = np.arange(len(self.places))
        self._latest_refined: RefinedOf | None = None
        self._silhouettes = Silhouettes(item.obstacles)

    @property
    def work(self) -> int:
        """The number of places at which rigs are measured, about; for progress."""
        stand = self.item.stand
        steps = list(stand.refinements)
        around = sum(9 * (3 if step_rad else 1) for _, step_rad in steps + 2 * steps[-1:])
        refined = around * min(LOWEST, len(self.places)) // 2  # neighbours are shared
        return len(self.places) * (1 + (self._robust.drawn if self._robust else 0)) + REFINED_WORK * refined

    @property
    def first_cap(self) -> int:
        """Returns beyond which they are counted only if nothing is lower anywhere."""
        return self.item.first_cap

    def counts(self, mounts: Sequence[Mount]) -> PlaceCounts:
        """What a rig reaches at the base grid's positions, each at its worst heading; of one just judged, as kept."""
        stand = self.item.stand
        found = self.measured(mounts, self.first_cap)
        worst, values = positions(found.places, found.values)
        at = found.places[worst, :2]
        side_m = np.full(len(at), stand.far_step_m)
        if stand.zone.body and stand.near_step_m < stand.far_step_m:
            distance_m = stand.zone.body.to_points_m(at)
            side_m[distance_m <= stand.near_m + stand.far_step_m] *= 2  # to the edge of the finer grid
            side_m[distance_m <= stand.near_m] = stand.near_step_m
        order = np.argsort(-side_m, kind="stable")
        return PlaceCounts(at[order], values[order], side_m[order], self.item.returns, self.first_cap)

    def evidence(self, mounts: Sequence[Mount], found: RequirementVerdict) -> Evidence:
        """The evidence for a verdict on a rig, without mounting errors."""
        item = self.item
        stand = item.stand
        phases = found.phases if item.cluster_m is not None else None
        return Evidence(
            found,
            stand.zone.body,
            stand.zone,
            map=self.counts(mounts),
            views=sensor_views(found, item.target, stand.ground_m, mounts, item.obstacles, phases),
            margins=(self.margins(mounts),),
        )

    def margins(self, mounts: Sequence[Mount]) -> MountMargins:
        """What single failures and mounts that are a little off leave, in the place that decides."""
        item = self.item
        cap = self.first_cap
        tried = self.refined(mounts)
        counted = tried.base if item.at_least < 1 else tried.every
        without = np.full(len(mounts), np.nan)
        if len(mounts) > 1:
            without[:] = [
                self._least_without(n, values, counted, mounts)
                for n, values in enumerate(self._without_each(counted, mounts, cap))
            ]
        lowest = np.ascontiguousarray(counted.places[self._deciding(counted.places, counted.values)])
        off = np.full((len(mounts), 6), np.inf)
        for n, axis, moved in with_one_off(mounts):
            off[n, axis] = min(off[n, axis], self.measured_at(lowest, moved, cap).values.min())
        clusters = item.cluster_m is not None
        return MountMargins(
            what=f"Returns{' of one cluster' if clusters else ''} at the verdict's places, in the one that decides",
            unit="returns",
            demanded=item.returns,
            at_most=False,
            whole=self._worst(tried)[1],
            without=without,
            off=off,
            where_lost="where there are then the fewest returns" if clusters else "",
            where_off="where the rig as it is has the fewest returns",
            cap=cap,
        )

    def _least_without(self, n: int, values: Counts, counted: Measured, mounts: Sequence[Mount]) -> int:
        """What is reached in the place that decides without a mount, of `values` that are exact on the base grid.

        At refined places, whose counts end at lower caps, they are lower bounds: those that are lower are counted anew.
        """
        item = self.item
        if item.at_least < 1 or item.cluster_m is not None:
            return int(self._number(values).min())
        least = int(values[: len(self.places)].min())
        lower = np.flatnonzero(values < least)  # refined ones alone
        if len(lower):
            places = np.ascontiguousarray(counted.places[lower])
            left = [mount for other, mount in enumerate(mounts) if other != n]
            found = lowest_at(places, item.target, left, self._obstacles, self.first_cap, item.sensors or 1)
            least = min(least, int(reached(found.counts, 0, item.sensors).min()))
        return least

    def refined(self, mounts: Sequence[Mount]) -> Refined:
        """The measurements that a verdict on a rig is of; of one just judged, as kept."""
        return self._tried(mounts, *self._base(mounts))

    def missed(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places of the base grid at which a rig fails that passes where trials are judged, the worst first.

        More and more of them are looked at, until some are found.
        """
        stand = self.item.stand
        looked_at = len(self.item.trial_places)
        most = TRIAL_PLACES
        while looked_at < len(stand.base):
            most *= TRIAL_GROWTH
            places = stand.thinned(most)
            looked_at = len(places)
            if looked_at < len(stand.base):
                values = self.measured_at(places, mounts, self.first_cap).values
            else:
                values = self.measured(mounts, self.first_cap).values
            short = values < self.item.returns
            if short.any():
                order = np.lexsort((stand.spread(places[short]), values[short]))
                return np.ascontiguousarray(places[short][order[:MISSED_MOST]])
        return NO_PLACES

    def missed_between(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places between those of the base grid at which a rig fails, the worst first.

        They are refined until some are found; if none are, `judge` takes no longer than it has to.
        """
        if self.item.at_least < 1:
            return NO_PLACES
        tried = self._tried(mounts, *self._base(mounts), stops=True).every
        short = np.flatnonzero(tried.values < self.item.returns)
        order = np.argsort(tried.values[short], kind="stable")[:MISSED_MOST]
        return np.ascontiguousarray(tried.places[short[order]])

    def missed_share(self, mounts: Sequence[Mount]) -> float:
        """At how many of the places of trials a rig fails, as a fraction; 0 of a fraction, where none can join."""
        if self.item.at_least < 1:
            return 0.0
        values = self.measured_at(self.item.trial_places, mounts, self.first_cap).values
        return float(np.mean(values < self.item.returns))

    def drawn(self, count: int, seed: Sequence[int]) -> Array:
        """(count, 4) drawn places that may join; fewer are the first of these."""
        return self.item.stand.drawn(count, seed, at_any_heading=False)

    def around(self, found: RequirementVerdict) -> Array:
        """(n, 4) the worst place of a verdict, and those around; none of a fraction."""
        if self.item.at_least < 1 or found.worst is None:
            return NO_PLACES
        stand = self.item.stand
        heading_rad = math.radians(found.worst.heading_deg or 0.0)
        place = np.array([[found.worst.x_m, found.worst.y_m, stand.ground_m, heading_rad]])
        return np.concatenate([place, stand.around(place, FINEST_M, FINEST_RAD, set())])

    def _base(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> tuple[Measured, int]:
        """What a rig reaches at the base grid's places, exact below the cap, and that, which is above the lowest."""
        cap = self.first_cap
        base = self.measured(mounts, cap, on_places)
        while self._worst_of_base(base)[1] >= cap and cap < CAP_MAX:
            cap *= CAP_FACTOR
            base = self.measured(mounts, cap)
        return base, cap

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        item = self.item
        base, cap = self._base(mounts, on_places)
        tried = self._tried(mounts, base, cap, on_places)
        at, value = self._worst(tried)
        counted = tried.base if item.at_least < 1 else tried.every
        found = mounts
        notes = []
        if self._robust:
            draws = self._drawn(mounts, tried, cap, on_places)
            number = self._robust.quantile_of(range(len(draws)), lambda n: draws[n][2])
            if draws[number][2] < value:
                counted, at, value = draws[number]
                quantile = f"{self._robust.quantile:g} quantile of {self._robust.drawn} draws"
                notes.append(
                    f"with mounting errors, in the {quantile}; the rig as it is reaches {self._worst(tried)[1]}"
                )
                found = misplaced(mounts, self._robust.errors(len(mounts))[number])
        if item.cluster_m is not None:
            notes.append(self._phases_note(mounts))
        place = counted.places[at]
        distance_m = float(item.stand.distance_m(place[None])[0])
        return RequirementVerdict(
            name=item.name,
            kind=KEY,
            passed=value >= item.returns,
            unit="returns",
            demanded=item.returns,
            reached=value,
            at_most=False,
            shortfall=self._shortfall(tried, value, len(mounts)),
            worst=WorstPlace(
                x_m=float(place[0]),
                y_m=float(place[1]),
                heading_deg=math.degrees(place[3]) % 360,
                distance_m=distance_m if math.isfinite(distance_m) else None,
            ),
            phases=tuple(counted.lowest.phases[at].tolist()),
            lost=tuple(found[n].name for n in counted.lost(at, item.lost, item.cluster_m is not None)),
            breaking=self._breaking(tried, mounts),
            fraction=self._fraction(tried.base) if item.at_least < 1 else None,
            sampling=Sampling(
                places=len(tried.every.places),
                base_m=(item.stand.near_step_m, item.stand.far_step_m),
                finest_m=tried.finest_m,
                finest_deg=round(math.degrees(tried.finest_rad), 9),
                shadows=item.at_least == 1,
            ),
            notes=tuple(notes),
        )

    def bounds(self, rig: TrialRig, stops: bool = True) -> Iterator[float]:
        """Ever greater lower bounds of a rig's shortfall, with more and more places; the last one is exact.

        The same as a verdict's where these are the base grid's places, but for refined ones and mounting errors.
        """
        item = self.item
        ways = cases(len(rig.poses), item.lost) if item.cluster_m is None else [list(range(len(rig.poses)))]
        number, count = self._position_numbers
        best = self._best(count)
        total = item.returns * best * len(ways)
        missing = 0
        worst = np.zeros((len(ways), 0 if item.at_least == 1 else count), np.int64)
        for rows in self._blocks(stops):
            short = np.maximum(item.returns - self._got(rig, rows, ways), 0)  # (cases, n)
            self._of_batch[rows] += short.sum(axis=0)
            if item.at_least == 1:
                missing += int(short.sum())
            else:
                for case, row in zip(worst, short, strict=True):
                    np.maximum.at(case, number[rows], row)
                missing = int(np.sort(worst, axis=1)[:, :best].sum())
            yield missing / total

    def learn(self) -> None:
        """Called after every batch of trials: the places at which the most was missing come first in the next."""
        self._weight = FADING * self._weight + self._of_batch
        self._of_batch = np.zeros(len(self.places))
        self._order = np.argsort(-self._weight, kind="stable")

    @cached_property
    def _position_numbers(self) -> tuple[Rows, int]:
        """(P,) the number of each place's position, over headings, and how many there are."""
        if self.item.at_least == 1:
            return np.arange(len(self.places)), len(self.places)
        number = np.unique(self.places[:, :2], axis=0, return_inverse=True)[1].ravel().astype(np.int64)
        return number, int(number.max()) + 1

    def _blocks(self, stops: bool) -> Iterator[Rows]:
        """The numbers of places, more at a time after every look at what they say."""
        done = 0
        size = FIRST_PLACES if stops else len(self._order)
        order = self._order
        while done < len(order):
            yield order[done : done + size]
            done += size
            size = done * (GROWTH - 1)

    def _got(self, rig: TrialRig, rows: Rows, ways: Sequence[Sequence[int]]) -> Counts:
        """(cases, n) the returns at some places in each case of failure, exact where fewer than are demanded."""
        item = self.item
        if item.cluster_m is not None:
            scanners, poses = self._share.known.clustering(rig.at)
            values = self._cluster_counts(self.places[rows], scanners, poses, item.returns, item.lost, threads=1)
            return values.counts[:, 0].astype(np.int64)[None]
        wanted = item.lost + (item.sensors or 1)
        found = self._share.lowest(rig.at, item.returns, wanted, rows, threads=1).counts
        return np.stack([reached(found[:, kept], 0, item.sensors) for kept in ways])

    def measured(self, mounts: Sequence[Mount], cap: int, on_places: OnPlaces = no_progress) -> Measured:
        """What a rig reaches at the base grid's places, exact below the cap."""
        if self.item.cluster_m is not None:
            known = self._latest
            if known is None or known.mounts != tuple(mounts) or known.cap < cap:
                known = Clustered(tuple(mounts), cap, self._clusters(self.places, mounts, cap, on_places))
                self._latest = known
            return known.measured
        rig = self._share.known.rig(mounts)
        lowest = self._share.lowest(rig, cap, self.item.wanted, on_places=on_places)
        return Measured(self.places, reached(lowest.counts, self.item.lost, self.item.sensors), lowest)

    def measured_at(
        self, places: Array, mounts: Sequence[Mount], cap: int, on_places: OnPlaces = no_progress
    ) -> Measured:
        """What a rig reaches at other places (P, 4)."""
        item = self.item
        if item.cluster_m is not None:
            return self._clusters(places, mounts, cap, on_places)
        lowest = lowest_at(places, item.target, mounts, self._obstacles, cap, item.wanted, on_places)
        return Measured(places, reached(lowest.counts, item.lost, item.sensors), lowest)

    def _clusters(
        self,
        places: Array,
        mounts: Sequence[Mount],
        cap: int,
        on_places: OnPlaces = no_progress,
        lost: int | None = None,
    ) -> Measured:
        lost = self.item.lost if lost is None else lost
        found = self._cluster_counts(places, scanners_of(mounts), poses_of(mounts), cap, lost, on_places)
        return Measured(places, found.counts[:, 0].astype(np.int64), found)

    def _cluster_counts(
        self,
        places: Array,
        scanners: Sequence[core.returns.Scanner],
        poses: Poses,
        cap: int,
        lost: int,
        on_places: OnPlaces = no_progress,
        threads: int | None = None,
    ) -> Lowest:
        """The largest clusters at places (P, 4), up to a cap."""
        item = self.item
        assert item.cluster_m
        joint = math.prod(one.phases for one in scanners) <= JOINT_MAX
        rule = ClusterRule(item.cluster_m, item.stand.ground_m + LOW_M)
        sensors = item.sensors or 0
        return count_clusters(
            places,
            item.target,
            scanners,
            poses,
            self._obstacles,
            rule,
            lost,
            sensors,
            joint,
            cap,
            on_places,
            threads,
        )

    def _phases_note(self, mounts: Sequence[Mount]) -> str:
        """How phases were combined for clusters."""
        count = math.prod(one.phases for one in scanners_of(mounts))
        if self.item.sensors:
            return "clusters of each sensor alone, in each of its phases"
        if count <= JOINT_MAX:
            return f"clusters in all {count} combinations of the sensors' phases"
        what = f"clusters with each sensor in the phase of its fewest returns, as there are {count:,} combinations"
        return f"{what} of phases; others may give smaller ones"

    def _best(self, positions: int) -> int:
        """How many of this many positions count: the fraction that is asked for."""
        return math.ceil(self.item.at_least * positions - 1e-9)

    def _number(self, values: Counts) -> Counts:
        """The values of the best positions, as many as the fraction asks for; all places without one."""
        if self.item.at_least == 1:
            return values
        by_position = np.sort(positions(self.places, values)[1])[::-1]
        return by_position[: self._best(len(by_position))]

    def _deciding(self, places: Array, values: Counts) -> NDArray[np.intp]:
        """The numbers of the lowest values at places (P, 4) among those that count, in no order."""
        if self.item.at_least == 1:
            return lowest_of(values)
        worst, by_position = positions(places, values)
        best = np.argsort(-by_position, kind="stable")[: self._best(len(by_position))]
        return worst[best[lowest_of(by_position[best])]]

    def _worst(self, tried: Refined) -> tuple[int, int]:
        """The place that decides, and what is reached there: the lowest, or that of the fraction asked for."""
        if self.item.at_least == 1:
            at = int(tried.every.values.argmin())
            return at, int(tried.every.values[at])
        return self._worst_of_base(tried.base)

    def _worst_of_base(self, base: Measured) -> tuple[int, int]:
        value = int(self._number(base.values).min())
        if self.item.at_least == 1:
            return int(base.values.argmin()), value
        worst, by_position = positions(base.places, base.values)
        return int(worst[np.flatnonzero(by_position == value)[0]]), value

    def _fraction(self, base: Measured) -> float:
        """Of the base grid's positions, how many reach what is demanded."""
        return float(np.mean(positions(base.places, base.values)[1] >= self.item.returns))

    def _drawn(
        self, mounts: Sequence[Mount], tried: Refined, cap: int, on_places: OnPlaces
    ) -> list[tuple[Measured, int, int]]:
        """For each draw of mounting errors what was measured, the place that decides and what is reached there."""
        assert self._robust
        refined = tried.every.places[len(tried.base.places) :]
        refined = refined[lowest_of(tried.every.values[len(tried.base.places) :])]
        out = []
        for errors in self._robust.errors(len(mounts)):
            off = misplaced(mounts, errors)
            measured = self.measured(off, cap, on_places)
            more = np.concatenate([refined, self._shadowed(off)])
            if self.item.at_least == 1 and len(more):
                measured = measured.joined(self.measured_at(more, off, cap))
            if self.item.at_least == 1:
                at = int(measured.values.argmin())
                out.append((measured, at, int(measured.values[at])))
            else:
                out.append((measured, *self._worst_of_base(measured)))
        return out

    def _shortfall(self, tried: Refined, value: int, sensors: int) -> float:
        """The mean over places and cases of failure of what is missing, as a fraction; 0 only where it is met."""
        item = self.item
        if item.cluster_m is not None:
            gots = [tried.base.values]
        else:
            counts = tried.base.lowest.counts
            gots = [reached(counts[:, kept], 0, item.sensors) for kept in cases(sensors, item.lost)]
        missing = [np.maximum(1 - self._number(got) / item.returns, 0).mean() for got in gots]
        short = float(np.mean(missing))
        if value < item.returns and short == 0:  # at a refined place, or with mounting errors alone
            short = (1 - value / item.returns) / (len(self.places) + 1)
        return short

    def _breaking(self, tried: Refined, mounts: Sequence[Mount]) -> tuple[str, ...]:
        """The sensors whose failure, each alone, breaks the requirement."""
        if len(mounts) == 1:
            return ()
        item = self.item
        counted = tried.base if item.at_least < 1 else tried.every
        each = self._without_each(counted, mounts, item.returns)
        return tuple(
            mount.name
            for mount, values in zip(mounts, each, strict=True)
            if (self._number(values) < item.returns).any()
        )

    def _without_each(self, measured: Measured, mounts: Sequence[Mount], cap: int) -> Iterator[Counts]:
        """(P,) what is reached at measured places without each of the mounts in turn, exact below the cap.

        Clusters, which take long to find, are so at the lowest places alone; elsewhere they are at most this.
        """
        item = self.item
        counts = measured.lowest.counts
        if item.cluster_m is not None:
            counts = lowest_at(measured.places, item.target, mounts, self._obstacles, cap, item.wanted).counts
        for n in range(len(mounts)):
            values = reached(np.delete(counts, n, axis=1), 0, item.sensors)
            if item.cluster_m is not None:
                if not item.lost:
                    values = np.minimum(values, measured.values)  # as fewer sensors make no larger clusters
                lowest = self._deciding(measured.places, values)
                left = [mount for other, mount in enumerate(mounts) if other != n]
                places = np.ascontiguousarray(measured.places[lowest])
                values[lowest] = self._clusters(places, left, cap, lost=0).values
            yield values

    def _tried(
        self,
        mounts: Sequence[Mount],
        base: Measured,
        cap: int,
        on_places: OnPlaces = no_progress,
        stops: bool = False,
    ) -> Refined:
        """The base grid's counts, and those at places between: around the lowest, and in narrow shadows of the bodies.

        Of mounts just looked at, as kept. With `stops` it ends once fewer returns than demanded are found.
        """
        known = self._latest_refined
        if known and known.mounts == tuple(mounts) and known.cap == cap:
            return known.refined
        found = Refined(base, base, 0.0, 0.0)
        for found in self._refined(mounts, base, on_places):
            if stops and found.every.values.min() < self.item.returns:
                return found
        self._latest_refined = RefinedOf(tuple(mounts), cap, found)
        return found

    def _refined(self, mounts: Sequence[Mount], base: Measured, on_places: OnPlaces) -> Iterator[Refined]:
        """The measurements with places between those of the base grid, round after round."""

        def measure(places: Array, cap: int) -> Measured:
            return self.measured_at(places, mounts, cap, lambda count: on_places(REFINED_WORK * count))

        finding = Refinement(self.item.stand, self.item.returns, measure)
        return finding.rounds(base, lambda: self._shadowed(mounts))

    def _shadowed(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places in narrow shadows of the bodies; none for a fraction of the base grid's positions."""
        stand = self.item.stand
        if self.item.at_least < 1:
            return NO_PLACES
        core = Core.of(stand.width_m, float(self.item.target.size_m[2]), stand.ground_m)
        return stand.standing(self._silhouettes.places(centres_of(mounts), core, stand.area, stand.far_step_m))
