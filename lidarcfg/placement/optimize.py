"""The search for the best rig of a study: asks a solver for trials, evaluates them, tells it their costs."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.evaluation import Evaluation, evaluate
from lidarcfg.placement.evaluator import Evaluator, max_vsr
from lidarcfg.placement.solvers import start_search
from lidarcfg.placement.solvers.search import Search, Trials, checked
from lidarcfg.placement.study import Study
from lidarcfg.rig import Rig

SLICE = 100  # trials between two looks at the clock, where there is a deadline
INFEASIBLE = 1e6  # cost of a rig that violates the constraints, times 1 + the violation


@dataclass(frozen=True)
class Cycle:
    """A line of the history: the state of the search at the end of a cycle."""

    cycle: int
    evaluations: int
    best: float
    mean: float
    seconds: float


@dataclass(frozen=True)
class Log:
    """The costs that a search was told: all that is needed to resume it."""

    cost: Array  # (told,) in the order of asking
    seconds: float  # spent so far

    @classmethod
    def empty(cls) -> "Log":
        """The log of a search that has not begun."""
        return cls(np.empty(0), 0.0)


@dataclass(frozen=True)
class Placement:
    """The best rig found, and how."""

    rig: Rig
    evaluation: Evaluation
    objective: float  # of the rig: its max VSR in metres, unless the study asks for something else
    midpoint_max_vsr_m: float  # of the rig at the midpoint of the bounds
    history: tuple[Cycle, ...]
    evaluations: int  # trials, not counting first sources and scouts
    first_evaluations: int
    scout_evaluations: int
    full_evaluations: int  # of all these, how many were evaluated in full
    cuboids: int  # evaluated
    segments: int  # cast from sensors to cuboids, at most
    log: Log
    seconds: float
    interrupted: bool


def optimize(
    study: Study,
    threads: int | None = None,
    on_cycle: Callable[[Cycle, Rig, Log], None] | None = None,
    log: Log | None = None,
    skip: bool = True,
) -> Placement:
    """Search for the rig with the least objective. The result depends on the seed, not on the number of threads.

    `log` is that of an earlier search to resume: the search ends where an unbroken one would (budgets in seconds
    aside). Without `skip` everything is evaluated in full, which changes nothing but the time. An interrupt (Ctrl-C)
    ends the search and keeps the best so far. Raises ConfigError if nothing is free to move, and if no rig was
    found that meets the constraints.
    """
    dimensions = int(study.free.sum())
    if dimensions == 0:
        raise ConfigError("nothing to optimise: every bound is equal; evaluate the rig instead")
    lidars = [slot.lidar for slot in study.slots]
    interrupted = False
    with Evaluator(study.region, lidars, threads, skip, study.criterion(), visibility=study.visibility) as evaluator:
        run = _Run(study, evaluator, start_search(study.solver, study.groups), log or Log.empty())
        try:
            while not (run.history and run.spent()):
                if run.step() and on_cycle:
                    on_cycle(run.history[-1], run.rig(), run.log())
        except KeyboardInterrupt:
            interrupted = True
    if not math.isfinite(run.best_cost):
        raise KeyboardInterrupt
    if run.best_cost >= INFEASIBLE:
        raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
    rig, log = run.rig(), run.log()
    return Placement(
        rig=rig,
        evaluation=evaluate(study, rig),
        objective=run.best_cost,
        midpoint_max_vsr_m=max_vsr(study.region, study.lidars(study.midpoint), study.visibility),
        history=tuple(run.history),
        evaluations=run.asked["trial"],
        first_evaluations=run.asked["first"],
        scout_evaluations=run.asked["scout"],
        full_evaluations=evaluator.full_evaluations,
        cuboids=evaluator.cuboids,
        segments=evaluator.segments,
        log=log,
        seconds=log.seconds,
        interrupted=interrupted,
    )


class _Run:
    """A search in progress; the costs in `log` are told first, without evaluating anything."""

    def __init__(self, study: Study, evaluator: Evaluator, search: Search, log: Log) -> None:
        self._study, self._evaluator, self._search = study, evaluator, search
        self._replay, self._told = log.cost, [log.cost]
        self._session = time.perf_counter()
        self._started = self._session - log.seconds
        self.asked = {"first": 0, "scout": 0, "trial": 0}
        self.history: list[Cycle] = []
        self._best_x, self.best_cost = search.best_x, math.inf

    def rig(self) -> Rig:
        """The best rig so far."""
        return self._study.rig(self._study.poses(self._best_x[None])[0])

    def log(self) -> Log:
        """All costs told so far."""
        return Log(np.concatenate(self._told), time.perf_counter() - self._started)

    def spent(self) -> bool:
        """Whether a budget is used up."""
        solver = self._study.solver
        return (
            (solver.cycles is not None and self._search.cycles >= solver.cycles)
            or (solver.evaluations is not None and self.asked["trial"] >= solver.evaluations)
            or (solver.seconds is not None and time.perf_counter() - self._session >= solver.seconds)
        )

    def step(self) -> bool:
        """Evaluate one batch of trials. Returns whether that made a line of the history, of this session's own."""
        search = self._search
        trials = search.ask()
        kind = trials.phase if trials.phase in self.asked else "trial"
        cost = self._costs(trials, kind)
        self.asked[kind] += len(cost)
        best = int(np.argmin(cost))
        if cost[best] < self.best_cost:
            self._best_x, self.best_cost = trials.x[best].copy(), float(cost[best])
        cycles = search.cycles
        if len(cost) == len(trials.x):  # one cut short is not told: a resumed run asks for all of it
            search.tell(cost)
        if search.cycles == cycles and kind != "first" and not self.spent():
            return False
        seconds = time.perf_counter() - self._started
        self.history.append(Cycle(search.cycles, self.asked["trial"], self.best_cost, search.mean_cost, seconds))
        return not len(self._replay)

    def _costs(self, trials: Trials, kind: str) -> Array:
        """The costs of the trials, from the log while it lasts; fewer where a budget cuts the batch short."""
        count = len(trials.x)
        if len(self._replay) >= count:
            cost, self._replay = self._replay[:count], self._replay[count:]
            return cost
        self._replay = self._replay[:0]
        solver, left, deadline = self._study.solver, count, math.inf
        if solver.evaluations is not None and kind == "trial":
            left = min(left, solver.evaluations - self.asked["trial"])
        if solver.seconds is not None:
            deadline = self._session + solver.seconds
        cost = costs(self._study, self._evaluator, self._search.sources, trials, left, deadline)
        if len(cost) == count:
            self._told.append(cost)
        return cost


def costs(study: Study, evaluator: Evaluator, sources: Array, trials: Trials, count: int, deadline: float) -> Array:
    """The costs of the first `count` trials, or inf for those that cannot beat what they have to.

    Fewer where the clock passes `deadline` (time.perf_counter) on the way.
    """
    source_poses = study.poses(sources)
    slices = []
    step = count if deadline == math.inf else SLICE
    for first in range(0, count, step):
        part = slice(first, min(first + step, count))
        poses, source, to_beat = study.poses(trials.x[part]), trials.source[part], trials.to_beat[part]
        violation = study.violation(poses)
        cost = INFEASIBLE * (1.0 + violation)
        allowed = np.flatnonzero(violation == 0.0)
        cost[allowed] = evaluator.costs(poses[allowed], source[allowed], source_poses, to_beat[allowed])
        slices.append(cost)
        if time.perf_counter() > deadline:
            break
    return checked(np.concatenate(slices))
