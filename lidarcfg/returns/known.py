"""What is known of the returns from objects at their places, of sensors at poses: kept rig after rig.

Of a rig only the sensors that moved are cast, and those only at places where the others do not settle the question.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array
from lidarcfg.returns.counts import Lowest, OnPlaces, in_parts, no_progress
from lidarcfg.returns.scanners import Poses, poses_of, scanners_of
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.tracer import Obstacles

Numbers = NDArray[np.int64]


class RigAt(NamedTuple):
    """S sensors at poses, each of a scanner that `KnownReturns` has by number."""

    scanners: Numbers  # (S,)
    R: Array  # (S, 3, 3)
    t: Array  # (S, 3)

    def left(self, kept: Sequence[int]) -> "RigAt":
        """The rig of some of its sensors."""
        some = list(kept)
        return RigAt(self.scanners[some], self.R[some], self.t[some])


class Standing(NamedTuple):
    """An object at the places where it may stand."""

    target: Target
    places: Array  # (P, 4) x, y, the ground's z, heading


class KnownReturns:
    """The returns from objects, of which what is known is kept for the latest poses; threads may share it.

    Sensors that fire alike share a scanner. Those of a rig that are new here begin with nothing known of any.
    """

    def __init__(self, objects: Sequence[Standing], obstacles: Obstacles, mounts: Sequence[Mount] = ()) -> None:
        """`mounts`, if given, are those of later rigs. Raises ConfigError if one cannot be simulated."""
        self.objects = tuple(objects)
        self.obstacles = obstacles
        self._shapes = [one.target.shape for one in objects]
        self._places = np.ascontiguousarray(np.concatenate([one.places for one in objects]))
        self._ends = np.cumsum([len(one.places) for one in objects])
        self._kinds: list[Mount] = []
        self._scanners: list[core.returns.Scanner] = []
        self._known = self._nothing_known()
        self.numbers(mounts)

    def _nothing_known(self) -> core.returns.KnownReturns:
        return core.returns.KnownReturns(self._scanners, self._shapes, self._places, self._ends, self.obstacles)

    def numbers(self, mounts: Sequence[Mount]) -> Numbers:
        """(S,) the scanners of mounts, whatever their poses. Raises ConfigError for those that cannot be simulated."""
        kinds = [_kind(mount) for mount in mounts]
        new = [n for n, kind in enumerate(kinds) if kind not in self._kinds and kind not in kinds[:n]]
        if new:
            self._scanners += scanners_of([mounts[n] for n in new])
            self._kinds += [kinds[n] for n in new]
            self._known = self._nothing_known()
        return np.array([self._kinds.index(kind) for kind in kinds], np.int64)

    def rig(self, mounts: Sequence[Mount]) -> RigAt:
        """A rig's mounts. Raises ConfigError as `numbers`."""
        return RigAt(self.numbers(mounts), *poses_of(mounts))

    def clustering(self, rig: RigAt) -> tuple[list[core.returns.Scanner], Poses]:
        """A rig's scanners and poses, as `counts.count_clusters` takes them."""
        return [self._scanners[one] for one in rig.scanners.tolist()], Poses(rig.R, rig.t)

    def misses(self, rig: RigAt, weights: Array, enough: int, limit: float = math.inf) -> float:
        """The weighted mean over objects of the share of places with fewer than `enough` returns.

        By the mean over phases. Or, as soon as it is known to be at least `limit`, any number that is.
        """
        return self._known.misses(*rig, weights, enough, limit)

    def missed(self, rig: RigAt, number: int, enough: int, limit: float = math.inf) -> float:
        """In how many places an object is missed, by the mean over phases; or any number from `limit` on."""
        return self._known.missed(*rig, number, enough, limit)

    def missed_among(self, rig: RigAt, number: int, enough: int, count: int) -> float:
        """The same among `count` of its places, the likeliest to be missed: no more than `missed`."""
        return self._known.missed_among(*rig, number, enough, count)

    def miss_probability(
        self, rig: RigAt, number: int, enough: int, on_places: OnPlaces = no_progress, threads: int | None = None
    ) -> Array:
        """(P,) how likely an object is missed at each of its places, over phases."""
        which = np.arange(len(self.objects[number].places))
        missed = np.empty(len(which))

        def run(part: slice, _: Numbers) -> None:
            self._known.probabilities(*rig, number, which[part], enough, missed[part])

        in_parts(len(which), run, threads, on_places)
        return missed

    def lowest(
        self,
        rig: RigAt,
        number: int,
        which: Numbers,
        cap: int,
        wanted: int,
        on_places: OnPlaces = no_progress,
        threads: int | None = None,
    ) -> Lowest:
        """Each sensor's returns in its worst phase at some places of an object, until `wanted` sensors have the cap.

        The others' are unknown. So the sum is exact without the `wanted` − 1 largest counts, if it is below the cap.
        """
        shape = len(which), len(rig.scanners)
        lowest = Lowest(np.empty(shape, np.int32), np.empty(shape, np.int8))

        def run(part: slice, _: Numbers) -> None:
            self._known.lowest(*rig, number, which[part], cap, wanted, lowest.counts[part], lowest.phases[part])

        if threads == 1:
            run(slice(0, len(which)), which)
        else:
            in_parts(len(which), run, threads, on_places)
        return lowest

    @property
    def traced(self) -> int:
        """How many pairs of sensor and place were cast so far."""
        return self._known.traced

    @property
    def memory_bytes(self) -> int:
        """What is known takes no more memory."""
        return self._known.memory_bytes


