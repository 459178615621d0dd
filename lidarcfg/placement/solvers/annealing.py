"""Simulated annealing of many chains that move one group of coordinates at a time, as ask and tell.

A chain moves uphill too (Metropolis 1953; Kirkpatrick 1983), by how much is drawn before the trial: it takes a trial
whose cost is below cost × exp(T × Exp(1)), which is what the rule that draws afterwards comes to, on the logarithm of
the cost. So an evaluator may refute a trial as soon as it is known not to be below that. A step is Gaussian, of any
size, or a difference between two chains (ter Braak 2006). As T falls, the worst chains go on from where the best are.
"""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.search import Trials, checked

CHAINS, TRIES = 32, 4  # trials of a chain at a time; the first that it takes moves it
HOT, COLD = 0.03, 0.0005  # T at the beginning and at the end of a run
LEAST, MOST = 0.001, 0.3  # standard deviations of Gaussian steps, in the unit cube
JITTER = 1e-4  # of a difference, so that chains that stand in one place can part
STEP_COORDINATE = 0.6  # the probability of a coordinate of the group to take part in a Gaussian step
RENEWALS = 20  # of a run; each time this fraction of the chains are moved to the best ones
RENEWED = 0.1
TRIALS = 4000  # of the first run of a search with restarts, per dimension


class Annealing:
    """One run of about `trials` trials; `over` once they are used up.

    groups (dimensions,): coordinates of equal numbers move together. `start` (chains, dimensions): where chains begin,
    by default at random points.
    """

    def __init__(
        self, groups: NDArray[np.int64], rng: np.random.Generator, trials: int, start: Array | None = None
    ) -> None:
        self._rng, self._trials, self._used, self._renewals = rng, trials, 0, 0
        self._members = np.unique(groups)[:, None] == groups
        self._x = rng.random((CHAINS, len(groups))) if start is None else start.copy()
        self._cost = np.full(len(self._x), np.inf)
        self.over = False
        self._asked = Trials("trial", self._x.copy(), np.arange(len(self._x)), self._cost.copy())

    @property
    def sources(self) -> Array:
        """(chains, dimensions) where the chains are."""
        return self._x

    @property
    def mean_cost(self) -> float:
        """The mean cost of the chains."""
        return float(self._cost.mean())

    @property
    def temperature(self) -> float:
        """How far uphill a chain goes on average, as a fraction of its cost."""
        return float(HOT * (COLD / HOT) ** min(self._used / self._trials, 1.0))

    def ask(self) -> Trials:
        """Where the chains begin, then some trials for each of them."""
        return self._asked

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials, in order; inf stands for any cost not below what was to beat."""
        trials, cost = self._asked, checked(cost)
        taken = np.flatnonzero(cost < trials.to_beat)
        chain, first = np.unique(trials.source[taken], return_index=True)
        self._x[chain], self._cost[chain] = trials.x[taken[first]], cost[taken[first]]
        self._used += len(cost)
        self.over = self._used >= self._trials
        if self._used * RENEWALS >= (self._renewals + 1) * self._trials:
            self._renewals += 1
            self._renew()
        self._asked = self._draw()

    def _renew(self) -> None:
        """Move the worst chains to where the best are."""
        count = max(1, round(RENEWED * len(self._x)))
        order = np.argsort(self._cost, kind="stable")
        self._x[order[-count:]], self._cost[order[-count:]] = self._x[order[:count]], self._cost[order[:count]]

    def _draw(self) -> Trials:
        rng, chains, dimensions = self._rng, *self._x.shape
        chain = np.repeat(np.arange(chains), TRIES)
        shape = n, _ = len(chain), dimensions
        moves = self._members[rng.integers(len(self._members), size=n)]
        some = moves & (rng.random(shape) < STEP_COORDINATE)
        some = np.where(some.any(axis=1, keepdims=True), some, moves)
        size = LEAST * (MOST / LEAST) ** rng.random(n)
        normal = rng.standard_normal(shape)
        one, other = (self._x[(chain + rng.integers(1, chains, size=n)) % chains] for _ in range(2))
        difference = rng.uniform(0.2, 1.0, n)[:, None] * (one - other) + JITTER * normal
        gaussian = rng.random((n, 1)) < 0.5
        x = self._x[chain] + np.where(gaussian, some * size[:, None] * normal, moves * difference)
        x = 1.0 - np.abs(1.0 - np.abs(x))  # reflected by the walls
        cost = self._cost[chain]
        with np.errstate(over="ignore", invalid="ignore"):
            to_beat = cost + np.abs(cost) * np.expm1(self.temperature * rng.exponential(size=n))
        return Trials("trial", np.clip(x, 0.0, 1.0), chain, np.where(np.isnan(to_beat), np.inf, to_beat))


class AnnealingRestarts:
    """Runs of annealing, one after the other, each with twice the trials of the one before."""

    def __init__(self, groups: NDArray[np.int64], seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._groups, self._trials = groups, TRIALS * len(groups)
        self._run = Annealing(groups, self._rng, self._trials)
        self.cycles = 0
        self.best_x, self.best_cost = np.full(len(groups), 0.5), np.inf

    @property
    def sources(self) -> Array:
        """(chains, dimensions) where the chains of the current run are."""
        return self._run.sources

    @property
    def mean_cost(self) -> float:
        """The mean cost of the chains."""
        return self._run.mean_cost

    def ask(self) -> Trials:
        """The next trials of the chains."""
        return self._run.ask()

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials."""
        x, best = self._run.ask().x, int(np.argmin(checked(cost)))
        if cost[best] < self.best_cost:
            self.best_x, self.best_cost = x[best].copy(), float(cost[best])
        self.cycles += 1
        self._run.tell(cost)
        if self._run.over:
            self._trials *= 2
            self._run = Annealing(self._groups, self._rng, self._trials)
