"""The search of a study with requirements: plain rigs first, then the solver; its best rigs are verified on the way.

Only the base grid's places count in trials; of a large grid, at first some that are spread over it. So from time to
time, and at the end, the best rig that meets all is verified, at all places of the grid and at refined ones. Where it
fails, the worst of these join the set, and the solver starts anew from that rig. When this happens depends on the
evaluations alone, so a search that is resumed does the same.

The shortfall of a rig is the sum of those of its requirements; that of one that violates constraints is INFEASIBLE or
more, which no sum reaches. Without an objective, what is minimised of rigs that meet all is 1 / (1 + the least relative
margin).
"""

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from types import TracebackType

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.achievable import unachievable
from lidarcfg.placement.evaluator import Index
from lidarcfg.placement.misses_search import MissesRun
from lidarcfg.placement.search_run import Budget, Cycle, Log, Placement, TrialEvaluator, objective_costs
from lidarcfg.placement.solvers.search import (
    NO_COST,
    Cost,
    is_below,
    unbounded,
)
from lidarcfg.placement.study import Study
from lidarcfg.placement.study_evaluator import StudyEvaluator
from lidarcfg.requirements.objects import ObjectJudge, ObjectRequirement
from lidarcfg.requirements.shortfalls import Draws, Shortfalls
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns.known import KnownReturns
from lidarcfg.returns.misses import SEARCH_PLACES
from lidarcfg.returns.places import FINEST_M, FINEST_RAD
from lidarcfg.sensors.rig import Mount

SHORTFALL_MOST = 1e5  # below INFEASIBLE
LEAST = math.ulp(0.0)  # the least number above 0
LOOK_S = 0.05  # between two looks at the clock, where there is a deadline
SLICE_MOST = 1000
LEFT_MOST = 0.25  # of the seconds of a search, to verify its best rig at the end
CHECK_EVERY = 500  # evaluations from one check to the next; twice as many after one that is passed


class RequirementsEvaluator:
    """Evaluates poses (n, slots, 6) of a study's sensors; a context that owns its threads. As StudyEvaluator.

    `more_places`: see Shortfalls.
    """

    smooths = False  # whether costs can be smoothed

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        skip: bool = True,
        on_evaluations: Callable[[int], None] | None = None,
        more_places: Mapping[int, Array] | None = None,
        places: int = SEARCH_PLACES,
    ) -> None:
        """Misses are counted at so many `places` of each object."""
        assert study.requirements
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads)
        self._skip = skip
        self._on_evaluations = on_evaluations
        self._requirements = study.requirements
        self._mounts = study.rig(study.lower).mounts
        self._judge = Shortfalls(self._requirements, self._mounts, skip, more_places)
        self._objective = None if study.only_required else StudyEvaluator(study, threads, skip, places=places)
        self._seconds = 0.0
        self.trials = 0  # evaluated, in full or until they were refuted

    def __enter__(self) -> "RequirementsEvaluator":
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._pool.shutdown(cancel_futures=True)
        if self._objective:
            self._objective.__exit__(kind, value, at)

    def add_places(self, more_places: Mapping[int, Array]) -> None:
        """Use these places, too, from now on; see Shortfalls. What is known of sensors is forgotten."""
        self._judge = Shortfalls(self._requirements, self._mounts, self._skip, more_places)

    @property
    def known(self) -> KnownReturns | None:
        """The returns at the places where misses are counted; None: they are not."""
        return self._objective.known if self._objective else None

    def count_at(self, places: int) -> None:
        """Count misses at so many places of each object from now on."""
        if self._objective:
            self._objective.count_at(places)

    @property
    def slice(self) -> int:
        """How many trials are evaluated between two looks at the clock, where there is a deadline."""
        each_s = self._seconds / self.trials if self.trials else math.inf
        return int(np.clip(LOOK_S / max(each_s, 1e-9), self._threads if self.trials else 1, SLICE_MOST))

    @property
    def full_evaluations(self) -> int:
        """The number of rigs whose objective was evaluated in full."""
        return self._objective.full_evaluations if self._objective else 0

    @property
    def cuboids(self) -> int:
        """The number of cuboids evaluated."""
        return self._objective.cuboids if self._objective else 0

    @property
    def segments(self) -> int:
        """The number of segments cast from LiDARs to cuboids, at most."""
        return self._objective.segments if self._objective else 0

    def costs(
        self, poses: Array, source: Index, source_poses: Array, upper_bound: Array, smoothing: float = 0.0
    ) -> Array:
        """(n, 2) the costs, or (inf, inf) where one is not below `upper_bound` (n, 2). See Evaluator.costs."""
        began = time.perf_counter()
        limits = upper_bound if self._skip else unbounded(len(poses))
        rigs = self._judge.rigs(poses)
        run = map if self._threads == 1 else self._pool.map
        cost = np.array(list(run(self._cost, rigs, limits.tolist()))).reshape(-1, 2)
        if self._objective:
            met = np.flatnonzero(cost[:, 0] == 0)
            if len(met):
                cost[met] = objective_costs(self._objective, poses[met], source[met], source_poses, limits[met])
        self._judge.learn()
        self.trials += len(poses)
        self._seconds += time.perf_counter() - began
        if self._on_evaluations:
            self._on_evaluations(self.trials)
        return np.where(is_below(cost, limits)[:, None], cost, np.inf)

    def shortfalls(self, poses: Array) -> tuple[float, ...]:
        """Of one rig's poses (slots, 6), for each requirement in turn."""
        return self._judge.shortfalls(self._judge.rigs(poses[None])[0])

    def _cost(self, rig: Draws, limit: tuple[float, float]) -> Cost:
        """The cost of a rig by its shortfall; (0, 0) if it meets all."""
        limit_shortfall, _ = limit
        shortfall = self._judge.shortfall(rig, max(limit_shortfall, LEAST))
        if shortfall > 0:
            return Cost(min(shortfall, SHORTFALL_MOST) if math.isfinite(shortfall) else math.inf, math.inf)
        return Cost(0.0, 0.0)


