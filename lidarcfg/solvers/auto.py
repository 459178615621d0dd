"""The default search: a little CMA-ES, then annealing (docs/evidence/benchmarks.md has what this gains).

Where LiDARs have little room, CMA-ES from the best of some random points is the quickest to a good rig. But it is a
local search that moves all coordinates at the same time. So annealing follows, whose chains move one group of
coordinates at a time: it refines that rig, then begins anew, for longer and longer.
"""

from typing import ClassVar, Literal

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.solvers.annealing import AnnealingRounds
from lidarcfg.solvers.cma_es import CmaEs
from lidarcfg.solvers.search import Best, Coordinates, Search, Trials, mean, unbounded
from lidarcfg.solvers.solver import Solver

POINTS = 200  # at random, then CMA-ES from the best of them
POPULATION = 30  # of CMA-ES
STEP = 0.15  # of CMA-ES at the beginning
EVALUATIONS = 200  # of CMA-ES at most, per dimension


class AutoSolver(Solver):
    """A little CMA-ES, then annealing; the default, for all studies."""

    in_full: ClassVar[str] = (
        "This solver begins with random trials and CMA-ES, which rank trials by cost: these are evaluated in full."
    )
    method: Literal["auto"] = "auto"

    def begin(self, coordinates: Coordinates, starts: Array | None = None) -> Search:
        """From `starts`, where trials that move one group are cheap, annealing alone, as its trials do."""
        if starts is not None and coordinates.one_group_is_cheap:
            return AnnealingRounds(coordinates, self.seed, starts)
        return Auto(coordinates, self.seed, starts)


class Auto(Best):
    """Random points, one run of CMA-ES, and rounds of annealing. `starts` (s, dimensions) are among the points."""

    def __init__(self, coordinates: Coordinates, seed: int, starts: Array | None = None) -> None:
        self._rng = np.random.default_rng(seed)
        self._coordinates = coordinates
        self._points = self._rng.random((POINTS, len(coordinates)))
        if starts is not None:
            self._points[: len(starts)] = starts
        self._run: CmaEs | AnnealingRounds | None = None
        self._left = EVALUATIONS * len(coordinates)
        self.cycles = 0
        self.best_x = np.full(len(coordinates), 0.5)
        self.mean_cost = np.inf

    @property
    def sources(self) -> Array:
        """The points that trials are drawn around; without any, the best so far."""
        return self._run.sources if self._run else self.best_x[None]

    def ask(self) -> Trials:
        """Random points, or the next trials of the current run."""
        if self._run:
            return self._run.ask()
        return Trials("trial", self._points, np.zeros(POINTS, np.int64), unbounded(POINTS))

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials."""
        best = self.keep_best(self.ask().x, cost)
        self.cycles += 1
        if self._run is None:
            self.mean_cost = mean(cost)
            self._run = CmaEs(best, self._seed(), STEP, POPULATION)
            return
        self._run.tell(cost)
        self.mean_cost = self._run.mean_cost
        if isinstance(self._run, CmaEs):
            self._left -= len(cost)
            if self._run.over or self._left <= 0:
                self._run = AnnealingRounds(self._coordinates, self._seed(), self.best_x[None])

    def _seed(self) -> int:
        return int(self._rng.integers(2**63))
