"""Artificial Bee Colony (Karaboga 2007; paper, section II-D and algorithm 2), as ask and tell.

It minimises over the unit cube. Each ask is one phase: employed bees, onlookers, scouts. All trials of a phase are
drawn from the sources as they were at its start; their costs are applied in order.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidarcfg.geometry import Array
from lidarcfg.solvers.search import (
    NO_COST,
    Coordinates,
    Search,
    Trials,
    checked,
    cost_of,
    mean,
    numbers,
    unbounded,
)
from lidarcfg.solvers.solver import Solver


class BeeColonySolver(Solver):
    """The paper's Artificial Bee Colony; to compare with the paper."""

    default_budget: ClassVar[Mapping[str, int]] = {"cycles": 800}  # the paper's
    is_upright_central: ClassVar[bool] = False  # the coordinates are the paper's
    method: Literal["abc"]
    bees: Annotated[
        int, Field(ge=2, le=1_000_000, description="food sources, with as many onlookers in each cycle")
    ] = 200
    limit: Annotated[
        Annotated[int, Field(ge=1)] | None,
        Field(description="failures after which a scout replaces a source; by default `bees` × free coordinates"),
    ] = None

    def begin(self, coordinates: Coordinates, starts: Array | None = None) -> Search:
        """A swarm at random sources, whatever the `starts`."""
        dimensions = len(coordinates)
        return BeeColony(dimensions, self.bees, self.limit or self.bees * dimensions, self.seed)


class BeeColony:
    """A swarm of `bees` food sources, as many onlookers, and scouts for exhausted sources.

    A source that has failed `limit` times by the end of a cycle is exhausted; every exhausted source is replaced.
    Its counter is reset when it improves or is replaced; the best point ever is stored separately.
    """

    def __init__(self, dimensions: int, bees: int, limit: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._limit = limit
        self.x = self._rng.random((bees, dimensions))
        self.cost = unbounded(bees)
        self.failures = np.zeros(bees, np.int64)
        self.best_x = self.x[0]
        self.best_cost = NO_COST
        self.cycles = 0
        self._asked = Trials("first", self.x, np.arange(bees), self.cost.copy())

    @property
    def sources(self) -> Array:
        """(bees, dimensions) the food sources."""
        return self.x

    @property
    def mean_cost(self) -> float:
        """The mean cost of the sources."""
        return mean(self.cost)

    def ask(self) -> Trials:
        """The trials of the current phase."""
        return self._asked

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials, in order."""
        trials = self._asked
        for x, source, row in zip(trials.x, trials.source, checked(cost), strict=True):
            value = cost_of(row)
            if trials.phase in ("first", "scout") or value < cost_of(self.cost[source]):
                self.x[source] = x
                self.cost[source] = value
                self.failures[source] = 0
            else:
                self.failures[source] += 1
            if value < self.best_cost:
                self.best_x = x.copy()
                self.best_cost = value
        self._asked = self._next(trials.phase)

    def _next(self, phase: str) -> Trials:
        everyone = np.arange(len(self.cost))
        if phase == "employed":
            return self._move("onlooker", self.choose(len(everyone)))
        exhausted = np.flatnonzero(self.failures >= self._limit)
        if phase == "onlooker" and len(exhausted):
            fresh = self._rng.random((len(exhausted), self.x.shape[1]))
            return Trials("scout", fresh, exhausted, unbounded(len(exhausted)))
        self.cycles += phase != "first"
        return self._move("employed", everyone)

    def choose(self, count: int) -> NDArray[np.int64]:
        """Roulette: `count` sources by P_i = fit_i / Σ fit (paper, eq. 11), with fit = 1 / (1 + cost).

        The cost is the shortfall of a source that has one, else its objective.
        """
        fit = 1.0 / (1.0 + numbers(self.cost))
        wheel = np.cumsum(fit)
        spin = self._rng.random(count) * wheel[-1]
        chosen: NDArray[np.int64] = np.minimum(np.searchsorted(wheel, spin, "right"), len(fit) - 1)
        return chosen

    def _move(self, phase: str, source: NDArray[np.int64]) -> Trials:
        """v_ij = x_ij + φ (x_ij − x_kj) for one j each, k ≠ i, φ in [−1, 1] (paper, eq. 12), clipped."""
        bees, dimensions = self.x.shape
        other = self._rng.integers(bees - 1, size=len(source))
        other += other >= source
        along = self._rng.integers(dimensions, size=len(source))
        phi = self._rng.uniform(-1.0, 1.0, len(source))
        x = self.x[source].copy()
        row = np.arange(len(source))
        x[row, along] += phi * (x[row, along] - self.x[other, along])
        return Trials(phase, np.clip(x, 0.0, 1.0), source, self.cost[source])
