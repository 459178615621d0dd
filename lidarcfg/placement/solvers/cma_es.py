"""CMA-ES by the `cma` package, as ask and tell, with restarts that double the population."""

import cma
import numpy as np

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.search import Best, Trials, mean, unbounded

STEP = 0.25  # the initial standard deviation, in the unit cube
HUGE = 1e300  # stands for inf, as cma subtracts costs
UNMET = 2.0**20  # is added to shortfalls; no objective exceeds it
NEAR_STEP = 0.08  # around a good point
NEAR_POPULATION = 12
FEWEST = 2  # dimensions that cma needs; a single one gets a dummy dimension beside it


class CmaEs(Best):
    """A search by covariance matrix adaptation (Hansen; IPOP restarts, Auger and Hansen 2005).

    It starts at `start` (dimensions,), by default at a random point, with cma's default population unless given.
    `over` right after a run has ended and the next one has begun.
    """

    def __init__(
        self, dimensions: int, seed: int, start: Array | None = None, step: float = STEP, population: int = 0
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._step = step
        self._population = population or 4 + int(3 * maths.log(dimensions))
        self.cycles = 0
        self.best_x = self._rng.random(dimensions)
        self.mean_cost = np.inf
        self.over = False
        self._begin(start if start is not None else self.best_x)

    @property
    def sources(self) -> Array:
        """The best so far; no trial is drawn around a source."""
        return self.best_x[None]

    def _begin(self, start: Array) -> None:
        options = {
            "bounds": [0, 1],
            "popsize": self._population,
            "randn": lambda *shape: self._rng.standard_normal(shape),
            "seed": np.nan,  # leave NumPy's global generator alone: `randn` is ours
            "verbose": -9,
        }
        start = np.concatenate([start, np.full(max(FEWEST - len(start), 0), 0.5)])
        self._es = cma.CMAEvolutionStrategy(start, self._step, options)
        self._asked = self._es.ask()

    def ask(self) -> Trials:
        """The next generation."""
        n = len(self._asked)
        return Trials("trial", np.array(self._asked)[:, : self._dimensions], np.zeros(n, np.int64), unbounded(n))

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the generation."""
        self.keep_best(self.ask().x, cost)
        self._es.tell(self._asked, ranked(cost))
        self.mean_cost = mean(cost)
        self.cycles += 1
        self.over = bool(self._es.stop())
        if self.over:
            self._population *= 2
            self._begin(self._rng.random(self._dimensions))
        else:
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
            self._run = CmaEs(len(best), self._seed, best, NEAR_STEP, NEAR_POPULATION)
