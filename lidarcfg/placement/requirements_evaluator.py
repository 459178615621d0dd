"""The costs of a study's trials that must meet requirements: shortfalls first, then the objective or the least margin.

A cost is one number, so that solvers need not know. Of a rig that misses requirements it is the sum of their
shortfalls. Of one that meets all it is the objective times 2⁻⁸⁰, a power of two, by which no digit is lost; without an
objective 1 / (1 + the least relative margin) stands for it. No shortfall is that small: the least is one return missing
at one of millions of places, and no objective exceeds 2²⁰. Rigs that violate constraints cost INFEASIBLE or more, which
no shortfall reaches. So costs are ordered as they should, and solvers that compare them by their ratio stay as they
are.
"""

import math
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.evaluator import Index
from lidarcfg.placement.study import Study
from lidarcfg.placement.study_evaluator import StudyEvaluator
from lidarcfg.requirements.trials import Draws, RigTrials

MET_SCALE = 2.0**-80
MET_MOST = 2.0**-60  # no rig that meets all costs as much
SHORTFALL_MOST = 1e5  # below INFEASIBLE
LOOK_S = 0.05  # between two looks at the clock, where there is a deadline
SLICE_MOST = 1000


def cost_of(shortfall: float, wanted: float) -> float:
    """The cost of a rig: its shortfall, or if that is 0 what else is minimised, which is at least 0.

    inf where the one or the other is, as of trials that are given up.
    """
    if shortfall > 0:
        return min(shortfall, SHORTFALL_MOST) if math.isfinite(shortfall) else math.inf
    return wanted * MET_SCALE


def meets(cost: float) -> bool:
    """Whether a rig of this cost meets all requirements, at the places of the base grid."""
    return cost < MET_MOST


def readable(cost: float) -> float:
    """What a cost stands for: the shortfall, or the objective of a rig that meets all."""
    return cost / MET_SCALE if meets(cost) else cost


class RequirementsEvaluator:
    """Evaluates poses (n, slots, 6) of a study's sensors; a context that owns its threads. As StudyEvaluator.

    `more_places`: see RigTrials.
    """

    smooths = False  # whether costs can be smoothed

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        skip: bool = True,
        on_evaluations: Callable[[int], None] | None = None,
        more_places: Mapping[int, Array] | None = None,
    ) -> None:
        assert study.requirements
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads)
        self._skip = skip
        self._on_evaluations = on_evaluations
        self._requirements = study.requirements
        self._mounts = study.rig(study.lower).mounts
        self._judge = RigTrials(self._requirements, self._mounts, skip, more_places)
        self._objective = None if study.seeks_margin else StudyEvaluator(study, threads, skip)
        self._seconds = 0.0
        self.trials = 0  # evaluated, in full or until they were refuted

    def __enter__(self) -> "RequirementsEvaluator":
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._pool.shutdown(cancel_futures=True)
        if self._objective:
            self._objective.__exit__(kind, value, at)

    def add_places(self, more_places: Mapping[int, Array]) -> None:
        """From now on these count, too; see RigTrials. What is known of sensors is forgotten."""
        self._judge = RigTrials(self._requirements, self._mounts, self._skip, more_places)

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
        """How many were evaluated."""
        return self._objective.cuboids if self._objective else 0

    @property
    def segments(self) -> int:
        """How many were cast from LiDARs to cuboids, at most."""
        return self._objective.segments if self._objective else 0

    def costs(
        self, poses: Array, source: Index, source_poses: Array, upper_bound: Array, smoothing: float = 0.0
    ) -> Array:
        """(n,) the costs, or inf where one is not below `upper_bound` (n,). See Evaluator.costs."""
        began = time.perf_counter()
        limits = upper_bound if self._skip else np.full(len(poses), np.inf)
        rigs = self._judge.rigs(poses)
        run = map if self._threads == 1 else self._pool.map
        cost = np.array(list(run(self._cost, rigs, limits.tolist())), np.float64)
        if self._objective:
            met = np.flatnonzero(cost < MET_MOST)
            bound = limits[met]
            beaten = np.where(bound < MET_MOST, bound / MET_SCALE, np.inf)
            wanted = self._objective.costs(poses[met], source[met], source_poses, beaten) if len(met) else np.empty(0)
            cost[met] = [cost_of(0.0, one) for one in wanted.tolist()]
        self._judge.learn()
        self.trials += len(poses)
        self._seconds += time.perf_counter() - began
        if self._on_evaluations:
            self._on_evaluations(self.trials)
        return np.where(cost < limits, cost, np.inf)

    def shortfalls(self, poses: Array) -> tuple[float, ...]:
        """Of one rig's poses (slots, 6), for each requirement in turn."""
        return self._judge.shortfalls(self._judge.rigs(poses[None])[0])

    def _cost(self, rig: Draws, limit: float) -> float:
        """The cost of a rig by shortfalls and margin; 0 if it meets all and there is an objective."""
        shortfall = self._judge.shortfall(rig, limit)
        if shortfall > 0 or self._objective:
            return cost_of(shortfall, 0.0)
        return cost_of(0.0, self._judge.tightness(rig, limit / MET_SCALE if limit < MET_MOST else math.inf))
