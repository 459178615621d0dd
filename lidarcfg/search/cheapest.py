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
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.requirements.verify import Verifier
from lidarcfg.search.achievable import unachievable
from lidarcfg.search.combinations import Combination, Example, distinct_options, starts
from lidarcfg.search.plain_rigs import plain_points
from lidarcfg.search.plan import versions
from lidarcfg.search.requirements_search import FIRST_LEFT, LEFT_MOST, Places, RequirementsRun
from lidarcfg.search.run import INFEASIBLE, Budget, Log, Placement
from lidarcfg.search.screen import LEAST, Screen, Screened
from lidarcfg.search.starts import starting_options
from lidarcfg.search.workers import Workers, check_versions, distribute
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.study import Study

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
class Job:
    """The search of a combination, to be continued, or the try of one rig."""

    study: Study
    log: Log  # of what was searched before
    places: Places  # that count besides the requirements' own
    evaluations: int  # all in all; 0: only the points of the log are tried
    seconds: float
    skip: bool
    excludes: bool  # whether it is asked first if any rig of it can meet all


@dataclass(frozen=True)
class Effort:
    """How far the search of a combination has come, and its result."""

    log: Log
    start_places: Places  # that counted in its search from the beginning, besides the requirements' own
    places: Places  # and at the end
    evaluations: int  # that the budget limits
    rigs: int  # evaluated, the points that it began with included
    x: Array  # (free coordinates,) the best rig
    worst: float  # the largest relative shortfall of that rig at any place
    shortfall: float  # the sum of the means over places; 0: it meets all at those of trials
    failing: tuple[str, ...]  # the requirements that it misses
    meets: bool  # whether its best rig is verified
    verdict: Verdict | None = None  # on that rig, where it is known


@dataclass(frozen=True)
class CheapestLog:
    """What the searches of all combinations have found: everything needed to resume them."""

    efforts: Mapping[int, Effort]  # by the number of the option
    turns: Mapping[int, int]  # that each had
    places: Places  # at which rigs failed that were tried
    excluded: Mapping[int, str]  # why no rig of an option can meet all


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
class Cheapest:
    """The cheapest rig that meets all requirements; or where none was found, the one that comes closest."""

    combination: Combination
    placement: Placement
    groups: tuple[str, ...]  # their names
    tried: tuple[SearchedCombination, ...]  # by price: all that are not alike, also those that were not searched
    combinations: int  # that are not alike
    excluded: int  # of those, the ones of which no rig can meet all requirements
    evaluations: int
    seconds: float  # of the search, without what is found out about its rig at the end
    interrupted: bool
    log: CheapestLog

    @property
    def meets(self) -> bool:
        """Whether it meets all requirements."""
        return self.placement.verdict is not None and self.placement.verdict.passed


OnEffort = Callable[["CheapestRun", str], None]


def cheapest(
    study: Study,
    threads: int | None = None,
    on_effort: OnEffort | None = None,
    workers: Workers | None = None,
    skip: bool = True,
    rigs: Sequence[Rig] = (),
    log: CheapestLog | None = None,
) -> Cheapest:
    """Find the cheapest combination of a study with a rig that meets all requirements.

    `rigs` are tried first, each in the combination whose models it has. `log` resumes an earlier search. `on_effort`
    gets the state and what was done last. With `workers` combinations are searched there, each by one thread; the
    result is the same, unless the budget ends within a round, as the last ones may be others. An interrupt (Ctrl-C)
    ends the search and keeps what is found so far. Raises ConfigError without a choice, without requirements, for rigs
    that the study does not allow, and if no combination has a rig that meets the constraints.
    """
    if not study.to_choose:
        raise ConfigError("nothing to choose in the study: no group has `choose`")
    if study.requirements is None:
        raise ConfigError("the study has no requirements, which the cheapest rig should meet; `front` needs none")
    run = CheapestRun(study, threads, workers, skip, rigs, log)
    interrupted = False
    try:
        run.run(on_effort)
    except KeyboardInterrupt:
        interrupted = True
    return run.result(interrupted)


