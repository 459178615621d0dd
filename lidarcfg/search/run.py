"""A search in progress: it asks a solver for trials, evaluates them, tells it their costs, and keeps the best rig."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.notebook import Shown
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.returns.misses import MissesFound
from lidarcfg.search.log import Log
from lidarcfg.sensors.rig import Rig
from lidarcfg.solvers.search import (
    NO_COST,
    Search,
    Trials,
    checked,
    cost_of,
    least,
)
from lidarcfg.solvers.solver import Solver
from lidarcfg.study.evaluation import Evaluation, evaluate
from lidarcfg.study.evaluator import Evaluator
from lidarcfg.study.file import COORDINATES
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.study import Study
from lidarcfg.vsr.metric import max_vsr

INFEASIBLE = 1e6  # shortfall of a rig that violates the constraints, by 1 + the violation
AT_BOUND = 1e-6  # metres and radians from it
TURN = 2 * math.pi - AT_BOUND


@dataclass(frozen=True)
class Cycle:
    """A line of the history: the state of the search at the end of a cycle."""

    cycle: int
    evaluations: int
    best: float  # objective, or shortfall of a rig that has one
    mean: float
    seconds: float


@dataclass(frozen=True)
class Compared:
    """A rig to compare the best one with, at the same fresh places."""

    rig: Rig
    objective: float
    misses: MissesFound


@dataclass(frozen=True)
class Believed:
    """What a search believed of its best rig, from the places that it counted misses at."""

    objective: float
    places: int  # of each object
    plain: Compared | None  # the best of the plain rigs; None: there was none
    midpoint: MissesFound  # of the rig at the midpoint of the bounds


@dataclass(frozen=True)
class Placement(Shown):
    """The best rig found, and how it was found."""

    rig: Rig
    evaluation: Evaluation
    objective: (
        float  # of the rig: misses at fresh places or max VSR in metres, unless the study asks for something else
    )
    midpoint_max_vsr_m: float  # of the rig at the midpoint of the bounds
    history: tuple[Cycle, ...]
    evaluations: int  # trials, not counting first sources and scouts
    first_evaluations: int
    scout_evaluations: int
    evaluated: int  # of all these, those that meet the constraints and were not replayed from a log
    full_evaluations: int  # rigs evaluated in full: several per trial with failures or mounting errors
    cuboids: int  # evaluated
    segments: int  # cast from sensors to cuboids, at most
    log: Log
    seconds: float
    interrupted: bool
    remarks: tuple[str, ...] = ()  # what the verdict does not say of the search
    at_bounds: tuple[str, ...] = ()  # coordinates that ended at a bound, with it
    believed: Believed | None = None  # where misses were minimised

    def __repr__(self) -> str:
        return f"<Placement after {self.evaluations:,} evaluations: {self.rig!r}, {self.evaluation!r}>"

    @property
    def verdict(self) -> Verdict | None:
        """Whether the rig meets the study's requirements; None: it has none."""
        return self.evaluation.verdict


@dataclass(frozen=True)
class Budget:
    """The limits of a search."""

    evaluations: int | None
    cycles: int | None
    seconds: float
    deadline: float  # of time.perf_counter

    @classmethod
    def of(cls, solver: Solver) -> "Budget":
        """The budget of a study's solver, starting now."""
        seconds = math.inf if solver.seconds is None else solver.seconds
        return cls(solver.evaluations, solver.cycles, seconds, time.perf_counter() + seconds)

    def fraction(self, evaluations: int, cycles: int) -> float:
        """The fraction that is spent, of the limit that will be reached first."""
        spent = 1.0 - (self.deadline - time.perf_counter()) / self.seconds if self.seconds < math.inf else 0.0
        return max(spent, evaluations / (self.evaluations or math.inf), cycles / (self.cycles or math.inf))

    def spent(self, evaluations: int, cycles: int) -> bool:
        """Whether any of the limits is reached."""
        return (
            (self.cycles is not None and cycles >= self.cycles)
            or (self.evaluations is not None and evaluations >= self.evaluations)
            or time.perf_counter() >= self.deadline
        )


