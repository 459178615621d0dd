"""The default search: the combination that won on several studies (docs/benchmarks.md), in rounds.

CMA-ES from the best of some random points is the quickest to a good rig; restarts with ever larger populations find
better ones. But CMA-ES is a local search. So each round ends with differential evolution (L-SHADE), which explores
for longer; with two LiDARs of 8 beams it alone found the best rigs known.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.cma_es import CmaEs
from lidarcfg.placement.solvers.lshade import EVALUATIONS, Lshade
from lidarcfg.placement.solvers.search import Trials, checked

POINTS, POPULATION, STEP = 200, 30, 0.15  # random points, then CMA-ES from the best of them


class Auto:
    """A search in rounds: CMA-ES for as many evaluations as the differential evolution that follows it."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._round = self._spent = 0  # evaluations in the round
        self.cycles = 0
        self.best_x, self.best_cost, self.mean_cost = np.full(dimensions, 0.5), np.inf, np.inf
        self._begin()

    def _begin(self) -> None:
        """Start a round with random points."""
        self._points = self._rng.random((POINTS, self._dimensions))
        self._run: CmaEs | Lshade | None = None
        self._first = True  # the next run starts from the best point

    @property
    def sources(self) -> Array:
        """The points that trials are drawn around; without any, the best so far."""
        return self._run.sources if self._run else self.best_x[None]

    def ask(self) -> Trials:
        """Random points, or the next generation of the current run."""
        if self._run:
            return self._run.ask()
        return Trials("trial", self._points, np.zeros(POINTS, np.int64), np.full(POINTS, np.inf))

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials."""
        x = self.ask().x
        best = int(np.argmin(checked(cost)))
        if cost[best] < self.best_cost:
            self.best_x, self.best_cost = x[best].copy(), float(cost[best])
        self.cycles += 1
        self._spent += len(cost)
        if self._run is None:
            self.mean_cost = float(np.mean(cost))
            self._run = CmaEs(self._dimensions, self._seed(), x[best], STEP, POPULATION)
            return
        self._run.tell(cost)
        self.mean_cost = self._run.mean_cost
        if not self._run.over:
            return
        budget = EVALUATIONS * self._dimensions * 2 ** (self._round // 2)
        if isinstance(self._run, Lshade):
            self._round, self._spent = self._round + 1, 0
            self._begin()
        elif self._spent >= budget:
            self._run = Lshade(self._dimensions, self._rng, budget)
        elif self._first:
            self._first, self._run = False, CmaEs(self._dimensions, self._seed())

    def _seed(self) -> int:
        return int(self._rng.integers(2**63))
