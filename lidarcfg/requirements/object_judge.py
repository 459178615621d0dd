"""Whether an object gets its returns wherever it stands in a zone, also with sensors lost or mounts slightly off.

A verdict looks at a base grid, whose places are measured by `returns.reach`, and between them by `returns.refinement`.
What is reached in the place that decides is compared with what is demanded: the lowest of all places, or, where a
fraction of positions is enough, the lowest of the best ones of the base grid.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.requirements.allowed_rigs import AllowedRigs
from lidarcfg.requirements.evidence import Evidence, MountMargins, sensor_views, with_one_off
from lidarcfg.requirements.judge import NO_PLACES, Judge, Requirement, TrialRig
from lidarcfg.requirements.robustness import Robust, off_by_draws
from lidarcfg.requirements.verdict import RequirementVerdict, Sampling, WorstPlace
from lidarcfg.returns.counts import LOW_M, ClusterRule, OnPlaces, no_progress
from lidarcfg.returns.known import Share, Standing, lowest_at, shares
from lidarcfg.returns.places import FINEST_M, FINEST_RAD, Stand
from lidarcfg.returns.reach import (
    ClusterReach,
    Counts,
    Measured,
    Reach,
    Rows,
    lowest_of,
    positions,
    reached,
)
from lidarcfg.returns.refinement import Refined, Refinement
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.tracer import Obstacles

KEY = "object"
CAP_MIN = 16  # returns of a sensor at a place; more are counted only if nothing is lower anywhere
CAP_FACTOR = 4  # by which the cap grows then
CAP_MAX = 1 << 23
TRIAL_PLACES = 1000  # of the base grid, at which the trials of a search are judged at first
QUICK = 64  # of those, at which many rigs are judged at first
TRIAL_GROWTH = 10  # of that number, until all are looked at
MISSED_MOST = 256  # places of the base grid, found at a time

FIRST_PLACES = 32  # of a search's trial, after which it is first asked whether it is refuted already
GROWTH = 4  # of the number of places, until it is asked again
FADING = 0.9  # of what a place counted for in earlier batches of trials


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
    def first_cap(self) -> int:
        """Returns beyond which they are counted only if nothing is lower anywhere."""
        return max(2 * self.returns, CAP_MIN)

    def best(self, count: int) -> int:
        """How many of this many positions count: the fraction that is asked for."""
        return math.ceil(self.at_least * count - 1e-9)

    def counted(self, places: Array, values: Counts) -> Counts:
        """The values at places (P, 4) that count: those of the best positions, or without a fraction all."""
        if self.at_least == 1:
            return values
        by_position = np.sort(positions(places, values)[1])[::-1]
        return by_position[: self.best(len(by_position))]

    def deciding(self, places: Array, values: Counts) -> NDArray[np.intp]:
        """The numbers of the lowest values at places (P, 4) among those that count, in no order."""
        if self.at_least == 1:
            return lowest_of(values)
        worst, by_position = positions(places, values)
        best = np.argsort(-by_position, kind="stable")[: self.best(len(by_position))]
        return worst[best[lowest_of(by_position[best])]]

    # Where returns alone count, many rigs are judged by the sums of their sensors':

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
        return np.asarray(1 - self.counted(places, reached(counts, self.lost, self.sensors)) / self.returns)

    def out_of_reach(self, rigs: AllowedRigs) -> str | None:
        """Why no rig can meet it, if that is certain: some place is out of range, or too few beams reach some."""
        beyond = rigs.beyond_range(self.stand.base[:, :3], self.target.box_m) if self.at_least == 1 else None
        return beyond or self._too_few_beams(rigs)

    def _too_few_beams(self, rigs: AllowedRigs) -> str | None:
        """Whether at a place that counts fewer beams than are demanded can hit the ball around the object's box.

        With a fraction of positions, those nearest to the bounds count.
        """
        low, high = self.target.box_m
        at = np.unique(self.stand.base[:, :3], axis=0)
        distance_m = np.sort(rigs.distance_m(at + 0.5 * (low + high)))[self.best(len(at)) - 1]
        most = int(reached(rigs.most_returns(0.5 * math.dist(low, high), distance_m), self.lost, self.sensors)[0])
        if most >= self.returns:
            return None
        who = "the sensors together get" if self.sensors is None else f"{self.sensors} of the sensors get, each alone,"
        return f"{who} at most {most:,} returns from {distance_m:.1f} m away"


@dataclass(frozen=True)
class PlaceCounts:
    """What an object reaches at N positions of the base grid, each at its worst heading."""

    at_m: Array  # (N, 2)
    values: Counts  # (N,) in the worst case; lower bounds from the cap on
    side_m: Array  # (N,) of squares that cover the zone; the largest come first, as they lie below the others
    demanded: int
    cap: int


class Decided(NamedTuple):
    """What was measured of a rig, and the place that decides: the lowest, or that of the fraction asked for."""

    mounts: Sequence[Mount]
    measured: Measured
    at: int  # the number of the place
    value: int  # that is reached there


class ObjectJudge(Judge):
    """Judges rigs by one object requirement: a verdict, or for searches ever greater lower bounds of the shortfall."""

    def __init__(self, item: ObjectRequirement, share: Share | None = None) -> None:
        """`share`: the places where it counts, of which what is known is kept; without it those of the base grid."""
        self.item = item
        share = share or shares([item.standing], item.obstacles)[0]
        self.reach = Reach(share, item.lost, item.sensors)
        if item.cluster_m is not None:
            rule = ClusterRule(item.cluster_m, item.stand.ground_m + LOW_M)
            self.reach = ClusterReach(share, item.lost, item.sensors, rule)
        self.places = self.reach.places  # (P, 4)
        self._refinement = Refinement(self.reach, item.stand, item.returns, in_shadows=item.at_least == 1)
        self._latest: tuple[tuple[Mount, ...], int, Refined] | None = None  # a rig, the cap, what it reaches
        self._weight = np.zeros(len(self.places))  # what places counted for in earlier batches of trials
        self._of_batch = np.zeros(len(self.places))  # and in this one
        self._order: Rows = np.arange(len(self.places))

    @property
    def work(self) -> int:
        """The number of places at which rigs are measured, about; for progress."""
        robust = self.item.robust
        return len(self.places) * (1 + (robust.drawn if robust else 0)) + self._refinement.work

    # A verdict:

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        item = self.item
        tried, cap = self._refined(mounts, on_places)
        counted = self._counted(tried)
        whole = worst = self._decided(mounts, counted)
        notes = self.reach.notes(mounts)
        draws = self._drawn(mounts, tried, cap, on_places)
        if item.robust and draws:
            drawn = item.robust.quantile_of(draws, lambda one: one.value)
            if drawn.value < whole.value:
                worst = drawn
                quantile = f"{item.robust.quantile:g} quantile of {item.robust.drawn} draws"
                notes.insert(0, f"with mounting errors, in the {quantile}; the rig as it is reaches {whole.value}")
        place = worst.measured.places[worst.at]
        distance_m = float(item.stand.distance_m(place[None])[0])
        return RequirementVerdict(
            name=item.name,
            kind=KEY,
            passed=worst.value >= item.returns,
            unit="returns",
            demanded=item.returns,
            reached=worst.value,
            at_most=False,
            shortfall=self._shortfall(tried.base, worst.value),
            worst=WorstPlace(
                x_m=float(place[0]),
                y_m=float(place[1]),
                heading_deg=math.degrees(place[3]) % 360,
                distance_m=distance_m if math.isfinite(distance_m) else None,
            ),
            phases=tuple(worst.measured.lowest.phases[worst.at].tolist()),
            lost=tuple(worst.mounts[n].name for n in self.reach.lost_at(worst.measured, worst.at)),
            breaking=self._breaking(counted, mounts),
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

    def refined(self, mounts: Sequence[Mount]) -> Refined:
        """The measurements that a verdict on a rig is of; of one just judged, as kept."""
        return self._refined(mounts)[0]

    def _refined(
        self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress, stops: bool = False
    ) -> tuple[Refined, int]:
        """The base grid's counts, those at places between, and the cap below which the former are exact.

        Of mounts just looked at, as kept. With `stops` it ends once fewer returns than demanded are found.
        """
        cap = self.item.first_cap
        base = self.reach.measured(mounts, cap, on_places)
        while self._decided(mounts, base).value >= cap and cap < CAP_MAX:
            cap *= CAP_FACTOR
            base = self.reach.measured(mounts, cap)
        if self._latest and self._latest[:2] == (tuple(mounts), cap):
            return self._latest[2], cap
        found = Refined(base, base, 0.0, 0.0)
        for found in self._refinement.rounds(mounts, base, on_places):
            if stops and found.every.values.min() < self.item.returns:
                return found, cap
        self._latest = tuple(mounts), cap, found
        return found, cap

    def _counted(self, tried: Refined) -> Measured:
        """The measurements that count: of a fraction, those of the base grid."""
        return tried.base if self.item.at_least < 1 else tried.every

    def _decided(self, mounts: Sequence[Mount], measured: Measured) -> Decided:
        """The place that decides of a rig."""
        values = measured.values
        if self.item.at_least == 1:
            return Decided(mounts, measured, int(values.argmin()), int(values.min()))
        value = int(self.item.counted(measured.places, values).min())
        lowest, by_position = positions(measured.places, values)
        return Decided(mounts, measured, int(lowest[np.flatnonzero(by_position == value)[0]]), value)

    def _drawn(self, mounts: Sequence[Mount], tried: Refined, cap: int, on_places: OnPlaces) -> list[Decided]:
        """What decides in each draw of mounting errors; the refined places are the lowest of the rig as it is."""
        refined = tried.every.places[len(tried.base.places) :]
        refined = refined[lowest_of(tried.every.values[len(tried.base.places) :])]
        out = []
        for off in off_by_draws(self.item.robust, mounts):
            measured = self.reach.measured(off, cap, on_places)
            if self.item.at_least == 1:
                more = np.concatenate([refined, self._refinement.shadowed(off)])
                if len(more):
                    measured = measured.joined(self.reach.measured_at(more, off, cap))
            out.append(self._decided(off, measured))
        return out

    def _shortfall(self, base: Measured, value: int) -> float:
        """The mean over places and cases of failure of what is missing, as a fraction; 0 only where it is met."""
        item = self.item
        each = [item.counted(base.places, got) for got in self.reach.by_case(base)]
        short = float(np.mean([np.maximum(1 - got / item.returns, 0).mean() for got in each]))
        if value < item.returns and short == 0:  # at a refined place, or with mounting errors alone
            short = (1 - value / item.returns) / (len(self.places) + 1)
        return short

    def _fraction(self, base: Measured) -> float:
        """Of the base grid's positions, how many reach what is demanded."""
        return float(np.mean(positions(base.places, base.values)[1] >= self.item.returns))

    def _breaking(self, counted: Measured, mounts: Sequence[Mount]) -> tuple[str, ...]:
        """The sensors whose failure, each alone, breaks the requirement."""
        if len(mounts) == 1:
            return ()
        item = self.item
        each = self.reach.without_each(counted, mounts, item.returns, item.deciding)
        return tuple(
            mount.name
            for mount, values in zip(mounts, each, strict=True)
            if (item.counted(counted.places, values) < item.returns).any()
        )

    # Its evidence:

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

    def counts(self, mounts: Sequence[Mount]) -> PlaceCounts:
        """What a rig reaches at the base grid's positions, each at its worst heading; of one just judged, as kept."""
        item = self.item
        stand = item.stand
        found = self.reach.measured(mounts, item.first_cap)
        worst, values = positions(found.places, found.values)
        at = found.places[worst, :2]
        side_m = np.full(len(at), stand.far_step_m)
        if stand.zone.body and stand.near_step_m < stand.far_step_m:
            distance_m = stand.zone.body.to_points_m(at)
            side_m[distance_m <= stand.near_m + stand.far_step_m] *= 2  # to the edge of the finer grid
            side_m[distance_m <= stand.near_m] = stand.near_step_m
        order = np.argsort(-side_m, kind="stable")
        return PlaceCounts(at[order], values[order], side_m[order], item.returns, item.first_cap)

    def margins(self, mounts: Sequence[Mount]) -> MountMargins:
        """What single failures and mounts that are a little off leave, in the place that decides."""
        item = self.item
        cap = item.first_cap
        counted = self._counted(self.refined(mounts))
        without = np.full(len(mounts), np.nan)
        if len(mounts) > 1:
            each = self.reach.without_each(counted, mounts, cap, item.deciding)
            without[:] = [self._least_without(n, values, counted, mounts) for n, values in enumerate(each)]
        lowest = np.ascontiguousarray(counted.places[item.deciding(counted.places, counted.values)])
        off = np.full((len(mounts), 6), np.inf)
        for n, axis, moved in with_one_off(mounts):
            off[n, axis] = min(off[n, axis], self.reach.measured_at(lowest, moved, cap).values.min())
        clusters = item.cluster_m is not None
        return MountMargins(
            what=f"Returns{' of one cluster' if clusters else ''} at the verdict's places, in the one that decides",
            unit="returns",
            demanded=item.returns,
            at_most=False,
            whole=self._decided(mounts, counted).value,
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
            return int(item.counted(counted.places, values).min())
        least = int(values[: len(self.places)].min())
        lower = np.flatnonzero(values < least)  # refined ones alone
        if len(lower):
            places = np.ascontiguousarray(counted.places[lower])
            left = [mount for other, mount in enumerate(mounts) if other != n]
            found = lowest_at(places, item.target, left, item.obstacles, item.first_cap, item.sensors or 1)
            least = min(least, int(reached(found.counts, 0, item.sensors).min()))
        return least

    # A search's trials:

    def shortfall(self, rig: TrialRig) -> float:
        """That of a trial: the mean over places and cases of failure of what is missing, as a fraction.

        The same as a verdict's where these are the base grid's places, but for refined ones and mounting errors.
        """
        *_, value = self._shortfalls(rig, [self._order])
        return value

    def bounds(self, rig: TrialRig) -> Iterator[float]:
        """Ever greater lower bounds of it, with more and more places; the last one is exact."""
        return self._shortfalls(rig, self._blocks())

    def _shortfalls(self, rig: TrialRig, blocks: Iterable[Rows]) -> Iterator[float]:
        """The same, by blocks of the numbers of places: as if nothing were missing at those that are still to come."""
        item = self.item
        number, count = self._position_numbers
        worst = np.zeros((0, count), np.int64)  # by case of failure, of a fraction
        missing = 0
        for rows in blocks:
            short = np.maximum(item.returns - self.reach.in_cases(rig.at, rows, item.returns), 0)  # (cases, n)
            self._of_batch[rows] += short.sum(axis=0)
            if item.at_least == 1:
                missing += int(short.sum())
            else:
                worst = worst if len(worst) else np.zeros((len(short), count), np.int64)
                for case, row in zip(worst, short, strict=True):
                    np.maximum.at(case, number[rows], row)
                missing = int(np.sort(worst, axis=1)[:, : item.best(count)].sum())
            yield missing / (item.returns * item.best(count) * len(short))

    @cached_property
    def _position_numbers(self) -> tuple[Rows, int]:
        """(P,) the number of each place's position, over headings, and how many there are."""
        if self.item.at_least == 1:
            return np.arange(len(self.places)), len(self.places)
        number = np.unique(self.places[:, :2], axis=0, return_inverse=True)[1].ravel().astype(np.int64)
        return number, int(number.max()) + 1

    def _blocks(self) -> Iterator[Rows]:
        """The numbers of places, more at a time after every look at what they say."""
        order = self._order
        done = 0
        size = FIRST_PLACES
        while done < len(order):
            yield order[done : done + size]
            done += size
            size = done * (GROWTH - 1)

    def learn(self) -> None:
        """Called after every batch of trials: the places at which the most was missing come first in the next."""
        self._weight = FADING * self._weight + self._of_batch
        self._of_batch = np.zeros(len(self.places))
        self._order = np.argsort(-self._weight, kind="stable")

    # Places that may join those of trials; none of a fraction, whose places all count from the beginning:

    def missed_share(self, mounts: Sequence[Mount]) -> float:
        """At how many of the places of trials a rig fails, as a fraction; 0 of a fraction, where none can join."""
        if self.item.at_least < 1:
            return 0.0
        values = self.reach.measured_at(self.item.trial_places, mounts, self.item.first_cap).values
        return float(np.mean(values < self.item.returns))

    def drawn(self, count: int, seed: Sequence[int]) -> Array:
        """(count, 4) drawn places that may join; fewer are the first of these."""
        return self.item.stand.drawn(count, seed, at_any_heading=False)

    def missed_nearby(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places around the lowest of those of trials at which a rig fails, the worst first.

        None if all of these have many more returns than demanded, or where counting takes long.
        """
        if self.item.at_least < 1 or self.item.cluster_m is not None:
            return NO_PLACES
        some = self.reach.measured_at(self.item.trial_places, mounts, self.item.first_cap)
        if some.values.min() >= self.item.first_cap:
            return NO_PLACES
        for found in self._refinement.rounds(mounts, some):
            if len(failing := self._failing(found.every)):
                return failing
        return NO_PLACES

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
                values = self.reach.measured_at(places, mounts, self.item.first_cap).values
            else:
                values = self.reach.measured(mounts, self.item.first_cap).values
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
        return self._failing(self._refined(mounts, stops=True)[0].every)

    def _failing(self, tried: Measured) -> Array:
        """(n, 4) the places with too few returns, the worst first, no more than may join."""
        short = np.flatnonzero(tried.values < self.item.returns)
        order = np.argsort(tried.values[short], kind="stable")[:MISSED_MOST]
        return np.ascontiguousarray(tried.places[short[order]])

    def around(self, found: RequirementVerdict) -> Array:
        """(n, 4) the worst place of a verdict, and those around; none of a fraction."""
        if self.item.at_least < 1 or found.worst is None:
            return NO_PLACES
        stand = self.item.stand
        heading_rad = math.radians(found.worst.heading_deg or 0.0)
        place = np.array([[found.worst.x_m, found.worst.y_m, stand.ground_m, heading_rad]])
        return np.concatenate([place, stand.around(place, FINEST_M, FINEST_RAD, set())])
