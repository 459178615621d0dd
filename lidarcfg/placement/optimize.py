"""The search for the best rig of a study: asks a solver for trials, evaluates them, tells it their costs."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.evaluator import Evaluator, max_vsr
from lidarcfg.placement.solvers import start_search
from lidarcfg.placement.solvers.search import Search, Trials, checked
from lidarcfg.placement.study import Evaluation, Study, evaluate
from lidarcfg.rig import Rig

SLICE = 100  # trials between two looks at the clock, where it matters
INFEASIBLE = 1e6  # what a rig that breaks the constraints costs, and more the more it does


@dataclass(frozen=True)
class Cycle:
    """A line of the history: how the search stood at the end of a cycle."""

    cycle: int
    evaluations: int
    best: float
    mean: float
    seconds: float


@dataclass(frozen=True)
class Log:
    """What a search was told, which is all that it takes to go on with it."""

    cost: Array  # (told,) in the order of asking
    seconds: float  # spent so far

    @classmethod
    def empty(cls) -> "Log":
        """Of a search that has not begun."""
        return cls(np.empty(0), 0.0)


@dataclass(frozen=True)
class Placement:
    """The best rig found, and how."""

    rig: Rig
    evaluation: Evaluation
    objective: float  # of the rig: its max VSR in metres, unless the study asks for something else
    midpoint_max_vsr_m: float  # of the rig at the midpoint of the bounds
    history: tuple[Cycle, ...]
    evaluations: int  # trials asked, but for first sources and scouts
    first_evaluations: int
    scout_evaluations: int
    full_evaluations: int  # so many of all these were computed in full
    cuboids: int  # so many were looked at
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
    """Look for the rig of least objective. The result depends on the seed, not on the number of threads.

    `log` is an earlier search's, to go on with: it ends where an unbroken one would (budgets in seconds aside).
    Without `skip` everything is evaluated in full, which changes nothing but the time. An interrupt (Ctrl-C) ends
    the search and keeps the best so far. Raises ConfigError where nothing is free to move, and where no rig was
    found that keeps the constraints.
    """
    dimensions = int(study.free.sum())
    if dimensions == 0:
        raise ConfigError("nothing to optimise: every bound is equal; evaluate the rig instead")
    solver = study.solver
    search = start_search(solver, dimensions)
    told = [(log or Log.empty()).cost]
    replay = told[0]
    started = time.perf_counter() - (log.seconds if log else 0.0)
    session = time.perf_counter()
    asked = {"first": 0, "scout": 0, "trial": 0}
    history: list[Cycle] = []
    best_x, best_cost = search.best_x, math.inf
    interrupted = False

    def spent() -> bool:
        return (
            (solver.cycles is not None and search.cycles >= solver.cycles)
            or (solver.evaluations is not None and asked["trial"] >= solver.evaluations)
            or (solver.seconds is not None and time.perf_counter() - session >= solver.seconds)
        )

    sines = [slot.sensor.sin_elevation for slot in study.slots]
    with Evaluator(study.region, sines, threads, skip) as evaluator:
        try:
            while not (history and spent()):
                trials = search.ask()
                kind = trials.phase if trials.phase in asked else "trial"
                count = len(trials.x)
                if len(replay) >= count:
                    cost, replay = replay[:count], replay[count:]
                else:
                    left = count
                    if solver.evaluations is not None and kind == "trial":
                        left = min(left, solver.evaluations - asked["trial"])
                    deadline = session + solver.seconds if solver.seconds is not None else math.inf
                    cost = costs(study, evaluator, search, trials, left, deadline)
                    replay = replay[:0]
                    count = len(cost)
                    if count == len(trials.x):
                        told.append(cost)
                asked[kind] += count
                least = int(np.argmin(cost))
                if cost[least] < best_cost:
                    best_x, best_cost = trials.x[least].copy(), float(cost[least])
                before = search.cycles
                if count == len(trials.x):  # a batch that the budget cut short is not told: a later run asks it whole
                    search.tell(cost)
                if search.cycles > before or kind == "first" or spent():
                    seconds = time.perf_counter() - started
                    history.append(Cycle(search.cycles, asked["trial"], best_cost, search.mean_cost, seconds))
                    if on_cycle and not len(replay):
                        rig = study.rig(study.poses(best_x[None])[0])
                        on_cycle(history[-1], rig, Log(np.concatenate(told), seconds))
        except KeyboardInterrupt:
            interrupted = True
    if not math.isfinite(best_cost):
        raise KeyboardInterrupt
    if best_cost >= INFEASIBLE:
        raise ConfigError("found no rig that keeps the constraints; widen the bounds, or search longer")
    rig = study.rig(study.poses(best_x[None])[0])
    middle = study.poses(np.full((1, dimensions), 0.5))[0]
    seconds = time.perf_counter() - started
    return Placement(
        rig=rig,
        evaluation=evaluate(study, rig),
        objective=best_cost,
        midpoint_max_vsr_m=max_vsr(study.region, study.lidars(middle)),
        history=tuple(history),
        evaluations=asked["trial"],
        first_evaluations=asked["first"],
        scout_evaluations=asked["scout"],
        full_evaluations=evaluator.full_evaluations,
        cuboids=evaluator.cuboids,
        log=Log(np.concatenate(told), seconds),
        seconds=seconds,
        interrupted=interrupted,
    )


def costs(study: Study, evaluator: Evaluator, search: Search, trials: Trials, count: int, deadline: float) -> Array:
    """The costs of the first `count` trials, or inf for those that cannot beat what they have to.

    Fewer where the clock passes `deadline` (time.perf_counter) on the way.
    """
    sources = study.poses(search.sources)
    slices = []
    step = count if deadline == math.inf else SLICE
    for first in range(0, count, step):
        part = slice(first, min(first + step, count))
        poses, source, to_beat = study.poses(trials.x[part]), trials.source[part], trials.to_beat[part]
        violation = study.violation(poses)
        cost = INFEASIBLE * (1.0 + violation)
        allowed = np.flatnonzero(violation == 0.0)
        if study.objective.is_max_vsr:
            cost[allowed] = evaluator.max_vsr(poses[allowed], source[allowed], sources, to_beat[allowed])
        else:
            cost[allowed] = evaluator.map(study.cost, poses[allowed])
        slices.append(cost)
        if time.perf_counter() > deadline:
            break
    return checked(np.concatenate(slices))
