"""The costs of many trials at once: on threads, and without the work that cannot change the answer.

A trial is kept only if it beats the food source that it was drawn around. For max VSR the subspaces around a few
witness cuboids (the source's worst ones, and those that refuted earlier trials of it) are flooded first; one that is
no better than the source refutes the trial. Only the LiDARs that moved are computed anew. Other terms of an objective
have their own ways to prove that they are too large, see objective.py. None of this changes a cost that is kept: tests
run whole searches with and without it.
"""

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, level, up
from lidarcfg.inputs import check_memory
from lidarcfg.placement import evaluator_kernels as kernels
from lidarcfg.placement import rows
from lidarcfg.placement.bits import Words
from lidarcfg.placement.cones import FIRST, Lidar, cone_rows, placed
from lidarcfg.placement.criterion import Criterion
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.region import Region
from lidarcfg.placement.subspace import segment
from lidarcfg.placement.terms import Trial
from lidarcfg.placement.turns import Turns, share
from lidarcfg.placement.visibility import Visibility
from lidarcfg.placement.visibility_kernels import LIMITS

CACHE_BYTES = 256 * 2**20
LABEL_BYTES = 6  # of memory a cuboid, where its subspace's number is needed
SLICE, SLICE_CUBOIDS = 1000, 5e7  # trials between two looks at the clock, and the most cuboids in them
TOLD = 10_000  # trials that may take the place of a food source
FEW = 8  # LiDARs, of which a trial takes no longer than its cuboids; of more it takes as much longer
RESTS = 10  # batches without witnesses after one in which they refuted less than a quarter
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]


def max_vsr(region: Region, lidars: Sequence[Lidar], visibility: Visibility | None = None) -> float:
    """The paper's cost: the largest volume-to-surface ratio over all subspaces, in metres (eq. 10)."""
    return float(vsr_m(segment(region, lidars, visibility)).max())


def slice_of(cuboids: int, threads: int) -> int:
    """Trials of so many cuboids between two looks at the clock: one for each thread at least."""
    return min(SLICE, max(threads, int(SLICE_CUBOIDS / cuboids)))


class _Told(NamedTuple):
    """What is known of some trials: a food source may move to where one is."""

    source: Index  # (n,)
    poses: Array  # (n, lidars, 6)
    fresh: Index  # (n, WITNESSES) as Verdicts has them
    links: Words  # (n, 3, rows) of the LiDAR `moved`, or none
    clear: Words  # (n, rows) of it, or none
    moved: Index  # (n,) the one that moved; −1 where there are others, or its links are not here


