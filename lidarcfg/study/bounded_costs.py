"""The costs of many trials by one criterion: on threads, and without work that cannot change the answer.

A trial is kept only if it beats the food source that it was drawn around. For max VSR the subspaces of a few cuboids
are flooded first, its certificates: those in the source's worst subspaces, and those that refuted earlier trials of
it. One that is no better than the source refutes the trial, as in branch and bound. Only the LiDARs that moved are
computed anew. Other terms of an objective have their own ways to prove that they are too large, see criterion.py. None
of this changes a cost that is kept: tests run whole searches with and without it.
"""

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import vsr as core
from lidarcfg.futures import Counter, parallel_for
from lidarcfg.geometry import Array, Flags, level, up
from lidarcfg.inputs import check_memory
from lidarcfg.study.criterion import Criterion
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.cones import FIRST, Lidar, cone_rows
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Words, check_grid, cuboid_number, grid_of
from lidarcfg.vsr.visibility import LIMITS, UNLIMITED_SIGHT, Visibility

CACHE_BYTES = 256 * 2**20
LABEL_BYTES = 6  # of memory a cuboid, where its subspace's number is needed
SLICE = 1000  # trials between two looks at the clock
SLICE_CUBOIDS = 5e7  # in them, at most
REMEMBERED = 10_000  # trials that may take the place of a food source
CERTIFICATES = 12  # of a food source, see core/vsr/evaluator.h
FEW = 8  # LiDARs; a trial of at most this many takes as long as its cuboids, one of more proportionally longer
PAUSE = 10  # batches without certificates after one in which they refuted less than a quarter
Index = NDArray[np.int64]


def slice_of(cuboids: int, threads: int) -> int:
    """Trials of `cuboids` cuboids between two looks at the clock: one for each thread at least."""
    return min(SLICE, max(threads, int(SLICE_CUBOIDS / cuboids)))


class _Remembered(NamedTuple):
    """What is known of some trials; a food source may move to one of them."""

    source: Index  # (n,)
    poses: Array  # (n, lidars, 6)
    certificates: Index  # (n, CERTIFICATES)
    links: Words  # (n, rows, 3) of the LiDAR `moved`, or none
    clear: Words  # (n, rows) of it, or none
    moved: Index  # (n,) the one that moved; −1 where there are others, or its links are not here


