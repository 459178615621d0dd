"""The search for the best rig of each price: many combinations of sensors, and one budget.

Each combination has a search of its own, which runs in parts. The next part goes to the combination that is expected
to reach the front soonest. A combination on the front is already there. For any other, the objective is assumed to
fall by the fraction PROGRESS whenever the number of evaluations grows by a factor of e: after n evaluations, with an
objective that is a fraction g above the best at the same or a lower price, it needs n exp(g / PROGRESS) evaluations.
So most of the budget goes to the front. Every combination gets at least 1 / NEGLECT of the evaluations that those on
the front have, because early values say little.

After the first part of its own search, and again whenever that search has grown by the factor LATER, a combination
learns from the others for TRANSFER evaluations: see transfer.py. None of this depends on the budget, so a resumed
search ends where an uninterrupted one does.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidarcfg import maths
from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError
from lidarcfg.files import loaded
from lidarcfg.geometry import Array
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.search.chooser import Chooser
from lidarcfg.search.combinations import Combination, combinations
from lidarcfg.search.log import Log, Record, SearchLog
from lidarcfg.search.plain_rigs import plain_points
from lidarcfg.search.run import Budget, Cycle, Placement, SearchRun
from lidarcfg.search.seeded import SeededSearch
from lidarcfg.search.start_rigs import points_by_combination
from lidarcfg.search.transfer import Example, transferred
from lidarcfg.search.workers import Job
from lidarcfg.sensors.rig import Rig, rigs_of
from lidarcfg.solvers.cma_es import WarmStart
from lidarcfg.solvers.search import NO_COST, FixedPoint, Search
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.evaluator import Evaluator
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study, with_solver

PROGRESS = 0.4
NEGLECT = 4.0
PART = 200  # evaluations of a part, at least
GROWTH = 0.25  # of a part, by the evaluations so far
FRONT_PLACES = 512  # of each object, at which misses are counted
TRANSFER = 150  # evaluations by which a combination learns from the others
LATER = 16  # the growth of its own search after which it does so again


@dataclass(frozen=True)
class FrontTurn:
    """A line of the history: one part of one combination's search."""

    evaluations: int  # of all combinations
    combination: str
    own_evaluations: int
    best: float
    on_front: bool  # then
    seconds: float


@dataclass(frozen=True)
class Candidate:
    """A combination, and the state of its search."""

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
    history: tuple[FrontTurn, ...]
    log: SearchLog
    seconds: float
    interrupted: bool

    @property
    def evaluations(self) -> int:
        """Evaluations of all combinations."""
        return sum(candidate.evaluations for candidate in self.candidates)

    @property
    def dominated_evaluations(self) -> int:
        """Evaluations of the combinations that are not on the front."""
        return sum(candidate.evaluations for candidate in self.candidates if not candidate.on_front)


def on_front(prices: Sequence[float], objectives: Sequence[float]) -> list[bool]:
    """Which pairs of price and objective are not dominated by another pair.

    One pair dominates another if neither its price nor its objective is larger, and one of them is smaller; of equal
    pairs the first counts. Pairs without a rig that meets the constraints are on no front.
    """
    best = math.inf
    found = [False] * len(prices)
    for i in sorted(range(len(prices)), key=lambda i: (prices[i], objectives[i])):
        if objectives[i] < best:
            best = objectives[i]
            found[i] = True
    return found


def front(
    study: Study | Given,
    threads: int | None = None,
    on_turn: Callable[["FrontRun"], None] | None = None,
    log: SearchLog | None = None,
    skip: bool = True,
    rigs: Sequence[Rig | Given] = (),
    *,
    seed: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
) -> Front:
    """Search for the rig with the least objective for each price, over all combinations that a study allows.

    Study and rigs are files, dicts with their keys, or loaded. `seed`, and a budget of `evaluations` or `seconds`,
    replace those of the study. The result depends on the seed, not on the number of threads; budgets count for all
    combinations together. `log` is that of an earlier search to resume. `rigs` are tried first, each in the combination
    whose models it has. An interrupt (Ctrl-C) ends the search and keeps the front so far. Raises ConfigError if nothing
    is to choose, for rigs that the study does not allow, and if no rig was found that meets the constraints.
    """
    study = with_solver(loaded(study, load_study, Study), seed=seed, evaluations=evaluations, seconds=seconds)
    run = FrontRun(study, threads, on_turn, log, skip, rigs_of(rigs))
    return run.result(interrupted=run.run())


class FrontSearch(SearchRun):
    """A search of one combination. Misses are counted at as many places as those of all others."""

    def _evaluator(self, threads: int | None, skip: bool, on_evaluations: Callable[[int], None] | None) -> Evaluator:
        return Evaluator(self.study, threads, skip, on_evaluations, FRONT_PLACES)

    def placement(self, interrupted: bool, verdict: Verdict | None = None) -> Placement:
        """As SearchRun; misses are those at fresh places."""
        found = super().placement(interrupted, verdict)
        if self.study.objective.misses is None:
            return found
        return replace(found, objective=objective_of(self.study, self.study.space.poses(self.best_x[None])[0]))


