"""What a search minimises: a weighted mean of terms, each of which can stop early once it is too large.

A trial has a cost to beat. Every term is at least 0, and sums, products and quotients of floating-point numbers are
monotonic. So as soon as the weighted mean of the terms known so far, with 0 or lower bounds for the others, reaches
the cost to beat, the trial is refuted exactly: its full cost would be no less.
"""

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidarcfg.config.models import Model, Weight
from lidarcfg.geometry import Array, rotations
from lidarcfg.placement.cones import Lidar, placed
from lidarcfg.placement.cones import poses as poses_of
from lidarcfg.placement.detection import DetectionObject, free_places, undetected
from lidarcfg.placement.region import Region, cuboids_needed
from lidarcfg.placement.return_counts import DetectionTarget, MissCounter
from lidarcfg.placement.spheres import Node, clearance_m, largest_spheres
from lidarcfg.placement.subspace import Links, Subspaces, segment
from lidarcfg.placement.visibility import Visibility, fraction_below
from lidarcfg.placement.zones import Weights, weighted_vsr_m
from lidarcfg.returns.known import KnownReturns, RigAt
from lidarcfg.returns.misses import Misses, MissesFile
from lidarcfg.returns.scanners import Poses
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.world.tracer import NO_OBSTACLES

SIGHT = ("blind_volume", "seen_by_two")  # terms that tell rigs apart only where something limits sight


RECENT = 32  # how many of the findings that settled past trials are tried first in new ones
SHARES = 0.2, 0.35, 0.5, 0.65, 0.8  # of the work, by which a term is bounded before any is computed
EVERY_CASE = np.empty((0, 0), bool)
Flags = NDArray[np.bool_]
T = TypeVar("T", bound=Node | int)


class Objective(Model):
    """What is minimised: the weighted mean of these.

    By default misses alone, or where there is no vehicle the paper's max VSR.
    """

    removed: ClassVar[dict[str, str]] = {"blind_spot_m": "ask for posts or a shadow under `requirements` instead"}
    misses: MissesFile | None = None  # the share of places where objects get too few returns
    max_vsr: Weight | None = None  # metres
    inscribed_radius: Weight | None = None  # metres: the largest sphere that no beam touches
    detection: dict[str, Weight] = Field(default_factory=dict)  # by object: 1 − its detection rate
    blind_volume: Weight | None = None  # the fraction of the region's volume that no LiDAR sees
    seen_by_two: Weight | None = None  # the fraction that fewer than two see

    @property
    def is_misses(self) -> bool:
        """Whether it is misses alone."""
        return self.misses is not None and self == Objective(misses=self.misses)

    @property
    def is_max_vsr(self) -> bool:
        """Whether it is max VSR alone."""
        others = ("misses", "inscribed_radius", *SIGHT)
        return not self.detection and all(getattr(self, key) is None for key in others)


def without_cones(
    objective: Objective, detection: Sequence[DetectionObject], only_required: bool, sensors: Sequence[Sensor]
) -> tuple[tuple[str | int, ...], str] | None:
    """The key of a study that only cones of beams can answer, and why some sensor's cannot; None if all is well."""
    keys: list[tuple[str | int, ...]] = [("detection", i) for i, item in enumerate(detection) if item.returns is None]
    keys += [("objective", key) for key in ("max_vsr", "inscribed_radius") if getattr(objective, key) is not None]
    if objective.is_max_vsr and not only_required:
        keys.append(("objective",))
    scans = [sensor.name for sensor in sensors if sensor.scan_pattern]
    if not scans or not keys:
        return None
    what = "counts subspaces" if keys[0][0] == "detection" else "is max_vsr" if keys[0] == ("objective",) else "is"
    return keys[0], (
        f"{what} of cones of beams, and {scans[0]} has a scan pattern; "
        "instead, detect objects by returns (detection: returns), give a vehicle, or give requirements"
    )