class BoundedCosts:
    """The costs of LiDARs at poses (n, lidars, 6), whose own poses do not matter; a context that owns its threads.

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
        self._region = region
        self._lidars = lidars
        self._skip = skip
        self._criterion = criterion
        self._visibility = visibility
        self._threads = threads or os.cpu_count() or 1
        self._cache_bytes = cache_bytes
        self._pool = ThreadPoolExecutor(self._threads)
        self._square = cone_rows(lidars)[:, FIRST:]
        self._grid = grid_of(region, criterion.weight if criterion else None)
        lidar_count, beams = self._square.shape
        check_grid(self._grid, lidar_count, beams, self._threads)
        self._cases = criterion.kept if criterion and len(criterion.kept) else np.ones((1, len(lidars)), bool)
        if criterion and not criterion.is_max_vsr:
            what = f"numbering {region.included.size:,} cuboids on {self._threads} threads"
            needed = LABEL_BYTES * region.included.size * self._threads
            check_memory(what, needed, "use larger cuboids or fewer threads")
        rows = self._grid.rows
        self._poses = np.empty((0, len(lidars), 6))  # of the food sources, for _certificates
        self._linked_poses = self._poses  # and for _links
        self._links = np.empty((0, len(lidars), rows, 3), np.uint64)  # (sources, …), or none
        self._clear = np.empty((0, len(lidars), rows), np.uint64)  # (sources, …), or none
        self._certificates = np.empty((0, CERTIFICATES), np.int64)  # (sources, …)
        self._remembered: deque[_Remembered] = deque()  # since food sources moved
        self._pause = 0  # see PAUSE
        self.on_evaluated: Callable[[int], None] | None = None  # is called with how many more have ended
        self.full_evaluations = 0
        self.cuboids = 0  # evaluated
        self.segments = 0  # cast from LiDARs to cuboids, at most
        self._segments = len(lidars) * int(region.included.sum()) if visibility and visibility.blocks else 0

    def __enter__(self) -> "BoundedCosts":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    @property
    def slice(self) -> int:
        """How many trials are evaluated between two looks at the clock, where there is a deadline."""
        cuboids = self._region.included.size * len(self._cases)
        return slice_of(cuboids * max(len(self._lidars), FEW) // FEW, self._threads)

    @property
    def smooths(self) -> bool:
        """Whether costs can be smoothed."""
        return self._criterion is None or self._criterion.is_max_vsr

    def costs(
        self, poses: Array, source: Index, source_poses: Array, upper_bound: Array, smoothing: float = 0.0
    ) -> Array:
        """(n,) the costs, or inf where one is not below `upper_bound` (n,).

        poses (n, lidars, 6); source (n,) says which of source_poses (sources, lidars, 6) a trial was drawn
        around, and matters for speed alone. With `smoothing` the cost is not max VSR, but the p-norm of the VSR of the
        worst subspaces, of at most CERTIFICATES, with p = 1 / smoothing; other costs stay as they are.
        """
        if not self._skip:
            upper_bound = np.full(len(poses), np.inf)
        if self._criterion is None or self._criterion.is_max_vsr:
            cost, full = self._max_vsr(poses, source, source_poses, upper_bound, smoothing=smoothing)
            self.full_evaluations += full
            return cost
        return self._weighted(self._criterion, poses, source, source_poses, upper_bound)

    def refuted(self, poses: Array, source: Index, source_poses: Array, upper_bound: Array) -> Flags:
        """(n,) whether a few certificates alone show that a cost is not below `upper_bound`; as `costs`."""
        criterion = self._criterion
        if not self._skip or not len(poses) or (criterion and criterion.max_vsr is None):
            return np.zeros(len(poses), bool)
        if criterion:
            nothing = [0.0] * len(criterion.terms)
            limit = [criterion.limit(nothing, criterion.max_vsr or 0, value) for value in upper_bound.tolist()]
            upper_bound = np.array(limit)
        cost, _ = self._max_vsr(poses, source, source_poses, upper_bound, in_full=False)
        out: Flags = cost == np.inf
        return out

    def _weighted(
        self, criterion: Criterion, poses: Array, source: Index, source_poses: Array, upper_bound: Array
    ) -> Array:
        """(n,) the costs by several terms: certificates of max VSR first, then the trials that they did not refute."""
        out = np.full(len(poses), np.nan)
        self._pause = max(self._pause - 1, 0)
        if criterion.max_vsr is not None and not self._pause:
            refuted = self.refuted(poses, source, source_poses, upper_bound)
            out[refuted] = np.inf
            self._pause = PAUSE if 4 * int(refuted.sum()) < len(poses) else 0
        trials = np.flatnonzero(np.isnan(out))

        def one(trial: int) -> tuple[float, Index, int]:
            rig = Trial(self._region, self._lidars, self._visibility, poses[trial])
            cost = criterion.of(rig, float(upper_bound[trial]))
            cut = sum(case.is_cut for case in criterion.cases(rig))
            return cost, self._worst(criterion, rig), cut

        refuted_by = np.full(len(poses), -1, np.int64)
        certificates = np.full((len(poses), CERTIFICATES), -1, np.int64)
        for trial, (cost, worst, cut) in zip(trials.tolist(), self._pool.map(one, trials.tolist()), strict=True):
            out[trial] = cost
            certificates[trial, : len(worst)] = worst
            self._evaluated(1)
            self.cuboids += self._region.included.size * cut
            self.segments += self._segments * (cut > 0)
            if cost < np.inf:
                self.full_evaluations += len(self._cases)
            elif len(worst):
                refuted_by[trial] = worst[0]
        if len(self._certificates):
            core.promote_certificates(self._certificates, source, refuted_by)
        alone = np.full(len(poses), -1)
        found = _Remembered(source, poses, certificates, self._links[:0, 0], self._clear[:0, 0], alone)
        self._remember(out, found)
        criterion.learn()
        return out

    def _worst(self, criterion: Criterion, trial: Trial) -> Index:
        """A certificate in each of the worst subspaces of the cases that were cut into any."""
        values = [np.empty(0)]
        certificates = [np.empty(0, np.int64)]
        for case, one in enumerate(criterion.cases(trial)):
            if one.is_cut:
                values.append(one.weighted_vsr_m)
                i, j, k = np.unravel_index(one.first, self._region.shape)
                first = case * 64 * self._grid.rows
                certificates.append(first + cuboid_number(self._grid, (i, j, k)))
        worst = np.argsort(-np.concatenate(values), kind="stable")[:CERTIFICATES]
        return np.concatenate(certificates)[worst]

    def _max_vsr(
        self,
        poses: Array,
        source: Index,
        source_poses: Array,
        upper_bound: Array,
        in_full: bool = True,
        smoothing: float = 0.0,
    ) -> tuple[Array, int]:
        """(n,) max VSR or inf, and how many were evaluated in full; NaN where that was needed, but not `in_full`."""
        count = len(poses)
        moved = np.ones(poses.shape[:2], bool)
        same_position = np.zeros(poses.shape[:2], bool)
        certificates = np.full((count, CERTIFICATES), -1, np.int64)
        if np.isfinite(upper_bound).any():
            self._sync(source_poses)
            certificates = self._certificates[source]
            if len(self._links):
                differs = poses != source_poses[source]
                moved = differs.any(axis=2)
                same_position = ~differs[..., :3].any(axis=2) & (len(self._clear) > 0)
                self._recompute_links(np.unique(source[(~moved | same_position).any(axis=1)]))
        batch = core.Batch(
            placed=self._placed(poses),
            upper_bound=upper_bound,
            moved=moved,
            source=source,
            certificates=certificates,
            links=self._links,
            same_position=same_position,
            clear=self._clear,
            smoothing=smoothing,
        )
        remembered = sum(len(one.links) for one in self._remembered)
        fits = len(self._links) > 0 and (remembered + count) * self._link_bytes <= self._cache_bytes
        alone = np.where((moved.sum(axis=1) == 1) & fits, moved.argmax(axis=1), -1)
        result = core.BatchResult(
            cost=np.full(count, np.inf),
            refuted_by=np.full(count, -1, np.int64),
            certificates=np.full_like(certificates, -1),
            links=np.empty((fits * count, *self._links.shape[2:]), np.uint64),
            clear=np.empty((fits * count * (len(self._clear) > 0), *self._clear.shape[2:]), np.uint64),
        )

        def run(counter: Counter, most: int, workspace: core.TrialEvaluator) -> tuple[int, int, int]:
            return workspace.evaluate_batch(counter, most, batch, in_full, result)

        on_begun = self.on_evaluated if in_full else None
        done = parallel_for(self._pool, self._workspaces, count, self.slice, run, on_begun)
        evaluated, compared, cast = (sum(counts) for counts in zip((0, 0, 0), *done, strict=True))
        self.segments += cast
        nx, ny, nz = self._region.shape
        self.cuboids += evaluated * nx * ny * nz + compared * min(nx, 64)
        if len(self._certificates):
            core.promote_certificates(self._certificates, source, result.refuted_by)
        found = _Remembered(source, poses, result.certificates, result.links, result.clear, alone)
        self._remember(result.cost, found)
        return result.cost, evaluated

    def _remember(self, cost: Array, found: _Remembered) -> None:
        """Remember those trials that were not refuted."""
        trials = np.flatnonzero(cost < np.inf)
        links, clear = (words[trials] if len(words) else words for words in (found.links, found.clear))
        self._remembered.append(
            _Remembered(
                found.source[trials],
                found.poses[trials],
                found.certificates[trials],
                links,
                clear,
                found.moved[trials],
            )
        )
        while sum(len(one.source) for one in self._remembered) > REMEMBERED:
            self._remembered.popleft()

    def _evaluated(self, count: int) -> None:
        if self.on_evaluated:
            self.on_evaluated(count)

    def _placed(self, poses: Array) -> core.Placed:
        """The LiDARs at poses (n, lidars, 6)."""
        cones = np.empty((*poses.shape[:2], FIRST + self._square.shape[1]))
        cones[..., :3] = poses[..., :3]
        cones[..., 3:FIRST] = up(poses[..., 3:])
        cones[..., FIRST:] = self._square
        if self._visibility is None:
            return core.Placed(cones, np.empty((len(poses), 0, LIMITS)), UNLIMITED_SIGHT.obstacles)
        limits = self._visibility.limits(self._lidars, level(poses[..., 3:]))
        return core.Placed(cones, limits, self._visibility.obstacles)

    @property
    def _link_bytes(self) -> int:
        """The bytes of a LiDAR's links and what is clear of it."""
        return 8 * self._grid.rows * (4 if self._visibility else 3)

    @cached_property
    def _workspaces(self) -> list[core.TrialEvaluator]:
        """One for each thread."""
        return [core.TrialEvaluator(self._grid, self._cases, CERTIFICATES) for _ in range(self._threads)]

    def _sync(self, source_poses: Array) -> None:
        """Bring the certificates of the food sources up to date."""
        if len(self._poses) != len(source_poses):
            self._poses = np.full_like(source_poses, np.nan)
            self._linked_poses = np.full_like(source_poses, np.nan)
            self._certificates = np.full((len(source_poses), CERTIFICATES), -1, np.int64)
            fits = len(source_poses) * len(self._lidars) * self._link_bytes <= self._cache_bytes
            self._links = np.empty((len(source_poses) * fits, *self._links.shape[1:]), np.uint64)
            clear = len(self._links) if self._visibility else 0
            self._clear = np.empty((clear, *self._clear.shape[1:]), np.uint64)
        changed = (self._poses != source_poses).any(axis=(1, 2))
        self._certificates[changed] = -1
        if not changed.any():
            return
        for one in self._remembered:
            new = np.flatnonzero(one.source < len(source_poses))
            row = one.source[new]
            new = new[changed[row] & (one.poses[new] == source_poses[row]).all(axis=(1, 2))]
            self._certificates[one.source[new]] = one.certificates[new]
            self._reuse_links(one, new[one.moved[new] >= 0])
        self._remembered.clear()
        self._poses = source_poses.copy()

    def _reuse_links(self, found: _Remembered, trials: Index) -> None:
        """Take the links of the LiDAR that moved from trials that some food sources have moved to."""
        differs = (self._linked_poses[found.source[trials]] != found.poses[trials]).any(axis=2)
        trials = trials[differs[np.arange(len(trials)), found.moved[trials]] & (differs.sum(axis=1) == 1)]
        row = found.source[trials]
        lidar = found.moved[trials]
        self._links[row, lidar] = found.links[trials]
        if len(self._clear):
            self._clear[row, lidar] = found.clear[trials]
        self._linked_poses[row] = found.poses[trials]

    def _recompute_links(self, sources: Index) -> None:
        """Bring the links of some other food sources up to date."""
        stale = sources[(self._linked_poses[sources] != self._poses[sources]).any(axis=(1, 2))]
        poses = self._poses[stale]
        linked_poses = self._linked_poses[stale]
        changed = (linked_poses != poses).any(axis=2)
        same_position = (linked_poses[..., :3] == poses[..., :3]).all(axis=2)
        known = core.Sources(
            row=stale,
            placed=self._placed(poses),
            changed=changed,
            same_position=same_position,
            links=self._links,
            clear=self._clear,
        )

        def run(counter: Counter, most: int, workspace: core.TrialEvaluator) -> None:
            workspace.recompute_links(counter, most, known)

        parallel_for(self._pool, self._workspaces, len(stale), self.slice, run)
        self._linked_poses[stale] = poses