class CandidateSearch:
    """A combination and its searches: the ordinary one first, then those that learn from others."""

    def __init__(self, combination: Combination, logs: Sequence[Log]) -> None:
        self.combination = combination
        self._logs = list(logs)
        study = combination.study
        points = logs[0].points if logs else None
        if points is None and study.objective.misses:
            points = plain_points(study)
        if not study.space.free.any():
            search: Search = FixedPoint()
        elif points is None:
            search = study.solver.begin(study.space.coordinates)
        else:
            search = SeededSearch(study, points)
        self.runs = [self._run(search)]
        self._transfer: WarmStart | None = None  # the last one's search

    def _run(self, search: Search) -> SearchRun:
        return FrontSearch(self.combination.study, search, self._logs.pop(0) if self._logs else None)

    @property
    def own(self) -> SearchRun:
        """The ordinary search."""
        return self.runs[0]

    @property
    def best(self) -> SearchRun:
        """The search with the best rig."""
        return min(self.runs, key=lambda run: run.best_cost)

    @property
    def objective(self) -> float:
        """The least so far; inf without a rig that meets the constraints."""
        return self.best.best_cost.objective

    @property
    def evaluations(self) -> int:
        """Evaluations of all its searches."""
        return sum(run.evaluations for run in self.runs)

    @property
    def cycles(self) -> int:
        """Cycles of all its searches."""
        return sum(run.cycles for run in self.runs)

    @property
    def seconds(self) -> float:
        """Seconds of all its searches."""
        return sum(run.seconds for run in self.runs)

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to try."""
        return self.evaluations > 0 and not self.combination.study.space.free.any()

    @property
    def should_transfer(self) -> bool:
        """Whether its own search has grown enough to learn from the others again."""
        return self.own.evaluations >= PART * int(LATER ** (len(self.runs) - 1))

    def learn(self, searches: Sequence["CandidateSearch"], number: int) -> SearchRun | None:
        """A search that starts from the best rigs of all; None if no rig fits. `number` is this candidate's index."""
        known = [candidate for candidate in searches if candidate.objective < math.inf]
        examples = [Example(one.combination, one.best.best_x, one.objective) for one in known]
        rng = np.random.default_rng([self.combination.study.solver.seed, number, len(self.runs)])
        found = transferred(self.combination, examples, rng)
        if not len(found):
            return None
        self._transfer = WarmStart(found, int(rng.integers(2**63)))
        self.runs.append(self._run(self._transfer))
        return self.runs[-1]

    def is_over(self, run: SearchRun) -> bool:
        """Whether one of its searches has nothing more to try for now."""
        return self.is_done or (run is not self.own and self._transfer is not None and self._transfer.over)

    def placement(self, interrupted: bool) -> Placement:
        """The best rig, with the ordinary search's history and log."""
        found = self.best.placement(interrupted)
        own = self.own
        if len(self.runs) == 1:
            return found
        last = Cycle(self.cycles, self.evaluations, self.best.best_cost.number, own.history[-1].mean, self.seconds)
        works = [run.work for run in self.runs]
        return replace(
            found,
            history=(*own.history, last),
            log=own.log(),
            evaluations=self.evaluations,
            first_evaluations=own.asked["first"],
            scout_evaluations=own.asked["scout"],
            evaluated=sum(work.trials for work in works),
            full_evaluations=sum(work.full_evaluations for work in works),
            cuboids=sum(work.cuboids for work in works),
            segments=sum(work.segments for work in works),
            seconds=self.seconds,
        )


