"""The cost of a trial: a weighted mean of terms, each of which can stop early once it is too large.

A trial has a cost to beat. Every term is at least 0, and sums, products and quotients of floating-point numbers are
monotonic. So as soon as the weighted mean of the terms known so far, with 0 or lower bounds for the others, reaches
the cost to beat, the trial is refuted exactly: its full cost would be no less.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from lidarcfg.placement.blind_spots import Directions
from lidarcfg.placement.detection import DetectionObject
from lidarcfg.placement.objective import Objective
from lidarcfg.placement.region import Region
from lidarcfg.placement.terms import (
    BlindSpot,
    BoundedTerm,
    InscribedRadius,
    MaxVsr,
    MissRate,
    Recent,
    Term,
    Trial,
    Undetected,
    UnseenFraction,
)
from lidarcfg.placement.zones import Weights

Flags = NDArray[np.bool_]
SHARES = 0.2, 0.35, 0.5, 0.65, 0.8  # of the work, by which a term is bounded before any is computed
EVERY_CASE = np.empty((0, 0), bool)


class Criterion:
    """The weighted mean of an objective's terms, for a region, its objects and the directions around the vehicle.

    With `kept`, the LiDARs that are left in each case of failure, it is that of the worst case.
    """

    def __init__(
        self,
        objective: Objective,
        region: Region,
        objects: Sequence[DetectionObject],
        around: Directions | None = None,  # needed for a blind spot
        by_returns: Mapping[str, MissRate] = MappingProxyType({}),  # needed for objects that are detected by them
        weight: Weights | None = None,  # of max VSR, by cuboid
        kept: Flags = EVERY_CASE,  # (cases, lidars); no cases: the whole rig alone
    ) -> None:
        self.weight, self.kept = weight, kept
        self._cases = [tuple(np.flatnonzero(case).tolist()) for case in kept]
        self._refuting: Recent[int] = Recent()  # cases
        wanted = objective.detection
        self.terms: list[Term] = [
            by_returns.get(item.name) or Undetected(region, item) for item in objects if item.name in wanted
        ]
        self._weights = [wanted[item.name] for item in objects if item.name in wanted]
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
        if objective.blind_spot_m is not None and around is not None:
            self.terms.append(BlindSpot(around))
            self._weights.append(objective.blind_spot_m.weight)

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
            limit, step = limit + step, 2.0 * step
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
