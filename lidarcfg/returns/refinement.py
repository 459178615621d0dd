"""Places between those of a base grid: around the lowest counts, ever closer, and in narrow shadows of the bodies."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.places import Stand
from lidarcfg.returns.reach import LOWEST, Measured, Reach, lowest_of
from lidarcfg.returns.silhouettes import Core, Silhouettes, centres_of
from lidarcfg.sensors.rig import Mount

LOWEST_SHADOWED = 32  # of those in narrow shadows
ROUNDS_MAX = 200  # of walking to lower counts at the finest spacing
WORK = 4  # of a refined place, by that of one of the base grid: they lie where it takes long to count


@dataclass(frozen=True)
class Refined:
    """The measurements of a rig."""

    base: Measured
    every: Measured  # with the refined places
    finest_m: float
    finest_rad: float


class Refinement:
    """Looks for lower counts of rigs between the places of a base grid."""

    def __init__(self, reach: Reach, stand: Stand, demanded: int, in_shadows: bool) -> None:
        self._reach = reach
        self._stand = stand
        self._demanded = demanded
        self._silhouettes = Silhouettes(reach.obstacles) if in_shadows else None

    @property
    def work(self) -> int:
        """The number of the base grid's places that take as long, about."""
        steps = list(self._stand.refinements)
        around = sum(9 * (3 if step_rad else 1) for _, step_rad in steps + 2 * steps[-1:])
        return WORK * (around * min(LOWEST, len(self._reach.places)) // 2)  # neighbours are shared

    def rounds(self, mounts: Sequence[Mount], base: Measured, on_places: OnPlaces = no_progress) -> Iterator[Refined]:
        """The measurements round after round. What has more returns than the lowest so far is counted no further."""
        stand = self._stand
        of_rig = _OfRig(self._reach, stand, self._demanded, mounts, on_places)
        begun = base
        if len(stand.edge):
            begun = base.joined(of_rig.measured(stand.edge, of_rig.enough(base)))
        yield Refined(base, begun, *stand.first_steps)
        every = begun
        for every, *steps in of_rig.finer(begun, LOWEST):
            yield Refined(base, every, *steps)
        hidden = self.shadowed(mounts)
        if len(hidden):
            for finer, *steps in of_rig.finer(of_rig.measured(hidden, of_rig.enough(every)), LOWEST_SHADOWED):
                yield Refined(base, every.joined(finer), *steps)

    def shadowed(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places in narrow shadows of the bodies, if these are looked at."""
        stand = self._stand
        if self._silhouettes is None:
            return np.empty((0, 4))
        core = Core.of(stand.width_m, self._reach.height_m, stand.ground_m)
        return stand.standing(self._silhouettes.places(centres_of(mounts), core, stand.area, stand.far_step_m))


class _OfRig:
    """The refined places of a rig."""

    def __init__(self, reach: Reach, stand: Stand, demanded: int, mounts: Sequence[Mount], on_places: OnPlaces) -> None:
        self._reach = reach
        self._stand = stand
        self._demanded = demanded
        self._mounts = mounts
        self._on_places = on_places
        self._seen: set[tuple[int, ...]] = set()

    def measured(self, places: Array, cap: int) -> Measured:
        """What the rig reaches at places (P, 4), exact below the cap."""
        return self._reach.measured_at(places, self._mounts, cap, lambda count: self._on_places(WORK * count))

    def enough(self, tried: Measured) -> int:
        """More returns than any of the lowest places has, and as many as are demanded."""
        return max(int(tried.values[lowest_of(tried.values)].max()) + 1, self._demanded)

    def finer(self, tried: Measured, most: int) -> Iterator[tuple[Measured, float, float]]:
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
        return tried.joined(self.measured(fresh, cap)) if len(fresh) else tried
