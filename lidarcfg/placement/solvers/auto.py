"""The default search: what won over several studies (docs/benchmarks.md), round after round until time is up.

CMA-ES from the best of some random points is quickest to a good rig; beginning anew, with larger and larger
populations, it finds better ones. But it goes downhill from where it stands. So each round ends with differential
evolution (L-SHADE), which looks around longer; on two LiDARs of 8 beams it alone found the best rigs known.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.cma_es import CmaEs
from lidarcfg.placement.solvers.lshade import SuccessHistory
from lidarcfg.placement.solvers.search import Trials, checked

POINTS, POPULATION, STEP = 200, 30, 0.15  # random points, and the CMA-ES from the best of them
EVALUATIONS = 4000  # of a differential evolution, a dimension


class Auto:
    """A search by rounds: CMA-ES until it has had as many evaluations as the differential evolution that follows."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._round = self._spent = 0  # evaluations in the round
        self.cycles = 0
        self.best_x, self.best_cost, self.mean_cost = np.full(dimensions, 0.5), np.inf, np.inf
        self._begin()

    def _begin(self) -> None:
        """A round, with random points."""
        self._points = self._rng.random((POINTS, self._dimensions))
        self._walk: CmaEs | SuccessHistory | None = None
        self._first = True  # from the best of the points

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
            self._walk = CmaEs(self._dimensions, self._seed(), x[best], STEP, POPULATION)
            return
        self._walk.tell(cost)
        self.mean_cost = self._walk.mean_cost
        if not self._walk.over:
            return
        share = EVALUATIONS * self._dimensions * 2 ** (self._round // 2)
        if isinstance(self._walk, SuccessHistory):
            self._round, self._spent = self._round + 1, 0
            self._begin()
        elif self._spent >= share:
            self._walk = SuccessHistory(self._dimensions, self._rng, share)
        elif self._first:
            self._first, self._walk = False, CmaEs(self._dimensions, self._seed())

    def _seed(self) -> int:
        return int(self._rng.integers(2**63))
