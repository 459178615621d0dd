"""The search for the best rig of each price: many combinations of sensors, and one budget.

Each combination has an ordinary search of its own, which runs in parts. The next part goes to the combination that
will soonest be on the front. One that is on it, is there now; of any other it is supposed that its objective falls by
PROGRESS with each e-fold of its evaluations, so that one with n evaluations, a fraction g above the best that costs no
more, needs n exp(g / PROGRESS). So the front gets most of the budget, and what is far from it little; but never less
than 1 / NEGLECT of the evaluations that the front's combinations have, as early values say little.

Nothing depends on the budget, so a search that is resumed ends where an unbroken one does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.combinations import Combination, combinations
from lidarcfg.placement.optimize import INFEASIBLE, Budget, Log, Placement, Run
from lidarcfg.placement.solvers import start_search
from lidarcfg.placement.solvers.search import Search, Trials
from lidarcfg.placement.study import Study

PROGRESS = 0.05
NEGLECT = 16.0
PART, GROWTH = 200, 0.25  # evaluations of a part, at least; of those so far


@dataclass(frozen=True)
class Part:
    """A line of the history: a combination whose search went on."""

    evaluations: int  # of all combinations
    combination: str
    own_evaluations: int
    best: float
    on_front: bool  # then
    seconds: float


@dataclass(frozen=True)
class Candidate:
    """A combination, and how far its search has come."""

    combination: Combination
    objective: float  # of the best rig; inf if none was found
    evaluations: int
    on_front: bool


@dataclass(frozen=True)
class Point:
    """A combination on the front, with its best rig."""

    combination: Combination
    placement: Placement


@dataclass(frozen=True)
class Front:
    """For each price the rig with the least objective."""

    points: tuple[Point, ...]  # by price; each has a smaller objective than the one before
    candidates: tuple[Candidate, ...]  # all combinations, by price, then objective
    history: tuple[Part, ...]
    logs: tuple[Log, ...]  # by combination, in their own order
    seconds: float
    interrupted: bool

    @property
    def evaluations(self) -> int:
        """Of all combinations."""
        return sum(candidate.evaluations for candidate in self.candidates)

    @property
    def dominated_evaluations(self) -> int:
        """Of the combinations that are not on the front."""
        return sum(candidate.evaluations for candidate in self.candidates if not candidate.on_front)


class FixedPoint:
    """The search of a study in which nothing is free to move: one trial, again and again."""

    def __init__(self) -> None:
        self.cycles = 0
        self.best_x, self.best_cost = np.empty(0), math.inf
        self.sources, self.mean_cost = np.empty((1, 0)), math.inf

    def ask(self) -> Trials:
        """The only trial."""
        return Trials("trial", self.sources, np.zeros(1, np.int64), np.full(1, math.inf))

    def tell(self, cost: Array) -> None:
        """Its cost (1,)."""
        self.cycles += 1
        self.best_cost = self.mean_cost = float(cost[0])


def on_front(prices: Sequence[float], objectives: Sequence[float]) -> list[bool]:
    """Which pairs no other dominates.

    One pair dominates another if neither its price nor its objective is larger, and one of them is smaller; of equal
    pairs the first counts. Pairs without a rig that meets the constraints are on no front.
    """
    best, found = math.inf, [False] * len(prices)
    for i in sorted(range(len(prices)), key=lambda i: (prices[i], objectives[i])):
        if objectives[i] < min(best, INFEASIBLE):
            best, found[i] = objectives[i], True
    return found


def front(
    study: Study,
    threads: int | None = None,
    on_part: Callable[["FrontRun"], None] | None = None,
    logs: Sequence[Log] = (),
    skip: bool = True,
) -> Front:
    """Search for the rig with the least objective for each price, over all combinations that a study allows.

    The result depends on the seed, not on the number of threads; budgets count for all combinations together. `logs`
    are those of an earlier search to resume. An interrupt (Ctrl-C) ends the search and keeps the front so far. Raises
    ConfigError if nothing is to choose, and if no rig was found that meets the constraints.
    """
    if not study.to_choose:
        raise ConfigError("nothing to choose in the study: no group has `choose`")
    search, interrupted = FrontRun(study, logs), False
    try:
        search.run(threads, on_part, skip)
    except KeyboardInterrupt:
        interrupted = True
    return search.result(interrupted)


class FrontRun:
    """The searches of all combinations, in progress."""

    def __init__(self, study: Study, logs: Sequence[Log] = ()) -> None:
        self.study, self.combinations = study, combinations(study)
        self.runs = [
            Run(one.study, _start(one.study), log)
            for one, log in zip(self.combinations, logs or [Log.empty()] * len(self.combinations), strict=True)
        ]
        self.history: list[Part] = []
        self._prices = np.array([one.price for one in self.combinations])
        self._budget = Budget.of(study.solver)

    @property
    def evaluations(self) -> int:
        """Of all combinations."""
        return sum(run.evaluations for run in self.runs)

    @property
    def cycles(self) -> int:
        """Of all combinations."""
        return sum(run.cycles for run in self.runs)

    @property
    def seconds(self) -> float:
        """Of all combinations."""
        return sum(run.seconds for run in self.runs)

    @property
    def objectives(self) -> Array:
        """(combinations,) the least so far; inf without a rig that meets the constraints."""
        return np.array([run.best_cost if run.best_cost < INFEASIBLE else math.inf for run in self.runs])

    @property
    def spent(self) -> float:
        """The fraction of the budget that is spent."""
        return self._budget.fraction(self.evaluations, self.cycles)

    def on_front(self) -> list[bool]:
        """(combinations,) which are on the front so far."""
        return on_front(self._prices.tolist(), self.objectives.tolist())

    def logs(self) -> list[Log]:
        """All that is needed to resume."""
        return [run.log() for run in self.runs]

    def run(self, threads: int | None, on_part: Callable[["FrontRun"], None] | None = None, skip: bool = True) -> None:
        """Search until the budget is spent, or nothing is left to try."""
        budget = self._budget
        while (i := self._next()) is not None:
            run = self.runs[i]
            end = run.evaluations + max(PART, GROWTH * run.evaluations)
            done = not run.study.free.any()
            with run.evaluator(threads, skip) as evaluator:
                while True:
                    run.step(evaluator, self._left(budget, run))
                    spent = budget.spent(self.evaluations, self.cycles)
                    if spent or done or run.evaluations >= end:
                        break
            name, front = self.combinations[i].name, self.on_front()[i]
            self.history.append(Part(self.evaluations, name, run.evaluations, run.best_cost, front, self.seconds))
            if on_part:
                on_part(self)
            if spent:
                return

    def _left(self, budget: Budget, run: Run) -> Budget:
        """What one search may use until the budget of all is spent."""
        evaluations = None if budget.evaluations is None else budget.evaluations - self.evaluations + run.evaluations
        cycles = None if budget.cycles is None else budget.cycles - self.cycles + run.cycles
        return replace(budget, evaluations=evaluations, cycles=cycles)

    def _next(self) -> int | None:
        """The combination that will soonest be on the front: first those not tried yet, by price."""
        open_ = [i for i, run in enumerate(self.runs) if run.study.free.any() or not run.evaluations]
        if not open_:
            return None
        fresh = [i for i in open_ if not self.runs[i].evaluations]
        if fresh:
            return min(fresh, key=lambda i: self._prices[i])
        effort = np.log([max(run.evaluations, 1) for run in self.runs]) + delay(self._prices, self.objectives)
        return min(open_, key=lambda i: effort[i])

    def result(self, interrupted: bool) -> Front:
        """The front so far. Raises KeyboardInterrupt if there is none yet, ConfigError where no rig is allowed."""
        if not any(math.isfinite(run.best_cost) for run in self.runs):
            raise KeyboardInterrupt
        front, objectives = self.on_front(), self.objectives.tolist()
        if not any(front):
            raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
        order = sorted(range(len(front)), key=lambda i: (self._prices[i], objectives[i]))
        ones = self.combinations
        return Front(
            points=tuple(Point(ones[i], self.runs[i].placement(interrupted)) for i in order if front[i]),
            candidates=tuple(Candidate(ones[i], objectives[i], self.runs[i].evaluations, front[i]) for i in order),
            history=tuple(self.history),
            logs=tuple(self.logs()),
            seconds=self.seconds,
            interrupted=interrupted,
        )


def delay(prices: Array, objectives: Array) -> Array:
    """(n,) the logarithm of how much further each search has to go to be on the front, as supposed above."""
    order = np.lexsort((objectives, prices))
    least = np.empty(len(prices))
    least[order] = np.minimum.accumulate(objectives[order])
    most = math.log(NEGLECT)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = objectives / least - 1.0
    gap[objectives == least] = 0.0
    gap[np.isinf(objectives)] = math.inf
    return np.minimum(gap / PROGRESS, most)


def _start(study: Study) -> Search:
    return start_search(study.solver, study.groups) if study.free.any() else FixedPoint()