def _kind(mount: Mount) -> Mount:
    """A mount without what does not change when its sensor fires."""
    return replace(
        mount, name="", host="", data_port=0, telemetry_port=0, position_m=(0.0, 0.0, 0.0), rpy_rad=(0.0, 0.0, 0.0)
    )


@dataclass(frozen=True)
class Share:
    """Some of the places of one of the objects whose returns are known."""

    known: KnownReturns
    number: int  # of the object
    which: Numbers  # (P,) its places

    @property
    def target(self) -> Target:
        """The object."""
        return self.known.objects[self.number].target

    @property
    def places(self) -> Array:
        """(P, 4) x, y, the ground's z, heading."""
        return np.ascontiguousarray(self.known.objects[self.number].places[self.which])

    def lowest(
        self,
        rig: RigAt,
        cap: int,
        wanted: int,
        rows: Numbers | slice = slice(None),
        on_places: OnPlaces = no_progress,
        threads: int | None = None,
    ) -> Lowest:
        """As KnownReturns.lowest, at all or some of these places."""
        return self.known.lowest(rig, self.number, self.which[rows], cap, wanted, on_places, threads)


def shares(objects: Sequence[Standing], obstacles: Obstacles, mounts: Sequence[Mount] = ()) -> list[Share]:
    """A share for each object; those of one shape know their returns together, at all of their places."""
    alike: list[list[int]] = []
    for n, one in enumerate(objects):
        same = (group for group in alike if _same_shape(objects[group[0]].target, one.target))
        group = next(same, None)
        if group is None:
            alike.append([n])
        else:
            group.append(n)
    joined = []
    which: dict[int, tuple[int, Numbers]] = {}
    for number, group in enumerate(alike):
        places, rows = united([objects[n].places for n in group])
        joined.append(Standing(objects[group[0]].target, places))
        which |= {n: (number, own) for n, own in zip(group, rows, strict=True)}
    known = KnownReturns(joined, obstacles, mounts)
    return [Share(known, *which[n]) for n in range(len(objects))]


def _same_shape(one: Target, other: Target) -> bool:
    return one is other or all(map(np.array_equal, one.mesh, other.mesh))


def united(groups: Sequence[Array]) -> tuple[Array, list[Numbers]]:
    """(P, 4) the places of groups (n, 4), each once, and for each group (n,) their numbers among these."""
    places = np.concatenate(groups)
    order = np.lexsort(places.T[::-1])
    ordered = places[order]
    new = np.ones(len(ordered), np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(ordered), np.int64)
    number[order] = np.cumsum(new) - 1
    return ordered[new], np.split(number, np.cumsum([len(group) for group in groups])[:-1])


def lowest_at(
    places: Array,
    target: Target,
    mounts: Sequence[Mount],
    obstacles: Obstacles,
    cap: int,
    wanted: int,
    on_places: OnPlaces = no_progress,
) -> Lowest:
    """The mounts' lowest counts at places (P, 4), of which nothing is kept; as KnownReturns.lowest."""
    known = KnownReturns([Standing(target, places)], obstacles, mounts)
    return known.lowest(known.rig(mounts), 0, np.arange(len(places)), cap, wanted, on_places)
