"""Simulated annealing of many chains that move one group of coordinates at a time, as ask and tell.

A chain moves uphill too (Metropolis 1953; Kirkpatrick 1983), by how much is drawn before the trial: it takes a trial
whose cost is below cost × exp(T × Exp(1)), which is what the rule that draws afterwards comes to, on the logarithm of
the cost. So an evaluator may refute a trial as soon as it is known not to be below that. A step is Gaussian, of any
size, or a difference between two chains (ter Braak 2006).

Or a group learns from another one, of its own chain or of a second: it takes over some coordinates that mean the same
there, nearly. For groups of a good point are alike in part: of the best rigs known, most have two or three LiDARs that
are tilted equally, and with one LiDAR at a time no chain would get there by chance.

Chains live on islands, and no island knows of another. Some basins are found by few chains, while these are hot, and
chains that learn from each other all end in one. So in every other round there are many small islands, of which the
worse half is given up early and again, as in successive halving (Jamieson and Talwalkar 2016). Other basins are reached
late, by many chains that learn from each other. So in the rounds between all chains live on one island.
"""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.search import Coordinates, Runs, Trials, checked

MANY, ONE = (8, 8), (1, 32)  # islands, and chains on each
TRIES = 8  # at most so many trials of a chain at a time; the first that it takes moves it
HOT, WARM, COLD = 0.04, 0.004, 0.0005  # T at the beginning, where a run goes on from a good point, and at the end
HALVED = (0.3, 0.38, 0.46)  # how far a run has come when the worse half of the islands is given up
LEAST, MOST = 0.001, 0.3  # standard deviations of Gaussian steps, in the unit cube
JITTER = 1e-4  # of a difference, so that chains that stand in one place can part
STEP_COORDINATE = 0.6  # the probability of a coordinate of the group to take part in a step that moves only some
LEARNING, OWN = 0.6, 0.6  # the probability of a step that takes over coordinates; and of taking them from its own chain
NEARLY = 0.3  # the standard deviation of what is taken over, in those of Gaussian steps
RENEWALS, RENEWED = 20, 0.1  # how often in a run, and what fraction of an island's chains, worst to best
TRIALS, REFINING = 10_000, 4000  # of a round, and of refining what it found, per dimension
LONGER = 4  # so many rounds are of one length; the next ones are twice as long