class Trial:
    """A rig that is evaluated: its LiDARs, and its subspaces once a term asks for them."""

    def __init__(
        self, region: Region, lidars: Sequence[Lidar], visibility: Visibility | None, poses: Array | None = None
    ) -> None:
        """LiDARs where they are, or at poses (lidars, 6): x, y, z, roll, pitch, yaw."""
        self.region = region
        self.visibility = visibility
        self.kept = tuple(range(len(lidars)))  # the numbers of its LiDARs in the whole rig
        self.is_cut = False  # into subspaces
        self.weighted_vsr_m = np.empty(0)  # of its subspaces; see forget
        self.first = np.empty(0, np.int64)  # cuboid of each
        self._given = lidars
        self._at = poses
        self._whole: Trial | None = None
        self._left: dict[tuple[int, ...], Trial] = {}

    @cached_property
    def lidars(self) -> Sequence[Lidar]:
        """The LiDARs at their poses."""
        if self._at is None:
            return self._given
        return [placed(one, row[:3], row[3:]) for row, one in zip(self._at, self._given, strict=True)]

    @cached_property
    def subspaces(self) -> Subspaces:
        """The subspaces into which the beams cut the region."""
        self.is_cut = True
        if self._whole:
            return self._whole._links.subspaces(self.kept)
        return segment(self.region, self.lidars, self.visibility)

    @cached_property
    def poses(self) -> Poses:
        """Where its LiDARs are."""
        if self._at is None:
            return poses_of(self.lidars)
        return Poses(rotations(self._at[:, 3:]), np.ascontiguousarray(self._at[:, :3]))

    def forget(self, weight: Weights | None) -> None:
        """Drop its subspaces, which are large, but for their weighted VSR and the first cuboid of each."""
        found = self.__dict__.pop("subspaces", None)
        if found:
            self.weighted_vsr_m = weighted_vsr_m(found, weight)
            self.first = found.first

    @cached_property
    def _links(self) -> Links:
        return Links(self.region, self.lidars, self.visibility)

    def left(self, kept: tuple[int, ...]) -> "Trial":
        """The trial of the same rig with only some of its LiDARs."""
        if kept not in self._left:
            some = list(kept)
            at = None if self._at is None else self._at[some]
            one = Trial(self.region, [self._given[i] for i in some], self.visibility, at)
            one.kept = kept
            one._whole = self
            self._left[kept] = one
        return self._left[kept]


class Term(Protocol):
    """A part of an objective, at least 0."""

    work: float  # roughly how long it takes: terms are computed in this order

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value; or, once the value is known to be at least `limit`, any number that is."""

    def learn(self) -> None:
        """Called after every batch of trials, so that later batches can use its findings."""


@runtime_checkable
class BoundedTerm(Term, Protocol):
    """A term with a lower bound that takes only part of the work."""

    def lower_bound(self, trial: Trial, share: float) -> float:
        """No more than its value, by a share of the work, 0 to 1."""


class Recent(Generic[T]):
    """Findings that settled trials: first those of the last batch, the most frequent in front, then earlier ones."""

    def __init__(self) -> None:
        self.items: list[T] = []
        self._seen: deque[T] = deque()  # of this batch

    def add(self, item: T) -> None:
        """Record a finding that settled a trial, or would settle a similar one."""
        self._seen.append(item)

    def learn(self) -> None:
        """Sort the findings of the batch in; the order does not depend on which thread was first."""
        counts: Counter[T] = Counter(self._seen)
        self._seen.clear()
        recent: list[T] = sorted(counts, key=lambda item: (-counts[item], item))
        self.items = [*recent, *(item for item in self.items if item not in counts)][:RECENT]


class MaxVsr:
    """The largest volume-to-surface ratio, in metres, times the weight of the subspace's zones."""

    work = 0.0

    def __init__(self, weight: Weights | None) -> None:
        self._weight = weight

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value, or any number that is at least `limit` once it is known to be."""
        return float(weighted_vsr_m(trial.subspaces, self._weight).max())

    def learn(self) -> None:
        """Learns nothing: the evaluator has certificates of max VSR."""


class MissesTerm:
    """The share of places where objects get too few returns. Stops once they do at too many places."""

    work = 1e2

    def __init__(self, misses: Misses, known: KnownReturns, mounts: Sequence[Mount]) -> None:
        """At the places of returns that are known, for rigs of these mounts, wherever they are."""
        self._misses = misses
        self._known = known
        self._numbers = known.numbers(mounts)

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value, or any number that is at least `limit` once it is known to be."""
        rig = RigAt(self._numbers[list(trial.kept)], *trial.poses)
        return self._known.misses(rig, self._misses.weights, self._misses.returns, limit)

    def learn(self) -> None:
        """Learns nothing: what is known of returns is kept as they are counted."""


