"""Misses: the share of places around a vehicle where objects get too few returns. The measure of what a rig sees.

An object at a place is missed if one revolution, or frame, of all sensors together puts fewer returns on it than are
asked for; the probability of that is over the sensors' phases. Places are drawn, uniform in area within some distances
of the body's outline and at any heading. A search uses few of them, and so finds rigs that suit these few a little too
well. So what is reported comes from fresh places, which no search has seen.

How well a detector that was trained on simulated clouds sees objects follows from this measure (Spearman's rho of 23
rigs: below −0.95), and not from max VSR: docs/evidence/validation.md.
"""

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model, Name, Weight
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.notebook import Shown
from lidarcfg.returns.known import KnownReturns, Standing
from lidarcfg.returns.places import Distances, Sector, Stand, StandZone
from lidarcfg.returns.target import ObjectFile, Target, target_of
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import Obstacles

OBJECTS = ("pedestrian", "child", "cyclist", "tyre", "post", "dog")
SEARCH_PLACES = 64  # of each object, at first in a search
SMALL_M = 2.0  # a body no longer than this moves slowly, among people: a robot
WITHIN_M = (0.1, 20.0)  # how far from the body objects are by default
WITHIN_SMALL_M = (0.1, 5.0)  # of a small one
FRESH_PLACES = 4096  # of each object, for what is reported
SEARCH, FRESH = range(2)  # what places are for: no place of one is one of the other
SEED = 20180913  # of the draws; combined with what they are for and the object's name
Z_95 = 1.959963984540054  # of the normal distribution, for intervals of 95 %

Interval = tuple[float, float]


def is_small(low_m: Array, high_m: Array) -> bool:
    """Whether a body with these bounds from above, (2,) each, is that of a robot rather than of a car."""
    return bool(np.max(high_m - low_m) <= SMALL_M)


class MissesFile(Model):
    """What is missed: objects near the vehicle that get too few returns."""

    objects: Annotated[dict[Name, Weight], Field(min_length=1)] = dict.fromkeys(OBJECTS, 1.0)  # of data/objects
    returns: Annotated[int, Field(ge=1, le=1000)] = 3  # with fewer it is missed
    within_m: Distances | None = None  # between the object and the body; none: by the size of the body
    sector_deg: Sector | None = None  # from, to, counter-clockwise from ahead; none: all around
    weight: Weight = 1.0  # beside other terms of an objective


@dataclass(frozen=True)
class MissedObject:
    """An object that may be missed, and where it may stand."""

    name: str
    weight: float
    target: Target
    zone: StandZone
    ground_m: float

    @cached_property
    def stand(self) -> Stand:
        """Where it may stand."""
        mesh = self.target.mesh[0] - self.target.origin_m, self.target.mesh[1]
        return Stand(self.zone, Footprint.of(mesh), np.zeros(1), self.ground_m)

    def places(self, count: int, purpose: int) -> Array:
        """(count, 4) places for a search or fresh ones; see Stand.drawn. Raises ConfigError as that."""
        try:
            return self.stand.drawn(count, [SEED, purpose, zlib.crc32(self.name.encode())], at_any_heading=True)
        except ConfigError as error:
            raise error.of(self.name) from None


@dataclass(frozen=True)
class ObjectMisses:
    """How often a rig misses an object, at P places."""

    name: str
    weight: float
    places: Array  # (P, 4) x, y, the ground's z, heading
    probability: Array  # (P,) that it is missed, over phases

    @property
    def share(self) -> float:
        """Of places at which it is missed."""
        return float(self.probability.mean())

    @property
    def interval(self) -> Interval:
        """The interval of 95 % of the share, Wilson's: that of independent places, and these lie more evenly."""
        count = len(self.places)
        p = self.share
        scale = 1 / (1 + Z_95**2 / count)
        middle = scale * (p + Z_95**2 / (2 * count))
        half = scale * Z_95 * math.sqrt(p * (1 - p) / count + Z_95**2 / (4 * count**2))
        return max(middle - half, 0.0), min(middle + half, 1.0)


