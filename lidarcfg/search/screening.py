"""Rigs of many combinations, judged at the places of trials by what each of their sensors gets there alone.

The returns of a rig are sums of its sensors'. So each sensor is cast once at each pose, whatever stands beside it, and
the plain rigs of all combinations of sensors are judged in the time of a few. Of requirements that are no such sums, as
of clusters, posts, shadows and scenarios, and of mounting errors it knows nothing: rigs may fail that it lets pass.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.requirements.resolved import Requirements
from lidarcfg.returns.known import lowest_at
from lidarcfg.study.mounting import Slot
from lidarcfg.study.study import Study

BEST = 12  # rigs that are then judged at all places, if they meet all there
LEAST = 1e-3  # the shortfall of a rig that was not judged at all places
CAP_FACTOR = 2  # by which returns are counted beyond those demanded, so that margins are told apart
Counts = NDArray[np.int32]
Key = tuple[str | None, tuple[float, float] | None, tuple[float, float] | None, bytes]  # of a sensor at a pose


@dataclass(frozen=True)
class ScreenedRigs:
    """What n rigs of a study reach, as far as it is known."""

    points: Array  # (n, free coordinates)
    worst: Array  # (n,) the largest relative shortfall at any place; below 0: the least relative margin
    shortfalls: Array  # (n, requirements) the means over places, as in trials
    is_judged: bool = False  # whether some had to be judged at all places

    @property
    def order(self) -> NDArray[np.int64]:
        """(n,) the numbers of the rigs, the one that comes closest first."""
        return np.lexsort((self.shortfalls.sum(axis=1), self.worst))

    def part(self, rows: NDArray[np.int64]) -> "ScreenedRigs":
        """Some of them."""
        return replace(self, points=self.points[rows], worst=self.worst[rows], shortfalls=self.shortfalls[rows])


class Screening:
    """Judges rigs by one set of requirements; what each sensor gets at each pose is kept."""

    def __init__(self, requirements: Requirements) -> None:
        self._count = len(requirements.items)
        self._obstacles = requirements.site.obstacles
        self._items = {n: item.sums for n, item in enumerate(requirements.items) if item.sums}
        self._places = {n: item.in_order() for n, item in self._items.items()}
        self._known: dict[Key, dict[int, Counts]] = {}

    def add_places(self, places: Mapping[int, Array]) -> None:
        """Use these places (n, 4), too, by the number of a requirement."""
        for n, some in places.items():
            if n in self._places:
                self._places[n] = np.concatenate([self._places[n], some])

    def judge(self, study: Study, points: Array, quick: bool = False) -> ScreenedRigs:
        """What the rigs at points (n, free coordinates) of a study with these requirements reach.

        If it is to be `quick`, at a few of the places.
        """
        poses = study.space.poses(points) + 0.0
        places = {n: self._places[n][: item.quick if quick else None] for n, item in self._items.items()}
        self._cast(study, poses, places)
        worst = np.full(len(poses), -math.inf if self._items else 0.0)
        shortfalls = np.zeros((len(poses), self._count))
        for rig, row in enumerate(poses):
            keys = [_key(slot, pose) for slot, pose in zip(study.slots, row, strict=True)]
            for n, item in self._items.items():
                counts = np.stack([self._known[key][n][: len(places[n])] for key in keys], axis=1)
                short = item.short(places[n], counts)
                worst[rig] = max(worst[rig], short.max())
                shortfalls[rig, n] = np.maximum(short, 0).mean()
        return ScreenedRigs(points, worst, shortfalls)

    def unknown(self, study: Study, points: Array) -> set[Key]:
        """The sensors at poses of the rigs at points (n, free coordinates) that a quick look would cast."""
        poses = study.space.poses(points) + 0.0
        return {_key(slot, pose) for row in poses for slot, pose in zip(study.slots, row, strict=True)} - set(
            self._known
        )

    def ranked(self, study: Study, points: Array, least: int = 0) -> ScreenedRigs:
        """The rigs at points (n, free coordinates), the closest first, and what they reach.

        Those that meet all at a few places are judged at all, up to BEST of them; and the closest, `least` at least.
        The others come behind these, and are known at the few places alone.
        """
        quick = self.judge(study, points, quick=True)
        quick = quick.part(quick.order)
        count = max(min(int((quick.worst <= 0).sum()), BEST), least)
        if not count:
            return quick
        best = self.judge(study, quick.points[:count])
        best = best.part(best.order)
        return ScreenedRigs(
            np.concatenate([best.points, quick.points[count:]]),
            np.concatenate([best.worst, np.maximum(quick.worst[count:], LEAST)]),
            np.concatenate([best.shortfalls, quick.shortfalls[count:]]),
            is_judged=least > 0,
        )

    def _cast(self, study: Study, poses: Array, wanted: Mapping[int, Array]) -> None:
        """Find out what is not known of the sensors of rigs at poses (n, slots, 6), at the first of the places."""
        for n, item in self._items.items():
            places = wanted[n]
            fresh: dict[int, dict[Key, tuple[int, Array]]] = {}  # by how many places are known
            for row in poses:
                for i, (slot, pose) in enumerate(zip(study.slots, row, strict=True)):
                    key = _key(slot, pose)
                    done = len(self._known.get(key, {}).get(n, ()))
                    if done < len(places):
                        fresh.setdefault(done, {})[key] = i, pose
            for done, found in fresh.items():
                at = study.space.lower.copy()
                mounts = []
                for i, pose in found.values():
                    at[i] = pose
                    mounts.append(study.rig(at).mounts[i])
                counts = lowest_at(
                    np.ascontiguousarray(places[done:]),
                    item.target,
                    mounts,
                    self._obstacles,
                    CAP_FACTOR * item.returns,
                    len(mounts) + 1,
                ).counts
                for key, column in zip(found, counts.T, strict=True):
                    known = self._known.setdefault(key, {})
                    known[n] = np.concatenate([known.get(n, np.empty(0, np.int32)), column])


def _key(slot: Slot, pose: Array) -> Key:
    return slot.model, slot.range_m, slot.azimuth_fov_deg, pose.tobytes()
