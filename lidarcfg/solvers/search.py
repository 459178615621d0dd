"""The protocol of a search in progress: it asks for trials and is told their costs, and knows nothing about LiDARs.

A cost is a pair, a shortfall and an objective, and is compared as a pair: whatever falls short of what is demanded
costs more than all that does not. Its objective does not count, and is inf.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import LidarcfgError
from lidarcfg.geometry import Array


class Cost(NamedTuple):
    """What a point costs; compared as a pair."""

    shortfall: float
    objective: float  # inf where the shortfall is not 0

    @property
    def number(self) -> float:
        """The shortfall, or the objective of what does not fall short."""
        return self.shortfall if self.shortfall > 0 else self.objective


NO_COST = Cost(math.inf, math.inf)  # of nothing yet, or of a trial that is given up


def of_objectives(objective: Array) -> Array:
    """(n, 2) the costs of trials without a shortfall, by their objectives (n,); inf: a trial is given up."""
    return np.stack([np.where(objective < np.inf, 0.0, np.inf), objective], axis=1)


def unbounded(count: int) -> Array:
    """(count, 2) upper bounds of trials of which every cost matters."""
    return np.full((count, 2), np.inf)


def is_below(cost: Array, bound: Array) -> NDArray[np.bool_]:
    """(n,) whether costs (n, 2) are below others (n, 2)."""
    less = cost < bound
    return np.asarray(less[:, 0] | ((cost[:, 0] == bound[:, 0]) & less[:, 1]))


def order(cost: Array) -> NDArray[np.int64]:
    """(n,) the numbers of costs (n, 2), the least first; equal ones in their order."""
    return np.lexsort((cost[:, 1], cost[:, 0]))


def least(cost: Array) -> int:
    """The number of the least of costs (n, 2), the first of equal ones."""
    return int(order(cost)[0])


def numbers(cost: Array) -> Array:
    """(n,) the shortfalls of costs (n, 2), or the objectives of those that do not fall short."""
    return np.where(cost[:, 0] > 0, cost[:, 0], cost[:, 1])


def mean(cost: Array) -> float:
    """The mean of the `numbers` of costs (n, 2)."""
    return float(numbers(cost).mean())


@dataclass(frozen=True)
class Coordinates:
    """The dimensions of a search."""

    group: NDArray[np.int64]  # (dimensions,) those of equal numbers belong together
    kind: NDArray[np.int64]  # (dimensions,) those of equal numbers mean the same, each in its group
    one_group_is_cheap: bool = False  # whether a trial that moves only one group costs far less work than others

    def __len__(self) -> int:
        return len(self.group)


@dataclass(frozen=True)
class Trials:
    """Points of the unit cube to evaluate."""

    phase: str  # "first" and "scout" do not count as evaluations; all others do
    x: Array  # (n, dimensions)
    source: NDArray[np.int64]  # (n,) the row of the search's `sources` that each was drawn around
    upper_bound: Array  # (n, 2) a cost that is not below this may be reported as (inf, inf)
    smoothing: float = 0.0  # of the costs that are wanted, if they can be smoothed, see BoundedCosts.costs; 0: none


class Sampler(Protocol):
    """Draws trials, and learns from their costs."""

    @property
    def sources(self) -> Array:
        """(s, dimensions) the points that trials are drawn around."""

    @property
    def mean_cost(self) -> float:
        """The mean cost of the population; see `mean`."""

    def ask(self) -> Trials:
        """The next trials; the same ones until their costs are told."""

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials asked for, in order. Raises LidarcfgError where one is not a number."""


class Search(Sampler, Protocol):
    """A running search: minimises over the unit cube, one batch of trials at a time."""

    cycles: int  # completed
    best_x: Array  # (dimensions,) the best point so far
    best_cost: Cost


def checked(cost: Array) -> Array:
    """The costs (n, 2), of numbers or inf. Raises LidarcfgError on NaN, which would compare as the least."""
    wrong = np.argwhere(~(cost > -np.inf))
    if len(wrong):
        trial, part = wrong[0].tolist()
        value = float(cost[trial, part])
        raise LidarcfgError(f"the cost of trial {trial} of {len(cost)} is {value}; allowed: numbers, and inf")
    return cost


def cost_of(row: Array) -> Cost:
    """A row (2,) of costs as a pair."""
    shortfall, objective = row.tolist()
    return Cost(shortfall, objective)


class Best:
    """The best point so far, for searches to derive from."""

    best_x: Array  # (dimensions,)
    best_cost = NO_COST

    def keep_best(self, x: Array, cost: Array) -> Array:
        """Keep the best of trials (n, dimensions), if it beats the best so far; the best of these (dimensions,)."""
        best = least(checked(cost))
        if cost_of(cost[best]) < self.best_cost:
            self.best_x = x[best].copy()
            self.best_cost = cost_of(cost[best])
        return np.asarray(x[best])


class SolverRun(Sampler, Protocol):
    """A part of a search, which ends."""

    @property
    def over(self) -> bool:
        """Whether it has ended."""


class Runs(Best):
    """A search by runs of another, one after the other. `_run` is the current one; `_follow` begins the next."""

    _run: SolverRun

    def __init__(self, dimensions: int) -> None:
        self.cycles = 0
        self.best_x = np.full(dimensions, 0.5)

    def _follow(self) -> None:
        raise NotImplementedError  # each search by runs begins them in its own way

    @property
    def sources(self) -> Array:
        """(s, dimensions) the points of the current run."""
        return self._run.sources

    @property
    def mean_cost(self) -> float:
        """The mean cost of the current population."""
        return self._run.mean_cost

    def ask(self) -> Trials:
        """The next trials of the current run."""
        return self._run.ask()

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials."""
        self.keep_best(self.ask().x, cost)
        self.cycles += 1
        self._run.tell(cost)
        if self._run.over:
            self._follow()


class FixedPoint:
    """A search without dimensions, as where nothing is free to move: one trial, again and again."""

    def __init__(self) -> None:
        self.cycles = 0
        self.best_x = np.empty(0)
        self.best_cost = NO_COST
        self.sources = np.empty((1, 0))
        self.mean_cost = np.inf

    def ask(self) -> Trials:
        """The only trial."""
        return Trials("trial", self.sources, np.zeros(1, np.int64), unbounded(1))

    def tell(self, cost: Array) -> None:
        """Its cost (1, 2)."""
        self.cycles += 1
        self.best_cost = cost_of(cost[0])
        self.mean_cost = self.best_cost.number
