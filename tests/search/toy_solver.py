"""A solver that the package does not have: it tries evenly spaced points of the diagonal."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from lidarcfg.geometry import Array
from lidarcfg.solvers.search import Best, Coordinates, Search, Trials, mean, unbounded
from lidarcfg.solvers.solver import Solver


class RulerSolver(Solver):
    """Evenly spaced values, of all coordinates at the same time; for a single one."""

    default_budget: ClassVar[Mapping[str, int]] = {"cycles": 1}
    method: Literal["ruler"]
    values: Annotated[int, Field(ge=2, description="how many, from bound to bound")] = 5

    def begin(self, coordinates: Coordinates, starts: Array | None = None) -> Search:
        return Ruler(len(coordinates), self.values)


class Ruler(Best):
    """All values in every cycle."""

    def __init__(self, dimensions: int, values: int) -> None:
        self._x = np.repeat(np.linspace(0, 1, values)[:, None], dimensions, axis=1)
        self.best_x = self._x[0]
        self.cycles = 0
        self.mean_cost = np.inf

    @property
    def sources(self) -> Array:
        return self.best_x[None]

    def ask(self) -> Trials:
        count = len(self._x)
        return Trials("trial", self._x, np.zeros(count, np.int64), unbounded(count))

    def tell(self, cost: Array) -> None:
        self.keep_best(self._x, cost)
        self.mean_cost = mean(cost)
        self.cycles += 1
