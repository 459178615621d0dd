"""The cheapest rig that meets all requirements: combination after combination, the cheapest first.

First the plain rigs of all combinations are screened, the cheapest first, which takes as long as a few evaluations
each. One that meets all at the places of trials is verified at once, up to TRIES of a combination; where it fails, the
worst places join those of all that follow. The first that passes is the cheapest so far: a combination that contains it
costs more, and needs no look.

Then the cheaper combinations are searched, those that come closest first, each from its plain rigs and from rigs of
others that fit: of the verified one without some of its sensors, and of the closest. What is closest is told by the
worst place of a combination's best rig, of some that were judged at all places of trials; each search in vain counts as
if it were twice as bad. A turn has FIRST evaluations, the next one of the same combination GROWTH times as many. After
each find there are as many turns as cheaper combinations, NEAREST at a time. So a search that its budget does not end
finds the same with any number of workers.

Combinations that cost too much, or have too many sensors, are not looked at, nor are those searched of which it is
known beforehand that they miss a requirement.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError
from lidarcfg.files import loaded
from lidarcfg.geometry import Array
from lidarcfg.notebook import Shown
from lidarcfg.requirements.verify import Verifier
from lidarcfg.search.chooser import Chooser
from lidarcfg.search.combinations import Combination, distinct_combinations
from lidarcfg.search.log import Log, Places, Record, SearchLog
from lidarcfg.search.plain_rigs import plain_points
from lidarcfg.search.requirements_search import FIRST_LEFT, LEFT_MOST, RequirementsRun, unachievable
from lidarcfg.search.run import INFEASIBLE, Budget, Placement
from lidarcfg.search.screening import LEAST, ScreenedRigs, Screening
from lidarcfg.search.start_rigs import points_by_combination
from lidarcfg.search.transfer import Example, transferred
from lidarcfg.search.workers import Job, Workers
from lidarcfg.sensors.rig import Rig, rigs_of
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study, with_solver

CONSTRAINTS = "the constraints"  # which a combination misses as long as no rig of it that was tried keeps them
TOO_DEAR = "too dear"
TRIES = 3
FIRST = 120  # evaluations of a combination's first turn
GROWTH = 3
ESTIMATED = 1000  # combinations at most, of which it is estimated how long screening them takes
NEAREST = 8  # combinations that have a turn at a time
JUDGED = 4  # rigs of each of these that are judged at all places of trials before
POINTS = 12  # plain rigs at which a combination's search begins
EXAMPLES = 4  # combinations whose best rigs others begin with


@dataclass(frozen=True)
class SearchedCombination:
    """A combination, and how long it was searched with what result."""

    name: str
    models: tuple[str, ...]  # how many of each, by group
    price: float
    sensors: int
    evaluations: int  # the plain rigs included
    worst: float  # of its best rig, the largest relative shortfall at any place; inf if it was not looked at
    shortfall: float  # and the sum of the means over places
    failing: tuple[str, ...]
    meets: bool
    excluded: str | None = None  # why no rig of it can meet all


@dataclass(frozen=True)
class Cheapest(Shown):
    """The cheapest rig that meets all requirements; or where none was found, the one that comes closest."""

    combination: Combination
    placement: Placement
    tried: tuple[SearchedCombination, ...]  # by price: all that are not alike, also those that were not searched
    excluded: int  # of those, the ones of which no rig can meet all requirements
    evaluations: int
    seconds: float  # of the search, without what is found out about its rig at the end
    interrupted: bool
    log: SearchLog

    def __repr__(self) -> str:
        said = "meets all requirements" if self.meets else "comes closest; none found meets all requirements"
        return f"<Cheapest: {self.combination.sensors}, for {self.combination.price:,.15g}: {said}>"

    @property
    def meets(self) -> bool:
        """Whether it meets all requirements."""
        return self.placement.verdict is not None and self.placement.verdict.passed

    @property
    def cannot(self) -> bool:
        """Whether it is known of each combination that no rig of it can meet all."""
        return all(one.excluded for one in self.tried)


def cheapest(
    study: Study | Given,
    threads: int | None = None,
    on_turn: Callable[["CheapestRun"], None] | None = None,
    workers: Workers | None = None,
    skip: bool = True,
    rigs: Sequence[Rig | Given] = (),
    log: SearchLog | None = None,
    *,
    seed: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
) -> Cheapest:
    """Find the cheapest combination of a study with a rig that meets all requirements.

    Study and rigs are files, dicts with their keys, or loaded. `seed`, and a budget of `evaluations` or `seconds`,
    replace those of the study. `rigs` are tried first, each in the combination whose models
    it has. `log` resumes an earlier search. With `workers` combinations are searched there, each by one thread; the
    result is the same, unless the budget ends within a round, as the last ones may be others. An interrupt (Ctrl-C)
    ends the search and keeps what is found so far. Raises ConfigError without a choice, without requirements, for rigs
    that the study does not allow, and if no combination has a rig that meets the constraints.
    """
    study = loaded(study, load_study, Study)
    study = with_solver(study, seed=seed, evaluations=evaluations, seconds=seconds)
    run = CheapestRun(study, threads, on_turn, log, skip, rigs_of(rigs), workers)
    return run.result(interrupted=run.run(workers))


class CheapestRun(Chooser):
    """The searches of all combinations, in progress; the policy of the cheapest rig."""

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        on_turn: Callable[["CheapestRun"], None] | None = None,
        log: SearchLog | None = None,
        skip: bool = True,
        rigs: Sequence[Rig] = (),
        workers: Workers | None = None,
    ) -> None:
        """Raises ConfigError for rigs that the study does not allow."""
        super().__init__(study, distinct_combinations(study), threads, skip, on_turn, log)
        asked = study.requirements
        if asked is None:
            raise ConfigError(
                "the study has no requirements, which the cheapest rig should meet; `lidarcfg optimize` needs none"
            )
        self._workers = workers
        self._began = time.perf_counter()
        self._names = [item.name for item in asked.items]
        self._given = points_by_combination(self.combinations, rigs)
        self._screening = Screening(asked)
        self._verifier = Verifier(asked)  # keeps the counts of sensors that combinations have in common
        self._places: Places = {}  # at which rigs failed that were tried
        self._screened: dict[int, ScreenedRigs] = {}  # by the number of a combination, those looked at
        self._verify_s = 0.0  # the longest time that a try took
        self._round: list[int] = []  # the combinations that have a turn, as far as it is not taken
        self._ended: dict[int, Record] = {}  # what turns of this round have found
        dear = [asked.too_dear(one.price, len(one.all_sensors)) for one in self.combinations]
        self.records = [Record(excluded=TOO_DEAR * is_dear) for is_dear in dear]  # by the number of a combination
        self.found: int | None = None  # the cheapest that meets all so far
        self.doing = ""  # what was done last
        self.done = 0.0  # the fraction of the screening, or of a round
        self.screening_s: float | None = None  # about how long screening all combinations takes, once the first is
        if log:
            self._resume(log)

    def _resume(self, log: SearchLog) -> None:
        for number, record in log.records.items():
            if record.x is not None and (len(record.x), len(record.shortfalls)) != (
                self.combinations[number].study.space.free.sum(),
                len(self._names),
            ):
                raise ConfigError(f"{self.study.name}: the log is that of another study")
            self.records[number] = record
        self._places = log.places
        self._screening.add_places(log.places)
        self.found = min((n for n, one in log.records.items() if one.meets), default=None)

    def log(self) -> SearchLog:
        """What is found so far."""
        return SearchLog(dict(enumerate(self.records)), self._places)

    @property
    def evaluations(self) -> int:
        """Evaluations of all combinations."""
        return sum(one.evaluations for one in self.records)

    @property
    def cheaper(self) -> int:
        """The number of combinations that cost less than what is found."""
        if self.found is None:
            return len(self.combinations)
        price = self.combinations[self.found].price
        return sum(one.price < price for one in self.combinations)

    def is_spent(self) -> bool:
        """Whether the budget is spent, but for what it takes to verify the rig that comes closest."""
        budget = self._budget
        left_s = 0.0
        if self.found is None and budget.seconds < math.inf:
            left_s = min(self._verify_s or FIRST_LEFT * budget.seconds, LEFT_MOST * budget.seconds)
        return time.perf_counter() + left_s >= budget.deadline or super().is_spent()

    def rounds(self) -> Iterator[Iterator[Job[int]]]:
        """Turns of those that come closest, until the cheapest is found, or the budget is spent."""
        self._screen_all()
        carried = None
        turns = 0
        while not self.is_spent():
            if self.found is not None and self.found != carried:
                carried = self.found
                self._carry(self.found)
                turns = 0
            numbers = self._nearest([n for n in range(self.cheaper) if not self.records[n].excluded])
            if not numbers or (self.found is not None and turns >= self.cheaper):
                break
            turns += len(numbers)
            yield self._jobs(numbers)

    def _jobs(self, numbers: Sequence[int]) -> Iterator[Job[int]]:
        """A turn of each combination; none of one that costs more than what is found meanwhile."""
        self._round = list(numbers)
        self._ended = {}
        here = () if self._workers else (self._threads, self._verifier)
        for number, search in [(n, self._turn(n)) for n in numbers]:
            if self.is_spent():
                return
            if number < self.cheaper:
                yield Job(number, searched, (search.starting_now(self._budget), *here))

    def take(self, key: int, found: Record | None) -> bool:
        """Take what a turn found once those before it in its round are taken. Raises ConfigError if there is nothing.

        One that costs more than what those before it found is not counted.
        """
        if found is None:
            raise ConfigError(f"{self.combinations[key].name}: its workers were killed; out of memory?")
        self._ended[key] = found
        self.done = len(self._ended) / (len(self._ended) + sum(n not in self._ended for n in self._round))
        while self._round and (self._round[0] in self._ended or self._round[0] >= self.cheaper):
            number = self._round.pop(0)
            if number < self.cheaper:
                self._take_turn(number, self._ended[number])
        return self.is_spent()

    def _take_turn(self, number: int, found: Record) -> None:
        record = replace(self.records[number], turns=self.records[number].turns + 1)
        self.records[number] = replace(record, excluded=found.excluded)
        if not found.excluded:
            self._keep(number, found)
        self._say(f"searched {self.combinations[number].name}")

    def _say(self, what: str) -> None:
        self.doing = what
        self._on_turn(self)

    def _nearest(self, numbers: Sequence[int]) -> list[int]:
        """The combinations that come closest, by rigs that were judged at all places of trials."""
        while True:
            nearest = sorted(numbers, key=lambda n: (self._badness(n), n))[:NEAREST]
            known = (n for n in nearest if n in self._screened and self.records[n].x is None)
            rough = next((n for n in known if not self._screened[n].is_judged), None)
            if rough is None or self.is_spent():
                return nearest
            self._screen(rough, self._screened[rough].points, JUDGED)

    def _study_of(self, number: int) -> Study:
        return self.combinations[number].study

    def _screen_all(self) -> None:
        """Screen the plain rigs of all combinations, the cheapest first, up to the first with one that passes.

        Rigs that were given come before, in theirs.
        """
        every = range(len(self.combinations))
        allowed = [n for n in every if not self.records[n].excluded] or list(every)
        order = [*self._given, *(n for n in allowed if n not in self._given)]
        casts = self._casts(order)
        for count, number in enumerate(order):
            if self._screened and self.is_spent():
                break
            self.done = count / len(allowed)
            if number < self.cheaper or number in self._given:
                given = self._given.get(number, [])
                began = time.perf_counter()
                self._screen(number, np.array([*given, *plain_points(self._study_of(number))]))
                if self.screening_s is None and casts:
                    self.screening_s = (time.perf_counter() - began) * sum(casts) / casts[0]
                self._try(number)
                self._say(f"plain rigs of {self.combinations[number].name}")
        self.done = 1.0

    def _casts(self, order: Sequence[int]) -> list[int]:
        """How many sensors at poses are cast for each of some combinations in turn; empty if that is not known."""
        if len(order) > ESTIMATED:
            return []
        seen: set[object] = set()
        found = []
        for number in order:
            study = self._study_of(number)
            fresh = self._screening.unknown(study, plain_points(study)) - seen
            seen |= fresh
            found.append(len(fresh))
        return found

    def _screen(self, number: int, points: Array, least: int = 0) -> None:
        """Rank the rigs of a combination at some points; see Screening.ranked."""
        self._screened[number] = self._screening.ranked(self._study_of(number), points, least)

    def _try(self, number: int) -> None:
        """Verify some rigs of a combination that meet all at the places of trials, until one passes.

        The one with the largest margin comes first.
        """
        tried: set[bytes] = set()
        while number < self.cheaper and len(tried) < TRIES and not (tried and self.is_spent()):
            rigs = self._screened[number]
            met = [x for x, worst in zip(rigs.points, rigs.worst, strict=True) if worst <= 0]
            x = next((x for x in met if x.tobytes() not in tried), None)
            if x is None:
                break
            tried.add(x.tobytes())
            began = time.perf_counter()
            record = self._judged(number, x[None])
            self._verify_s = max(self._verify_s, time.perf_counter() - began)
            if math.isinf(record.worst):  # it breaks the constraints
                continue
            self._keep(number, record)
            if not record.meets:
                places = record.logs[0].places
                self._screening.add_places({n: some[len(self._places.get(n, ())) :] for n, some in places.items()})
                self._places = places
                self._screen(number, rigs.points)

    def _judged(self, number: int, points: Array) -> Record:
        """What the best of some rigs of a combination reaches, which is verified if it meets all."""
        search = CombinationSearch(self._study_of(number), Log.empty(points, places=self._places), 0, self._skip)
        return searched(search.starting_now(self._budget), self._threads, self._verifier)

    def _keep(self, number: int, found: Record) -> None:
        """Keep what is found of a combination; of rigs that were only judged, if that is better."""
        known = self.records[number]
        if known.x is not None and not found.evaluations:
            rigs = known.rigs + found.rigs
            better = found if found.meets or found.worst < known.worst else known
            found = replace(better, evaluations=known.evaluations, rigs=rigs)
        self.records[number] = replace(found, turns=known.turns, excluded=known.excluded)
        if found.meets and (self.found is None or number < self.found):
            self.found = number

    def _worst(self, number: int) -> float:
        """The largest relative shortfall of a combination's best rig."""
        record, rigs = self.records[number], self._screened.get(number)
        return record.worst if record.x is not None else float(rigs.worst[0]) if rigs else math.inf

    def _badness(self, number: int) -> float:
        """How far a combination's best rig is from meeting all; twice as far for each turn that it had."""
        return max(self._worst(number), LEAST) * 2.0 ** self.records[number].turns

    def _carry(self, found: int) -> None:
        """Try the rig that was found in cheaper combinations: without some of its sensors, or with others in place."""
        for number in range(self.cheaper):
            if self.records[number].excluded or number not in self._screened or self.is_spent():
                continue
            points = self._fitting(number, [found])
            if len(points):
                self._screen(number, np.concatenate([points, self._screened[number].points]))
                self._try(number)

    def _fitting(self, number: int, others: Sequence[int]) -> Array:
        """(n, free coordinates) the best rigs of other combinations, as far as they fit in one."""
        known = [(n, self.records[n]) for n in others if n != number]
        examples = [Example(self.combinations[n], one.x, one.worst) for n, one in known if one.x is not None]
        rng = np.random.default_rng([self.study.solver.seed, number])
        return transferred(self.combinations[number], examples, rng)

    def _turn(self, number: int) -> "CombinationSearch":
        """The next turn of a combination: its search goes on, or begins with plain rigs and with those of others."""
        study = self._study_of(number)
        known = self.records[number]
        count = FIRST * GROWTH**known.turns
        if self._budget.evaluations is not None:
            count = min(count, self._budget.evaluations - self.evaluations)
        if known.turns and known.x is not None:
            return CombinationSearch(study, known.logs[0], known.evaluations + count, self._skip)
        others = [n for n, one in enumerate(self.records) if one.x is not None]
        closest = sorted(others, key=lambda n: (self.records[n].worst, n))[:EXAMPLES]
        fitting = self._fitting(number, closest)
        plain = self._screened[number].points if number in self._screened else plain_points(study)
        log = Log.empty(np.concatenate([fitting, plain[:POINTS]]), places=self._places)
        return CombinationSearch(study, log, count, self._skip, asks_first=self._skip and known.x is None)

    def _end(self) -> int | None:
        """What is found; else the combination that comes closest, of which a rig is then judged by all requirements."""
        if self.found is not None:
            return self.found
        known = {n for n, one in enumerate(self.records) if n in self._screened or one.x is not None}
        while known:
            best = min(known, key=lambda n: (self._worst(n), n))
            if self.records[best].x is not None and math.isfinite(self.records[best].worst):
                return best
            known.remove(best)
            if best in self._screened:
                record = self._judged(best, self._screened[best].points[:POINTS])
                if math.isfinite(record.worst):
                    was = self.records[best]
                    self.records[best] = replace(record, turns=was.turns, excluded=was.excluded)
                    known.add(best)
        return None

    def result(self, interrupted: bool) -> Cheapest:
        """The best found so far. Raises KeyboardInterrupt or ConfigError if there is none yet."""
        best = self._end()
        if best is None:
            if interrupted:
                raise KeyboardInterrupt
            raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
        combination = self.combinations[best]
        record = self.records[best]
        assert record.x is not None
        if record.verdict is None:  # of one that misses requirements, or was resumed
            study = combination.study
            rig = study.rig(study.space.poses(record.x[None])[0])
            record = replace(record, verdict=self._verifier.verify(rig.mounts))
        seconds = time.perf_counter() - self._began
        return Cheapest(
            combination=combination,
            placement=_placement(combination.study, record, self._threads, self._skip, interrupted),
            tried=tuple(map(self._tried, range(len(self.combinations)))),
            excluded=sum(bool(one.excluded) for one in self.records),
            evaluations=self.evaluations,
            seconds=seconds,
            interrupted=interrupted,
            log=self.log(),
        )

    def _tried(self, number: int) -> SearchedCombination:
        one = self.combinations[number]
        record, rigs = self.records[number], self._screened.get(number)
        short = np.full(1, math.inf)  # where it was not looked at
        failing: tuple[str, ...] = ()
        if record.x is not None or rigs:
            short = record.shortfalls if record.x is not None else rigs.shortfalls[0] if rigs else short
            failing = tuple(name for name, one in zip(self._names, short, strict=True) if one > 0)
            if np.isinf(short).all():
                failing = (CONSTRAINTS,)
        return SearchedCombination(
            name=one.name,
            models=one.models,
            price=one.price,
            sensors=len(one.all_sensors),
            evaluations=record.rigs + (len(rigs.points) if rigs else 0),
            worst=self._worst(number),
            shortfall=float(short.sum()),
            failing=failing,
            meets=record.meets,
            excluded=record.excluded or None,
        )


