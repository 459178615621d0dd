"""The cheapest rig that meets all requirements: combination after combination, the cheapest first.

Combinations are searched in rounds. In the first, each is tried with the plain rigs alone; in each further one its
search goes on until it has FIRST evaluations, then GROWTH times as many, and so on. A round ends at the first
combination that has a verified rig; from then on only cheaper ones are searched, for one more round after each find.
So a search that its budget does not end finds the same with any number of workers. Those that cost too much, or have
too many sensors, are not searched, nor those of which it is known beforehand that they miss a requirement.
"""

import math
import pickle
import time
from collections.abc import Callable
from dataclasses import dataclass

from lidarcfg.errors import ConfigError
from lidarcfg.placement.achievable import unachievable
from lidarcfg.placement.combinations import Combination, Option, distinct_options
from lidarcfg.placement.plan import versions
from lidarcfg.placement.requirements_search import RequirementsRun
from lidarcfg.placement.search_run import INFEASIBLE, Budget, Log, Placement
from lidarcfg.placement.study import Study
from lidarcfg.placement.sweep import Workers, check_versions, distribute

CONSTRAINTS = "the constraints"  # which a combination misses as long as no rig of it that was tried keeps them
TOO_DEAR = "too dear"
FIRST = 250  # evaluations of the second round
GROWTH = 4


@dataclass(frozen=True)
class Job:
    """The search of a combination, to be continued."""

    study: Study
    log: Log | None  # of what was searched before
    evaluations: int  # all in all
    seconds: float
    skip: bool
    excludes: bool  # whether it is asked first if any rig of it can meet all


@dataclass(frozen=True)
class Effort:
    """How far the search of a combination has come, and its result."""

    log: Log
    evaluations: int  # that the budget limits
    rigs: int  # evaluated, the plain ones included
    shortfall: float  # of the best rig; 0: it meets all; inf: no rig tried keeps the constraints
    failing: tuple[str, ...]  # the requirements that it misses
    meets: bool  # verified, refined places included


@dataclass(frozen=True)
class SearchedCombination:
    """A combination, and how long it was searched with what result."""

    name: str
    price: float
    sensors: int
    evaluations: int  # the plain rigs included
    shortfall: float  # of its best rig; inf if there is none yet
    failing: tuple[str, ...]
    meets: bool
    excluded: str | None = None  # why no rig of it can meet all


@dataclass(frozen=True)
class Cheapest:
    """The cheapest rig that meets all requirements; or where none was found, the one that comes closest."""

    combination: Combination
    placement: Placement
    tried: tuple[SearchedCombination, ...]  # by price: all that are not alike, also those that were not searched
    combinations: int  # that are not alike
    excluded: int  # of those, the ones of which no rig can meet all requirements
    evaluations: int
    seconds: float  # of the search, without what is found out about its rig at the end
    interrupted: bool

    @property
    def meets(self) -> bool:
        """Whether it meets all requirements."""
        return self.placement.verdict is not None and self.placement.verdict.passed


OnEffort = Callable[["CheapestRun", Option], None]


def cheapest(
    study: Study,
    threads: int | None = None,
    on_effort: OnEffort | None = None,
    workers: Workers | None = None,
    skip: bool = True,
) -> Cheapest:
    """Find the cheapest combination of a study with a rig that meets all requirements.

    With `workers` combinations are searched there, each by one thread; the result is the same, unless the budget ends
    within a round, as the last ones may be others. An interrupt (Ctrl-C) ends the search and keeps what is found so
    far. Raises ConfigError without a choice, without requirements, and if no combination has a rig that meets the
    constraints.
    """
    if not study.to_choose:
        raise ConfigError("nothing to choose in the study: no group has `choose`")
    if study.requirements is None:
        raise ConfigError("the study has no requirements, which the cheapest rig should meet; `front` needs none")
    run = CheapestRun(study, threads, workers, skip)
    interrupted = False
    try:
        run.run(on_effort)
    except KeyboardInterrupt:
        interrupted = True
    return run.result(interrupted)


