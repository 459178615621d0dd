"""What a rig reaches with an object at places: returns of all sensors together, of each alone, or of one cluster.

Each sensor is in its worst phase, and those sensors are lost whose loss is the worst.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array
from lidarcfg.returns.counts import ClusterRule, Lowest, OnPlaces, count_clusters, no_progress
from lidarcfg.returns.known import RigAt, Share, lowest_at
from lidarcfg.returns.scanners import Poses, poses_of, scanners_of
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.tracer import Obstacles

LOWEST = 256  # places, around which others are tried
JOINT_MAX = 256  # combinations of phases that are all tried for clusters

Counts = NDArray[np.int64]
Rows = NDArray[np.int64]
Deciding = Callable[[Array, Counts], NDArray[np.intp]]  # the numbers of the lowest of values at places (P, 4)


@dataclass(frozen=True)
class Measured:
    """What a rig reaches at P places."""

    places: Array  # (P, 4)
    values: Counts  # (P,) exact where below a cap
    lowest: Lowest  # each sensor's counts; for clusters no counts

    def joined(self, other: "Measured") -> "Measured":
        """These and the measurements at other places."""
        return Measured(
            np.concatenate([self.places, other.places]),
            np.concatenate([self.values, other.values]),
            Lowest(
                np.concatenate([self.lowest.counts, other.lowest.counts]),
                np.concatenate([self.lowest.phases, other.lowest.phases]),
            ),
        )


class Reach:
    """What rigs reach at the places of a share, and at others: returns of all sensors together, or of each alone."""

    def __init__(self, share: Share, lost: int, sensors: int | None) -> None:
        """With `lost` sensors gone. `sensors`: the number of those that get it, each alone; None: all together."""
        self.places = share.places  # (P, 4)
        self._share = share
        self._lost = lost
        self._sensors = sensors

    @property
    def obstacles(self) -> Obstacles:
        """What blocks beams."""
        return self._share.known.obstacles

    @property
    def height_m(self) -> float:
        """The object's."""
        return float(self._share.target.size_m[2])

    def measured(self, mounts: Sequence[Mount], cap: int, on_places: OnPlaces = no_progress) -> Measured:
        """What a rig reaches at the share's places, exact below the cap; what is known of it is kept."""
        rig = self._share.known.rig(mounts)
        lowest = self._share.lowest(rig, cap, self._wanted, on_places=on_places)
        return Measured(self.places, reached(lowest.counts, self._lost, self._sensors), lowest)

    def measured_at(
        self, places: Array, mounts: Sequence[Mount], cap: int, on_places: OnPlaces = no_progress
    ) -> Measured:
        """What a rig reaches at other places (P, 4)."""
        lowest = self._lowest_at(places, mounts, cap, on_places)
        return Measured(places, reached(lowest.counts, self._lost, self._sensors), lowest)

    def in_cases(self, rig: RigAt, rows: Rows, cap: int) -> Counts:
        """(cases, n) what a rig reaches at some of the share's places in each case of failure, exact below the cap."""
        counts = self._share.lowest(rig, cap, self._lost + (self._sensors or 1), rows, threads=1).counts
        return self._by_case(counts)

    def by_case(self, measured: Measured) -> Counts:
        """(cases, P) what is reached in each case of failure where it was measured."""
        return self._by_case(measured.lowest.counts)

    def lost_at(self, measured: Measured, at: int) -> list[int]:
        """The sensors that are lost in the worst case at one of the places; to lose one that sees nothing is none."""
        counts = measured.lowest.counts[at]
        gone = np.argsort(-counts, kind="stable")[: self._lost]
        return sorted(gone[counts[gone] > 0].tolist())

    def without_each(
        self, measured: Measured, mounts: Sequence[Mount], cap: int, deciding: Deciding
    ) -> Iterator[Counts]:
        """(P,) what is reached at measured places without each of the mounts in turn, exact below the cap."""
        for n in range(len(mounts)):
            yield reached(np.delete(measured.lowest.counts, n, axis=1), 0, self._sensors)

    def notes(self, mounts: Sequence[Mount]) -> list[str]:
        """What a verdict says of how it was counted."""
        return []

    @property
    def _wanted(self) -> int:
        """How many sensors with more returns than matter make the others' counts needless."""
        return max(self._lost, 1) + (self._sensors or 1)

    def _lowest_at(self, places: Array, mounts: Sequence[Mount], cap: int, on_places: OnPlaces = no_progress) -> Lowest:
        return lowest_at(places, self._share.target, mounts, self.obstacles, cap, self._wanted, on_places)

    def _by_case(self, counts: NDArray[np.int32]) -> Counts:
        return np.stack([reached(counts[:, kept], 0, self._sensors) for kept in cases(counts.shape[1], self._lost)])


