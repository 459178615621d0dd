"""Costs of trials by what requirements ask: a shortfall, or the objective of what meets them all."""

import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.shortfalls import Draws, Shortfalls
from lidarcfg.returns.known import KnownReturns
from lidarcfg.returns.misses import SEARCH_PLACES
from lidarcfg.search.log import Places
from lidarcfg.search.run import objective_costs
from lidarcfg.solvers.search import Cost, is_below, unbounded
from lidarcfg.study.evaluator import Index
from lidarcfg.study.study import Study
from lidarcfg.study.study_evaluator import StudyEvaluator

SHORTFALL_MOST = 1e5  # below INFEASIBLE
LEAST = math.ulp(0.0)  # the least number above 0
LOOK_S = 0.05  # between two looks at the clock, where there is a deadline
SLICE_MOST = 1000


class RequirementsEvaluator:
    """Evaluates poses (n, slots, 6) of a study's sensors; a context that owns its threads. As StudyEvaluator.

    `more_places`: see Shortfalls.
    """

    smooths = False  # whether costs can be smoothed

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        skip: bool = True,
        on_evaluations: Callable[[int], None] | None = None,
        more_places: Places | None = None,
        places: int = SEARCH_PLACES,
    ) -> None:
        """Misses are counted at so many `places` of each object."""
        assert study.requirements
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads)
        self._skip = skip
        self._on_evaluations = on_evaluations
        self._requirements = study.requirements
        self._mounts = study.rig(study.lower).mounts
        self._judge = Shortfalls(self._requirements, self._mounts, skip, more_places)
        self._objective = None if study.only_required else StudyEvaluator(study, threads, skip, places=places)
        self._seconds = 0.0
        self.minimises = True  # what rigs that meet all are compared by; else all of them cost nothing
        self.trials = 0  # evaluated, in full or until they were refuted

    def __enter__(self) -> "RequirementsEvaluator":
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._pool.shutdown(cancel_futures=True)
        if self._objective:
            self._objective.__exit__(kind, value, at)

    def add_places(self, more_places: Places) -> None:
        """Use these places, too, from now on; see Shortfalls. What is known of sensors is forgotten."""
        self._judge = Shortfalls(self._requirements, self._mounts, self._skip, more_places)

    @property
    def known(self) -> KnownReturns | None:
        """The returns at the places where misses are counted; None: they are not."""
        return self._objective.known if self._objective else None

    def count_at(self, places: int) -> None:
        """Count misses at so many places of each object from now on."""
        if self._objective:
            self._objective.count_at(places)

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
        """The number of cuboids evaluated."""
        return self._objective.cuboids if self._objective else 0

    @property
    def segments(self) -> int:
        """The number of segments cast from LiDARs to cuboids, at most."""
        return self._objective.segments if self._objective else 0

    def costs(
        self, poses: Array, source: Index, source_poses: Array, upper_bound: Array, smoothing: float = 0.0
    ) -> Array:
        """(n, 2) the costs, or (inf, inf) where one is not below `upper_bound` (n, 2). See Evaluator.costs."""
        began = time.perf_counter()
        limits = upper_bound if self._skip else unbounded(len(poses))
        rigs = self._judge.rigs(poses)
        run = map if self._threads == 1 else self._pool.map
        cost = np.array(list(run(self._cost, rigs, limits.tolist()))).reshape(-1, 2)
        if self._objective and self.minimises:
            met = np.flatnonzero(cost[:, 0] == 0)
            if len(met):
                cost[met] = objective_costs(self._objective, poses[met], source[met], source_poses, limits[met])
        self._judge.learn()
        self.trials += len(poses)
        self._seconds += time.perf_counter() - began
        if self._on_evaluations:
            self._on_evaluations(self.trials)
        return np.where(is_below(cost, limits)[:, None], cost, np.inf)

    def shortfalls(self, poses: Array) -> tuple[float, ...]:
        """Of one rig's poses (slots, 6), for each requirement in turn."""
        return self._judge.shortfalls(self._judge.rigs(poses[None])[0])

    def _cost(self, rig: Draws, limit: tuple[float, float]) -> Cost:
        """The cost of a rig by its shortfall; (0, 0) if it meets all."""
        limit_shortfall, _ = limit
        shortfall = self._judge.shortfall(rig, max(limit_shortfall, LEAST))
        if shortfall > 0:
            return Cost(min(shortfall, SHORTFALL_MOST) if math.isfinite(shortfall) else math.inf, math.inf)
        return Cost(0.0, 0.0)
