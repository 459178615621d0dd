"""How a combination of sensors learns from others: their best rigs are starts for a local search.

A rig of another combination fits if a few sensors are exchanged, added or removed. Sensors of the same group and model
keep their poses, then those of the same group; a sensor that is new stands anywhere within its bounds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.combinations import Combination
from lidarcfg.placement.solvers.cma_es import CmaEs
from lidarcfg.placement.solvers.search import Trials

CHANGES_MAX = 2  # sensors exchanged, added and removed
DRAWS = 4  # of the pose of a sensor that is new
STARTS_MAX = 40
STEP, POPULATION = 0.08, 12  # of the local search


@dataclass(frozen=True)
class Example:
    """A rig of some combination, in its unit cube."""

    combination: Combination
    x: Array  # (free coordinates,)
    objective: float


@dataclass(frozen=True, eq=False)
class _Seat:
    """A sensor of a combination, or a mirrored pair, and its free coordinates."""

    group: int
    model: str | None
    columns: NDArray[np.int64]


def starts(combination: Combination, examples: Sequence[Example], rng: np.random.Generator) -> Array:
    """(n, free coordinates) points of a combination's unit cube, made from examples, those of the best one first."""
    seats, found = _seats(combination), []
    for example in sorted(examples, key=lambda example: example.objective):
        for _ in range(DRAWS):
            x, is_new = _fitted(seats, example, rng)
            if x is not None:
                found.append(x)
            if x is None or not is_new:
                break
    return np.array(found[:STARTS_MAX]).reshape(-1, combination.study.free.sum())


def _seats(combination: Combination) -> list[_Seat]:
    study = combination.study
    seats = []
    for i, slot in enumerate(study.slots):
        if np.isnan(study.mirror[i]):
            seats.append(_Seat(combination.groups[i], slot.model, np.flatnonzero(study.groups == i)))
    return seats


def _fitted(seats: Sequence[_Seat], example: Example, rng: np.random.Generator) -> tuple[Array | None, bool]:
    """The example's poses for these seats, and whether one was drawn; None if too many sensors differ."""
    left = _seats(example.combination)
    left = [left[i] for i in rng.permutation(len(left))]  # which of several is removed
    taken: dict[int, _Seat] = {}
    for same in (True, False):  # model and group, then group alone
        for i, seat in enumerate(seats):
            if i not in taken:
                fits = [one for one in left if one.group == seat.group and (one.model == seat.model or not same)]
                if fits:
                    taken[i] = fits[0]
                    left.remove(fits[0])
    exchanged = sum(one.model != seats[i].model for i, one in taken.items())
    new = len(seats) - len(taken)
    if exchanged + new + len(left) > CHANGES_MAX:
        return None, False
    x = rng.random(sum(len(seat.columns) for seat in seats))
    for i, one in taken.items():
        x[seats[i].columns] = example.x[one.columns]
    return x, new > 0


class Transfer:
    """A search that tries the starts, then runs CMA-ES around the best; `over` once that has converged."""

    def __init__(self, starts: Array, seed: int) -> None:
        self._starts, self._seed = starts, seed
        self._run: CmaEs | None = None
        self.cycles = 0
        self.over = False
        self.best_x, self.best_cost, self.mean_cost = starts[0], np.inf, np.inf

    @property
    def sources(self) -> Array:
        """The best so far; no trial is drawn around a source."""
        best: Array = self.best_x[None]
        return best

    def ask(self) -> Trials:
        """The starts, then a generation."""
        if self._run:
            return self._run.ask()
        n = len(self._starts)
        return Trials("trial", self._starts, np.zeros(n, np.int64), np.full(n, np.inf))

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the trials."""
        x, best = self.ask().x, int(np.argmin(cost))
        if cost[best] < self.best_cost:
            self.best_x, self.best_cost = x[best].copy(), float(cost[best])
        self.mean_cost = float(np.mean(cost))
        self.cycles += 1
        if self._run:
            self._run.tell(cost)
            self.over = self._run.over
        else:
            self._run = CmaEs(x.shape[1], self._seed, x[best], STEP, POPULATION)