class ClusterReach(Reach):
    """The same of the points of the largest cluster, which take long to find."""

    def __init__(self, share: Share, lost: int, sensors: int | None, rule: ClusterRule) -> None:
        super().__init__(share, lost, sensors)
        self._rule = rule
        self._latest: tuple[tuple[Mount, ...], int, Measured] | None = None  # a rig, the cap, what it reaches

    def measured(self, mounts: Sequence[Mount], cap: int, on_places: OnPlaces = no_progress) -> Measured:
        """As Reach.measured; of the latest rig all is kept."""
        if self._latest is None or self._latest[0] != tuple(mounts) or self._latest[1] < cap:
            self._latest = tuple(mounts), cap, self.measured_at(self.places, mounts, cap, on_places)
        return self._latest[2]

    def measured_at(
        self, places: Array, mounts: Sequence[Mount], cap: int, on_places: OnPlaces = no_progress
    ) -> Measured:
        """As Reach.measured_at."""
        return self._counted(places, mounts, cap, self._lost, on_places)

    def in_cases(self, rig: RigAt, rows: Rows, cap: int) -> Counts:
        """As Reach.in_cases: (1, n) in the worst case."""
        scanners, poses = self._share.known.clustering(rig)
        found = self._clusters(self.places[rows], scanners, poses, cap, self._lost, threads=1)
        return found.counts[:, 0].astype(np.int64)[None]

    def by_case(self, measured: Measured) -> Counts:
        """As Reach.by_case: (1, P) in the worst case."""
        return measured.values[None]

    def lost_at(self, measured: Measured, at: int) -> list[int]:
        """As Reach.lost_at."""
        lost: list[int] = np.flatnonzero(measured.lowest.phases[at] < 0).tolist()
        return lost

    def without_each(
        self, measured: Measured, mounts: Sequence[Mount], cap: int, deciding: Deciding
    ) -> Iterator[Counts]:
        """As Reach.without_each, at the lowest places alone, as clusters take long to find; elsewhere at most this."""
        counts = self._lowest_at(measured.places, mounts, cap).counts
        for n in range(len(mounts)):
            values = reached(np.delete(counts, n, axis=1), 0, self._sensors)
            if not self._lost:
                values = np.minimum(values, measured.values)  # as fewer sensors make no larger clusters
            lowest = deciding(measured.places, values)
            left = [mount for other, mount in enumerate(mounts) if other != n]
            places = np.ascontiguousarray(measured.places[lowest])
            values[lowest] = self._counted(places, left, cap, lost=0).values
            yield values

    def notes(self, mounts: Sequence[Mount]) -> list[str]:
        """How phases were combined."""
        count = math.prod(one.phases for one in scanners_of(mounts))
        if self._sensors:
            return ["clusters of each sensor alone, in each of its phases"]
        if count <= JOINT_MAX:
            return [f"clusters in all {count} combinations of the sensors' phases"]
        what = f"clusters with each sensor in the phase of its fewest returns, as there are {count:,} combinations"
        return [f"{what} of phases; others may give smaller ones"]

    def _counted(
        self, places: Array, mounts: Sequence[Mount], cap: int, lost: int, on_places: OnPlaces = no_progress
    ) -> Measured:
        found = self._clusters(places, scanners_of(mounts), poses_of(mounts), cap, lost, on_places)
        return Measured(places, found.counts[:, 0].astype(np.int64), found)

    def _clusters(
        self,
        places: Array,
        scanners: Sequence[core.returns.Scanner],
        poses: Poses,
        cap: int,
        lost: int,
        on_places: OnPlaces = no_progress,
        threads: int | None = None,
    ) -> Lowest:
        joint = math.prod(one.phases for one in scanners) <= JOINT_MAX
        target = self._share.target
        sensors = self._sensors or 0
        return count_clusters(
            places, target, scanners, poses, self.obstacles, self._rule, lost, sensors, joint, cap, on_places, threads
        )


def cases(sensors: int, lost: int) -> list[list[int]]:
    """The sensors that are left: all of them, then those of each case of failure."""
    whole = list(range(sensors))
    ways = combinations(whole, lost) if lost else ()
    return [whole, *([n for n in whole if n not in gone] for gone in ways)]


def reached(counts: NDArray[np.int32], lost: int, sensors: int | None) -> Counts:
    """(P,) the sum of counts (P, S) without the `lost` largest; or, of those left, the `sensors`-th largest."""
    ordered = -np.sort(-np.maximum(counts, 0).astype(np.int64), axis=1)
    if sensors is None:
        return np.asarray(ordered[:, lost:].sum(axis=1))
    return ordered[:, lost + sensors - 1] if lost + sensors <= counts.shape[1] else np.zeros(len(counts), np.int64)


def positions(places: Array, values: Counts) -> tuple[NDArray[np.intp], Counts]:
    """(n,) each: the place of the lowest value at each position, over headings, and that value."""
    order = np.lexsort((values, places[:, 1], places[:, 0]))
    at = places[order, :2]
    first = np.ones(len(at), np.bool_)
    first[1:] = (at[1:] != at[:-1]).any(axis=1)
    return order[first], values[order[first]]


def lowest_of(values: Counts, most: int = LOWEST) -> NDArray[np.intp]:
    """The numbers of the lowest values."""
    count = min(most, len(values))
    return np.argpartition(values, count - 1)[:count] if count else np.empty(0, np.intp)
