"""What every solver is: ask for trials, be told their costs. None of them knows anything about LiDARs."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import LidarcfgError
from lidarcfg.geometry import Array


@dataclass(frozen=True)
class Trials:
    """Points of the unit cube to evaluate."""

    phase: str  # "first" and "scout" do not count as evaluations; all others do
    x: Array  # (n, dimensions)
    source: NDArray[np.int64]  # (n,) the row of the search's `sources` that each was drawn around
    to_beat: Array  # (n,) a cost at or above this may be told as inf; inf where every cost matters


class Search(Protocol):
    """A solver at work: minimises over the unit cube, one batch an ask."""

    cycles: int  # that are over
    best_x: Array  # (dimensions,) the best ever
    best_cost: float

    @property
    def sources(self) -> Array:
        """(s, dimensions) what trials are drawn around, as it stands."""

    @property
    def mean_cost(self) -> float:
        """The mean cost of the population, as it stands."""

    def ask(self) -> Trials:
        """The trials that are due."""

    def tell(self, cost: Array) -> None:
        """The costs (n,) of what was asked, in its order. Raises LidarcfgError where one is not a number."""


def checked(cost: Array) -> Array:
    """Costs (n,), each a number or inf. Raises LidarcfgError: NaN is no result, and would pass for the least."""
    wrong = np.flatnonzero(~(cost > -np.inf))
    if len(wrong):
        raise LidarcfgError(
            f"the cost of trial {wrong[0]} of {len(cost)} is {cost[wrong[0]]}; allowed: numbers, and inf"
        )
    return cost
