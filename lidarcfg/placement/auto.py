"""The default search: what won over several studies (docs/benchmarks.md), round after round until time is up.

CMA-ES from the best of some random points is quickest to a good rig, and with a larger population finds a better
one where many LiDARs move. But it goes downhill from where it stands. So each round ends with differential evolution
(L-SHADE), which looks around longer; on two LiDARs of 8 beams it alone found the best rigs known.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.cma_es import CmaEs
from lidarcfg.placement.search import Trials, checked
from lidarcfg.placement.success_history import SuccessHistory

POINTS, STEP = 200, 0.15  # random points before CMA-ES, and its first standard deviation, in the unit cube
POPULATION = 30  # of the first CMA-ES of a round; each next one's is twice as large
EVALUATIONS = 4000  # of a differential evolution, a dimension


class Auto:
    """A search by rounds: CMA-ES until it has had as many evaluations as the differential evolution that ends it."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._round = self._run = self._spent = 0  # runs of CMA-ES in the round, and their evaluations
        self.cycles = 0
        self.best_x, self.best_cost, self.mean_cost = np.full(dimensions, 0.5), np.inf, np.inf
        self._walk: CmaEs | SuccessHistory | None = None
        self._points = self._rng.random((POINTS, dimensions))

    @property
    def sources(self) -> Array:
        """What trials are drawn around, if they are; else the best so far."""
        return self._walk.sources if self._walk else self.best_x[None]

    def ask(self) -> Trials:
        """Random points, or the generation of the run that is on."""
        if self._walk:
            return self._walk.ask()
        return Trials("trial", self._points, np.zeros(POINTS, np.int64), np.full(POINTS, np.inf))

    def tell(self, cost: Array) -> None:
        """The costs (n,) of what was asked."""
        x = self.ask().x
        best = int(np.argmin(checked(cost)))
        if cost[best] < self.best_cost:
            self.best_x, self.best_cost = x[best].copy(), float(cost[best])
        self.cycles += 1
        self._spent += len(cost)
        if self._walk is None:
            self.mean_cost = float(np.mean(cost))
            seed, population = int(self._rng.integers(2**63)), POPULATION * 2**self._run
            self._walk = CmaEs(self._dimensions, seed, x[best], STEP, population)
            self._run += 1
            return
        self._walk.tell(cost)
        self.mean_cost = self._walk.mean_cost
        if not self._walk.over:
            return
        share = EVALUATIONS * self._dimensions * 2 ** (self._round // 2)
        if isinstance(self._walk, CmaEs) and self._spent >= share:
            self._walk = SuccessHistory(self._dimensions, self._rng, share)
            return
        if isinstance(self._walk, SuccessHistory):
            self._round, self._run, self._spent = self._round + 1, 0, 0
        self._walk, self._points = None, self._rng.random((POINTS, self._dimensions))