@dataclass(frozen=True)
class WorkDone:
    """The work that evaluators have done."""

    trials: int = 0
    full_evaluations: int = 0
    cuboids: int = 0
    segments: int = 0

    def plus(self, evaluator: Evaluator) -> "WorkDone":
        """The sum with one more evaluator's work."""
        return WorkDone(
            self.trials + evaluator.trials,
            self.full_evaluations + evaluator.full_evaluations,
            self.cuboids + evaluator.cuboids,
            self.segments + evaluator.segments,
        )


class SearchRun:
    """A search in progress. It first replays the costs in `log`, without evaluating anything.

    `best_x` and `best_cost` are those of the best trial so far; `work` is the work done so far. A run may pause: each
    part of it gets a new evaluator.
    """

    def __init__(self, study: Study, search: Search, log: Log | None = None) -> None:
        log = log or Log.empty()
        if log.points is not None and log.points.shape[1] != study.space.free.sum():
            raise ConfigError(f"{study.name}: its log is that of another study")
        self.study = study
        self._search = search
        self._log = log  # that it begins with
        self._replay = log.cost
        self._told = [log.cost]
        self._cut_short = 0  # costs of a batch that a budget cut short, which are not told
        self._spent = log.seconds  # before this part
        self._since = math.inf  # when it began
        self._smooths = False  # whether its evaluator smooths the costs of trials that ask for it
        self.asked = {"first": 0, "scout": 0, "trial": 0}
        self.history: list[Cycle] = []
        self.best_x = search.best_x
        self.best_cost = NO_COST
        self.work = WorkDone()

    @property
    def evaluations(self) -> int:
        """Trials so far, not counting first sources and scouts."""
        return self.asked["trial"]

    @property
    def cycles(self) -> int:
        """Cycles so far."""
        return self._search.cycles

    @property
    def is_replaying(self) -> bool:
        """Whether costs of the log are left."""
        return len(self._replay) > 0

    @property
    def seconds(self) -> float:
        """Spent so far, without pauses."""
        return self._spent + max(time.perf_counter() - self._since, 0.0)

    def rig(self) -> Rig:
        """The best rig so far."""
        return self.study.rig(self.study.space.poses(self.best_x[None])[0])

    def log(self) -> Log:
        """All costs told so far."""
        return replace(self._log, cost=np.concatenate(self._told), seconds=self.seconds)

    @contextmanager
    def evaluator(
        self, threads: int | None, skip: bool = True, on_evaluations: Callable[[int], None] | None = None
    ) -> Iterator[Evaluator]:
        """An evaluator for one part of the run."""
        self._since = time.perf_counter()
        with self._evaluator(threads, skip, on_evaluations) as one:
            self._smooths = one.smooths
            try:
                yield one
            finally:
                self.work = self.work.plus(one)
                self._spent = self.seconds
                self._since = math.inf

    def _evaluator(self, threads: int | None, skip: bool, on_evaluations: Callable[[int], None] | None) -> Evaluator:
        return Evaluator(self.study, threads, skip, on_evaluations)

    def is_over(self, budget: Budget) -> bool:
        """Whether a limit is reached; there is always a first batch."""
        return bool(self.history) and budget.spent(self.evaluations, self.cycles)

    def step(self, evaluator: Evaluator, budget: Budget) -> bool:
        """Evaluate one batch of trials. Returns whether it added a line to the history that is not replayed."""
        trials = self.ask()
        cost = self.costs(trials, evaluator, budget)
        return self.tell(trials, cost, budget)

    def ask(self) -> Trials:
        """The solver's next trials: points of the unit cube."""
        return self._search.ask()

    def tell(self, trials: Trials, cost: Array, budget: Budget) -> bool:
        """Tell the solver the costs (n, 2) of its trials, and keep the best. Returns as `step` does."""
        search = self._search
        kind = self._kind(trials)
        self.asked[kind] += len(cost)
        best = least(cost)
        counts = not (trials.smoothing and self._smooths)
        if cost_of(cost[best]) < self.best_cost and counts:
            self.best_x = trials.x[best].copy()
            self.best_cost = cost_of(cost[best])
        cycles = search.cycles
        if len(cost) == len(trials.x):  # a batch cut short is not told: a resumed run asks for all of it again
            search.tell(cost)
        if search.cycles == cycles and kind != "first" and not budget.spent(self.evaluations, search.cycles):
            return False
        self.history.append(self._line())
        return not len(self._replay)

    def _line(self) -> Cycle:
        search = self._search
        return Cycle(search.cycles, self.evaluations, self.best_cost.number, search.mean_cost, self.seconds)

    def _kind(self, trials: Trials) -> str:
        return trials.phase if trials.phase in self.asked else "trial"

    def costs(self, trials: Trials, evaluator: Evaluator, budget: Budget) -> Array:
        """(n, 2) the costs of the rigs at trials, those of the log first; fewer if a budget cuts the batch short."""
        count = len(trials.x)
        self._cut_short = 0
        if len(self._replay) >= count:
            cost = self._replay[:count]
            self._replay = self._replay[count:]
            return cost
        self._replay = self._replay[:0]
        left = count
        if budget.evaluations is not None and self._kind(trials) == "trial":
            left = min(left, budget.evaluations - self.evaluations)
        cost = self._evaluated(trials, evaluator, left, budget.deadline)
        if len(cost) == count:
            self._told.append(cost)
        else:
            self._cut_short = len(cost)
        return cost

    def _evaluated(self, trials: Trials, evaluator: Evaluator, count: int, deadline: float) -> Array:
        """(count, 2) the costs of the first trials, or inf where one is not below its upper bound.

        Fewer if the `deadline` (of time.perf_counter) passes meanwhile.
        """
        study = self.study
        source_poses = study.space.poses(self._search.sources)
        slices = []
        step = count if deadline == math.inf else evaluator.slice
        for first in range(0, count, step):
            part = slice(first, min(first + step, count))
            poses = study.space.poses(trials.x[part])
            violation = study.space.violation(poses)
            cost = np.stack([INFEASIBLE * (1.0 + violation), np.full(len(poses), np.inf)], axis=1)
            kept = np.flatnonzero(violation == 0.0)
            asked = poses[kept], trials.source[part][kept], source_poses, trials.upper_bound[part][kept]
            cost[kept] = evaluator.costs(*asked, trials.smoothing)
            slices.append(cost)
            if time.perf_counter() > deadline:
                break
        return checked(np.concatenate(slices))

    def placement(self, interrupted: bool, verdict: Verdict | None = None) -> Placement:
        """The result; `verdict` as in evaluate.

        Raises KeyboardInterrupt if there is none yet, ConfigError if no rig meets the constraints.
        """
        if self.best_cost == NO_COST:
            raise KeyboardInterrupt
        if self.best_cost.shortfall >= INFEASIBLE:
            raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
        study = self.study
        rig = self.rig()
        log = self.log()
        # before the evaluation, not during it, since either may need a gigabyte
        midpoint = max_vsr(study.region, lidars_at(study.slots, study.space.midpoint), study.visibility)
        return Placement(
            rig=rig,
            evaluation=evaluate(study, rig, verdict=verdict),
            objective=self.best_cost.objective,
            midpoint_max_vsr_m=midpoint,
            history=tuple(self.history),
            evaluations=self.evaluations,
            first_evaluations=self.asked["first"],
            scout_evaluations=self.asked["scout"],
            evaluated=self.work.trials,
            full_evaluations=self.work.full_evaluations,
            cuboids=self.work.cuboids,
            segments=self.work.segments,
            log=log,
            seconds=log.seconds,
            interrupted=interrupted,
            at_bounds=at_bounds(study, study.space.poses(self.best_x[None])[0]),
        )


def at_bounds(study: Study, poses: Array) -> tuple[str, ...]:
    """The coordinates of poses (slots, 6) that could vary and are at a bound: each with its sensor and the bound."""
    space = study.space
    found = []
    bounded = (space.upper - space.lower < TURN) | (np.arange(len(COORDINATES)) < 3)  # a free turn has no end
    for i, k in np.argwhere(space.free & bounded).tolist():
        for bound, end in ((space.lower[i, k], "least"), (space.upper[i, k], "most")):
            if abs(poses[i, k] - bound) <= AT_BOUND:
                value = f"{math.degrees(bound):.6g}°" if k >= 3 else f"{bound:.6g} m"
                found.append(f"{study.slots[i].name}: {COORDINATES[k]} is at its {end}, {value}")
    return tuple(found)
