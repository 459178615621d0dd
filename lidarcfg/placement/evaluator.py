"""The costs of many trials at once: on threads, and without the work that cannot change the answer.

A trial is kept only if it beats the food source that it was drawn around. For max VSR the subspaces around a few
witness cuboids (the source's worst ones, and those that refuted earlier trials of it) are flooded first; one that is
no better than the source refutes the trial. Only the LiDARs that moved are computed anew. Other terms of an objective
have their own ways to prove that they are too large, see objective.py. None of this changes a cost that is kept: tests
run whole searches with and without it.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, level, up
from lidarcfg.placement import evaluator_kernels as kernels
from lidarcfg.placement import rows
from lidarcfg.placement.cones import FIRST, Lidar, cone_rows, placed
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.objective import Criterion, Trial
from lidarcfg.placement.region import Region
from lidarcfg.placement.subspace import Subspaces, segment
from lidarcfg.placement.visibility import Visibility
from lidarcfg.placement.visibility_kernels import LIMITS

CACHE_BYTES = 256 * 2**20
RESTS = 10  # so many batches go without witnesses after one in which they refuted less than a quarter
Index = NDArray[np.int64]


def max_vsr(region: Region, lidars: Sequence[Lidar], visibility: Visibility | None = None) -> float:
    """The paper's cost: the largest volume-to-surface ratio over all subspaces, in metres (eq. 10)."""
    return float(vsr_m(segment(region, lidars, visibility)).max())


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
        self._grid = rows.Grid.of(region)
        self._poses = np.empty((0, len(lidars), 6))  # of the food sources, for _witness
        self._linked = self._poses  # and for _links
        self._links = np.empty((0, len(lidars), *self._grid.links.shape), np.uint64)  # (sources, …), or none
        self._clear = np.empty((0, len(lidars), self._grid.included.size), np.uint64)  # (sources, …), or none
        self._witness = np.empty((0, kernels.WITNESSES), np.int64)  # (sources, …)
        self._last: tuple[Index, Array, Index] = (np.empty(0, np.int64), self._poses, self._witness)
        self._rest = 0  # see RESTS
        self.full_evaluations = 0
        self.cuboids = 0  # evaluated
        self.segments = 0  # cast from LiDARs to cuboids, at most
        self._segments = len(lidars) * int(region.included.sum()) if visibility and visibility.blocks else 0

    def __enter__(self) -> "Evaluator":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def costs(self, poses: Array, source: Index, source_poses: Array, to_beat: Array) -> Array:
        """(n,) the costs, or inf where one is not below `to_beat` (n,).

        poses (n, lidars, 6); source (n,) says which of source_poses (sources, lidars, 6) a trial was drawn
        around, and matters for speed alone.
        """
        if not self._skip:
            to_beat = np.full(len(poses), np.inf)
        if self._criterion is None or self._criterion.is_max_vsr:
            cost, full = self._max_vsr(poses, source, source_poses, to_beat)
            self.full_evaluations += full
            return cost
        return self._weighted(self._criterion, poses, source, source_poses, to_beat)

    def _weighted(
        self, criterion: Criterion, poses: Array, source: Index, source_poses: Array, to_beat: Array
    ) -> Array:
        """The same for other terms: witnesses of max VSR first, then the subspaces of what they did not refute."""
        out = np.full(len(poses), np.nan)
        self._rest = max(self._rest - 1, 0)
        if criterion.max_vsr is not None and not self._rest:
            nothing = [0.0] * len(criterion.terms)
            limit = [criterion.limit(nothing, criterion.max_vsr, value) for value in to_beat.tolist()]
            out, _ = self._max_vsr(poses, source, source_poses, np.array(limit), in_full=False)
            self._rest = RESTS if 4 * int((out == np.inf).sum()) < len(poses) else 0
        trials = np.flatnonzero(np.isnan(out))

        def one(trial: int) -> tuple[float, Index]:
            rig = Trial(self._region, self._rig(poses[trial]), self._visibility)
            cost = criterion.of(rig, float(to_beat[trial]))
            return cost, self._worst(rig.subspaces) if rig.is_cut else np.empty(0, np.int64)

        refuter, fresh = np.full(len(poses), -1, np.int64), np.full((len(poses), kernels.WITNESSES), -1, np.int64)
        for trial, (cost, worst) in zip(trials.tolist(), self._pool.map(one, trials.tolist()), strict=True):
            out[trial], fresh[trial, : len(worst)] = cost, worst
            self.cuboids += self._region.included.size * (len(worst) > 0)
            self.segments += self._segments * (len(worst) > 0)
            if cost < np.inf:
                self.full_evaluations += 1
            elif len(worst):
                refuter[trial] = worst[0]
        if len(self._witness):
            kernels.remember(self._witness, source, refuter)
        self._last = source, poses, fresh
        for term in criterion.terms:
            term.learn()
        return out

    def _worst(self, subspaces: Subspaces) -> Index:
        """A cuboid in each of the worst subspaces."""
        worst = np.argsort(-vsr_m(subspaces), kind="stable")[: kernels.WITNESSES]
        i, j, k = np.unravel_index(subspaces.first[worst], self._region.shape)
        return rows.cuboid_number(self._grid, (i, j, k))

    def _max_vsr(
        self, poses: Array, source: Index, source_poses: Array, to_beat: Array, in_full: bool = True
    ) -> tuple[Array, int]:
        """(n,) max VSR or inf, and how many were evaluated in full; NaN where that was needed, but not `in_full`."""
        moved, witness = np.ones(poses.shape[:2], bool), np.full((len(poses), kernels.WITNESSES), -1, np.int64)
        stays = np.zeros(poses.shape[:2], bool)
        if np.isfinite(to_beat).any():
            self._follow(source_poses)
            witness = self._witness[source]
            if len(self._links):
                differs = poses != source_poses[source]
                moved = differs.any(axis=2)
                stays = ~differs[..., :3].any(axis=2) & (len(self._clear) > 0)
                self._renew(np.unique(source[(~moved | stays).any(axis=1)]))
        batch = kernels.Batch(self._placed(poses), to_beat, moved, source, witness, self._links, stays, self._clear)
        verdicts = kernels.Verdicts(
            np.full(len(poses), np.inf), np.full(len(poses), -1, np.int64), np.full_like(witness, -1)
        )

        def run(trials: Index) -> tuple[int, int, int]:
            return kernels.try_out(trials, batch, self._grid, in_full, verdicts)

        nx, ny, nz = self._region.shape
        evaluated = 0
        for full, compared, cast in self._pool.map(run, self._parts(len(poses))):
            evaluated += full
            self.segments += cast
            self.cuboids += full * nx * ny * nz + compared * min(nx, 64)
        if len(self._witness):
            kernels.remember(self._witness, source, verdicts.refuter)
        self._last = source, poses, verdicts.fresh
        return verdicts.cost, evaluated

    def _rig(self, poses: Array) -> list[Lidar]:
        return [placed(one, row[:3], row[3:]) for row, one in zip(poses, self._lidars, strict=True)]

    def _placed(self, poses: Array) -> kernels.Placed:
        """The LiDARs at poses (n, lidars, 6)."""
        square = np.broadcast_to(self._square, (len(poses), *self._square.shape))
        cones = np.concatenate([poses[..., :3], up(poses[..., 3:]), square], axis=-1)
        if self._visibility is None:
            return kernels.Placed(cones, np.empty((len(poses), 0, LIMITS)), rows.EVERYTHING.obstacles)
        limits = self._visibility.limits(self._lidars, level(poses[..., 3:]))
        return kernels.Placed(cones, limits, self._visibility.obstacles)

    def _parts(self, count: int) -> list[Index]:
        """The numbers 0 … count − 1 in enough parts that no thread waits long for another."""
        parts = min(count, 8 * self._threads) if self._threads > 1 else 1
        return [np.arange(first, count, parts) for first in range(parts)]

    def _follow(self, source_poses: Array) -> None:
        """Bring the witnesses of the food sources up to date."""
        if len(self._poses) != len(source_poses):
            self._poses = np.full_like(source_poses, np.nan)
            self._linked = np.full_like(source_poses, np.nan)
            self._witness = np.full((len(source_poses), kernels.WITNESSES), -1, np.int64)
            words = self._grid.links.nbytes + (self._grid.included.nbytes if self._visibility else 0)
            fits = len(source_poses) * len(self._lidars) * words <= self._cache_bytes
            self._links = np.empty((len(source_poses) * fits, *self._links.shape[1:]), np.uint64)
            clear = len(self._links) if self._visibility else 0
            self._clear = np.empty((clear, *self._clear.shape[1:]), np.uint64)
        changed = (self._poses != source_poses).any(axis=(1, 2))
        source, poses, fresh = (of[self._last[0] < len(source_poses)] for of in self._last)
        self._witness[changed] = -1
        new = np.flatnonzero((poses == source_poses[source]).all(axis=(1, 2)) & changed[source])
        self._witness[source[new]] = fresh[new]
        self._poses = source_poses.copy()

    def _renew(self, sources: Index) -> None:
        """Bring the links of some food sources up to date."""
        changed = np.zeros(self._poses.shape[:2], bool)
        changed[sources] = (self._linked[sources] != self._poses[sources]).any(axis=2)
        stale = np.flatnonzero(changed.any(axis=1))
        stays = (self._linked[..., :3] == self._poses[..., :3]).all(axis=2)
        known = kernels.Sources(self._placed(self._poses), changed, self._links, stays, self._clear)

        def renew(part: Index) -> None:
            kernels.renew(stale[part], known, self._grid)

        list(self._pool.map(renew, self._parts(len(stale))))
        self._linked[sources] = self._poses[sources]
