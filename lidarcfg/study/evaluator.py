"""What a search asks for the costs of its trials: how far they fall short of requirements, then their objective.

Only rigs that meet all requirements have an objective.
"""

import math
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.shortfalls import Draws, Shortfalls
from lidarcfg.returns.known import KnownReturns
from lidarcfg.returns.misses import SEARCH_PLACES
from lidarcfg.solvers.search import Cost, is_below, of_objectives, unbounded
from lidarcfg.study.bounded_costs import Index
from lidarcfg.study.objective_costs import LOOK_S, ObjectiveCosts
from lidarcfg.study.study import Study

SHORTFALL_MOST = 1e5  # less than what a rig costs that violates constraints
LEAST = math.ulp(0.0)  # the least number above 0
SLICE_MOST = 1000


class Evaluator:
    """The costs of a study's sensors at poses (n, slots, 6); a context that owns its threads.

    Misses are counted at so many `places` of each object. `more_places`: see Shortfalls.
    """

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        skip: bool = True,
        on_evaluations: Callable[[int], None] | None = None,
        places: int = SEARCH_PLACES,
        more_places: Mapping[int, Array] | None = None,
    ) -> None:
        self._study = study
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads)
        self._skip = skip
        self._on_evaluations = on_evaluations
        self._judge: Shortfalls | None = None
        if study.requirements:
            self.add_places(more_places or {})
        told = None if study.requirements else on_evaluations
        self._objective = None if study.only_required else ObjectiveCosts(study, threads, skip, told, places)
        self._seconds = 0.0
        self.minimises = True  # what rigs that meet all are compared by; else all of them cost nothing
        self.trials = 0  # evaluated, in full or until they were refuted

    def __enter__(self) -> "Evaluator":
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._pool.shutdown(cancel_futures=True)
        if self._objective:
            self._objective.__exit__(kind, value, at)

    def add_places(self, more_places: Mapping[int, Array]) -> None:
        """Use these places, too, from now on; see Shortfalls. What is known of sensors is forgotten."""
        assert self._study.requirements
        mounts = self._study.rig(self._study.space.lower).mounts
        self._judge = Shortfalls(self._study.requirements, mounts, self._skip, more_places)

    @property
    def known(self) -> KnownReturns | None:
        """The returns at the places where misses are counted; None: they are not."""
        return self._objective.known if self._objective else None

    def count_at(self, places: int) -> None:
        """Count misses at so many places of each object from now on."""
        if self._objective:
            self._objective.count_at(places)

    @property
    def smooths(self) -> bool:
        """Whether costs can be smoothed."""
        return self._judge is None and self._objective is not None and self._objective.smooths

    @property
    def slice(self) -> int:
        """How many trials are evaluated between two looks at the clock, where there is a deadline."""
        if self._objective and self._judge is None:
            return self._objective.slice
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
        """(n, 2) the costs, or (inf, inf) where one is not below `upper_bound` (n, 2). See BoundedCosts.costs."""
        self.trials += len(poses)
        if self._judge is None:
            return self._objectives(poses, source, source_poses, upper_bound, smoothing)
        began = time.perf_counter()
        limits = upper_bound if self._skip else unbounded(len(poses))
        cost = self._shortfalls(self._judge, poses, limits)
        if self._objective and self.minimises:
            met = np.flatnonzero(cost[:, 0] == 0)
            if len(met):
                cost[met] = self._objectives(poses[met], source[met], source_poses, limits[met])
        self._judge.learn()
        self._seconds += time.perf_counter() - began
        if self._on_evaluations:
            self._on_evaluations(self.trials)
        return np.where(is_below(cost, limits)[:, None], cost, np.inf)

    def _objectives(
        self, poses: Array, source: Index, source_poses: Array, upper_bound: Array, smoothing: float = 0.0
    ) -> Array:
        """(n, 2) the costs of rigs without a shortfall."""
        assert self._objective
        beaten = np.where(upper_bound[:, 0] > 0, np.inf, upper_bound[:, 1])
        return of_objectives(self._objective.costs(poses, source, source_poses, beaten, smoothing))

    def _shortfalls(self, judge: Shortfalls, poses: Array, limits: Array) -> Array:
        """(n, 2) the costs by shortfalls alone; (0, 0) of rigs that meet all requirements."""

        def one(rig: Draws, limit: tuple[float, float]) -> Cost:
            shortfall = judge.shortfall(rig, max(limit[0], LEAST))
            if shortfall > 0:
                return Cost(min(shortfall, SHORTFALL_MOST) if math.isfinite(shortfall) else math.inf, math.inf)
            return Cost(0.0, 0.0)

        run = map if self._threads == 1 else self._pool.map
        return np.array(list(run(one, judge.rigs(poses), limits.tolist()))).reshape(-1, 2)

    def shortfalls(self, poses: Array) -> tuple[float, ...]:
        """Of one rig's poses (slots, 6), for each requirement in turn."""
        assert self._judge
        return self._judge.shortfalls(self._judge.rigs(poses[None])[0])
