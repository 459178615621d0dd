"""Max VSR of many trials at once: on threads, and without the work that cannot change the answer.

A trial is kept only if it beats the food source it was drawn around. So the subspaces around a few witness cuboids
(the source's worst ones, and what last refuted a trial of it) are flooded first; one of them that is no better
than the source settles the trial. Only the LiDARs that moved are computed anew. None of this changes a cost that
is kept: a test runs searches with and without it.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, up
from lidarcfg.placement import evaluator_kernels as kernels
from lidarcfg.placement import rows
from lidarcfg.placement.cones import FIRST, Lidar, cone_rows
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.region import Region
from lidarcfg.placement.subspace import segment

CACHE_BYTES = 256 * 2**20  # for the links of the food sources; where they would need more, none are kept
Index = NDArray[np.int64]


def max_vsr(region: Region, lidars: Sequence[Lidar]) -> float:
    """The paper's cost: the largest volume-to-surface ratio over all subspaces, in metres (eq. 10)."""
    return float(vsr_m(segment(region, lidars)).max())


class Evaluator:
    """Evaluates poses (n, lidars, 6) of sensors with these sines of elevation; a context that owns its threads.

    Results depend neither on the number of threads nor on `skip`, which turns the savings off.
    """

    def __init__(self, region: Region, sines: Sequence[Array], threads: int | None = None, skip: bool = True) -> None:
        self._region, self._sines, self._skip = region, sines, skip
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads)
        origin = np.zeros(3)
        self._square = cone_rows([Lidar(origin, origin, sine) for sine in sines])[:, FIRST:]
        self._grid = rows.Grid.of(region)
        self._poses = np.empty((0, len(sines), 6))  # of the food sources, as _witness has them
        self._linked = self._poses  # and as _links has them
        self._links = np.empty((0, len(sines), *self._grid.links.shape), np.uint64)  # (sources, …), or none
        self._witness = np.empty((0, kernels.WITNESSES), np.int64)  # (sources, …)
        self._told: tuple[Index, Array, Index] = (np.empty(0, np.int64), self._poses, self._witness)
        self.full_evaluations = 0
        self.cuboids = 0  # looked at

    def __enter__(self) -> "Evaluator":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def map(self, function: Callable[[Array], float], poses: Array) -> Array:
        """`function` of each of the poses (n, lidars, 6), on the threads: (n,)."""
        return np.array(list(self._pool.map(function, poses)), np.float64)

    def max_vsr(self, poses: Array, source: Index, source_poses: Array, to_beat: Array) -> Array:
        """(n,) max VSR in metres, or inf where it is not below `to_beat` (n,).

        poses (n, lidars, 6); source (n,) says which of source_poses (sources, lidars, 6) a trial was drawn
        around, and matters for speed alone.
        """
        cones = self._cones(poses)
        moved, witness = np.ones(poses.shape[:2], bool), np.full((len(poses), kernels.WITNESSES), -1, np.int64)
        if not self._skip:
            to_beat = np.full(len(poses), np.inf)
        if np.isfinite(to_beat).any():
            self._follow(source_poses)
            witness = self._witness[source]
            if len(self._links):
                moved = (poses != source_poses[source]).any(axis=2)
                self._renew(np.unique(source[~moved.all(axis=1)]))
        batch = kernels.Batch(cones, to_beat, moved, source, witness, self._links)
        verdicts = kernels.Verdicts(
            np.full(len(poses), np.inf), np.full(len(poses), -1, np.int64), np.full_like(witness, -1)
        )

        def run(trials: Index) -> tuple[int, int]:
            return kernels.try_out(trials, batch, self._grid, verdicts)

        nx, ny, nz = self._region.shape
        for full, cut in self._pool.map(run, self._parts(len(poses))):
            self.full_evaluations += full
            self.cuboids += full * nx * ny * nz + cut * min(nx, 64)
        if len(self._witness):
            kernels.remember(self._witness, source, verdicts.refuter)
        self._told = source, poses, verdicts.fresh
        return verdicts.cost

    def _cones(self, poses: Array) -> Array:
        """(n, lidars, 6 + beams): position, axis, and what centres are compared with."""
        square = np.broadcast_to(self._square, (len(poses), *self._square.shape))
        return np.concatenate([poses[..., :3], up(poses[..., 3:]), square], axis=-1)

    def _parts(self, count: int) -> list[Index]:
        """Numbers 0 … count − 1, dealt out: enough parts that no thread waits long for another."""
        parts = min(count, 8 * self._threads) if self._threads > 1 else 1
        return [np.arange(first, count, parts) for first in range(parts)]

    def _follow(self, source_poses: Array) -> None:
        """Bring the witnesses of the food sources up to date."""
        if len(self._poses) != len(source_poses):
            self._poses = np.full_like(source_poses, np.nan)
            self._linked = np.full_like(source_poses, np.nan)
            self._witness = np.full((len(source_poses), kernels.WITNESSES), -1, np.int64)
            fits = len(source_poses) * len(self._sines) * self._grid.links.nbytes <= CACHE_BYTES
            self._links = np.empty((len(source_poses) * fits, *self._links.shape[1:]), np.uint64)
        changed = (self._poses != source_poses).any(axis=(1, 2))
        source, poses, fresh = (of[self._told[0] < len(source_poses)] for of in self._told)
        self._witness[changed] = -1
        new = np.flatnonzero((poses == source_poses[source]).all(axis=(1, 2)) & changed[source])
        self._witness[source[new]] = fresh[new]
        self._poses = source_poses.copy()

    def _renew(self, sources: Index) -> None:
        """Bring the links of some food sources up to date."""
        changed = np.zeros(self._poses.shape[:2], bool)
        changed[sources] = (self._linked[sources] != self._poses[sources]).any(axis=2)
        stale = np.flatnonzero(changed.any(axis=1))
        cones = self._cones(self._poses)

        def renew(part: Index) -> None:
            kernels.renew(stale[part], self._links, changed, cones, self._grid)

        list(self._pool.map(renew, self._parts(len(stale))))
        self._linked[sources] = self._poses[sources]