class Undetected:
    """1 − the detection rate of an object. Stops once it is undetected in too many places."""

    def __init__(self, region: Region, item: DetectionObject) -> None:
        self._item = item
        self._free = free_places(region, item)
        self.work = float(sum(self._free) * math.prod(cuboids_needed(item.box_m, region.cuboid_m)))

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value, or any number that is at least `limit` once it is known to be."""
        return undetected(trial.subspaces, self._item, self._free, limit)

    def learn(self) -> None:
        """Learns nothing."""


class MissRate:
    """1 − the detection rate of an object by its returns. Stops once too many places have too few returns."""

    def __init__(self, target: DetectionTarget, mounts: Sequence[Mount]) -> None:
        """`mounts`: all of the study's, wherever they are."""
        self._target = target
        self._mounts = mounts
        self._counter = MissCounter(target, mounts, NO_OBSTACLES)
        self.work = 1e3 * len(target.places)

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value, or any number that is at least `limit` once it is known to be."""
        return self._counter_for(trial).rate(trial.kept, trial.poses, limit)

    def lower_bound(self, trial: Trial, share: float) -> float:
        """The lower bound from the places where the object is most likely to be missed."""
        return self._counter_for(trial).lower_bound(trial.kept, trial.poses, share)

    def _counter_for(self, trial: Trial) -> MissCounter:
        obstacles = trial.visibility.obstacles if trial.visibility else NO_OBSTACLES
        counter = self._counter
        if counter.obstacles is not obstacles:
            counter = self._counter = MissCounter(self._target, self._mounts, obstacles)
        return counter

    def learn(self) -> None:
        """Learns nothing."""


class UnseenFraction:
    """The fraction of the region's volume that fewer than some number of LiDARs see."""

    work = 1.0

    def __init__(self, least: int) -> None:
        self._least = least

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value, or any number that is at least `limit` once it is known to be."""
        return fraction_below(trial.region, trial.subspaces.seen_by, self._least)

    def learn(self) -> None:
        """Learns nothing."""


class InscribedRadius:
    """The radius of the largest sphere in any subspace, in metres.

    Spheres around the centres of earlier trials' largest ones are tried first: if one is too large, so is the term.
    """

    work = math.inf

    def __init__(self) -> None:
        self._centres: Recent[Node] = Recent()

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value, or any number that is at least `limit` once it is known to be."""
        if limit < math.inf:
            for centre in self._centres.items:
                if (radius := clearance_m(trial.subspaces, centre)) >= limit:
                    self._centres.add(centre)
                    return radius
        found = largest_spheres(trial.subspaces)
        self._centres.add(found.centre)
        return float(found.radius_m.max())

    def learn(self) -> None:
        """Sort the findings of the batch in."""
        self._centres.learn()