@dataclass(frozen=True)
class MissesFound(Shown):
    """How often a rig misses objects."""

    objects: tuple[ObjectMisses, ...]
    returns: int  # with fewer an object is missed
    within_m: tuple[float, float]  # of the body

    @property
    def weights(self) -> Array:
        """(objects,) of the mean; their sum is 1."""
        weights = np.array([one.weight for one in self.objects])
        return np.asarray(weights / weights.sum())

    @property
    def mean(self) -> float:
        """Misses: the weighted mean over objects."""
        return math.fsum(self.weights * [one.share for one in self.objects])

    @property
    def interval(self) -> Interval:
        """The interval of 95 % of the mean, from those of the objects (Zou and Donner 2008)."""
        share = np.array([one.share for one in self.objects])
        low, high = np.array([one.interval for one in self.objects]).T
        below = math.hypot(*(self.weights * (share - low)))
        above = math.hypot(*(self.weights * (high - share)))
        return max(self.mean - below, 0.0), min(self.mean + above, 1.0)

    def compared(self, other: "MissesFound") -> tuple[float, float]:
        """How much less is missed than by another rig at the same places, and the standard error of that."""
        change = [b.probability - a.probability for a, b in zip(self.objects, other.objects, strict=True)]
        variance = np.array([np.var(one, ddof=1) / len(one) for one in change])
        return other.mean - self.mean, math.sqrt(math.fsum(self.weights**2 * variance))

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "share": self.mean,
            "interval_95": list(self.interval),
            "returns": self.returns,
            "within_m": list(self.within_m),
            "places_per_object": len(self.objects[0].places),
            "objects": [
                {"name": one.name, "weight": one.weight, "share": one.share, "interval_95": list(one.interval)}
                for one in self.objects
            ],
        }


@dataclass(frozen=True)
class Misses:
    """The measure for a vehicle."""

    objects: tuple[MissedObject, ...]
    returns: int
    within_m: tuple[float, float]
    obstacles: Obstacles

    @classmethod
    def of(cls, file: MissesFile, body: Footprint, obstacles: Obstacles, ground_m: float, folder: Path) -> "Misses":
        """What a file in a folder says, around a body. Raises ConfigError for an object that is not known."""
        sector = None
        if file.sector_deg:
            sector = math.radians(file.sector_deg[0]), math.radians(file.sector_deg[1])
        within_m = file.within_m or (WITHIN_SMALL_M if is_small(*body.bounds_m) else WITHIN_M)
        zone = StandZone(body, within_m, sector)
        found = []
        for name, weight in file.objects.items():
            target = target_of(ObjectFile(name=name), folder)
            found.append(MissedObject(name, weight, target, zone, ground_m))
        return cls(tuple(found), file.returns, within_m, obstacles)

    @property
    def weights(self) -> Array:
        """(objects,) of the mean."""
        return np.array([one.weight for one in self.objects])

    def known(self, count: int, purpose: int = SEARCH) -> KnownReturns:
        """The returns at so many places of each object; nothing is known of them yet."""
        standing = [Standing(one.target, one.places(count, purpose)) for one in self.objects]
        return KnownReturns(standing, self.obstacles)

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # what is known is found anew

    @cached_property
    def fresh(self) -> KnownReturns:
        """The returns at fresh places, which no search has seen."""
        return self.known(FRESH_PLACES, FRESH)

    def found(
        self, mounts: Sequence[Mount], on_progress: Callable[[float], None] = lambda fraction: None
    ) -> MissesFound:
        """How often a rig misses each object at fresh places. Raises ConfigError for sensors that lack facts."""
        return self.found_at(self.fresh, mounts, on_progress)

    def found_at(
        self, known: KnownReturns, mounts: Sequence[Mount], on_progress: Callable[[float], None] = lambda fraction: None
    ) -> MissesFound:
        """The same at the places of returns that are known."""
        rig = known.rig(mounts)
        every = sum(len(one.places) for one in known.objects)
        done = 0

        def on_places(count: int) -> None:
            nonlocal done
            done += count
            on_progress(done / every)

        found = []
        for number, one in enumerate(self.objects):
            missed = known.miss_probability(rig, number, self.returns, on_places)
            found.append(ObjectMisses(one.name, one.weight, known.objects[number].places, missed))
        return MissesFound(tuple(found), self.returns, self.within_m)
