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
from lidarcfg.placement import kernels, runs
from lidarcfg.placement.lidar import Lidar, bits_needed, thresholds
from lidarcfg.placement.metric import vsr_m, vsr_of_counts
from lidarcfg.placement.region import Region, excluded, word_dtype
from lidarcfg.placement.subspace import RUNS_FROM, segment

CACHE_BYTES = 256 * 2**20  # for the labels of the food sources; where they would need more, none are kept
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
        bits = np.array(bits_needed(sines))
        self._fits = bits.sum() < 64
        dtype = word_dtype(int(bits.sum()))
        self._excluded = excluded(dtype)
        self._shift = np.cumsum(bits) - bits
        self._threshold = np.full((len(bits), max(sine.size for sine in sines) + 2), np.inf)
        for row, sine in zip(self._threshold, sines, strict=True):
            row[: sine.size + 2] = thresholds(sine)
        if self._fits:
            ones = [((1 << int(b)) - 1) << int(s) for b, s in zip(bits, self._shift, strict=True)]
            self._mask = np.array(ones, dtype)
        self._grid = runs.Grid.of(region) if region.included.size >= RUNS_FROM else None
        self._frame = region.frame(dtype)
        self._edge = tuple(region.cuboid_m.tolist())
        self._poses = np.empty((0, len(bits), 6))  # of the food sources, as the next two have them
        self._words = self._frame[None]  # (sources, padded), or the bare frame
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
        if self._grid or not self._fits:
            self.full_evaluations += len(poses)
            self.cuboids += len(poses) * self._region.included.size
            cost = self.map(self._whole, poses)
            return np.where(cost < to_beat, cost, np.inf)
        cones = _cones(poses)
        moved, row = np.ones(poses.shape[:2], bool), np.zeros(len(poses), np.int64)
        if not self._skip:
            to_beat = np.full(len(poses), np.inf)
        witness = np.full((len(poses), kernels.WITNESSES), -1, np.int64)
        if np.isfinite(to_beat).any():
            self._follow(source_poses)
            witness = self._witness[source]
            if len(self._words) == len(source_poses):
                moved, row = (poses != source_poses[source]).any(axis=2), source
        cost = np.full(len(poses), np.inf)
        refuter = np.full(len(poses), -1, np.int64)
        fresh = np.full_like(witness, -1)

        def run(trials: Index) -> tuple[int, int]:
            return kernels.try_out(
                trials, to_beat, moved, cones, self._threshold, self._shift, self._mask,
                self._region.centres(), self._edge, self._frame, self._words, row, witness, self._excluded,
                cost, refuter, fresh,
            )  # fmt: skip

        for full, touched in self._pool.map(run, self._parts(len(poses))):
            self.full_evaluations += full
            self.cuboids += touched
        if len(self._witness):
            kernels.remember(self._witness, source, refuter)
        self._told = source, poses, fresh
        return cost

    def _whole(self, poses: Array) -> float:
        lidars = [Lidar(row[:3], up(row[3:]), sine) for row, sine in zip(poses, self._sines, strict=True)]
        if self._grid is None:
            return max_vsr(self._region, lidars)
        cuboids, internal, _ = runs.count(self._grid, lidars)
        return float(vsr_of_counts(cuboids, internal, self._region.cuboid_m).max())

    def _parts(self, count: int) -> list[Index]:
        """Numbers 0 … count − 1, dealt out: enough parts that no thread waits long for another."""
        parts = min(count, 8 * self._threads) if self._threads > 1 else 1
        return [np.arange(first, count, parts) for first in range(parts)]

    def _follow(self, source_poses: Array) -> None:
        """Bring the labels and witnesses of the food sources up to date."""
        if len(self._poses) != len(source_poses):
            self._poses = np.full_like(source_poses, np.nan)
            self._witness = np.full((len(source_poses), kernels.WITNESSES), -1, np.int64)
            if len(source_poses) * self._frame.nbytes <= CACHE_BYTES:
                self._words = np.tile(self._frame, (len(source_poses), 1))
        changed = (self._poses != source_poses).any(axis=2)
        rows = np.flatnonzero(changed.any(axis=1))
        source, poses, fresh = self._told
        self._witness[rows] = -1
        new = np.flatnonzero((poses == source_poses[source]).all(axis=(1, 2)))
        self._witness[source[new]] = np.where(
            changed[source[new]].any(axis=1)[:, None], fresh[new], self._witness[source[new]]
        )
        if len(self._words) == len(source_poses):
            cones = _cones(source_poses)
            parts = [rows[part] for part in self._parts(len(rows))]
            list(
                self._pool.map(
                    lambda part: kernels.renew(
                        part, self._words, changed, cones, self._threshold, self._shift, self._mask,
                        self._region.centres(),
                    ),
                    parts,
                )
            )  # fmt: skip
        self._poses = source_poses.copy()


def _cones(poses: Array) -> Array:
    """(…, 6): position and axis, from position and angles."""
    return np.concatenate([poses[..., :3], up(poses[..., 3:])], axis=-1)
