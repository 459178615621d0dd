"""Places between those of a base grid: around the lowest counts, ever closer, and in narrow shadows of the bodies."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.returns.places import Stand
from lidarcfg.returns.reach import LOWEST, Measured, lowest_of

LOWEST_SHADOWED = 32  # of those in narrow shadows
ROUNDS_MAX = 200  # of walking to lower counts at the finest spacing

Measure = Callable[[Array, int], Measured]  # at places (P, 4), exact below a cap


@dataclass(frozen=True)
class Refined:
    """The measurements of a rig."""

    base: Measured
    every: Measured  # with the refined places
    finest_m: float
    finest_rad: float


class Refinement:
    """Looks for lower counts between the places of a base grid."""

    def __init__(self, stand: Stand, demanded: int, measure: Measure) -> None:
        self._stand = stand
        self._demanded = demanded
        self._measure = measure
        self._seen: set[tuple[int, ...]] = set()

    def rounds(self, base: Measured, shadowed: Callable[[], Array]) -> Iterator[Refined]:
        """The measurements round after round. What has more returns than the lowest so far is counted no further.

        `shadowed`: places (n, 4) in narrow shadows, for which it is asked late.
        """
        stand = self._stand
        begun = base
        if len(stand.edge):
            begun = base.joined(self._measure(stand.edge, self._enough(base)))
        yield Refined(base, begun, *stand.first_steps)
        every = begun
        for every, *steps in self._finer(begun, LOWEST):
            yield Refined(base, every, *steps)
        hidden = shadowed()
        if len(hidden):
            for finer, *steps in self._finer(self._measure(hidden, self._enough(every)), LOWEST_SHADOWED):
                yield Refined(base, every.joined(finer), *steps)

    def _enough(self, tried: Measured) -> int:
        """More returns than any of the lowest places has, and as many as are demanded."""
        return max(int(tried.values[lowest_of(tried.values)].max()) + 1, self._demanded)

    def _finer(self, tried: Measured, most: int) -> Iterator[tuple[Measured, float, float]]:
        """With places around the `most` lowest, ever closer, until nothing around is lower; and the spacings."""
        every = tried
        step_m, step_rad = self._stand.first_steps
        for step_m, step_rad in self._stand.refinements:
            every = self._with_neighbours(every, lowest_of(every.values, most), step_m, step_rad)
            yield every, step_m, step_rad
        for _ in range(ROUNDS_MAX):  # until all neighbours of the lowest are known
            least = np.flatnonzero(every.values == every.values.min())[:most]
            more = self._with_neighbours(every, least, step_m, step_rad)
            settled = len(more.places) == len(every.places)
            every = more
            yield every, step_m, step_rad
            if settled:
                break

    def _with_neighbours(self, tried: Measured, centres: NDArray[np.intp], step_m: float, step_rad: float) -> Measured:
        """With the neighbours, at these spacings, of some of the places, as far as they are new and in the zone.

        They are counted up to the greatest of these, and to what is demanded, as it matters which sensors' loss breaks
        that.
        """
        if not len(centres):
            return tried
        cap = max(int(tried.values[centres].max()) + 1, self._demanded)
        fresh = self._stand.around(tried.places[centres], step_m, step_rad, self._seen)
        return tried.joined(self._measure(fresh, cap)) if len(fresh) else tried
