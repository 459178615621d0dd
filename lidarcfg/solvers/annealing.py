"""Simulated annealing of many chains that move one group of coordinates at a time, as ask and tell.

A chain moves uphill too (Metropolis 1953; Kirkpatrick 1983), by how much is drawn before the trial: it takes a trial
whose cost is below cost × exp(T × Exp(1)), which is what the rule that draws afterwards comes to, on the logarithm of
the cost; so of the shortfall as long as a chain has one, then of the objective. So an evaluator may refute a trial as
soon as it is known not to be below that. A step is Gaussian, of any size, or a difference between two chains (ter Braak
2006).

Or a group learns from another one, of its own chain or of a second: it takes over some coordinates that mean the same
there, nearly. For groups of a good point are alike in part: of the best rigs known, most have two or three LiDARs that
are tilted equally, and with one LiDAR at a time no chain would get there by chance.

Max VSR is the greatest of many values. Near its minima several of them are nearly as great, and few steps lower them
all. So a run may ask for smoothed costs, in which all of these count. Now and then it asks for the costs of its chains
without smoothing, for these alone are minimised.

How far a run has come is counted by work, not by trials: a trial that is taken was evaluated in full, which takes ten
times as long as to refute one. Otherwise hot chains, which take every second trial, would have most of the time.

Chains that learn from each other all end in one basin. So there are several populations of them, and more than one
round. Long before its end it shows which population is in the best basin: only that one goes on.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.solvers.search import (
    NO_COST,
    Coordinates,
    Runs,
    Search,
    Trials,
    checked,
    cost_of,
    is_below,
    least,
    mean,
    order,
    unbounded,
)
from lidarcfg.solvers.solver import Solver

CHAINS = 16  # of a population
POPULATIONS = 3  # of a round
SELECTION_PROGRESS = 0.7  # the progress of a round from which on only its best population goes on
MAX_TRIALS = 8  # of a chain at a time; the first that it takes moves it
ACCEPT_WORK = 10  # the work of a trial that is taken, besides the 1 of any trial
T_START = 0.03  # at the beginning of a run
T_RESTART = 0.004  # of a run that goes on from a good point
T_END = 0.0005  # at the end
STEP_LEAST = 0.001  # standard deviations of Gaussian steps, in the unit cube
STEP_MOST = 0.3
JITTER = 1e-4  # of a difference, so that chains that stand in one place can part
STEP_COORDINATE = 0.6  # the probability of a coordinate of the group to take part in a step that moves only some
LEARNING = (0.6, 0.1)  # the probability of a step that takes over coordinates, at the beginning and at the end
OWN = 0.6  # the probability of taking them from its own chain
NEARLY = 0.3  # the standard deviation of what is taken over, in those of Gaussian steps
RENEWALS = 20  # how often in a run the worst chains go to the best
RENEWED = 2  # how many chains
FIRST_WORK = 1_000  # of the first round, per dimension and population
SECOND_WORK = 21_000  # of the second
LONGER = 1.5  # the work of every further round, by that of the one before
SMOOTHING = 1 / 32  # of the costs in all rounds but the first; refining is without
REFINING = 0.25  # the work of refining what a round found, by the round's


class AnnealingSolver(Solver):
    """Simulated annealing of many chains, whose trials are the cheapest; for LiDARs with much room."""

    method: Literal["annealing"]

    def begin(self, coordinates: Coordinates, starts: Array | None = None) -> Search:
        """Rounds of annealing."""
        return AnnealingRounds(coordinates, self.seed, starts)


class Annealing:
    """One run with about `work` for each population; `over` once that is done.

    Coordinates of a group move together. `starts` (s, dimensions): where chains begin, in turn and less hot; without
    them each one begins at a random point. With `smoothing`, costs are smoothed, but now and then, and at the end, it
    asks for those of its chains without. Of several populations the best goes on alone, once it shows which that is.
    """

    def __init__(
        self,
        coordinates: Coordinates,
        rng: np.random.Generator,
        work: float,
        starts: Array | None = None,
        smoothing: float = 0.0,
        populations: int = 1,
    ) -> None:
        self._rng = rng
        self._renewals = 0
        self._smoothing = smoothing
        self._tries = 1  # of each chain at a time
        self._done = 0.0  # work of a chain so far
        self._members = np.unique(coordinates.group)[:, None] == coordinates.group
        self._counterpart = _counterparts(coordinates.kind, self._members)
        self._x = rng.random((populations * CHAINS, len(coordinates)))
        if starts is not None:
            self._x[:] = starts[np.arange(len(self._x)) % len(starts)]
        self._cost = unbounded(len(self._x))
        self._hot = T_START if starts is None else T_RESTART
        self._work = work / CHAINS  # of each
        self.over = False
        self._asked = self._positions(smoothing)

    @property
    def sources(self) -> Array:
        """(chains, dimensions) where the chains are."""
        return self._x

    @property
    def mean_cost(self) -> float:
        """The mean cost of the chains."""
        return mean(self._cost)

    @property
    def progress(self) -> float:
        """The fraction of the work that is done."""
        return min(self._done / self._work, 1.0)

    @property
    def temperature(self) -> float:
        """How far uphill a chain goes on average, as a fraction of its cost."""
        return float(self._hot * maths.power(T_END / self._hot, self.progress))

    def ask(self) -> Trials:
        """Where the chains begin, then some trials for each of them."""
        return self._asked

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials, in order; (inf, inf) stands for any cost not below what was to beat."""
        trials = self._asked
        cost = checked(cost)
        if trials.smoothing != self._smoothing:
            self._go_on(cost)
            return
        taken = np.flatnonzero(is_below(cost, trials.upper_bound))
        chain, first = np.unique(trials.source[taken], return_index=True)
        self._x[chain] = trials.x[taken[first]]
        self._cost[chain] = cost[taken[first]]
        self._done += self._tries + ACCEPT_WORK * len(taken) / len(self._x)
        few = len(cost) // (2 * max(len(taken), 1))  # so that few are taken in vain
        self._tries = int(np.clip(few, 1, MAX_TRIALS))
        renews = self._done * RENEWALS >= (self._renewals + 1) * self._work
        if renews:
            self._renewals += 1
            self._renew()
        if renews and self._smoothing:
            self._asked = self._positions(0.0)
        else:
            self._go_on(self._cost)

    def _positions(self, smoothing: float) -> Trials:
        """Where the chains are, to be evaluated whatever they cost."""
        chains = len(self._x)
        return Trials("trial", self._x.copy(), np.arange(chains), unbounded(chains), smoothing)

    def _renew(self) -> None:
        """Move the worst chains of each population to where its best are."""
        for first in range(0, len(self._x), CHAINS):
            ranked = first + order(self._cost[first : first + CHAINS])
            worst = ranked[-RENEWED:]
            best = ranked[:RENEWED]
            self._x[worst] = self._x[best]
            self._cost[worst] = self._cost[best]

    def _go_on(self, cost: Array) -> None:
        """Draw the next trials; from SELECTION_PROGRESS on, of the population with the least cost (chains, 2) alone."""
        self.over = self._done >= self._work
        if self.progress >= SELECTION_PROGRESS and len(self._x) > CHAINS:
            first = least(cost) // CHAINS * CHAINS
            self._x = self._x[first : first + CHAINS]
            self._cost = self._cost[first : first + CHAINS]
        self._asked = self._draw()

    def _draw(self) -> Trials:
        rng = self._rng
        dimensions = self._x.shape[1]
        chain = np.repeat(np.arange(len(self._x)), self._tries)
        n = len(chain)
        groups = len(self._members)
        group = rng.integers(groups, size=n)
        moves = self._members[group]
        some = moves & (rng.random((n, dimensions)) < STEP_COORDINATE)
        some = np.where(some.any(axis=1, keepdims=True), some, moves)
        deviation = STEP_LEAST * maths.power(STEP_MOST / STEP_LEAST, rng.random((n, 1)))
        normal = rng.standard_normal((n, dimensions))
        first = chain // CHAINS * CHAINS  # of its population
        one, other = (first + (chain + rng.integers(1, CHAINS, size=n)) % CHAINS for _ in range(2))
        difference = rng.uniform(0.2, 1.0, (n, 1)) * (self._x[one] - self._x[other]) + JITTER * normal
        gaussian = rng.random((n, 1)) < 0.5
        x = self._x[chain] + np.where(gaussian, some * deviation * normal, moves * difference)
        teacher = (group + rng.integers(1, max(groups, 2), size=n)) % groups  # another group, if there is one
        source = np.where(rng.random(n) < OWN, chain, one)
        taken = self._x[source[:, None], self._counterpart[teacher]] + NEARLY * deviation * normal
        learns = rng.random((n, 1)) < LEARNING[0] + (LEARNING[1] - LEARNING[0]) * self.progress
        x = np.where(learns & moves, np.where(some, taken, self._x[chain]), x)
        x = 1.0 - np.abs(1.0 - np.abs(x))  # reflected by the walls
        cost = self._cost[chain]
        with np.errstate(over="ignore", invalid="ignore"):
            uphill = maths.exp(self.temperature * rng.exponential(size=n)) - 1
            upper_bound = cost + np.abs(cost) * uphill[:, None]
        upper_bound = np.where(np.isnan(upper_bound), np.inf, upper_bound)
        return Trials("trial", np.clip(x, 0.0, 1.0), chain, upper_bound, self._smoothing)