@dataclass(frozen=True)
class CombinationSearch:
    """The search of a combination, to be continued; a worker may do it."""

    study: Study
    log: Log  # of what was searched before
    evaluations: int  # all in all; 0: only the points of the log are tried
    skip: bool
    asks_first: bool = False  # whether it is asked first if any rig of it can meet all
    seconds: float = math.inf

    def starting_now(self, budget: Budget) -> "CombinationSearch":
        """The same with the seconds that a budget has left."""
        return replace(self, seconds=budget.deadline - time.perf_counter())


def searched(search: CombinationSearch, threads: int | None = 1, verifier: Verifier | None = None) -> Record:
    """Continue a search to a number of evaluations, or until a rig meets all requirements.

    `verifier`, of the same requirements, may be shared. Or why there is nothing to search: none can meet all.
    """
    study = search.study
    assert study.requirements
    if search.asks_first:
        for name, why in unachievable(study).items():
            return Record(excluded=f"{name}: {why}")
    run = RequirementsRun(study, search.log, verifier)
    budget = Budget(max(search.evaluations, 1), None, search.seconds, time.perf_counter() + search.seconds)
    worst = math.inf
    shortfalls = np.full(len(study.requirements.items), math.inf)
    with run.evaluator(threads, search.skip) as evaluator:
        while not (run.is_over(budget) or run.is_verified or (run.history and not search.evaluations)):
            run.step(evaluator, budget)
        if run.best_cost.shortfall < INFEASIBLE:  # else the constraints are not kept by any rig that was tried
            shortfalls = np.array(evaluator.shortfalls(study.space.poses(run.best_x[None])[0]))
            screening = Screening(study.requirements)
            screening.add_places(run.more_places)
            seen = screening.judge(study, run.best_x[None])
            worst = max(float(seen.worst[0]), float(np.where(seen.shortfalls[0] > 0, 0.0, shortfalls).max()))
    return Record(
        logs=(run.log(),),
        evaluations=run.evaluations if search.evaluations else 0,
        rigs=sum(run.asked.values()),
        x=run.best_x,
        worst=worst,
        shortfalls=shortfalls,
        verdict=run.verdict,
    )


def _placement(study: Study, record: Record, threads: int | None, skip: bool, interrupted: bool) -> Placement:
    """The result of a combination's search, of which the costs are known."""
    assert record.x is not None
    run = RequirementsRun(study, record.logs[0])
    budget = Budget(None, None, math.inf, math.inf)
    with run.evaluator(threads, skip) as evaluator:
        while run.is_replaying or not run.history:
            run.step(evaluator, budget)
        if run.evaluations < record.evaluations and not np.array_equal(run.best_x, record.x):
            run.step(evaluator, replace(budget, evaluations=record.evaluations))  # it is of a batch that was cut short
    return run.placement(interrupted, record.verdict if np.array_equal(run.best_x, record.x) else None)
