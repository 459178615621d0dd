"""The default search: what won over several studies (docs/benchmarks.md), round after round until time is up.

CMA-ES is quickest to a good rig, and with a larger population finds a better one where many LiDARs move. But it goes
downhill from where it stands. So each round ends with differential evolution (L-SHADE), which looks around longer; on
two LiDARs of 8 beams it alone found the best rigs known.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.cma_es import CmaEs
from lidarcfg.placement.search import Trials, checked
from lidarcfg.placement.success_history import SuccessHistory

EVALUATIONS = 4000  # of a differential evolution, a dimension


class Auto:
    """A search by rounds: CMA-ES with restarts until it has had as many evaluations as the evolution that follows."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._round = self._spent = 0  # evaluations in the round
        self.cycles = 0
        self.best_x, self.best_cost, self.mean_cost = np.full(dimensions, 0.5), np.inf, np.inf
        self._walk: CmaEs | SuccessHistory = self._cma_es()

    def _cma_es(self) -> CmaEs:
        return CmaEs(self._dimensions, int(self._rng.integers(2**63)))

    @property
    def sources(self) -> Array:
        """What trials are drawn around, if they are; else the best so far."""
        return self._walk.sources

    def ask(self) -> Trials:
        """The generation of the search that is on."""
        return self._walk.ask()

    def tell(self, cost: Array) -> None:
        """The costs (n,) of what was asked."""
        x = self.ask().x
        best = int(np.argmin(checked(cost)))
        if cost[best] < self.best_cost:
            self.best_x, self.best_cost = x[best].copy(), float(cost[best])
        self.cycles += 1
        self._walk.tell(cost)
        self.mean_cost = self._walk.mean_cost
        self._spent += len(cost)
        if not self._walk.over:
            return
        share = EVALUATIONS * self._dimensions * 2 ** (self._round // 2)
        if isinstance(self._walk, SuccessHistory):
            self._round, self._spent = self._round + 1, 0
            self._walk = self._cma_es()
        elif self._spent >= share:
            self._walk = SuccessHistory(self._dimensions, self._rng, share)