def _counterparts(kind: NDArray[np.int64], members: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(groups, dimensions): the coordinate that means the same in each group; without one, the coordinate itself."""
    alike = members[:, None, :] & (kind[:, None] == kind)
    out: NDArray[np.int64] = np.where(alike.any(axis=2), alike.argmax(axis=2), np.arange(len(kind)))
    return out


class AnnealingRounds(Runs):
    """Rounds of annealing: first a short one, for an early result, then longer and longer ones.

    The best end of a round so far is refined by another run. `starts` (s, dimensions), if given, are refined together
    before the first round.
    """

    def __init__(self, coordinates: Coordinates, seed: int, starts: Array | None = None) -> None:
        super().__init__(len(coordinates))
        self._rng = np.random.default_rng(seed)
        self._coordinates = coordinates
        self.rounds = 0  # begun
        self._end_x = self.best_x  # the best of the current round
        self._end = NO_COST  # its cost
        self._record = NO_COST  # the best end of a round before
        self._run = self._round() if starts is None else self._refining(starts)

    @property
    def _work(self) -> float:
        each = FIRST_WORK if self.rounds < 2 else SECOND_WORK * LONGER ** (self.rounds - 2)
        return each * len(self._coordinates)

    def _round(self) -> Annealing:
        self._refines = False
        self._end = NO_COST
        self.rounds += 1
        smoothing = SMOOTHING if self.rounds > 1 else 0.0
        return Annealing(self._coordinates, self._rng, self._work, None, smoothing, POPULATIONS)

    def _refining(self, starts: Array) -> Annealing:
        self._refines = True
        return Annealing(self._coordinates, self._rng, REFINING * self._work, starts)

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials."""
        trials = self.ask()
        best = least(checked(cost))
        if cost_of(cost[best]) < self._end and not trials.smoothing:
            self._end_x = trials.x[best].copy()
            self._end = cost_of(cost[best])
        super().tell(cost)

    def _follow(self) -> None:
        if self._end < self._record and not self._refines:
            self._record = self._end
            self._run = self._refining(self._end_x[None])
        else:
            self._run = self._round()