class Annealing:
    """One run of about `trials` trials; `over` once they are used up.

    Coordinates of a group move together. shape: MANY or ONE. `start` (dimensions,): where all chains begin, less hot;
    without it every chain begins at a random point.
    """

    def __init__(
        self,
        coordinates: Coordinates,
        rng: np.random.Generator,
        trials: int,
        shape: tuple[int, int] = MANY,
        start: Array | None = None,
    ) -> None:
        self._rng, self._renewals, self._halvings = rng, 0, 0
        self._tries, self._tried = 1, 0  # trials of a chain: those asked for now, and before
        self._members = np.unique(coordinates.group)[:, None] == coordinates.group
        self._counterpart = _counterparts(coordinates.kind, self._members)
        self._islands = np.arange(shape[0] * shape[1]).reshape(shape)  # those that are left, by their chains
        self._x = rng.random((self._islands.size, len(coordinates)))
        if start is not None:
            self._x[:] = start
        self._cost = np.full(len(self._x), np.inf)
        self._hot = HOT if start is None else WARM
        left = np.maximum(shape[0] >> np.arange(len(HALVED) + 1), 1) / shape[0]
        fraction = (np.diff((0.0, *HALVED, 1.0)) * left).sum()  # of the trials that all chains would take to the end
        self._most_tries = trials / (len(self._x) * fraction)
        self.over = False
        self._asked = Trials("trial", self._x.copy(), np.arange(len(self._x)), self._cost.copy())

    @property
    def sources(self) -> Array:
        """(chains, dimensions) where the chains are, including those that were given up."""
        return self._x

    @property
    def mean_cost(self) -> float:
        """The mean cost of the chains that are left."""
        return float(self._cost[self._islands].mean())

    @property
    def temperature(self) -> float:
        """How far uphill a chain goes on average, as a fraction of its cost."""
        return float(self._hot * (COLD / self._hot) ** min(self._tried / self._most_tries, 1.0))

    def ask(self) -> Trials:
        """Where the chains begin, then some trials for each of them."""
        return self._asked

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials, in order; inf stands for any cost not below what was to beat."""
        trials, cost = self._asked, checked(cost)
        taken = np.flatnonzero(cost < trials.to_beat)
        chain, first = np.unique(trials.source[taken], return_index=True)
        self._x[chain], self._cost[chain] = trials.x[taken[first]], cost[taken[first]]
        self._tried += self._tries
        self._tries = int(np.clip(len(cost) // (2 * max(len(taken), 1)), 1, TRIES))  # so that few are taken in vain
        self.over = self._tried >= self._most_tries
        if len(self._islands) > 1 and self._tried >= HALVED[self._halvings] * self._most_tries:
            self._halvings += 1
            order = np.argsort(self._cost[self._islands].min(axis=1), kind="stable")
            self._islands = self._islands[np.sort(order[: len(order) // 2])]
        if self._tried * RENEWALS >= (self._renewals + 1) * self._most_tries:
            self._renewals += 1
            self._renew()
        self._asked = self._draw()

    def _renew(self) -> None:
        """Move the worst chains of each island to where its best are."""
        for island in self._islands:
            count = max(1, round(RENEWED * len(island)))
            order = island[np.argsort(self._cost[island], kind="stable")]
            self._x[order[-count:]], self._cost[order[-count:]] = self._x[order[:count]], self._cost[order[:count]]

    def _draw(self) -> Trials:
        rng, size, dimensions = self._rng, self._islands.shape[1], self._x.shape[1]
        chain = np.repeat(self._islands.ravel(), self._tries)
        n, groups = len(chain), len(self._members)
        group = rng.integers(groups, size=n)
        moves = self._members[group]
        some = moves & (rng.random((n, dimensions)) < STEP_COORDINATE)
        some = np.where(some.any(axis=1, keepdims=True), some, moves)
        deviation = LEAST * (MOST / LEAST) ** rng.random((n, 1))
        normal = rng.standard_normal((n, dimensions))
        place = chain % size  # on its island
        one, other = (chain - place + (place + rng.integers(1, size, size=n)) % size for _ in range(2))
        difference = rng.uniform(0.2, 1.0, (n, 1)) * (self._x[one] - self._x[other]) + JITTER * normal
        gaussian = rng.random((n, 1)) < 0.5
        x = self._x[chain] + np.where(gaussian, some * deviation * normal, moves * difference)
        teacher = (group + rng.integers(1, max(groups, 2), size=n)) % groups  # another group, if there is one
        source = np.where(rng.random(n) < OWN, chain, one)
        taken = self._x[source[:, None], self._counterpart[teacher]] + NEARLY * deviation * normal
        x = np.where((rng.random((n, 1)) < LEARNING) & moves, np.where(some, taken, self._x[chain]), x)
        x = 1.0 - np.abs(1.0 - np.abs(x))  # reflected by the walls
        cost = self._cost[chain]
        with np.errstate(over="ignore", invalid="ignore"):
            to_beat = cost + np.abs(cost) * np.expm1(self.temperature * rng.exponential(size=n))
        return Trials("trial", np.clip(x, 0.0, 1.0), chain, np.where(np.isnan(to_beat), np.inf, to_beat))


def _counterparts(kind: NDArray[np.int64], members: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(groups, dimensions): what means the same as a coordinate in each group; else the coordinate itself."""
    alike = members[:, None, :] & (kind[:, None] == kind)
    out: NDArray[np.int64] = np.where(alike.any(axis=2), alike.argmax(axis=2), np.arange(len(kind)))
    return out


class AnnealingRounds(Runs):
    """Rounds of annealing, longer and longer. What is the best end of a round so far is refined by another run.

    `start` (dimensions,), if given, is refined before the first round.
    """

    def __init__(self, coordinates: Coordinates, seed: int, start: Array | None = None) -> None:
        super().__init__(len(coordinates))
        self._rng = np.random.default_rng(seed)
        self._coordinates = coordinates
        self.rounds = 0  # completed
        self._end_x, self._end = self.best_x, np.inf  # the best of the current round
        self._record = np.inf  # the best end of a round before
        self._opens, self._refines = start is not None, start is not None  # what the current run is
        self._run = self._new_run(start)

    def _new_run(self, start: Array | None) -> Annealing:
        trials = (TRIALS if start is None else REFINING) * len(self._coordinates) << self.rounds // LONGER
        shape = MANY if start is None and self.rounds % 2 == 0 else ONE
        return Annealing(self._coordinates, self._rng, trials, shape, start)

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials."""
        x, best = self.ask().x, int(np.argmin(checked(cost)))
        if cost[best] < self._end:
            self._end_x, self._end = x[best].copy(), float(cost[best])
        super().tell(cost)

    def _follow(self) -> None:
        if self._end < self._record and not self._refines:
            self._record, self._refines = self._end, True
            self._run = self._new_run(self._end_x)
        else:
            self.rounds += not self._opens
            self._opens, self._refines, self._end = False, False, np.inf
            self._run = self._new_run(None)
