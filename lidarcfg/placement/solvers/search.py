"""The protocol of every solver: it asks for trials and is told their costs. None of them knows about LiDARs."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import LidarcfgError
from lidarcfg.geometry import Array


@dataclass(frozen=True)
class Coordinates:
    """The dimensions of a search."""

    group: NDArray[np.int64]  # (dimensions,) those of equal numbers belong together
    kind: NDArray[np.int64]  # (dimensions,) those of equal numbers mean the same, each in its group

    def __len__(self) -> int:
        return len(self.group)


@dataclass(frozen=True)
class Trials:
    """Points of the unit cube to evaluate."""

    phase: str  # "first" and "scout" do not count as evaluations; all others do
    x: Array  # (n, dimensions)
    source: NDArray[np.int64]  # (n,) the row of the search's `sources` that each was drawn around
    upper_bound: Array  # (n,) a cost at or above this may be reported as inf; inf where every cost matters
    smoothing: float = 0.0  # of the costs that are wanted, if they can be smoothed, see Evaluator.costs; 0: none


class Sampler(Protocol):
    """Draws trials, and learns from their costs."""

    @property
    def sources(self) -> Array:
        """(s, dimensions) the points that trials are drawn around."""

    @property
    def mean_cost(self) -> float:
        """The mean cost of the population."""

    def ask(self) -> Trials:
        """The next trials; the same ones until their costs are told."""

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials asked for, in order. Raises LidarcfgError where one is not a number."""


class Search(Sampler, Protocol):
    """A running search: minimises over the unit cube, one batch of trials at a time."""

    cycles: int  # completed
    best_x: Array  # (dimensions,) the best point so far
    best_cost: float


def checked(cost: Array) -> Array:
    """The costs (n,), each a number or inf. Raises LidarcfgError on NaN, which would compare as the least."""
    wrong = np.flatnonzero(~(cost > -np.inf))
    if len(wrong):
        raise LidarcfgError(
            f"the cost of trial {wrong[0]} of {len(cost)} is {cost[wrong[0]]}; allowed: numbers, and inf"
        )
    return cost


class Best:
    """The best point so far, for searches to derive from."""

    best_x: Array  # (dimensions,)
    best_cost: float = np.inf

    def keep_best(self, x: Array, cost: Array) -> Array:
        """Keep the best of trials (n, dimensions), if it beats the best so far; the best of these (dimensions,)."""
        best = int(np.argmin(checked(cost)))
        if cost[best] < self.best_cost:
            self.best_x = x[best].copy()
            self.best_cost = float(cost[best])
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
        """The costs (n,) of the trials."""
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
        self.best_cost = np.inf
        self.sources = np.empty((1, 0))
        self.mean_cost = np.inf

    def ask(self) -> Trials:
        """The only trial."""
        return Trials("trial", self.sources, np.zeros(1, np.int64), np.full(1, np.inf))

    def tell(self, cost: Array) -> None:
        """Its cost (1,)."""
        self.cycles += 1
        self.best_cost = self.mean_cost = float(cost[0])