class FrontRun(Chooser):
    """The searches of all combinations, in progress; the policy of the front."""

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        on_turn: Callable[["FrontRun"], None] | None = None,
        log: SearchLog | None = None,
        skip: bool = True,
        rigs: Sequence[Rig] = (),
    ) -> None:
        """Raises ConfigError for rigs that the study does not allow."""
        super().__init__(study, combinations(study), threads, skip, on_turn, log)
        if log is None:
            given = points_by_combination(self.combinations, rigs)
            log = SearchLog({n: Record((Log.empty(np.array(points)),)) for n, points in given.items()})
        records = (log.records.get(n, Record()) for n in range(len(self.combinations)))
        each = zip(self.combinations, records, strict=True)
        self.searches = [CandidateSearch(one, record.logs) for one, record in each]
        self.history: list[FrontTurn] = []
        self._prices = np.array([one.price for one in self.combinations])

    @property
    def evaluations(self) -> int:
        """Evaluations of all combinations."""
        return sum(candidate.evaluations for candidate in self.searches)

    @property
    def cycles(self) -> int:
        """Cycles of all combinations."""
        return sum(candidate.cycles for candidate in self.searches)

    @property
    def seconds(self) -> float:
        """Seconds of all combinations."""
        return sum(candidate.seconds for candidate in self.searches)

    @property
    def objectives(self) -> Array:
        """(combinations,) the least so far; inf without a rig that meets the constraints."""
        return np.array([candidate.objective for candidate in self.searches])

    def on_front(self) -> list[bool]:
        """(combinations,) which are on the front so far."""
        return on_front(self._prices.tolist(), self.objectives.tolist())

    def log(self) -> SearchLog:
        """The logs of each combination's searches."""
        every = enumerate(self.searches)
        return SearchLog({n: Record(tuple(run.log() for run in one.runs)) for n, one in every})

    def rounds(self) -> Iterator[list[Job[int]]]:
        """A turn of one combination at a time, here, until the budget is spent, or nothing is left to try."""
        while (number := self._next()) is not None and not (self.history and self.is_spent()):
            yield [Job(number, self._turn, (number,))]

    def _turn(self, number: int) -> FrontTurn:
        """Let a combination's search go on, or learn from the others."""
        candidate = self.searches[number]
        learner = candidate.learn(self.searches, number) if candidate.should_transfer else None
        run = learner or candidate.own
        end = run.evaluations + (TRANSFER if learner else max(PART, int(GROWTH * run.evaluations)))
        with run.evaluator(self._threads, self._skip) as evaluator:
            run.step(evaluator, self._left(run))
            while not (candidate.is_over(run) or run.evaluations >= end or self.is_spent()):
                run.step(evaluator, self._left(run))
        state = candidate.evaluations, candidate.best.best_cost.number, self.on_front()[number], self.seconds
        return FrontTurn(self.evaluations, candidate.combination.name, *state)

    def take(self, key: int, found: FrontTurn | None) -> bool:
        """Add a line to the history."""
        assert found
        self.history.append(found)
        self._on_turn(self)
        return False

    def _left(self, run: SearchRun) -> Budget:
        """The budget of one search, so that all together do not exceed theirs."""
        budget = self._budget
        evaluations = None if budget.evaluations is None else budget.evaluations - self.evaluations + run.evaluations
        cycles = None if budget.cycles is None else budget.cycles - self.cycles + run.cycles
        return replace(budget, evaluations=evaluations, cycles=cycles)

    def _next(self) -> int | None:
        """The combination that will soonest be on the front: first those not tried yet, by price."""
        there = [i for i, candidate in enumerate(self.searches) if not candidate.is_done]
        if not there:
            return None
        fresh = [i for i in there if not self.searches[i].evaluations]
        if fresh:
            return min(fresh, key=lambda i: self._prices[i])
        spent = np.array([max(candidate.evaluations, 1) for candidate in self.searches])
        effort = maths.log(spent) + required_growth(self._prices, self.objectives)
        return min(there, key=lambda i: effort[i])

    def result(self, interrupted: bool) -> Front:
        """The front so far. Raises KeyboardInterrupt if there is none yet, ConfigError where no rig is allowed."""
        if all(candidate.best.best_cost == NO_COST for candidate in self.searches):
            raise KeyboardInterrupt
        on_front = self.on_front()
        objectives = self.objectives.tolist()
        if not any(on_front):
            raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
        order = sorted(range(len(on_front)), key=lambda i: (self._prices[i], objectives[i]))
        ones = self.searches
        points = [Point(ones[i].combination, ones[i].placement(interrupted)) for i in order if on_front[i]]
        return Front(
            points=tuple(_best_for_their_price(points)),
            candidates=tuple(
                Candidate(ones[i].combination, objectives[i], ones[i].evaluations, on_front[i]) for i in order
            ),
            history=tuple(self.history),
            log=self.log(),
            seconds=self.seconds,
            interrupted=interrupted,
        )


def _best_for_their_price(points: Sequence[Point]) -> list[Point]:
    """Those points that no cheaper one equals, which at fresh places it may."""
    prices = [one.combination.price for one in points]
    kept = on_front(prices, [one.placement.objective for one in points])
    return [one for one, is_kept in zip(points, kept, strict=True) if is_kept]


def required_growth(prices: Array, objectives: Array) -> Array:
    """(n,) the logarithm of the factor by which each search must grow to reach the front, as assumed above."""
    order = np.lexsort((objectives, prices))
    least = np.empty(len(prices))
    least[order] = np.minimum.accumulate(objectives[order])
    most: float = maths.log(NEGLECT)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = objectives / least - 1.0
    gap[objectives == least] = 0.0
    gap[np.isinf(objectives)] = math.inf
    return np.minimum(gap / PROGRESS, most)