class Evaluator:
    """Evaluates poses (n, lidars, 6) of LiDARs, whose own poses do not matter; a context that owns its threads.

    Without a criterion the cost is max VSR. Results depend neither on the number of threads, nor on `skip`, which
    turns the savings off, nor on cache_bytes: the links of the food sources are kept if they fit.
    """

    def __init__(
        self,
        region: Region,
        lidars: Sequence[Lidar],
        threads: int | None = None,
        skip: bool = True,
        criterion: Criterion | None = None,
        cache_bytes: int = CACHE_BYTES,
        visibility: Visibility | None = None,
    ) -> None:
        self._region, self._lidars, self._skip, self._criterion = region, lidars, skip, criterion
        self._visibility = visibility
        self._threads, self._cache_bytes = threads or os.cpu_count() or 1, cache_bytes
        self._pool = ThreadPoolExecutor(self._threads)
        self._square = cone_rows(lidars)[:, FIRST:]
        self._grid = rows.Grid.of(region, criterion.weight if criterion else None)
        lidar_count, beams = self._square.shape
        rows.check_room(self._grid, lidar_count, beams, self._threads)
        self._kept = criterion.kept if criterion and len(criterion.kept) else np.ones((1, len(lidars)), bool)
        if criterion and not criterion.is_max_vsr:
            what = f"numbering {region.included.size:,} cuboids on {self._threads} threads"
            needed = LABEL_BYTES * region.included.size * self._threads
            check_memory(what, needed, "use larger cuboids or fewer threads")
        self._witnesses = kernels.WITNESSES
        self._poses = np.empty((0, len(lidars), 6))  # of the food sources, for _witness
        self._linked = self._poses  # and for _links
        self._links = np.empty((0, len(lidars), *self._grid.links.shape), np.uint64)  # (sources, …), or none
        self._clear = np.empty((0, len(lidars), self._grid.included.size), np.uint64)  # (sources, …), or none
        self._witness = np.empty((0, self._witnesses), np.int64)  # (sources, …)
        self._told: deque[_Told] = deque()  # since food sources moved
        self._rest = 0  # see RESTS
        self.on_evaluated: Callable[[int], None] | None = None  # is called with how many more have ended
        self.full_evaluations = 0
        self.cuboids = 0  # evaluated
        self.segments = 0  # cast from LiDARs to cuboids, at most
        self._segments = len(lidars) * int(region.included.sum()) if visibility and visibility.blocks else 0

    def __enter__(self) -> "Evaluator":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    @property
    def slice(self) -> int:
        """How many trials are evaluated between two looks at the clock, where there is a deadline."""
        cuboids = self._region.included.size * len(self._kept)
        return slice_of(cuboids * max(len(self._lidars), FEW) // FEW, self._threads)

    @property
    def smooths(self) -> bool:
        """Whether costs can be smoothed."""
        return self._criterion is None or self._criterion.is_max_vsr

    def costs(self, poses: Array, source: Index, source_poses: Array, to_beat: Array, smoothing: float = 0.0) -> Array:
        """(n,) the costs, or inf where one is not below `to_beat` (n,).

        poses (n, lidars, 6); source (n,) says which of source_poses (sources, lidars, 6) a trial was drawn
        around, and matters for speed alone. With `smoothing` the cost is not max VSR, but the p-norm of the VSR of the
        worst subspaces, at most so many as there are witnesses, with p = 1 / smoothing; other costs stay as they are.
        """
        if not self._skip:
            to_beat = np.full(len(poses), np.inf)
        if self._criterion is None or self._criterion.is_max_vsr:
            cost, full = self._max_vsr(poses, source, source_poses, to_beat, smoothing=smoothing)
            self.full_evaluations += full
            return cost
        return self._weighted(self._criterion, poses, source, source_poses, to_beat)

    def refuted(self, poses: Array, source: Index, source_poses: Array, to_beat: Array) -> Flags:
        """(n,) whether a few witnesses, and nothing else, show that a cost is not below `to_beat`; as `costs`."""
        criterion = self._criterion
        if not self._skip or not len(poses) or (criterion and criterion.max_vsr is None):
            return np.zeros(len(poses), bool)
        if criterion:
            nothing = [0.0] * len(criterion.terms)
            limit = [criterion.limit(nothing, criterion.max_vsr or 0, value) for value in to_beat.tolist()]
            to_beat = np.array(limit)
        cost, _ = self._max_vsr(poses, source, source_poses, to_beat, in_full=False)
        out: Flags = cost == np.inf
        return out

    def _weighted(
        self, criterion: Criterion, poses: Array, source: Index, source_poses: Array, to_beat: Array
    ) -> Array:
        """The same for other terms: witnesses of max VSR first, then the subspaces of what they did not refute."""
        out = np.full(len(poses), np.nan)
        self._rest = max(self._rest - 1, 0)
        if criterion.max_vsr is not None and not self._rest:
            refuted = self.refuted(poses, source, source_poses, to_beat)
            out[refuted] = np.inf
            self._rest = RESTS if 4 * int(refuted.sum()) < len(poses) else 0
        trials = np.flatnonzero(np.isnan(out))

        def one(trial: int) -> tuple[float, Index, int]:
            rig = Trial(self._region, self._rig(poses[trial]), self._visibility)
            cost = criterion.of(rig, float(to_beat[trial]))
            cut = sum(case.is_cut for case in criterion.cases(rig))
            return cost, self._worst(criterion, rig), cut

        refuter, fresh = np.full(len(poses), -1, np.int64), np.full((len(poses), self._witnesses), -1, np.int64)
        for trial, (cost, worst, cut) in zip(trials.tolist(), self._pool.map(one, trials.tolist()), strict=True):
            out[trial], fresh[trial, : len(worst)] = cost, worst
            self._evaluated(1)
            self.cuboids += self._region.included.size * cut
            self.segments += self._segments * (cut > 0)
            if cost < np.inf:
                self.full_evaluations += len(self._kept)
            elif len(worst):
                refuter[trial] = worst[0]
        if len(self._witness):
            kernels.remember(self._witness, source, refuter)
        self._tell(out, _Told(source, poses, fresh, self._links[:0, 0], self._clear[:0, 0], np.full(len(poses), -1)))
        criterion.learn()
        return out

    def _worst(self, criterion: Criterion, trial: Trial) -> Index:
        """A witness in each of the worst subspaces of the cases that were cut into any."""
        values, witnesses = [np.empty(0)], [np.empty(0, np.int64)]
        for case, one in enumerate(criterion.cases(trial)):
            if one.is_cut:
                values.append(one.worth_m)
                i, j, k = np.unravel_index(one.first, self._region.shape)
                first = case * 64 * self._grid.included.size
                witnesses.append(first + rows.cuboid_number(self._grid, (i, j, k)))
        worst = np.argsort(-np.concatenate(values), kind="stable")[: self._witnesses]
        return np.concatenate(witnesses)[worst]

    def _max_vsr(
        self,
        poses: Array,
        source: Index,
        source_poses: Array,
        to_beat: Array,
        in_full: bool = True,
        smoothing: float = 0.0,
    ) -> tuple[Array, int]:
        """(n,) max VSR or inf, and how many were evaluated in full; NaN where that was needed, but not `in_full`."""
        moved, witness = np.ones(poses.shape[:2], bool), np.full((len(poses), self._witnesses), -1, np.int64)
        stays = np.zeros(poses.shape[:2], bool)
        if np.isfinite(to_beat).any():
            self._follow(source_poses)
            witness = self._witness[source]
            if len(self._links):
                differs = poses != source_poses[source]
                moved = differs.any(axis=2)
                stays = ~differs[..., :3].any(axis=2) & (len(self._clear) > 0)
                self._renew(np.unique(source[(~moved | stays).any(axis=1)]))
        batch = kernels.Batch(
            self._placed(poses),
            to_beat,
            moved,
            source,
            self._kept,
            witness,
            self._links,
            stays,
            self._clear,
            smoothing,
        )
        held = sum(len(one.links) for one in self._told)
        fits = len(self._links) > 0 and (held + len(poses)) * self._words <= self._cache_bytes
        alone = np.where((moved.sum(axis=1) == 1) & fits, moved.argmax(axis=1), -1)
        verdicts = kernels.Verdicts(
            np.full(len(poses), np.inf),
            np.full(len(poses), -1, np.int64),
            np.full_like(witness, -1),
            np.empty((fits * len(poses), *self._links.shape[2:]), np.uint64),
            np.empty((fits * len(poses) * (len(self._clear) > 0), *self._clear.shape[2:]), np.uint64),
        )

        def run(turns: Turns, most: int, scratch: kernels.Scratch) -> tuple[int, int, int]:
            found: tuple[int, int, int] = kernels.try_out(turns, most, batch, self._grid, in_full, scratch, verdicts)
            return found

        on_begun = self.on_evaluated if in_full else None
        done = share(self._pool, self._rooms, len(poses), self.slice, run, on_begun)
        evaluated, compared, cast = (sum(counts) for counts in zip((0, 0, 0), *done, strict=True))
        self.segments += cast
        nx, ny, nz = self._region.shape
        self.cuboids += evaluated * nx * ny * nz + compared * min(nx, 64)
        if len(self._witness):
            kernels.remember(self._witness, source, verdicts.refuter)
        self._tell(verdicts.cost, _Told(source, poses, *verdicts[2:], alone))
        return verdicts.cost, evaluated

    def _tell(self, cost: Array, told: _Told) -> None:
        """Remember those trials that were not refuted."""
        trials = np.flatnonzero(cost < np.inf)
        links, clear = (words[trials] if len(words) else words for words in (told.links, told.clear))
        source, poses, fresh, moved = told.source[trials], told.poses[trials], told.fresh[trials], told.moved[trials]
        self._told.append(_Told(source, poses, fresh, links, clear, moved))
        while sum(len(one.source) for one in self._told) > TOLD:
            self._told.popleft()

    def _evaluated(self, count: int) -> None:
        if self.on_evaluated:
            self.on_evaluated(count)

    def _rig(self, poses: Array) -> list[Lidar]:
        return [placed(one, row[:3], row[3:]) for row, one in zip(poses, self._lidars, strict=True)]

    def _placed(self, poses: Array) -> kernels.Placed:
        """The LiDARs at poses (n, lidars, 6)."""
        cones = np.empty((*poses.shape[:2], FIRST + self._square.shape[1]))
        cones[..., :3], cones[..., 3:FIRST], cones[..., FIRST:] = poses[..., :3], up(poses[..., 3:]), self._square
        if self._visibility is None:
            return kernels.Placed(cones, np.empty((len(poses), 0, LIMITS)), rows.EVERYTHING.obstacles)
        limits = self._visibility.limits(self._lidars, level(poses[..., 3:]))
        return kernels.Placed(cones, limits, self._visibility.obstacles)

    @property
    def _words(self) -> int:
        """The bytes of a LiDAR's links and what is clear of it."""
        return self._grid.links.nbytes + (self._grid.included.nbytes if self._visibility else 0)

    @cached_property
    def _rooms(self) -> list[kernels.Scratch]:
        """Working memory for each thread."""
        return [kernels.scratch_for(self._grid, self._kept, self._square.shape[1]) for _ in range(self._threads)]

    def _follow(self, source_poses: Array) -> None:
        """Bring the witnesses of the food sources up to date."""
        if len(self._poses) != len(source_poses):
            self._poses = np.full_like(source_poses, np.nan)
            self._linked = np.full_like(source_poses, np.nan)
            self._witness = np.full((len(source_poses), self._witnesses), -1, np.int64)
            fits = len(source_poses) * len(self._lidars) * self._words <= self._cache_bytes
            self._links = np.empty((len(source_poses) * fits, *self._links.shape[1:]), np.uint64)
            clear = len(self._links) if self._visibility else 0
            self._clear = np.empty((clear, *self._clear.shape[1:]), np.uint64)
        changed = (self._poses != source_poses).any(axis=(1, 2))
        self._witness[changed] = -1
        if not changed.any():
            return
        for told in self._told:
            new = np.flatnonzero(told.source < len(source_poses))
            row = told.source[new]
            new = new[changed[row] & (told.poses[new] == source_poses[row]).all(axis=(1, 2))]
            self._witness[told.source[new]] = told.fresh[new]
            self._take_over(told, new[told.moved[new] >= 0])
        self._told.clear()
        self._poses = source_poses.copy()

    def _take_over(self, told: _Told, trials: Index) -> None:
        """Take the links of the LiDAR that moved from trials that some food sources have moved to."""
        differs = (self._linked[told.source[trials]] != told.poses[trials]).any(axis=2)
        trials = trials[differs[np.arange(len(trials)), told.moved[trials]] & (differs.sum(axis=1) == 1)]
        row, lidar = told.source[trials], told.moved[trials]
        self._links[row, lidar] = told.links[trials]
        if len(self._clear):
            self._clear[row, lidar] = told.clear[trials]
        self._linked[row] = told.poses[trials]

    def _renew(self, sources: Index) -> None:
        """Bring the links of some other food sources up to date."""
        stale = sources[(self._linked[sources] != self._poses[sources]).any(axis=(1, 2))]
        poses, linked = self._poses[stale], self._linked[stale]
        changed, stays = (linked != poses).any(axis=2), (linked[..., :3] == poses[..., :3]).all(axis=2)
        known = kernels.Sources(stale, self._placed(poses), changed, stays, self._links, self._clear)

        def run(turns: Turns, most: int, scratch: kernels.Scratch) -> None:
            kernels.renew(turns, most, known, self._grid, scratch)

        share(self._pool, self._rooms, len(stale), self.slice, run)
        self._linked[stale] = poses
