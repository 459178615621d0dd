"""The default: a bee colony finds the good valleys, CMA-ES walks down them.

In turns: a colony of 40 bees for 3,000 trials, then CMA-ES from its best sources in turn, each until it stops.
When all have been walked down, all begins anew with fresh bees and twice the trials.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.bee_colony import BeeColony
from lidarcfg.placement.cma_es import CmaEs
from lidarcfg.placement.search import Search, Trials

BEES, TRIALS, WALKS, STEP = 40, 3_000, 4, 0.15  # found by trying, see docs/benchmarks.md


class Auto:
    """A search by bees and CMA-ES in turns."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._trials = TRIALS
        self._starts: list[Array] = []
        self.cycles = 0
        self.best_x, self.best_cost = np.full(dimensions, 0.5), np.inf
        self._now: Search = self._bees()

    def _bees(self) -> Search:
        self._left = self._trials
        return BeeColony(self._dimensions, BEES, BEES * self._dimensions, self._seed())

    def _seed(self) -> int:
        return int(self._rng.integers(2**63))

    @property
    def sources(self) -> Array:
        """Those of whoever is at work."""
        return self._now.sources

    @property
    def mean_cost(self) -> float:
        """That of whoever is at work."""
        return self._now.mean_cost

    def ask(self) -> Trials:
        """The trials of whoever is at work."""
        return self._now.ask()

    def tell(self, cost: Array) -> None:
        """The costs (n,) of what was asked."""
        before = self._now.cycles
        self._now.tell(cost)
        self.cycles += self._now.cycles - before
        if self._now.best_cost < self.best_cost:
            self.best_x, self.best_cost = self._now.best_x.copy(), self._now.best_cost
        self._left -= len(cost)
        if isinstance(self._now, BeeColony) and self._left <= 0:
            best = np.argsort(self._now.cost, kind="stable")[:WALKS]
            self._starts = list(self._now.sources[best].copy())
            self._trials *= 2
            self._walk()
        elif isinstance(self._now, CmaEs) and self._now.over:
            self._walk()

    def _walk(self) -> None:
        if self._starts:
            self._now = CmaEs(self._dimensions, self._seed(), self._starts.pop(0), STEP)
        else:
            self._now = self._bees()
