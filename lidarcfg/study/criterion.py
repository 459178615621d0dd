"""The cost of rigs by an objective: a weighted mean of terms, each of which can stop early once it is too large.

A trial has a cost to beat. Every term is at least 0, and sums, products and quotients of floating-point numbers are
monotonic. So as soon as the weighted mean of the terms known so far, with 0 or lower bounds for the others, reaches
the cost to beat, the trial is refuted exactly: its full cost would be no less.
"""

import math
from collections.abc import Sequence

import numpy as np

from lidarcfg.geometry import Array, Flags
from lidarcfg.requirements.robustness import mounted
from lidarcfg.returns.known import KnownReturns
from lidarcfg.sensors.rig import Mount
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.objective import Objective
from lidarcfg.study.study import Study
from lidarcfg.study.terms.max_vsr import MaxVsr
from lidarcfg.study.terms.recent import Recent
from lidarcfg.study.terms.term import TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.study.zones import weights

SHARES = 0.2, 0.35, 0.5, 0.65, 0.8  # of the work, by which a term is bounded before any is computed
EVERY_CASE = np.empty((0, 0), bool)


class Criterion:
    """The weighted mean of an objective's terms; with `kept`, that of the worst case of failure."""

    def __init__(
        self,
        objective: Objective,
        context: TermContext,
        kept: Flags = EVERY_CASE,  # (cases, lidars) the LiDARs left in each case; no cases: the whole rig alone
    ) -> None:
        self.weight = context.weight
        self.kept = kept
        self.terms = objective.terms(context)
        self.max_vsr = next((n for n, one in enumerate(self.terms) if isinstance(one, MaxVsr)), None)  # which it is
        self._weights = [one.weight for one in self.terms]
        self._cases = [tuple(np.flatnonzero(case).tolist()) for case in kept]
        self._refuting: Recent[int] = Recent()  # cases

    @classmethod
    def of_study(
        cls, study: Study, kept: Flags = EVERY_CASE, mounts: Sequence[Mount] = (), known: KnownReturns | None = None
    ) -> "Criterion":
        """That of a study. A rig whose sensors are not the study's needs its mounts here.

        Misses are counted at the places of `known` returns; without them, at fresh ones.
        """
        context = TermContext(
            region=study.region,
            objects=study.detection,
            targets=study.detection_targets,
            weight=weights(study.zones, study.region),
            misses=study.misses,
            known=known,
            mounts=mounts or study.rig(study.space.lower).mounts,
        )
        return cls(study.objective, context, kept)

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
            for number, one in enumerate(self.terms):
                bound = one.bound(trial, share)
                if bound > values[number]:
                    values[number] = bound
                    if self.mean(values) >= upper_bound:
                        return math.inf
        for term in sorted(range(len(self.terms)), key=lambda term: self.terms[term].work):
            limit = self.limit(values, term, upper_bound)
            values[term] = self.terms[term].value(trial, limit)
            if values[term] >= limit:
                return math.inf
        return self.mean(values)


def objective_of(study: Study, poses: Array) -> float:
    """The objective of one rig's poses (slots, 6), computed in full: by definition, what a search minimises.

    Misses are counted at fresh places; a search counts them at its own.
    """

    def at(where: Array) -> Trial:
        return Trial(study.region, lidars_at(study.slots, where), study.visibility)

    robust = study.robust
    whole = Criterion.of_study(study)
    if robust is None:
        return whole.of(at(poses))
    costs = []
    if robust.lost:
        costs.append(Criterion.of_study(study, robust.kept(len(study.slots))).of(at(poses)))
    if robust.drawn:
        drawn = sorted(whole.of(at(mounted(poses, error))) for error in robust.errors(len(study.slots)))
        costs.append(drawn[robust.drawn - 1 - robust.spare])
    return max(costs)
