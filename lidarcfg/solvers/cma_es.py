"""A run of CMA-ES by the `cma` package, as ask and tell."""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.solvers.search import Best, Trials, mean, unbounded

HUGE = 1e300  # stands for inf, as cma subtracts costs
UNMET = 2.0**20  # is added to shortfalls; no objective exceeds it
NEAR_STEP = 0.08  # around a good point
NEAR_POPULATION = 12
FEWEST = 2  # dimensions that cma needs; a single one gets a dummy dimension beside it


class CmaEs(Best):
    """Covariance matrix adaptation (Hansen) from `start` (dimensions,); `over` once it has converged.

    `step` is the standard deviation at the beginning, in the unit cube.
    """

    def __init__(self, start: Array, seed: int, step: float, population: int) -> None:
        import cma  # takes seconds to load

        self._rng = np.random.default_rng(seed)
        self._dimensions = len(start)
        self.best_x = self._rng.random(len(start))  # anywhere, until costs are told
        self.mean_cost = np.inf
        self.over = False
        options = {
            "bounds": [0, 1],
            "popsize": population,
            "randn": lambda *shape: self._rng.standard_normal(shape),
            "seed": np.nan,  # leave NumPy's global generator alone: `randn` is ours
            "verbose": -9,
        }
        start = np.concatenate([start, np.full(max(FEWEST - len(start), 0), 0.5)])
        self._es = cma.CMAEvolutionStrategy(start, step, options)
        self._asked = self._es.ask()

    @property
    def sources(self) -> Array:
        """The best so far; no trial is drawn around a source."""
        return self.best_x[None]

    def ask(self) -> Trials:
        """The next generation."""
        n = len(self._asked)
        return Trials("trial", np.array(self._asked)[:, : self._dimensions], np.zeros(n, np.int64), unbounded(n))

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the generation."""
        self.keep_best(self.ask().x, cost)
        self._es.tell(self._asked, ranked(cost))
        self.mean_cost = mean(cost)
        self.over = bool(self._es.stop())
        if not self.over:
            self._asked = self._es.ask()


def ranked(cost: Array) -> list[float]:
    """Costs (n, 2) as numbers of the same order, which is all that matters to CMA-ES."""
    number = np.where(cost[:, 0] > 0, UNMET + cost[:, 0], cost[:, 1])
    return list(np.minimum(number, HUGE))


class WarmStart(Best):
    """Tries given points (n, dimensions), then runs CMA-ES around the best; `over` once that has converged."""

    def __init__(self, starts: Array, seed: int) -> None:
        self._starts = starts
        self._seed = seed
        self._run: CmaEs | None = None
        self.cycles = 0
        self.over = False
        self.best_x = starts[0]
        self.mean_cost = np.inf

    @property
    def sources(self) -> Array:
        """The best so far; no trial is drawn around a source."""
        best: Array = self.best_x[None]
        return best

    def ask(self) -> Trials:
        """The starts, then a generation."""
        if self._run:
            return self._run.ask()
        n = len(self._starts)
        return Trials("trial", self._starts, np.zeros(n, np.int64), unbounded(n))

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials."""
        best = self.keep_best(self.ask().x, cost)
        self.mean_cost = mean(cost)
        self.cycles += 1
        if self._run:
            self._run.tell(cost)
            self.over = self._run.over
        else:
            self._run = CmaEs(best, self._seed, NEAR_STEP, NEAR_POPULATION)
