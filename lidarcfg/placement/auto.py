"""The default search: CMA-ES from the best of many random points, again and again.

Of what was tried at 10,000 evaluations (docs/benchmarks.md) it is among the best on four LiDARs of 16 beams and
within 1 % on two of 8; bees before CMA-ES brought no more. Every second run has twice the population.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.cma_es import CmaEs
from lidarcfg.placement.search import Trials

POINTS, STEP = 200, 0.15


class Auto:
    """A search by runs: random points, then CMA-ES from the best of them until it stops."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._runs = self.cycles = 0
        self.best_x, self.best_cost, self.mean_cost = np.full(dimensions, 0.5), np.inf, np.inf
        self._points, self._walk = self._rng.random((POINTS, dimensions)), None

    _walk: CmaEs | None

    @property
    def sources(self) -> Array:
        """The best so far: nothing is drawn around a source here."""
        return self.best_x[None]

    def ask(self) -> Trials:
        """Random points, or CMA-ES's generation."""
        if self._walk:
            return self._walk.ask()
        return Trials("trial", self._points, np.zeros(POINTS, np.int64), np.full(POINTS, np.inf))

    def tell(self, cost: Array) -> None:
        """The costs (n,) of what was asked."""
        x = self.ask().x
        best = int(np.argmin(cost))
        if cost[best] < self.best_cost:
            self.best_x, self.best_cost = x[best].copy(), float(cost[best])
        self.mean_cost = float(np.mean(cost))
        self.cycles += 1
        if self._walk is None:
            seed, larger = int(self._rng.integers(2**63)), 2 ** (self._runs // 2)
            self._walk = CmaEs(self._dimensions, seed, x[best], STEP, larger)
            self._runs += 1
        else:
            self._walk.tell(cost)
            if self._walk.over:
                self._points, self._walk = self._rng.random((POINTS, self._dimensions)), None