@dataclass(frozen=True)
class RequirementsCycle(Cycle):
    """A line of the history; while the best rig misses requirements, `best` and `mean` are shortfalls."""

    shortfall: float  # of the best rig, at the places that count in trials


@dataclass(frozen=True)
class Verified:
    """A rig that meets all requirements, refined places included."""

    x: Array
    cost: Cost
    verdict: Verdict


class RequirementsRun(MissesRun):
    """A search for a rig that meets requirements; see SearchRun."""

    def __init__(self, study: Study, log: Log | None = None, plain: bool = True) -> None:
        """With `plain`, the plain rigs are the first trials."""
        assert study.requirements
        super().__init__(study, log, plain)
        self._requirements = study.requirements
        self._verify_s = 0.0  # the longest time that it took
        self._more_places: dict[int, Array] = {}  # by requirement
        self._next_check = 0  # evaluations
        self._interval = CHECK_EVERY
        self._verified: Verified | None = None  # the cheapest

    @cached_property
    def _verifier(self) -> Verifier:
        return Verifier(self._requirements)

    @property
    def is_verified(self) -> bool:
        """Whether a rig was found that meets all requirements, refined places included."""
        return self._verified is not None

    @contextmanager
    def evaluator(
        self, threads: int | None, skip: bool = True, on_evaluations: Callable[[int], None] | None = None
    ) -> Iterator[RequirementsEvaluator]:
        """An evaluator for one part of the run."""
        with super().evaluator(threads, skip, on_evaluations) as one:
            assert isinstance(one, RequirementsEvaluator)
            yield one

    def _evaluator(
        self, threads: int | None, skip: bool, on_evaluations: Callable[[int], None] | None
    ) -> RequirementsEvaluator:
        self._find_midpoint()
        return RequirementsEvaluator(self.study, threads, skip, on_evaluations, self._more_places, self.places)

    def _costs(
        self,
        evaluator: TrialEvaluator,
        poses: Array,
        source: Index,
        source_poses: Array,
        upper_bound: Array,
        smoothing: float,
    ) -> Array:
        return evaluator.costs(poses, source, source_poses, upper_bound, smoothing)

    def _line(self) -> Cycle:
        line = super()._line()
        return RequirementsCycle(
            cycle=self.cycles,
            evaluations=line.evaluations,
            best=line.best,
            mean=line.mean,
            seconds=line.seconds,
            shortfall=self.best_cost.shortfall,
        )

    def is_over(self, budget: Budget) -> bool:
        """Whether a limit is reached; of seconds, some are left to verify the best rig."""
        if self.study.only_required and self._is_best_verified:
            return True
        needed_s = 0.0 if self._is_best_verified else min(self._verify_s, LEFT_MOST * budget.seconds)
        return super().is_over(budget) or (bool(self.history) and time.perf_counter() + needed_s >= budget.deadline)

    @property
    def _meets(self) -> bool:
        """Whether the best rig meets all requirements at the places that count in trials."""
        return self.best_cost.shortfall == 0

    @property
    def _is_best_verified(self) -> bool:
        return self._verified is not None and bool((self.best_x == self._verified.x).all())

    def step(self, evaluator: TrialEvaluator, budget: Budget) -> bool:
        """Evaluate one batch of trials, and verify the best rig where that is due. Returns as SearchRun.step."""
        told = super().step(evaluator, budget)
        is_due = self._meets and self.evaluations >= self._next_check and not self.is_over(budget)
        if is_due and time.perf_counter() + self._verify_s < budget.deadline:
            self._check(evaluator)
        return told

    def verdict_on(self, x: Array) -> Verdict:
        """The verdict on the rig at a point (free coordinates,), with refined places."""
        began = time.perf_counter()
        found = self._verifier.verify(self._mounts(x))
        self._verify_s = max(self._verify_s, time.perf_counter() - began)
        return found

    def verify_best(self) -> bool:
        """Whether the best rig meets all requirements, at all places."""
        if self._is_best_verified:
            return True
        return self._meets and not self._missed() and self._verify().passed

    def _verify(self) -> Verdict:
        """The verdict on the best rig, which is kept if it passes."""
        found = self.verdict_on(self.best_x)
        if found.passed:
            self._verified = Verified(self.best_x.copy(), self.best_cost, found)
        return found

    def _mounts(self, x: Array) -> Sequence[Mount]:
        """Those of the rig at a point."""
        return self.study.rig(self.study.poses(x[None])[0]).mounts

    def _check(self, evaluator: TrialEvaluator) -> None:
        """Verify the best rig; if it fails at places that do not count in trials, these join and the search goes on."""
        assert isinstance(evaluator, RequirementsEvaluator)
        if self._is_best_verified:
            self._schedule(self._interval)
            return
        if missed := self._missed():
            for number, places in missed.items():
                self._add(number, places)
            self._restart(evaluator, self._points)
            return
        found = self._verify()
        if found.passed:
            self._schedule(2 * self._interval)
            return
        self._schedule(CHECK_EVERY)
        if self._add_places(found):
            self._restart(evaluator, self._points[:0])

    def _restart(self, evaluator: RequirementsEvaluator, points: Array) -> None:
        """Use the added places, and start the solver anew from the best rigs, or from some points."""
        evaluator.add_places(self._more_places)
        self._start_anew(evaluator, np.concatenate([self._verified.x[None], points]) if self._verified else points)

    @property
    def _may_double(self) -> bool:
        """As of MissesRun, once a rig is verified: nothing else is minimised before."""
        return super()._may_double and self.is_verified

    def _rivals(self) -> Array:
        """None: a plain rig need not meet the requirements."""
        return self._points[:0]

    def _schedule(self, interval: int) -> None:
        self._interval = interval
        self._next_check = self.evaluations + interval

    def _missed(self) -> dict[int, Array]:
        """Places of the base grid that trials leave out and at which the best rig fails, by requirement."""
        mounts = self._mounts(self.best_x)
        judges = [(n, judge) for n, judge in enumerate(self._verifier.judges) if isinstance(judge, ObjectJudge)]
        return {n: places for n, judge in judges if len(places := judge.missed(mounts))}

    def _add(self, number: int, places: Array) -> None:
        known = self._more_places.get(number)
        self._more_places[number] = places if known is None else np.concatenate([known, places])

    def _add_places(self, found: Verdict) -> bool:
        """Add the worst places at which requirements fail, and those around. Returns whether there are any."""
        added = False
        for number, (item, one) in enumerate(zip(self._requirements.items, found.requirements, strict=True)):
            if one.passed or not isinstance(item, ObjectRequirement) or item.at_least < 1 or one.worst is None:
                continue
            heading = math.radians(one.worst.heading_deg or 0.0)
            place = np.array([[one.worst.x_m, one.worst.y_m, item.stand.ground_m, heading]])
            self._add(number, np.concatenate([place, item.stand.around(place, FINEST_M, FINEST_RAD, set())]))
            added = True
        return added

    def placement(self, interrupted: bool, verdict: Verdict | None = None) -> Placement:
        """The result: the best rig; where that fails at refined places alone, the best that was verified."""
        x = self.best_x
        if verdict is None and self._verified and self._is_best_verified:
            verdict = self._verified.verdict
        if verdict is None:
            verdict = Verdict(()) if self.best_cost == NO_COST else self.verdict_on(x)
        remarks = []
        if self._meets and not verdict.passed:
            what = "the best rig met all requirements at the places that count in a search, but not at all others"
            if self._verified:
                what += "; this one is the best that was verified"
            else:
                what += "; search longer, and the worst of them count"
            remarks.append(what)
        if self._verified and not verdict.passed:
            x = self._verified.x
            verdict = self._verified.verdict
            self.best_x = x
            self.best_cost = self._verified.cost
        if self._more_places:
            places = sum(len(one) for one in self._more_places.values())
            remarks.append(f"{places} places joined those that count in a search, as rigs failed there")
        found = super().placement(interrupted, _with_reasons(self.study, verdict))
        poses = self.study.poses(x[None])[0]
        objective = found.objective
        if self.study.only_required:
            objective = verdict.least_margin
        elif not self._meets:
            objective = self.study.cost(poses)
        return replace(found, objective=objective, remarks=tuple(remarks))


def _with_reasons(study: Study, found: Verdict) -> Verdict:
    """The verdict, with notes where no rig could do better."""
    if found.passed:
        return found
    why = unachievable(study)
    out = []
    for one in found.requirements:
        reason = None if one.passed else one.not_achievable or why.get(one.name)
        out.append(replace(one, not_achievable=reason))
    return Verdict(tuple(out))
