"""The returns from an object at its places in one revolution, by phase; and the clusters that they form.

A return is counted where a beam hits the object first, within the sensor's range and field of view, as the simulator
does without noise, before ranges are rounded for packets.
"""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.returns.scanners import Poses
from lidarcfg.returns.target import Target
from lidarcfg.world.tracer import NO_OBSTACLES, Obstacles

PLACES_PER_PART = 64  # that a thread takes at a time
COUNT_BYTES = 8  # of the returns of a sensor in a phase, and of what is computed from them

# Above the ground a cluster has a point at least so high: autonomous_emergency_braking.param.yaml of autoware_launch at
# 025908d.
LOW_M = 0.1

OnPlaces = Callable[[int], None]  # is told how many more places are done; what it raises ends the work


def no_progress(count: int) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class Returned:
    """The returns from an object at P places."""

    counts: NDArray[np.int32]  # (P, sensors, PHASES)
    phases: tuple[int, ...]  # (sensors,) how many entries of the last axis are a sensor's; the others are 0

    @property
    def worst(self) -> Array:
        """(P,) the returns with each sensor in its worst phase."""
        parts = [self.counts[:, s, :count].min(axis=1) for s, count in enumerate(self.phases)]
        return np.asarray(np.sum(parts, axis=0, dtype=np.float64))

    @property
    def mean(self) -> Array:
        """(P,) the mean number of returns over all phases."""
        parts = [self.counts[:, s, :count].mean(axis=1) for s, count in enumerate(self.phases)]
        return np.asarray(np.sum(parts, axis=0, dtype=np.float64))

    def probability(self, enough: int) -> Array:
        """(P,) the probability of at least this many returns in a revolution."""
        return core.returns.detection_probabilities(self.counts, np.array(self.phases, np.int64), enough)


def returns(
    places: Array,
    target: Target,
    scanners: Sequence[core.returns.Scanner],
    poses: Poses,
    obstacles: Obstacles = NO_OBSTACLES,
    threads: int | None = None,
    on_places: OnPlaces = no_progress,
) -> Returned:
    """The returns from an object at places (P, 4): x, y, the ground's z, heading in radians, of the vehicle frame."""
    phases = tuple(one.phases for one in scanners)
    shape = len(places), len(scanners), max(phases)
    what = f"counting the returns at {shape[0]:,} places to {shape[1]} sensors"
    check_memory(what, COUNT_BYTES * math.prod(shape), "use fewer places at a time")
    counts = np.zeros(shape, np.int32)

    object_shape = target.shape

    def run(part: slice, every: NDArray[np.int64]) -> None:
        some = places[part]
        core.returns.count_returns(some, every, scanners, poses.R, poses.t, object_shape, obstacles, counts[part])

    in_parts(len(places), run, threads, on_places)
    return Returned(counts, phases)


def in_parts(
    places: int,
    run: Callable[[slice, NDArray[np.int64]], None],
    threads: int | None,
    on_places: OnPlaces,
) -> None:
    """Have threads run successive places at a time: where they are among all, and their numbers among themselves."""
    parts = [slice(first, min(first + PLACES_PER_PART, places)) for first in range(0, places, PLACES_PER_PART)]
    numbers = [np.arange(part.stop - part.start) for part in parts]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        try:
            for every, _ in zip(numbers, pool.map(run, parts, numbers), strict=True):
                on_places(len(every))
        finally:
            pool.shutdown(cancel_futures=True)


class Lowest(NamedTuple):
    """The returns from an object at P places, each sensor in its worst phase, up to a cap."""

    counts: NDArray[np.int32]  # (P, sensors) at most the cap; below 0: unknown
    phases: NDArray[np.int8]  # (P, sensors) the worst phase, where there are fewer returns than the cap


class ClusterRule(NamedTuple):
    """Which returns are taken for one object."""

    tolerance_m: float  # between neighbours, at most
    above_m: float  # height in the vehicle frame that at least one of its points has


def count_clusters(
    places: Array,
    target: Target,
    scanners: Sequence[core.returns.Scanner],
    poses: Poses,
    obstacles: Obstacles,
    rule: ClusterRule,
    lost: int,
    sensors: int,
    joint: bool,
    cap: int,
    on_places: OnPlaces = no_progress,
    threads: int | None = None,
) -> Lowest:
    """The points (P, 1) of the largest cluster of an object's returns at places (P, 4), in the worst case.

    With `lost` sensors gone: of all others together, or with `sensors`, of each of that many alone. In the worst of all
    combinations of phases if `joint`, else with each sensor in the phase of its fewest returns. Beyond the cap values
    are lower bounds. Also the phases there (P, sensors); -1: lost.
    """
    counts = np.zeros(len(places), np.int32)
    phases = np.zeros((len(places), len(scanners)), np.int8)
    shape = target.shape

    def run(part: slice, every: NDArray[np.int64]) -> None:
        core.returns.count_clusters(
            places[part],
            every,
            scanners,
            poses.R,
            poses.t,
            shape,
            obstacles,
            *rule,
            lost,
            sensors,
            joint,
            cap,
            counts[part],
            phases[part],
        )

    in_parts(len(places), run, threads, on_places)
    return Lowest(counts[:, None], phases)
