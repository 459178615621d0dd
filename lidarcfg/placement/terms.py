"""The terms of an objective: each is a figure of a trial, and can stop early once it is too large."""

import math
from collections import Counter, deque
from collections.abc import Sequence
from functools import cached_property
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from lidarcfg import core
from lidarcfg.placement.blind_spots import Directions, fraction_below, largest_m, looked_at, seen_by_any
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.cones import poses as poses_of
from lidarcfg.placement.detection import DetectionObject, free_places, undetected
from lidarcfg.placement.metric import Node, Spheres, clearance_m
from lidarcfg.placement.region import Region, cuboids_needed
from lidarcfg.placement.return_counts import DetectionTarget, MissCounter
from lidarcfg.placement.subspace import Links, Subspaces, segment
from lidarcfg.placement.visibility import Visibility
from lidarcfg.placement.zones import Weights, worth_m
from lidarcfg.simulate.returns import Poses
from lidarcfg.world.obstacles import NO_OBSTACLES

RECENT = 32  # how many of the findings that settled past trials are tried first in new ones
T = TypeVar("T", bound=Node | int)


class Trial:
    """A rig that is evaluated: its LiDARs, and its subspaces once a term asks for them."""

    def __init__(self, region: Region, lidars: Sequence[Lidar], visibility: Visibility | None) -> None:
        self.region, self.lidars, self.visibility = region, lidars, visibility
        self.kept = tuple(range(len(lidars)))  # the numbers of its LiDARs in the whole rig
        self.is_cut = False  # into subspaces
        self.worth_m, self.first = np.empty(0), np.empty(0, np.int64)  # of its subspaces; see forget
        self._whole: Trial | None = None
        self._left: dict[tuple[int, ...], Trial] = {}

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
        return poses_of(self.lidars)

    def forget(self, weight: Weights | None) -> None:
        """Keep of its subspaces only what they are worth and the first cuboid of each: the rest is large."""
        found = self.__dict__.pop("subspaces", None)
        if found:
            self.worth_m, self.first = worth_m(found, weight), found.first

    @cached_property
    def _links(self) -> Links:
        return Links(self.region, self.lidars, self.visibility)

    def left(self, kept: tuple[int, ...]) -> "Trial":
        """The trial of the rig with only some of its LiDARs."""
        if kept not in self._left:
            one = Trial(self.region, [self.lidars[i] for i in kept], self.visibility)
            one.kept, one._whole = kept, self
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
    """A term of which a part of the work tells how large it is at least."""

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
        """See Term."""
        return float(worth_m(trial.subspaces, self._weight).max())

    def learn(self) -> None:
        """Nothing: see Evaluator.max_vsr."""


class Undetected:
    """1 − the detection rate of an object. Stops once it is undetected in too many places."""

    def __init__(self, region: Region, item: DetectionObject) -> None:
        self._item, self._free = item, free_places(region, item)
        self.work = float(sum(self._free) * math.prod(cuboids_needed(item.box_m, region.cuboid_m)))

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """See Term."""
        return undetected(trial.subspaces, self._item, self._free, limit)

    def learn(self) -> None:
        """Nothing."""


class MissRate:
    """1 − the detection rate of an object by its returns. Stops once too many places have too few returns."""

    def __init__(self, target: DetectionTarget, scanners: Sequence[core.returns.Scanner]) -> None:
        """`scanners` of all of the study's LiDARs."""
        self._target, self._scanners = target, scanners
        self._counter = MissCounter(target, scanners, NO_OBSTACLES)
        self.work = 1e3 * len(target.places)

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """See Term."""
        return self._counter_for(trial).rate(trial.kept, trial.poses, limit)

    def lower_bound(self, trial: Trial, share: float) -> float:
        """By the places where the object is the likeliest to be missed."""
        return self._counter_for(trial).lower_bound(trial.kept, trial.poses, share)

    def _counter_for(self, trial: Trial) -> MissCounter:
        obstacles = trial.visibility.obstacles if trial.visibility else NO_OBSTACLES
        counter = self._counter
        if counter.obstacles is not obstacles:
            counter = self._counter = MissCounter(self._target, self._scanners, obstacles)
        return counter

    def learn(self) -> None:
        """Nothing."""


class UnseenFraction:
    """The fraction of the region's volume that fewer than some number of LiDARs see."""

    work = 1.0

    def __init__(self, least: int) -> None:
        self._least = least

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """See Term."""
        return fraction_below(trial.region, trial.subspaces.seen_by, self._least)

    def learn(self) -> None:
        """Nothing."""


class InscribedRadius:
    """The radius of the largest sphere in any subspace, in metres.

    Spheres around the centres of earlier trials' largest ones are tried first: if one is too large, so is the term.
    """

    work = math.inf

    def __init__(self) -> None:
        self._centres: Recent[Node] = Recent()

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """See Term."""
        if limit < math.inf:
            for centre in self._centres.items:
                if (radius := clearance_m(trial.subspaces, centre)) >= limit:
                    self._centres.add(centre)
                    return radius
        radius, centre = Spheres(trial.subspaces).largest()
        self._centres.add(centre)
        return radius

    def learn(self) -> None:
        """See Recent."""
        self._centres.learn()


class BlindSpot:
    """The largest distance of the blind-spot contour, in metres.

    The term is too large as soon as one point far enough from the body is blind. Points that were blind in earlier
    trials are tested first, then all of them, from the outside inwards. The subspaces are not needed.
    """

    def __init__(self, around: Directions) -> None:
        self._around, self._points = around, looked_at(around)
        self._recent: Recent[int] = Recent()
        self.work = float(len(self._points.number))

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """See Term."""
        if trial.visibility is None:
            return 0.0
        seen = seen_by_any(trial.visibility, trial.lidars)
        first = np.array(self._recent.items, np.int64)
        distance, point = largest_m(self._around, self._points, seen, limit, first)
        if point >= 0:
            self._recent.add(point)
        return distance

    def learn(self) -> None:
        """See Recent."""
        self._recent.learn()