class Criterion:
    """The weighted mean of an objective's terms, for a region and its objects.

    With `kept`, the LiDARs that are left in each case of failure, it is that of the worst case.
    """

    def __init__(
        self,
        objective: Objective,
        region: Region,
        objects: Sequence[DetectionObject],
        by_returns: Mapping[str, MissRate] = MappingProxyType({}),  # needed for objects that are detected by them
        misses: MissesTerm | None = None,  # needed for misses
        weight: Weights | None = None,  # of max VSR, by cuboid
        kept: Flags = EVERY_CASE,  # (cases, lidars); no cases: the whole rig alone
    ) -> None:
        self.weight = weight
        self.kept = kept
        self._cases = [tuple(np.flatnonzero(case).tolist()) for case in kept]
        self._refuting: Recent[int] = Recent()  # cases
        wanted = objective.detection
        self.terms: list[Term] = [
            by_returns.get(item.name) or Undetected(region, item) for item in objects if item.name in wanted
        ]
        self._weights = [wanted[item.name] for item in objects if item.name in wanted]
        if objective.misses is not None and misses is not None:
            self.terms.append(misses)
            self._weights.append(objective.misses.weight)
        self.max_vsr: int | None = None  # which term it is
        if objective.max_vsr is not None or objective.is_max_vsr:
            self.max_vsr = len(self.terms)
            self.terms.append(MaxVsr(weight))
            self._weights.append(objective.max_vsr or 1.0)
        if objective.inscribed_radius is not None:
            self.terms.append(InscribedRadius())
            self._weights.append(objective.inscribed_radius)
        for least, wanted_for in ((1, objective.blind_volume), (2, objective.seen_by_two)):
            if wanted_for is not None:
                self.terms.append(UnseenFraction(least))
                self._weights.append(wanted_for)

        self._bounded = [(number, one) for number, one in enumerate(self.terms) if isinstance(one, BoundedTerm)]

    @property
    def is_max_vsr(self) -> bool:
        """Whether max VSR is its only term."""
        return len(self.terms) == 1 and self.max_vsr is not None

    def mean(self, values: Sequence[float]) -> float:
        """The weighted mean of the terms' values."""
        if len(values) == 1:
            return values[0]
        return sum(w * v for w, v in zip(self._weights, values, strict=True)) / sum(self._weights)

    def limit(self, values: Sequence[float], term: int, upper_bound: float) -> float:
        """A value of one term at which the mean, with the other terms as in `values`, reaches `upper_bound`."""
        if upper_bound == math.inf:
            return math.inf
        others = self.mean([0.0 if i == term else value for i, value in enumerate(values)])
        scale = sum(self._weights) / self._weights[term]
        limit = max((upper_bound - others) * scale, 0.0)
        step = np.finfo(float).eps * upper_bound * scale
        while self.mean([limit if i == term else value for i, value in enumerate(values)]) < upper_bound:  # rounding
            limit += step
            step *= 2.0
        return limit

    def cases(self, trial: Trial) -> list[Trial]:
        """The trials of each case of failure; without any, the trial itself."""
        return [trial.left(kept) for kept in self._cases] or [trial]

    def of(self, trial: Trial, upper_bound: float = math.inf) -> float:
        """The cost of a trial, or inf if it is not below `upper_bound`; cases that refuted recent trials come first."""
        cases = self.cases(trial)
        cost = -math.inf
        for case in dict.fromkeys((*self._refuting.items, *range(len(cases)))):
            cost = max(cost, self._of_case(cases[case], upper_bound))
            cases[case].forget(self.weight)
            if cost == math.inf:
                self._refuting.add(case)
                break
        return cost

    def learn(self) -> None:
        """Called after every batch of trials: see Term."""
        self._refuting.learn()
        for term in self.terms:
            term.learn()

    def _of_case(self, trial: Trial, upper_bound: float) -> float:
        """The cost in one case, or inf if it is not below `upper_bound`; cheap terms come first."""
        values = [0.0] * len(self.terms)
        for share in SHARES if upper_bound < math.inf else ():
            for number, one in self._bounded:
                values[number] = one.lower_bound(trial, share)
                if self.mean(values) >= upper_bound:
                    return math.inf
        for term in sorted(range(len(self.terms)), key=lambda term: self.terms[term].work):
            limit = self.limit(values, term, upper_bound)
            values[term] = self.terms[term].value(trial, limit)
            if values[term] >= limit:
                return math.inf
        return self.mean(values)