@dataclass(frozen=True)
class Rigs:
    """The rigs of a combination that were screened, the closest first."""

    points: Array  # (n, free coordinates)
    found: Screened
    judged: bool  # whether some were judged at all places of trials

    @property
    def worst(self) -> float:
        """Of the closest."""
        return float(self.found.worst[0])


class CheapestRun:
    """The searches of all combinations, in progress."""

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        workers: Workers | None = None,
        skip: bool = True,
        rigs: Sequence[Rig] = (),
        log: CheapestLog | None = None,
    ) -> None:
        """Raises ConfigError for rigs that the study does not allow."""
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
        self._given = starting_options(self.options, rigs)
        self._screen = Screen(asked)
        self._verifier = Verifier(asked)  # keeps the counts of sensors that combinations have in common
        self._places: dict[int, Array] = {}  # at which rigs failed that were tried
        self._rigs: dict[int, Rigs] = {}  # of the options looked at
        self.efforts: dict[int, Effort] = {}
        self._turns: dict[int, int] = {}  # that each has had
        self._verify_s = 0.0  # the longest time that a try took
        self._say: Callable[[str], None] = lambda what: None
        self.found: int | None = None  # the cheapest that meets all so far
        self.done = 0.0  # the fraction of the screening, or of a round
        self.sweep_s: float | None = None  # about how long screening all options takes, once the first is
        if log:
            self.efforts |= log.efforts
            self._turns |= log.turns
            self._places |= log.places
            self.excluded |= log.excluded
            self._screen.add_places(log.places)
            self.found = min((n for n, one in log.efforts.items() if one.meets), default=None)

    def log(self) -> CheapestLog:
        """What is found so far."""
        return CheapestLog(dict(self.efforts), dict(self._turns), dict(self._places), dict(self.excluded))

    @property
    def evaluations(self) -> int:
        """Evaluations of all combinations."""
        return sum(one.evaluations for one in self.efforts.values())

    @property
    def spent(self) -> float:
        """The fraction of the budget that is spent."""
        return self._budget.fraction(self.evaluations, 0)

    @property
    def cheaper(self) -> int:
        """The number of options that cost less than what is found."""
        if self.found is None:
            return len(self.options)
        price = self.options[self.found].price
        return sum(one.price < price for one in self.options)

    def run(self, on_effort: OnEffort | None = None) -> None:
        """Search until the cheapest is found, or the budget is spent."""
        if on_effort:
            self._say = partial(on_effort, self)
        self._sweep()
        carried = None
        turns = 0
        while not self._is_spent():
            if self.found != carried:
                carried = self.found
                self._carry()
                turns = 0
            numbers = self._nearest([n for n in range(self.cheaper) if n not in self.excluded])
            if not numbers or (self.found is not None and turns >= self.cheaper):
                break
            turns += len(numbers)
            self._do_round(numbers)

    def _nearest(self, numbers: Sequence[int]) -> list[int]:
        """The combinations that come closest, by rigs that were judged at all places of trials."""
        while True:
            nearest = sorted(numbers, key=lambda n: (self._badness(n), n))[:NEAREST]
            known = (n for n in nearest if n in self._rigs and n not in self.efforts and not self._rigs[n].judged)
            rough = next(known, None)
            if rough is None or self._is_spent():
                return nearest
            self._screened(rough, self._rigs[rough].points, JUDGED)

    def _is_spent(self) -> bool:
        """Whether the budget is spent, but for what it takes to verify the rig that comes closest."""
        budget = self._budget
        left_s = 0.0
        if self.found is None and budget.seconds < math.inf:
            left_s = min(self._verify_s or FIRST_LEFT * budget.seconds, LEFT_MOST * budget.seconds)
        return time.perf_counter() + left_s >= budget.deadline or budget.spent(self.evaluations, 0)

    def _study_of(self, number: int) -> Study:
        return self.options[number].combination.study

    def _sweep(self) -> None:
        """Screen the plain rigs of all combinations, the cheapest first, up to the first with one that passes.

        Rigs that were given come before, in theirs.
        """
        allowed = [n for n in range(len(self.options)) if n not in self.excluded] or list(range(len(self.options)))
        order = [*self._given, *(n for n in allowed if n not in self._given)]
        casts = self._casts(order)
        for count, number in enumerate(order):
            if self._rigs and self._is_spent():
                break
            self.done = count / len(allowed)
            if number < self.cheaper or number in self._given:
                given = self._given.get(number, [])
                began = time.perf_counter()
                self._screened(number, np.array([*given, *plain_points(self._study_of(number))]))
                if self.sweep_s is None and casts:
                    self.sweep_s = (time.perf_counter() - began) * sum(casts) / casts[0]
                self._try(number)
                self._say(f"plain rigs of {self.options[number].name}")
        self.done = 1.0

    def _casts(self, order: Sequence[int]) -> list[int]:
        """How many sensors at poses are cast for each of some options in turn; empty if that is not known."""
        if len(order) > ESTIMATED:
            return []
        seen: set[object] = set()
        found = []
        for number in order:
            study = self._study_of(number)
            fresh = self._screen.unknown(study, plain_points(study)) - seen
            seen |= fresh
            found.append(len(fresh))
        return found

    def _screened(self, number: int, points: Array, least: int = 0) -> None:
        """Rank the rigs of a combination at some points; see Screen.ranked."""
        self._rigs[number] = Rigs(*self._screen.ranked(self._study_of(number), points, least), judged=least > 0)

    def _try(self, number: int) -> None:
        """Verify some rigs of a combination that meet all at the places of trials, until one passes.

        The one with the largest margin comes first.
        """
        tried: set[bytes] = set()
        while number < self.cheaper and len(tried) < TRIES and not (tried and self._is_spent()):
            rigs = self._rigs[number]
            met = [x for x, worst in zip(rigs.points, rigs.found.worst, strict=True) if worst <= 0]
            x = next((x for x in met if x.tobytes() not in tried), None)
            if x is None:
                break
            tried.add(x.tobytes())
            began = time.perf_counter()
            effort = effort_of(self._job(number, Log.empty(x[None]), 0), self._threads, self._verifier)
            self._verify_s = max(self._verify_s, time.perf_counter() - began)
            if isinstance(effort, str) or math.isinf(effort.worst):  # it breaks the constraints
                continue
            self._keep(number, effort)
            if not effort.meets:
                self._screen.add_places({n: some[len(self._places.get(n, ())) :] for n, some in effort.places.items()})
                self._places = dict(effort.places)
                self._screened(number, rigs.points)

    def _keep(self, number: int, effort: Effort) -> None:
        """Keep the effort of an option; of a try, if it is the better one."""
        known = self.efforts.get(number)
        if known and not effort.evaluations:
            rigs = known.rigs + effort.rigs
            better = effort if effort.meets or effort.worst < known.worst else known
            effort = replace(better, evaluations=known.evaluations, rigs=rigs)
        self.efforts[number] = effort
        if effort.meets and (self.found is None or number < self.found):
            self.found = number

    def _worst(self, number: int) -> float:
        """The largest relative shortfall of a combination's best rig."""
        effort, rigs = self.efforts.get(number), self._rigs.get(number)
        return effort.worst if effort else rigs.worst if rigs else math.inf

    def _badness(self, number: int) -> float:
        """How far a combination's best rig is from meeting all; twice as far for each turn that it had."""
        return max(self._worst(number), LEAST) * 2.0 ** self._turns.get(number, 0)

    def _carry(self) -> None:
        """Try the rig that was found in cheaper combinations: without some of its sensors, or with others in place."""
        if self.found is None:
            return
        for number in range(self.cheaper):
            if number in self.excluded or number not in self._rigs or self._is_spent():
                continue
            points = self._fitting(number, [self.found])
            if len(points):
                self._screened(number, np.concatenate([points, self._rigs[number].points]))
                self._try(number)

    def _fitting(self, number: int, others: Sequence[int]) -> Array:
        """(n, free coordinates) the best rigs of other combinations, as far as they fit in one."""
        known = [(n, self.efforts[n]) for n in others if n in self.efforts and n != number]
        examples = [Example(self.options[n].combination, one.x, one.worst) for n, one in known]
        rng = np.random.default_rng([self._study.solver.seed, number])
        return starts(self.options[number].combination, examples, rng)

    def _do_round(self, numbers: list[int]) -> None:
        """Let the search of each combination have a turn; one that costs more than a find before it is not counted."""
        jobs = {n: self._turn(n) for n in numbers}
        found: dict[int, Effort | str | None] = {}

        def ended(number: int, effort: Effort | str | None) -> bool:
            found[number] = effort
            self.done = len(found) / len(numbers)
            return self._is_spent()

        if self._workers:
            calls = ((n, (work, pickle.dumps(self._now(job)), versions())) for n, job in jobs.items())
            distribute(calls, self._workers, ended)
        for n, job in jobs.items():
            if n >= self.cheaper:
                continue
            if not self._workers and not self._is_spent():
                ended(n, effort_of(self._now(job), self._threads, self._verifier))
            if n in found:
                self._take(n, found[n])
                self._say(f"searched {self.options[n].name}")

    def _take(self, number: int, effort: Effort | str | None) -> None:
        """Take the result of a turn. Raises ConfigError if there is none."""
        if effort is None:
            raise ConfigError(f"{self.options[number].name}: its workers were killed; out of memory?")
        self._turns[number] = self._turns.get(number, 0) + 1
        if isinstance(effort, str):
            self.excluded.setdefault(number, effort)
        else:
            self._keep(number, effort)

    def _turn(self, number: int) -> Job:
        """The next turn of a combination: its search goes on, or begins with plain rigs and with those of others."""
        turns = self._turns.get(number, 0)
        known = self.efforts.get(number)
        count = FIRST * GROWTH**turns
        if self._budget.evaluations is not None:
            count = min(count, self._budget.evaluations - self.evaluations)
        if turns and known:
            return self._job(number, known.log, known.evaluations + count, known.start_places)
        closest = sorted(self.efforts, key=lambda n: (self.efforts[n].worst, n))[:EXAMPLES]
        others = self._fitting(number, closest)
        plain = self._rigs[number].points if number in self._rigs else plain_points(self._study_of(number))
        return self._job(number, Log.empty(np.concatenate([others, plain[:POINTS]])), count)

    def _job(self, number: int, log: Log, evaluations: int, places: Places | None = None) -> Job:
        job = Job(
            study=self._study_of(number),
            log=log,
            places=self._places if places is None else places,
            evaluations=evaluations,
            seconds=math.inf,
            skip=self._skip,
            excludes=self._skip and evaluations > 0 and number not in self.efforts,
        )
        return self._now(job)

    def _now(self, job: Job) -> Job:
        """A job that begins now."""
        return replace(job, seconds=self._budget.deadline - time.perf_counter())

    def _end(self) -> int | None:
        """What is found; else the combination that comes closest, of which a rig is then judged by all requirements."""
        if self.found is not None:
            return self.found
        broken: set[int] = set()
        while numbers := [n for n in {*self._rigs, *self.efforts} if n not in broken]:
            best = min(numbers, key=lambda n: (self._worst(n), n))
            if best in self.efforts and math.isfinite(self.efforts[best].worst):
                return best
            effort = effort_of(
                self._job(best, Log.empty(self._rigs[best].points[:POINTS]), 0), self._threads, self._verifier
            )
            if isinstance(effort, Effort) and math.isfinite(effort.worst):
                self.efforts[best] = effort
            else:
                broken.add(best)
        return None

    def result(self, interrupted: bool) -> Cheapest:
        """The best found so far. Raises KeyboardInterrupt or ConfigError if there is none yet."""
        best = self._end()
        if best is None:
            if interrupted:
                raise KeyboardInterrupt
            raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
        combination = self.options[best].combination
        effort = self.efforts[best]
        if effort.verdict is None:  # of one that misses requirements, or was resumed
            effort = replace(effort, verdict=self._verdict_on(combination.study, effort.x))
        seconds = time.perf_counter() - self._began
        return Cheapest(
            combination=combination,
            placement=_placement(combination.study, effort, self._threads, self._skip, interrupted),
            groups=combination.group_names,
            tried=tuple(map(self._tried, range(len(self.options)))),
            combinations=len(self.options),
            excluded=len(self.excluded),
            evaluations=self.evaluations,
            seconds=seconds,
            interrupted=interrupted,
            log=self.log(),
        )

    def _verdict_on(self, study: Study, x: Array) -> Verdict:
        """The verdict on the rig at a point (free coordinates,) of a combination."""
        return self._verifier.verify(study.rig(study.space.poses(x[None])[0]).mounts)

    def _tried(self, number: int) -> SearchedCombination:
        option = self.options[number]
        effort, rigs = self.efforts.get(number), self._rigs.get(number)
        assert self._study.requirements
        names = [item.name for item in self._study.requirements.items]
        shortfalls = rigs.found.shortfalls[0] if rigs else np.zeros(len(names))
        screened = tuple(name for name, short in zip(names, shortfalls, strict=True) if short > 0)
        return SearchedCombination(
            name=option.name,
            models=option.models,
            price=option.price,
            sensors=option.sensors,
            evaluations=(effort.rigs if effort else 0) + (len(rigs.points) if rigs else 0),
            worst=self._worst(number),
            shortfall=effort.shortfall if effort else float(shortfalls.sum()) if rigs else math.inf,
            failing=effort.failing if effort else screened,
            meets=effort.meets if effort else False,
            excluded=self.excluded.get(number),
        )


