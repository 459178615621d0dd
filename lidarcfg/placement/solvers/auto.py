"""The default search: the combination that won on the paper's studies (docs/benchmarks.md), in turns.

CMA-ES from the best of some random points is the quickest to a good rig; restarts with ever larger populations find
better ones. But CMA-ES is a local search that moves everything at once. So annealing follows, whose chains move one
group of coordinates at a time. It refines the best so far, then begins anew many times.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.annealing import LONGER, AnnealingRounds
from lidarcfg.placement.solvers.cma_es import CmaEs
from lidarcfg.placement.solvers.search import Coordinates, Trials, checked

POINTS, POPULATION, STEP = 200, 30, 0.15  # random points, then CMA-ES from the best of them
EVALUATIONS = 1000  # of CMA-ES at first, per dimension


class Auto:
    """CMA-ES and annealing in turns: so many evaluations, so many rounds; each turn is twice as long as its last."""

    def __init__(self, coordinates: Coordinates, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._coordinates = coordinates
        self._turn = self._spent = 0  # turns completed, and evaluations in this one
        self.cycles = 0
        self.best_x, self.best_cost, self.mean_cost = np.full(len(coordinates), 0.5), np.inf, np.inf
        self._annealing: AnnealingRounds | None = None
        self._begin()

    def _begin(self) -> None:
        """Start a turn with random points."""
        self._points = self._rng.random((POINTS, len(self._coordinates)))
        self._run: CmaEs | AnnealingRounds | None = None
        self._first = True  # the next run starts from the best point

    @property
    def sources(self) -> Array:
        """The points that trials are drawn around; without any, the best so far."""
        return self._run.sources if self._run else self.best_x[None]

    def ask(self) -> Trials:
        """Random points, or the next trials of the current run."""
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
            self._run = CmaEs(len(self._coordinates), self._seed(), x[best], STEP, POPULATION)
            return
        self._run.tell(cost)
        self.mean_cost = self._run.mean_cost
        if isinstance(self._run, AnnealingRounds):
            if self._run.rounds == LONGER * (self._turn + 1):
                self._turn, self._spent = self._turn + 1, 0
                self._begin()
        elif self._run.over:
            self._follow()

    def _follow(self) -> None:
        """What comes after a run of CMA-ES: another one, or annealing."""
        if self._spent >= EVALUATIONS * len(self._coordinates) * 2**self._turn:
            self._annealing = self._annealing or AnnealingRounds(self._coordinates, self._seed(), self.best_x)
            self._run = self._annealing
        elif self._first:
            self._first, self._run = False, CmaEs(len(self._coordinates), self._seed())

    def _seed(self) -> int:
        return int(self._rng.integers(2**63))
