"""Differential evolution that learns its own settings, L-SHADE (Tanabe and Fukunaga 2014), as ask and tell.

A population that shrinks as its evaluations are used up: many points look around first, few go deep at the end.
Names and constants are the paper's; a coordinate that leaves the unit cube stops halfway between its point and the
wall.
"""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.search import Trials, checked

POINTS = 18  # of the first population, a dimension
FEWEST = 4
MEMORIES = 6
BEST = 0.11  # a trial is drawn towards one of this share of the population
ARCHIVE = 1.4  # beaten points are kept, up to so many populations


class SuccessHistory:
    """A search of about so many evaluations. `over` says that they are spent."""

    def __init__(self, dimensions: int, rng: np.random.Generator, evaluations: int) -> None:
        self._rng, self._evaluations, self._used = rng, evaluations, 0
        self._x = rng.random((POINTS * dimensions, dimensions))
        self._cost = np.full(len(self._x), np.inf)
        self._alive = np.arange(len(self._x))  # rows of the two, the best first
        self._archive = np.empty((0, dimensions))
        self._f, self._cr = np.full(MEMORIES, 0.5), np.full(MEMORIES, 0.5)  # the paper's M_F and M_CR, −1 for ⊥
        self._next = 0  # of them to be written
        self._drawn = self._f, self._cr  # F and CR of the trials asked
        self.over = False
        self._asked = Trials("trial", self._x.copy(), self._alive, self._cost.copy())

    @property
    def sources(self) -> Array:
        """(n, dimensions) the points, those that were given up included."""
        return self._x

    @property
    def mean_cost(self) -> float:
        """The mean cost of the population."""
        return float(self._cost[self._alive].mean())

    def ask(self) -> Trials:
        """The first population, then a trial for each point of it."""
        return self._asked

    def tell(self, cost: Array) -> None:
        """The costs (n,) of what was asked, in its order; inf will do for one no better than its point's."""
        trials, cost = self._asked, checked(cost)
        if self._used:
            self._learn(trials, cost)
        else:
            self._cost[:] = cost
        self._used += len(cost)
        self.over = self._used >= self._evaluations
        most = POINTS * self._x.shape[1]
        left = round(most + (FEWEST - most) * min(self._used / self._evaluations, 1.0))
        self._alive = self._alive[np.argsort(self._cost[self._alive], kind="stable")][: max(left, FEWEST)]
        room = int(ARCHIVE * len(self._alive))
        if len(self._archive) > room:
            self._archive = self._archive[self._rng.permutation(len(self._archive))[:room]]
        self._asked = self._draw()

    def _learn(self, trials: Trials, cost: Array) -> None:
        point = trials.source
        better = cost < self._cost[point]
        if not better.any():
            return
        f, cr = (drawn[better] for drawn in self._drawn)
        gain = self._cost[point[better]] - cost[better]
        if np.isinf(gain).any():  # they outweigh all others
            gain = np.isinf(gain).astype(np.float64)
        weight = gain / gain.sum()
        self._f[self._next] = (weight * f**2).sum() / (weight * f).sum()
        if self._cr[self._next] >= 0.0:
            self._cr[self._next] = (weight * cr**2).sum() / (weight * cr).sum() if cr.max() > 0.0 else -1.0
        self._next = (self._next + 1) % MEMORIES
        self._archive = np.concatenate([self._archive, self._x[point[better]]])
        self._x[point[better]], self._cost[point[better]] = trials.x[better], cost[better]

    def _draw(self) -> Trials:
        """Current-to-pbest mutation with the archive, and binomial crossover."""
        rng, point = self._rng, self._alive
        n, dimensions = len(point), self._x.shape[1]
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


def _cauchy(rng: np.random.Generator, middle: Array) -> Array:
    """Cauchy numbers of scale 0.1 around `middle` (n,), drawn again where not above 0, at most 1."""
    out: NDArray[np.float64] = middle + 0.1 * rng.standard_cauchy(len(middle))
    while (low := out <= 0.0).any():
        out[low] = middle[low] + 0.1 * rng.standard_cauchy(int(low.sum()))
    return np.minimum(out, 1.0)
