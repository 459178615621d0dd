"""The objective of a study's trials, with failures and mounting errors where the study asks for them.

Each draw of mounting errors has bounded costs of its own, with its own certificates and links. A trial is refuted as
soon as more draws reach the cost to beat than may be worse than the quantile, because then the quantile reaches it,
too.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.robustness import mounted
from lidarcfg.returns.misses import SEARCH_PLACES
from lidarcfg.study.bounded_costs import BoundedCosts, Index
from lidarcfg.study.criterion import EVERY_CASE, Criterion
from lidarcfg.study.study import Study
from lidarcfg.study.terms.recent import Recent
from lidarcfg.vsr.cones import Lidar

LOOK_S = 0.05  # between two looks at the clock, where there is a deadline


class ObjectiveCosts:
    """The objective of a study's sensors at poses (n, slots, 6); a context that owns its threads. See BoundedCosts."""

    def __init__(
        self,
        study: Study,
        threads: int | None = None,
        skip: bool = True,
        on_evaluations: Callable[[int], None] | None = None,
        places: int | None = SEARCH_PLACES,
    ) -> None:
        """Misses are counted at so many `places` of each object; None: at fresh ones."""
        self._study = study
        self._threads = threads
        self._skip = skip
        self._robust = study.robust
        self._drawn = study.robust.drawn if study.robust else 0
        self._on_evaluations = on_evaluations
        self._refuting: Recent[int] = Recent()  # draws
        self._sources = self._off_sources = np.empty((0, len(study.slots), 6))
        self._ended = 0
        self._seconds = 0.0
        self._before: list[BoundedCosts] = []  # that counted misses at other places
        self.trials = 0  # evaluated, in full or until they were refuted
        self.count_at(places)

    def count_at(self, places: int | None) -> None:
        """Count misses at so many places of each object from now on; None: at fresh ones."""
        study = self._study
        lidars = [slot.lidar for slot in study.slots]
        robust = study.robust
        known = study.misses.known(places) if places and study.misses and study.objective.misses else None
        self.known = known
        if self.trials:
            self.__exit__(None, None, None)
            self._before += self._parts
        self._at_rest = self._off = None
        if robust is None or robust.lost:
            criterion = Criterion.of_study(study, robust.kept(len(lidars)) if robust else EVERY_CASE, known=known)
            self._at_rest = self._part(lidars, criterion)
        if robust and robust.drawn:
            self._errors = robust.errors(len(lidars))
            self._off = self._part(lidars, Criterion.of_study(study, known=known))

    def _part(self, lidars: Sequence[Lidar], criterion: Criterion) -> BoundedCosts:
        study = self._study
        one = BoundedCosts(study.region, lidars, self._threads, self._skip, criterion, visibility=study.visibility)
        one.on_evaluated = partial(self._evaluated, self._on_evaluations) if self._on_evaluations else None
        return one

    def __enter__(self) -> "ObjectiveCosts":
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        for one in self._parts:
            one.__exit__(kind, value, at)

    def _evaluated(self, on_evaluations: Callable[[int], None], count: int) -> None:
        self._ended += count
        on_evaluations(self._ended)

    @property
    def _parts(self) -> list[BoundedCosts]:
        return [one for one in (self._at_rest, self._off) if one]

    @property
    def slice(self) -> int:
        """How many trials are evaluated between two looks at the clock, where there is a deadline."""
        by_cuboids = min(max(one.slice // max(self._drawn * (one is self._off), 1), 1) for one in self._parts)
        cuts = self._study.objective.cuts(self._study.detection)
        if cuts or not self.trials:
            return by_cuboids if cuts else 1
        return min(by_cuboids, max(int(LOOK_S * self.trials / max(self._seconds, 1e-9)), 1))

    @property
    def full_evaluations(self) -> int:
        """The number of rigs evaluated in full: several per trial with failures or mounting errors."""
        return sum(one.full_evaluations for one in [*self._before, *self._parts])

    @property
    def cuboids(self) -> int:
        """The number of cuboids evaluated."""
        return sum(one.cuboids for one in [*self._before, *self._parts])

    @property
    def segments(self) -> int:
        """The number of segments cast from LiDARs to cuboids, at most."""
        return sum(one.segments for one in [*self._before, *self._parts])

    @property
    def smooths(self) -> bool:
        """Whether costs can be smoothed."""
        return self._at_rest is not None and self._at_rest.smooths and self._off is None

    def costs(
        self, poses: Array, source: Index, source_poses: Array, upper_bound: Array, smoothing: float = 0.0
    ) -> Array:
        """(n,) the costs, or inf where one is not below `upper_bound` (n,). See BoundedCosts.costs."""
        cost = np.full(len(poses), -np.inf)
        began = time.perf_counter()
        self.trials += len(poses)
        if self._at_rest:
            cost = self._at_rest.costs(poses, source, source_poses, upper_bound, smoothing if self.smooths else 0.0)
        if self._off:
            some = np.flatnonzero(cost < (upper_bound if self._skip else np.inf))
            off = self._quantiles(self._off, poses[some], source[some], source_poses, upper_bound[some])
            cost[some] = np.maximum(cost[some], off)
        self._seconds += time.perf_counter() - began
        return cost

    def _quantiles(
        self, bounded: BoundedCosts, poses: Array, source: Index, source_poses: Array, upper_bound: Array
    ) -> Array:
        """(n,) the quantiles of the draws' costs, or inf where one is not below `upper_bound`."""
        assert self._robust
        if self._sources.shape != source_poses.shape or (self._sources != source_poses).any():
            everywhere = [mounted(source_poses, error) for error in self._errors]
            self._sources = source_poses.copy()
            self._off_sources = np.concatenate(everywhere)
        first = len(source_poses) * np.arange(self._drawn)
        order = list(dict.fromkeys((*self._refuting.items, *range(self._drawn))))
        values = np.full((len(poses), self._drawn), np.nan)
        spare = self._robust.spare
        if not self._skip:
            upper_bound = np.full(len(poses), np.inf)
        for witnesses_alone in (True, False):
            for draw in order:
                worse = (values >= upper_bound[:, None]).sum(axis=1)
                open_ones = np.flatnonzero((worse <= spare) & np.isnan(values[:, draw]))
                if not len(open_ones):
                    continue
                off = mounted(poses[open_ones], self._errors[draw])
                asked = off, source[open_ones] + first[draw], self._off_sources, upper_bound[open_ones]
                if witnesses_alone:
                    values[open_ones[bounded.refuted(*asked)], draw] = np.inf
                else:
                    values[open_ones, draw] = bounded.costs(*asked)
                for _ in range(int((values[open_ones, draw] == np.inf).sum())):
                    self._refuting.add(draw)
        self._refuting.learn()
        settled = (values >= upper_bound[:, None]).sum(axis=1) > spare
        out = np.full(len(poses), np.inf)
        out[~settled] = np.sort(values[~settled], axis=1)[:, self._drawn - 1 - spare]
        return out


def rigs_of_trial(study: Study) -> int:
    """The number of rigs that a trial stands for, of which the worst counts."""
    return len(study.robust.kept(len(study.slots))) + study.robust.drawn if study.robust else 1


def segments_of_trial(study: Study) -> int:
    """The number of segments from the LiDARs of these rigs to cuboids, along which bodies may hide the cuboids."""
    if study.visibility is None or not study.visibility.blocks:
        return 0
    lidars = len(study.slots)
    if study.robust:
        lidars = int(study.robust.kept(lidars).sum()) + study.robust.drawn * lidars
    return lidars * int(study.region.included.sum())
