"""The places at which an object must be seen: a base grid in a zone, and a finer one around some of its places."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Annotated

import numpy as np
import shapely
from pydantic import AfterValidator, Field
from shapely.geometry.base import BaseGeometry

from lidarcfg import maths
from lidarcfg.config.models import validation_error
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Flags
from lidarcfg.inputs import check_memory
from lidarcfg.sensors.rig import Distance
from lidarcfg.world.footprint import Footprint

NEAR_M = 5.0  # from the body: as far out places lie at most half the object's least width apart
STEP_M = 0.5  # between places farther out, unless the requirement says otherwise; or half the width if that is more
FINEST_M = 0.0125  # between refined places: with 0.025 m one minimum in ten is missed by 2 returns or more
FINEST_RAD = math.radians(15)  # between refined headings
TOUCHING_M = 1e-3  # from the body: nearer, an object touches it
LEAST_STEP_M = 0.02  # in a zone that holds no place of a coarser grid
PLACES_MAX = 5_000_000
PLACE_BYTES = 300  # of memory, while they are found
KEYS_PER_UNIT = 1e6  # metres and radians, by which places are told apart
# Multiples of the spacing along x and y whose sums, modulo 1, are spread evenly: the R2 sequence (Roberts 2018).
SPREAD = np.array([0.7548776662466927, 0.5698402909980532])
DRAWN_AT_A_TIME = 1 << 11  # a power of 2, as Sobol's sequence asks for
TRIES_MAX = 1 << 22
FIT_M = 1e-9  # by which an object may reach over the zone's side, for rounding


def ascending(value: tuple[float, float]) -> tuple[float, float]:
    """A range whose end is above its beginning. Raises a fault otherwise."""
    if not value[0] < value[1]:
        raise validation_error(f"{value[1]:g} is not above {value[0]:g}", 1)
    return value


def _at_most_a_turn(value: tuple[float, float]) -> tuple[float, float]:
    first, last = value
    if not 0 < last - first <= 360:
        what = f"{last:g} is not above {first:g} by 360 at most; give from and to, counter-clockwise from ahead"
        raise validation_error(f"{what}, such as [-45, 45] or [135, 225]", 1)
    return value


Heading = Annotated[float, Field(ge=-360, le=360)]  # degrees
Distances = Annotated[tuple[Distance, Distance], AfterValidator(ascending)]  # least, greatest
Sector = Annotated[tuple[Heading, Heading], AfterValidator(_at_most_a_turn)]  # from, to, counter-clockwise from ahead


@dataclass(frozen=True)
class StandZone:
    """Where an object may stand: within distances of the body and in a sector, or in a box; never in the body."""

    body: Footprint | None = None
    within_m: tuple[float, float] | None = None  # least, greatest distance from the body
    sector_rad: tuple[float, float] | None = None  # from, to, counter-clockwise from ahead, about the body's middle
    box_m: tuple[Array, Array] | None = None  # (2,) each: corners of what wholly contains the object

    def allows(self, at_m: Array) -> Flags:
        """(P,) which positions (P, 2) are in the sector."""
        if self.sector_rad is None or self.body is None:
            return np.ones(len(at_m), np.bool_)
        first, last = self.sector_rad
        x, y = (at_m - self.body.middle_m).T
        return np.asarray(np.mod(maths.atan2(y, x) - first, 2 * math.pi) <= last - first + 1e-12)


@dataclass(frozen=True)
class Stand:
    """An object that may stand in a zone at some headings."""

    zone: StandZone
    footprint: Footprint  # of the object at heading 0, about its place
    headings_rad: Array  # (H,)
    ground_m: float  # height in the vehicle frame
    step_m: float | None = None  # between places, at most

    @property
    def width_m(self) -> float:
        """The least width of the object's bounding box."""
        low, high = self.footprint.bounds_m
        return float((high - low).min())

    @cached_property
    def near_step_m(self) -> float:
        """Between places near the body."""
        return min(self.width_m / 2, self.far_step_m)

    @cached_property
    def far_step_m(self) -> float:
        """Between places farther out."""
        return self.step_m or max(STEP_M, self.width_m / 2)

    @property
    def near_m(self) -> float:
        """As far from the body as positions are near it."""
        return NEAR_M + self.footprint.radius_m

    def distance_m(self, places: Array) -> Array:
        """(P,) the object's distances from the body at places (P, 4); inf without a body."""
        body = self.zone.body
        return body.to_objects_m(self.footprint, places) if body else np.full(len(places), np.inf)

    def holds(self, places: Array) -> Flags:
        """(P,) whether places (P, 4) are in the zone and do not overlap the body."""
        zone = self.zone
        body = zone.body
        kept = zone.allows(places[:, :2])
        if zone.box_m is not None:
            low, high = self._reach_m(places[:, 3])
            kept &= (places[:, :2] + low >= zone.box_m[0] - FIT_M).all(axis=1)
            kept &= (places[:, :2] + high <= zone.box_m[1] + FIT_M).all(axis=1)
        if body is None:
            return kept
        least_m, most_m = zone.within_m or (0.0, math.inf)
        some = np.flatnonzero(kept)
        middle_m = np.full(len(places), np.nan)
        middle_m[some] = body.to_points_m(places[some, :2])
        nearest_m = middle_m - self.footprint.radius_m  # that the object may be
        farthest_m = middle_m - self.footprint.inner_radius_m
        kept[some] = (nearest_m[some] <= most_m) & (farthest_m[some] >= least_m - 2 * FIT_M)
        unsure = np.flatnonzero(kept & ~((nearest_m > least_m) & (farthest_m <= most_m)))
        kept[unsure] = body.are_beside(max(least_m - FIT_M, 0.0), most_m + FIT_M, self.footprint, places[unsure])
        return kept

    def _reach_m(self, headings_rad: Array) -> tuple[Array, Array]:
        """(P, 2) each: the lower and the upper corner of the object's bounds at some headings, about its place."""
        x, y = np.concatenate(self.footprint.outlines_m).T
        values, index = np.unique(headings_rad, return_inverse=True)
        low, high = np.empty((len(values), 2)), np.empty((len(values), 2))
        for n, heading in enumerate(values):
            c, s = maths.cos(heading), maths.sin(heading)
            turned = np.stack([c * x - s * y, s * x + c * y], axis=1)
            low[n], high[n] = turned.min(axis=0), turned.max(axis=0)
        return low[index], high[index]

    @cached_property
    def base(self) -> Array:
        """(P, 4) x, y, the ground's z and the heading of the base grid's places. Raises ConfigError if none is free."""
        near_m, far_m = self.near_step_m, self.far_step_m
        while True:
            found = self._grid(near_m, far_m)
            if len(found):
                return found
            if far_m <= LEAST_STEP_M:
                raise ConfigError("the object fits nowhere in this zone beside the body; widen the zone")
            near_m, far_m = max(near_m / 2, LEAST_STEP_M), max(far_m / 2, LEAST_STEP_M)

    def thinned(self, most: int) -> Array:
        """(P, 4) the base grid; of a greater one about `most` places, spread evenly, each position at all headings.

        Those of a lower `most` are among them.
        """
        share = most / len(self.base)
        return self.base if share >= 1 else np.ascontiguousarray(self.base[self.spread(self.base) < share])

    def spread(self, places: Array) -> Array:
        """(P,) from 0 to 1: the first places (P, 4) by this order are spread evenly over a grid."""
        return np.asarray((places[:, 0] * SPREAD[0] + places[:, 1] * SPREAD[1]) / self.near_step_m % 1)

    @cached_property
    def edge(self) -> Array:
        """(P, 4) places at the least and the greatest distance from the body: base places near these, pushed there."""
        body = self.zone.body
        within_m = self.zone.within_m
        if body is None or within_m is None:
            return np.empty((0, 4))
        middle_m = body.to_points_m(self.base[:, :2])
        found = []
        for limit_m, step_m in zip(
            (max(within_m[0], TOUCHING_M), within_m[1]), (self.near_step_m, self.far_step_m), strict=True
        ):
            places = self.base[abs(middle_m - limit_m) < self.footprint.radius_m + 2 * step_m]
            way = body.ways_to_objects_m(self.footprint, places)
            length_m = np.linalg.norm(way, axis=1)
            some = (length_m > 0) & (abs(length_m - limit_m) < 1.5 * step_m)
            pushed = places[some].copy()
            pushed[:, :2] += way[some] * (limit_m / length_m[some] - 1)[:, None]
            found.append(pushed)
        places = np.concatenate(found)
        return np.ascontiguousarray(places[self.holds(places)])

    def _grid(self, near_m: float, far_m: float) -> Array:
        """(P, 4) the places of a grid of these spacings near the body and farther out."""
        body = self.zone.body
        if body is None or near_m == far_m:
            at = self._lattice(*self._bounds_m(), far_m)
        else:
            reach_m = self.near_m
            low, high = self._bounds_m()
            near = self._lattice(
                np.maximum(low, body.bounds_m[0] - reach_m), np.minimum(high, body.bounds_m[1] + reach_m), near_m
            )
            far = self._lattice(low, high, far_m)
            at = np.concatenate(
                [near[body.to_points_m(near) <= reach_m], far[body.to_points_m(far) > reach_m]],
            )
        return self.standing(at)

    def drawn(self, count: int, seed: Sequence[int], at_any_heading: bool) -> Array:
        """(count, 4) places drawn uniformly in area, at any heading or at one of its own; fewer are the first of these.

        Scrambled points of Sobol's sequence, of which those that are not in the zone are left out. Raises ConfigError
        where hardly any is in it.
        """
        from scipy.stats import qmc  # takes half a second to load

        low, high = self._bounds_m()
        sobol = qmc.Sobol(3, rng=np.random.default_rng(list(seed)))
        found: list[Array] = []
        missing = count
        for _ in range(TRIES_MAX // DRAWN_AT_A_TIME):
            unit = sobol.random(DRAWN_AT_A_TIME)
            x, y = (low + unit[:, :2] * (high - low)).T
            heading = 2 * math.pi * unit[:, 2]
            if not at_any_heading:
                heading = self.headings_rad[(unit[:, 2] * len(self.headings_rad)).astype(np.intp)]
            places = np.stack([x, y, np.full_like(x, self.ground_m), heading], axis=1)
            found.append(places[self.holds(places)][:missing])
            missing -= len(found[-1])
            if not missing:
                return np.concatenate(found)
        raise ConfigError("hardly a place in the zone is free; widen within_m or sector_deg")

    def _lattice(self, low: Array, high: Array, step_m: float) -> Array:
        """(n, 2) positions of a grid from low to high; it goes through the box's middle, or the vehicle's origin."""
        middle = np.zeros(2) if self.zone.box_m is None else (self.zone.box_m[0] + self.zone.box_m[1]) / 2
        numbers = np.stack([np.ceil((low - middle) / step_m - FIT_M), np.floor((high - middle) / step_m + FIT_M) + 1])
        count = math.prod(np.maximum(numbers[1] - numbers[0], 0).tolist()) * len(self.headings_rad)
        advice = "give a larger step_m, a smaller zone, or fewer headings_deg"
        if count > PLACES_MAX:
            raise ConfigError(f"{count:,.0f} places; allowed: at most {PLACES_MAX:,}; {advice}")
        check_memory(f"a grid of {count:,.0f} places", PLACE_BYTES * count, advice)
        x, y = (middle[axis] + step_m * np.arange(*numbers[:, axis]) for axis in (0, 1))
        return np.stack(np.broadcast_arrays(x[:, None], y), axis=-1).reshape(-1, 2)

    def _bounds_m(self) -> tuple[Array, Array]:
        """(2,) each: corners of a box that holds all places."""
        if self.zone.box_m is not None:
            return self.zone.box_m
        assert self.zone.body is not None
        assert self.zone.within_m is not None
        low, high = self.zone.body.bounds_m
        reach_m = self.zone.within_m[1] + self.footprint.radius_m
        return low - reach_m, high + reach_m

    def standing(self, at_m: Array) -> Array:
        """(n, 4) the places at positions (P, 2), at all headings, that are in the zone."""
        shape = len(at_m), len(self.headings_rad)
        columns = at_m[:, :1], at_m[:, 1:], self.ground_m, self.headings_rad
        places = np.stack([np.broadcast_to(column, shape).ravel() for column in columns], axis=1)
        return np.ascontiguousarray(places[self.holds(places)])

    @cached_property
    def area(self) -> BaseGeometry:
        """Where the object's middle may be, at any heading; a sector does not narrow it."""
        zone = self.zone
        if zone.box_m is not None:
            return shapely.box(*zone.box_m[0], *zone.box_m[1])
        assert zone.body is not None
        assert zone.within_m is not None
        least_m, most_m = zone.within_m
        reach = zone.body.shape.buffer(most_m + self.footprint.radius_m)
        return reach.difference(zone.body.shape.buffer(least_m + self.width_m / 2))

    @property
    def first_steps(self) -> tuple[float, float]:
        """The spacing of the base grid, farther out, and of its headings; 0 where there is one."""
        turns = np.diff(self.headings_rad)
        return self.far_step_m, float(turns.min()) if len(turns) else 0.0

    @property
    def refinements(self) -> Iterator[tuple[float, float]]:
        """Ever finer spacings of positions and of headings, from half those of the base grid on."""
        step_m, step_rad = self.first_steps
        while step_m > FINEST_M or step_rad > FINEST_RAD:
            step_m = step_m / 2 if step_m > 2 * FINEST_M else min(step_m, FINEST_M)
            step_rad = step_rad / 2 if step_rad > 2 * FINEST_RAD else min(step_rad, FINEST_RAD)
            yield step_m, step_rad

    def around(self, places: Array, step_m: float, step_rad: float, seen: set[tuple[int, ...]]) -> Array:
        """(n, 4) the neighbours of places (P, 4) at these spacings that are in the zone and not in `seen`.

        They are added to it.
        """
        steps = (-step_m, 0.0, step_m)
        turns = (-step_rad, 0.0, step_rad) if step_rad else (0.0,)
        offsets = np.array([(x, y, 0.0, turn) for x, y, turn in product(steps, steps, turns)])
        found = (places[:, None] + offsets).reshape(-1, 4)
        found[:, 3] %= 2 * math.pi
        keys = np.rint(found[:, [0, 1, 3]] * KEYS_PER_UNIT).astype(np.int64).tolist()
        fresh = []
        for number, key in enumerate(map(tuple, keys)):
            if key not in seen:
                seen.add(key)
                fresh.append(number)
        found = found[fresh]
        return np.ascontiguousarray(found[self.holds(found)])
