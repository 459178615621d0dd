"""Differential evolution that adapts its own parameters, L-SHADE (Tanabe and Fukunaga 2014), as ask and tell.

The population shrinks as evaluations are used up: many points explore first, few refine at the end. Names and
constants are the paper's; a coordinate that leaves the unit cube is set halfway between its point and the wall.
"""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.search import Runs, Trials, checked

POINTS = 18  # of the first population, a dimension
FEWEST = 4
MEMORIES = 6
BEST = 0.11  # a trial moves towards one of this fraction of the population
ARCHIVE = 1.4  # size of the archive of replaced points, in populations
EVALUATIONS = 4000  # of the first run of a search with restarts, per dimension


class Lshade:
    """One run of about `evaluations` evaluations; `over` once they are used up."""

    def __init__(self, dimensions: int, rng: np.random.Generator, evaluations: int) -> None:
        self._rng = rng
        self._evaluations = evaluations
        self._used = 0
        self._x = rng.random((POINTS * dimensions, dimensions))
        self._cost = np.full(len(self._x), np.inf)
        self._alive = np.arange(len(self._x))  # the population: rows of _x and _cost, best first
        self._archive = np.empty((0, dimensions))
        self._f = np.full(MEMORIES, 0.5)  # the paper's M_F
        self._cr = np.full(MEMORIES, 0.5)  # the paper's M_CR, −1 for ⊥
        self._next = 0  # the memory to write next
        self._drawn = self._f, self._cr  # F and CR of the current trials
        self.over = False
        self._asked = Trials("trial", self._x.copy(), self._alive, self._cost.copy())

    @property
    def sources(self) -> Array:
        """(n, dimensions) the points, including those dropped from the population."""
        return self._x

    @property
    def mean_cost(self) -> float:
        """The mean cost of the population."""
        return float(self._cost[self._alive].mean())

    def ask(self) -> Trials:
        """The first population, then a trial for each point of it."""
        return self._asked

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials, in order; inf stands for any cost no better than the point's."""
        trials = self._asked
        cost = checked(cost)
        if self._used:
            self._learn(trials, cost)
        else:
            self._cost[:] = cost
        self._used += len(cost)
        self.over = self._used >= self._evaluations
        most = POINTS * self._x.shape[1]
        left = round(most + (FEWEST - most) * min(self._used / self._evaluations, 1.0))
        self._alive = self._alive[np.argsort(self._cost[self._alive], kind="stable")][: max(left, FEWEST)]
        size = int(ARCHIVE * len(self._alive))
        if len(self._archive) > size:
            self._archive = self._archive[self._rng.permutation(len(self._archive))[:size]]
        self._asked = self._draw()

    def _learn(self, trials: Trials, cost: Array) -> None:
        point = trials.source
        better = cost < self._cost[point]
        if not better.any():
            return
        f, cr = (drawn[better] for drawn in self._drawn)
        gain = self._cost[point[better]] - cost[better]
        if np.isinf(gain).any():  # these outweigh all others
            gain = np.isinf(gain).astype(np.float64)
        weight = gain / gain.sum()
        self._f[self._next] = (weight * f**2).sum() / (weight * f).sum()
        if self._cr[self._next] >= 0.0:
            self._cr[self._next] = (weight * cr**2).sum() / (weight * cr).sum() if cr.max() > 0.0 else -1.0
        self._next = (self._next + 1) % MEMORIES
        self._archive = np.concatenate([self._archive, self._x[point[better]]])
        self._x[point[better]] = trials.x[better]
        self._cost[point[better]] = cost[better]

    def _draw(self) -> Trials:
        """Current-to-pbest mutation with the archive, and binomial crossover."""
        rng = self._rng
        point = self._alive
        n = len(point)
        dimensions = self._x.shape[1]
        memory = rng.integers(MEMORIES, size=n)
        cr = np.where(self._cr[memory] < 0.0, 0.0, np.clip(rng.normal(self._cr[memory], 0.1), 0.0, 1.0))
        f = _cauchy(rng, self._f[memory])
        x = self._x[point]
        best = x[rng.integers(max(2, round(BEST * n)), size=n)]
        one = rng.integers(n - 1, size=n)
        one += one >= np.arange(n)
        others = np.concatenate([x, self._archive])
        other = others[rng.integers(len(others), size=n)]
        v = x + f[:, None] * (best - x) + f[:, None] * (x[one] - other)
        v = np.where(v < 0.0, x / 2.0, np.where(v > 1.0, (1.0 + x) / 2.0, v))
        crossed = rng.random((n, dimensions)) < cr[:, None]
        crossed[np.arange(n), rng.integers(dimensions, size=n)] = True
        self._drawn = f, cr
        return Trials("trial", np.where(crossed, v, x), point, self._cost[point])


class LshadeRestarts(Runs):
    """Runs of L-SHADE, one after the other, each with twice the evaluations of the one before."""

    def __init__(self, dimensions: int, seed: int) -> None:
        super().__init__(dimensions)
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._evaluations = EVALUATIONS * dimensions
        self._run = Lshade(dimensions, self._rng, self._evaluations)

    def _follow(self) -> None:
        self._evaluations *= 2
        self._run = Lshade(self._dimensions, self._rng, self._evaluations)


def _cauchy(rng: np.random.Generator, centre: Array) -> Array:
    """Cauchy numbers of scale 0.1 around `centre` (n,), redrawn until above 0, at most 1."""
    out: NDArray[np.float64] = centre + 0.1 * rng.standard_cauchy(len(centre))
    while (low := out <= 0.0).any():
        out[low] = centre[low] + 0.1 * rng.standard_cauchy(int(low.sum()))
    return np.minimum(out, 1.0)
