"""The search for the rig that misses least: from plain rigs, at ever more places, compared at the end at fresh ones.

A search that counts misses at few places is quick, and soon finds rigs that suit these places better than the world.
So once its best rigs differ by less than so few places can tell, it counts at twice as many, up to a limit, and the
solver starts anew from the best rigs and the best plain ones. Costs of different numbers of places are never compared.
When the places double depends on the evaluations alone, so a search that is resumed does the same.

At the end the best of the rigs that are searched around, and the best plain ones, are compared at fresh places, which
no search has seen. If a plain one is better, it is the result.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.returns.known import KnownReturns
from lidarcfg.returns.misses import FRESH_PLACES, SEARCH_PLACES, MissesFound
from lidarcfg.search.log import Log
from lidarcfg.search.run import Believed, Budget, Compared, Placement, SearchRun
from lidarcfg.search.seeded import STARTS, SeededSearch
from lidarcfg.solvers.search import NO_COST, FixedPoint, Trials, cost_of, unbounded
from lidarcfg.study.evaluator import Evaluator
from lidarcfg.study.objective_costs import ObjectiveCosts
from lidarcfg.study.study import Study

DOUBLED_EVERY = 30  # evaluations a dimension, until it is asked again whether places tell the best rigs apart
CHOSEN_AT = 1024  # places of each object, at least, by which the best of the last rigs is chosen
COMPARED = 2 + STARTS  # rigs, counted at fresh places, that take as long as to choose and to compare
TOLD_APART = 2.0  # standard errors by which rigs have to differ
NO_BETTER = "no rig that was found misses less than the best plain rig at fresh places; this one is that plain rig"


class MissesRun(SearchRun):
    """A search that minimises misses; see SearchRun."""

    def __init__(self, study: Study, log: Log) -> None:
        """It begins with the points of the log, or without any with the midpoint."""
        points = np.full((1, study.space.dimensions), 0.5) if log.points is None else log.points
        self._first_points = points
        self._given = points[: log.given]  # the rigs to start with
        super().__init__(study, SeededSearch(study, points) if study.space.free.any() else FixedPoint(), log)
        self._restarts = 0
        self._cycles_before = 0  # of searches that were given up
        self.places = SEARCH_PLACES  # of each object, at which misses are counted
        self._asked_at = 0  # evaluations, when it was asked whether these tell rigs apart
        self._second_x: Array | None = None  # the best rig before the best one, at these places
        self._plain = points[:0]  # the best of the first points so far
        self._midpoint: MissesFound | None = None
        self._compare_s = 0.0  # that it takes to compare rigs at fresh places

    @property
    def cycles(self) -> int:
        """Cycles so far."""
        return self._cycles_before + super().cycles

    def _evaluator(self, threads: int | None, skip: bool, on_evaluations: Callable[[int], None] | None) -> Evaluator:
        self._find_midpoint()
        return Evaluator(self.study, threads, skip, on_evaluations, self.places)

    def _find_midpoint(self) -> None:
        """Count what the rig at the midpoint misses, which says how long that takes at fresh places."""
        study = self.study
        if self._midpoint is None and study.objective.misses and study.misses:
            places = study.misses.fresh
            began = time.perf_counter()
            self._midpoint = study.misses.found_at(places, study.rig(study.space.midpoint).mounts)
            self._compare_s = COMPARED * (time.perf_counter() - began)

    def is_over(self, budget: Budget) -> bool:
        """Whether a limit is reached; of seconds, some are left to compare the best rigs at fresh places."""
        return super().is_over(budget) or (
            bool(self.history) and time.perf_counter() + self._compare_s >= budget.deadline
        )

    def tell(self, trials: Trials, cost: Array, budget: Budget) -> bool:
        """As SearchRun."""
        before = self.best_x, self.best_cost
        told = super().tell(trials, cost, budget)
        if NO_COST > before[1] > self.best_cost:
            self._second_x = before[0]
        return told

    def step(self, evaluator: Evaluator, budget: Budget) -> bool:
        """Evaluate one batch of trials, and double the places where that is due. Returns as SearchRun.step."""
        told = super().step(evaluator, budget)
        due = self._asked_at + DOUBLED_EVERY * len(self.best_x)
        if self._may_double and self.evaluations >= due and not self.is_over(budget):
            self._asked_at = self.evaluations
            if evaluator.known and not self._tells_apart(evaluator.known):
                self._double(evaluator)
        return told

    @property
    def _may_double(self) -> bool:
        """Whether misses are what the best rigs differ in."""
        return self.study.objective.misses is not None and self.best_cost.shortfall == 0

    def _tells_apart(self, known: KnownReturns) -> bool:
        """Whether the best rig differs by more than chance from the best one before."""
        study = self.study
        assert study.misses
        if self._second_x is None:
            return False
        best, second = (
            study.misses.found_at(known, study.rig(pose).mounts)
            for pose in study.space.poses(np.array([self.best_x, self._second_x]))
        )
        mean, error = best.compared(second)
        return mean > TOLD_APART * error

    def _double(self, evaluator: Evaluator) -> None:
        """Count at twice as many places, if there may be more, and start the solver anew."""
        if self.places < FRESH_PLACES:
            self.places *= 2
            evaluator.count_at(self.places)
            self._second_x = None
        self._start_anew(evaluator, np.concatenate([self._search.sources, self._best_plain()]))

    def _best_plain(self) -> Array:
        """(s, dimensions) the best of the plain rigs that keep the constraints, by all that is known of them."""
        if isinstance(self._search, SeededSearch) and not self._restarts:
            best = self._search.best_points
            self._plain = best[self.study.space.violation(self.study.space.poses(best)) == 0.0]
        return self._plain

    def _start_anew(self, evaluator: Evaluator, points: Array) -> None:
        """Start the solver anew, from the best of the best rig and some points."""
        self._best_plain()  # while the search that knows them is there
        self._restarts += 1
        self._cycles_before = self.cycles
        every = np.concatenate([self.best_x[None], points])
        _, first = np.unique(every, axis=0, return_index=True)
        self._search = SeededSearch(self.study, every[np.sort(first)], self._restarts)
        self.best_cost = cost_of(self._cost_of(evaluator, self.best_x[None])[0])

    def _cost_of(self, evaluator: Evaluator, x: Array) -> Array:
        """(n, 2) the costs of points (n, dimensions), as they count now."""
        poses = self.study.space.poses(x)
        return evaluator.costs(poses, np.zeros(len(x), np.int64), poses, unbounded(len(x)))

    def placement(self, interrupted: bool, verdict: Verdict | None = None) -> Placement:
        """The result: the best rig, or if that is better at fresh places the best plain one. Raises as SearchRun."""
        if self._midpoint is None or self.best_cost.shortfall > 0:
            return super().placement(interrupted, verdict)
        self.best_x, believed, places = self._chosen()
        rivals = self._rivals()
        objective, *others = self._fresh_objectives(np.concatenate([self.best_x[None], rivals]))
        plain = None
        remarks: tuple[str, ...] = ()
        if others:
            best = int(np.argmin(others))
            plain = self._compared(rivals[best], others[best])
            if others[best] < objective:
                self.best_x = rivals[best]
                objective = others[best]
                remarks = (NO_BETTER,)
        found = super().placement(interrupted, verdict)
        told = Believed(believed, places, plain, self._midpoint)
        return replace(found, objective=objective, believed=told, remarks=remarks)

    def _chosen(self) -> tuple[Array, float, int]:
        """The best of the best rig (dimensions,) and those that are searched around, by more places than before.

        Its objective there, and how many places these are.
        """
        best, least = self.best_x, self.best_cost.objective
        if self.places >= CHOSEN_AT:
            return best, least, self.places
        points = np.unique(np.concatenate([best[None], self._search.sources]), axis=0)
        points = points[self.study.space.violation(self.study.space.poses(points)) == 0.0]
        least = np.inf
        with ObjectiveCosts(self.study, 1, places=CHOSEN_AT) as objective:
            for x in points:
                poses = self.study.space.poses(x[None])
                [cost] = objective.costs(poses, np.zeros(1, np.int64), poses, np.full(1, least))
                if cost < least:
                    best, least = x, float(cost)
        return best, least, CHOSEN_AT

    def _rivals(self) -> Array:
        """(n, dimensions) the rigs given and the best plain ones, than which the result is no worse."""
        return np.concatenate([self._given, self._best_plain()])

    def _fresh_objectives(self, points: Array) -> list[float]:
        """The objectives of points (n, dimensions) at fresh places."""
        poses = self.study.space.poses(points)
        with ObjectiveCosts(self.study, places=None) as fresh:
            found = fresh.costs(poses, np.zeros(len(poses), np.int64), poses, np.full(len(poses), np.inf))
        return [float(one) for one in found]

    def _compared(self, x: Array, objective: float) -> Compared:
        """The rig at a point, of a known objective at fresh places."""
        study = self.study
        assert study.misses
        rig = study.rig(study.space.poses(x[None])[0])
        return Compared(rig, objective, study.misses.found(rig.mounts))