def work(content: bytes, theirs: dict[str, str]) -> Effort | str:
    """Search a combination in a worker. Raises ConfigError if `theirs` are not the worker's versions."""
    check_versions(theirs, "the command")
    return effort_of(pickle.loads(content), 1)


def effort_of(job: Job, threads: int | None = None, verifier: Verifier | None = None) -> Effort | str:
    """Continue a combination's search to a number of evaluations, or until a rig meets all requirements.

    `verifier`, of the same requirements, may be shared. Or why there is nothing to search: none can meet all.
    """
    study = job.study
    if job.excludes:
        for name, why in unachievable(study).items():
            return f"{name}: {why}"
    run = RequirementsRun(study, job.log, job.places, verifier)
    budget = Budget(max(job.evaluations, 1), None, job.seconds, time.perf_counter() + job.seconds)
    with run.evaluator(threads, job.skip) as evaluator:
        while not (run.is_over(budget) or run.is_verified or (run.history and not job.evaluations)):
            run.step(evaluator, budget)
        keeps = run.best_cost.shortfall < INFEASIBLE  # the constraints; where none that was tried does, others may
        poses = study.space.poses(run.best_x[None])[0]
        shortfalls = np.array(evaluator.shortfalls(poses)) if keeps else np.array([math.inf])
    assert study.requirements
    worst = math.inf
    failing: tuple[str, ...] = (CONSTRAINTS,)
    if keeps:
        screen = Screen(study.requirements)
        screen.add_places(run.more_places)
        seen = screen.judge(study, run.best_x[None])
        worst = max(float(seen.worst[0]), float(np.where(seen.shortfalls[0] > 0, 0.0, shortfalls).max()))
        items = study.requirements.items
        failing = tuple(item.name for item, short in zip(items, shortfalls, strict=True) if short > 0)
    return Effort(
        log=run.log(),
        start_places=job.places,
        places=run.more_places,
        evaluations=run.evaluations if job.evaluations else 0,
        rigs=sum(run.asked.values()),
        x=run.best_x,
        worst=worst,
        shortfall=float(shortfalls.sum()),
        failing=failing,
        meets=run.is_verified,
        verdict=run.verdict,
    )


def _placement(study: Study, effort: Effort, threads: int | None, skip: bool, interrupted: bool) -> Placement:
    """The result of a combination's search, of which the costs are known."""
    run = RequirementsRun(study, effort.log, effort.start_places)
    budget = Budget(None, None, math.inf, math.inf)
    with run.evaluator(threads, skip) as evaluator:
        while run.is_replaying or not run.history:
            run.step(evaluator, budget)
    return run.placement(interrupted, effort.verdict)