class CheapestRun:
    """The searches of all combinations, in progress."""

    def __init__(
        self, study: Study, threads: int | None = None, workers: Workers | None = None, skip: bool = True
    ) -> None:
        assert study.requirements
        self._study = study
        self._threads = threads
        self._workers = workers
        self._skip = skip
        self._budget = Budget.of(study.solver)
        self._began = time.perf_counter()
        self.options = distinct_options(study)
        asked = study.requirements
        dear = (n for n, one in enumerate(self.options) if asked.too_dear(one.price, one.sensors))
        self.excluded = dict.fromkeys(dear, TOO_DEAR)  # why no rig of an option can meet all
        self._excludes = True
        self.efforts: dict[int, Effort] = {}
        self.found: int | None = None  # the cheapest that meets all so far
        self.round = 0
        self.round_done = 0.0  # the fraction of its combinations

    @property
    def evaluations(self) -> int:
        """Evaluations of all combinations."""
        return sum(one.evaluations for one in self.efforts.values())

    def run(self, on_effort: OnEffort | None = None) -> None:
        """Search until the cheapest is found, or the budget is spent."""
        self._search([n for n in range(len(self.options)) if n not in self.excluded], on_effort)
        if not self.efforts:  # none can meet all: the closest of the plain rigs
            self._excludes = False
            self.round = 0
            numbers = range(len(self.options))
            self._do_round([n for n in numbers if self.excluded.get(n) != TOO_DEAR] or list(numbers), on_effort)

    def _search(self, numbers: list[int], on_effort: OnEffort | None) -> None:
        """Search round after round."""
        rounds_left = math.inf
        while numbers and rounds_left > 0 and not self._is_spent():
            before = self.found
            self._do_round(numbers, on_effort)
            numbers = [n for n in numbers if n in self.efforts]
            if self.found is not None:
                rounds_left = 1 if self.found != before else rounds_left - 1
                numbers = [n for n in numbers if self.options[n].price < self.options[self.found].price]
            self.round += 1

    def _is_spent(self) -> bool:
        return bool(self.efforts) and self._budget.spent(self.evaluations, 0)

    @property
    def _has_rig(self) -> bool:
        """Whether some rig keeps the constraints."""
        return any(math.isfinite(one.shortfall) for one in self.efforts.values())

    @property
    def _evaluations_each(self) -> int:
        """The number of evaluations that each combination's search reaches in this round."""
        return FIRST * GROWTH ** (self.round - 1) if self.round else 0

    def _do_round(self, numbers: list[int], on_effort: OnEffort | None) -> None:
        """Let the search of each combination go on, up to the first that meets all."""
        done = 0

        def ended(number: int, effort: Effort | str | None) -> bool:
            nonlocal done
            if effort is None:
                raise ConfigError(f"{self.options[number].name}: its workers were killed; out of memory?")
            if isinstance(effort, str):
                self.excluded.setdefault(number, effort)
            else:
                self.efforts[number] = effort
                if effort.meets and (self.found is None or number < self.found):
                    self.found = number
            done += 1
            self.round_done = done / len(numbers)
            if on_effort:
                on_effort(self, self.options[number])
            return (self._has_rig and self._is_spent()) or self.found in numbers

        each = self._evaluations_each
        if self._workers:
            before = self.efforts.copy()
            jobs = ((n, (work, pickle.dumps(self._job(n, each)), versions())) for n in numbers)
            distribute(jobs, self._workers, ended)
            if self.found in numbers:  # what was begun before the find was known does not count
                efforts = self.efforts.items()
                self.efforts = before | {n: one for n, one in efforts if n not in numbers or n <= self.found}
            return
        for n in numbers:
            if ended(n, effort_of(self._job(n, each), self._threads)):
                return

    def _job(self, number: int, each: int) -> Job:
        known = self.efforts.get(number)
        return Job(
            study=self.options[number].combination.study,
            log=known.log if known else None,
            evaluations=each,
            seconds=self._budget.deadline - time.perf_counter(),
            skip=self._skip,
            excludes=self._excludes and self._skip,
        )

    def result(self, interrupted: bool) -> Cheapest:
        """The best found so far. Raises KeyboardInterrupt or ConfigError if there is none yet."""
        seconds = time.perf_counter() - self._began
        if not self._has_rig:
            if interrupted:
                raise KeyboardInterrupt
            raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
        best = self.found
        if best is None:
            best = min(self.efforts, key=lambda n: (self.efforts[n].shortfall, self.options[n].price))
        tried = []
        for n, one in enumerate(self.options):
            effort = self.efforts.get(n)
            tried.append(
                SearchedCombination(
                    name=one.name,
                    price=one.price,
                    sensors=one.sensors,
                    evaluations=effort.rigs if effort else 0,
                    shortfall=effort.shortfall if effort else math.inf,
                    failing=effort.failing if effort else (),
                    meets=effort.meets if effort else False,
                    excluded=self.excluded.get(n),
                )
            )
        combination = self.options[best].combination
        return Cheapest(
            combination=combination,
            placement=_placement(combination.study, self.efforts[best], self._threads, self._skip, interrupted),
            tried=tuple(tried),
            combinations=len(self.options),
            excluded=len(self.excluded),
            evaluations=self.evaluations,
            seconds=seconds,
            interrupted=interrupted,
        )


def work(content: bytes, theirs: dict[str, str]) -> Effort | str:
    """Search a combination in a worker. Raises ConfigError if `theirs` are not the worker's versions."""
    check_versions(theirs, "the command")
    return effort_of(pickle.loads(content), 1)


def effort_of(job: Job, threads: int | None = None) -> Effort | str:
    """Continue a combination's search to a number of evaluations, or until a rig meets all requirements.

    Or why there is nothing to search: no rig of it can meet all.
    """
    study = job.study
    if job.log is None and job.excludes:
        for name, why in unachievable(study).items():
            return f"{name}: {why}"
    run = RequirementsRun(study, job.log)
    budget = Budget(max(job.evaluations, 1), None, job.seconds, time.perf_counter() + job.seconds)
    with run.evaluator(threads, job.skip) as evaluator:
        while not run.is_over(budget) and not run.is_verified:
            run.step(evaluator, budget)
        if run.best_cost.shortfall >= INFEASIBLE:
            rigs = sum(run.asked.values())
            return Effort(run.log(), run.evaluations, rigs, math.inf, (CONSTRAINTS,), meets=False)
        shortfalls = evaluator.shortfalls(study.poses(run.best_x[None])[0])
    assert study.requirements
    names = [item.name for item in study.requirements.items]
    return Effort(
        log=run.log(),
        evaluations=run.evaluations,
        rigs=sum(run.asked.values()),
        shortfall=sum(shortfalls),
        failing=tuple(name for name, short in zip(names, shortfalls, strict=True) if short > 0),
        meets=run.is_verified or run.verify_best(),
    )


def _placement(study: Study, effort: Effort, threads: int | None, skip: bool, interrupted: bool) -> Placement:
    """The result of a combination's search, of which the costs are known."""
    run = RequirementsRun(study, effort.log)
    budget = Budget(max(effort.evaluations, 1), None, math.inf, math.inf)
    with run.evaluator(threads, skip) as evaluator:
        while not run.is_over(budget) and not run.is_verified:
            run.step(evaluator, budget)
    return run.placement(interrupted)
