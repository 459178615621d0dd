"""Requirements that no rig within a study's bounds can meet: out of range or sight, too many returns, too dear.

Only what is certain is reported, as far as sampling goes: the bounds are tried every 0.25 m, and an object at 26
points on its bounding box. A requirement that passes here may be out of reach all the same.
"""

import math
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import world
from lidarcfg.geometry import Array
from lidarcfg.packets.families import pattern
from lidarcfg.placement.slots import Slot
from lidarcfg.placement.study import Study
from lidarcfg.requirements.objects import ObjectRequirement, reached
from lidarcfg.requirements.prices import PriceRequirement
from lidarcfg.requirements.sight import places_within
from lidarcfg.returns.scanners import PHASES
from lidarcfg.sensors.firing import CycleBeams
from lidarcfg.sensors.sensor import Sensor

LOOKED_AT = 48  # directions around the body: in each the nearest place of an object is looked at from everywhere
FROM = 512  # places of sensors, from which they are


def unachievable(study: Study) -> dict[str, str]:
    """Why no rig can meet a requirement, by name, for the requirements where that is certain."""
    if study.requirements is None:
        return {}
    found = {}
    for item in study.requirements.items:
        why = None
        if isinstance(item, PriceRequirement) and (least := cheapest_price(study, item)) > item.at_most:
            why = f"the cheapest rig costs {least:,.6g}"
        elif isinstance(item, ObjectRequirement):
            if item.at_least == 1:
                why = _beyond_range(study, item) or _out_of_sight(study, item)
            why = why or _too_few_beams(study, item)
        if why:
            found[item.name] = why
    return found


def cheapest_price(study: Study, item: PriceRequirement) -> float:
    """The price of the cheapest rig; where models are to choose, of at least one sensor."""
    if not study.to_choose:
        return item.price(study.rig(study.lower).mounts)
    least = []
    some = []
    for slot in study.slots:
        prices = [choice.price for choice in slot.choices if choice]
        some.append(min(prices))
        least.append(0.0 if None in slot.choices else min(prices))
    return sum(least) or min(some)


def _sensors(slot: Slot) -> list[Sensor]:
    """The models that a slot may have."""
    return [choice.sensor for choice in slot.choices if choice] or [slot.sensor]


def _range_m(study: Study) -> float:
    """The greatest range of any sensor that may be chosen."""
    found = []
    for slot in study.slots:
        ranges = (
            [slot.range_m]
            if slot.range_m
            else [(one.range.min_m, one.range.max_m) for one in _sensors(slot) if one.range]
        )
        found += [most for _, most in ranges]
    return max(found, default=np.inf)


def _beyond_range(study: Study, item: ObjectRequirement) -> str | None:
    """Whether some place is farther from all bounds than any sensor's range."""
    at = item.stand.base[:, :3]
    distance_m = _from_bounds_m(study, at)
    low, high = item.target.box_m
    radius_m = float(np.linalg.norm(np.maximum(abs(low), abs(high))))
    far = int(distance_m.argmax())
    if distance_m[far] - radius_m <= (most_m := _range_m(study)):
        return None
    x, y = at[far, :2]
    far_m = f"({x:.2f}, {y:.2f}) is {distance_m[far]:.1f} m from the bounds of all sensors"
    return f"{far_m}, and no range exceeds {most_m:g} m"


def _from_bounds_m(study: Study, at_m: Array) -> Array:
    """(N,) the distances of points (N, 3) from the nearest bounds of any sensor; 0 where these are not known."""
    assert study.requirements
    bounds = study.requirements.site.bounds
    if not bounds:
        return np.zeros(len(at_m))
    each = [np.linalg.norm(at_m - np.clip(at_m, low, high), axis=1) for low, high in bounds]
    return np.asarray(np.min(each, axis=0))


def _too_few_beams(study: Study, item: ObjectRequirement) -> str | None:
    """Whether at a place that counts fewer beams than are demanded can hit the ball around the object's bounding box.

    With a fraction of positions, those nearest to the bounds count.
    """
    low, high = item.target.box_m
    radius_m = 0.5 * float(np.linalg.norm(high - low))
    at = np.unique(item.stand.base[:, :3], axis=0)
    distance_m = np.sort(_from_bounds_m(study, at + 0.5 * (low + high)))[math.ceil(item.at_least * len(at) - 1e-9) - 1]
    most = []
    for slot, mount in zip(study.slots, study.rig(study.lower).mounts, strict=True):
        beams = [pattern(replace(mount, sensor=sensor)).beams(sensor, PHASES) for sensor in _sensors(slot)]
        most.append(max(most_returns(one, radius_m, distance_m) for one in beams))
    returns = int(reached(np.array([most], np.int32), item.lost, item.sensors)[0])
    if returns >= item.returns:
        return None
    who = "the sensors together get" if item.sensors is None else f"{item.sensors} of the sensors get, each alone,"
    return f"{who} at most {returns:,} returns from {distance_m:.1f} m away"


def most_returns(beams: CycleBeams, radius_m: float, distance_m: float) -> int:
    """The most beams of a revolution, or a frame, that can hit a ball, however the sensor is turned.

    The ball's middle is at a distance. The beams that hit it, moved to the sensor's origin, are within a cone. So their
    elevations differ by its whole angle at most; and the azimuths at an elevation by twice asin(sin of half the angle
    / cos of the elevation), as in a spherical triangle with a right angle where the cone's middle is.
    """
    radius_m += float(np.linalg.norm(beams.start_m, axis=1).max())
    half_rad = maths.asin(radius_m / distance_m) if radius_m < distance_m else math.pi / 2
    spacing_rad = beams.step_rad * beams.phases
    most = 0
    for phase in range(beams.phases):
        heads_rad, firings = beams.of_phase(phase)
        elevation_rad = np.sort(beams.elevation_rad[firings])
        sine = maths.sin(half_rad) / np.maximum(maths.cos(elevation_rad), 1e-12)
        number = np.full(len(firings), len(heads_rad))
        narrow = (sine < 1) & (spacing_rad > 0)
        within = 2 * maths.asin(sine[narrow]) / max(spacing_rad, 1e-12)
        number[narrow] = np.minimum(within + 2, len(heads_rad))  # one more where a revolution ends
        before = np.concatenate([[0], np.cumsum(number)])
        last = np.searchsorted(elevation_rad, elevation_rad + 2 * half_rad + 1e-9, side="right")
        most = max(most, int((before[last] - before[:-1]).max()))
    return most


def _out_of_sight(study: Study, item: ObjectRequirement) -> str | None:
    """Whether at some place too few sensors have a line of sight to the object from anywhere within their bounds."""
    assert study.requirements
    site = study.requirements.site
    if not site.bounds:
        return None
    within = [places_within([box], site.vehicle) for box in site.bounds]
    tried = sum(map(len, within))
    if not tried or tried > FROM:
        return None
    needed = item.lost + (item.sensors or 1)
    for place in _nearest(item):
        points = _points(item, place)
        seeing = sum(_sees(places, points, site.obstacles.tree, site.obstacles.origin_m) for places in within)
        if seeing >= needed:
            continue
        at = f"at ({place[0]:.2f}, {place[1]:.2f}), heading {np.degrees(place[3]):.0f}°"
        if not seeing:
            return f"{at}, it is hidden from all {tried:,} places that were tried within the bounds"
        few = f"at most {seeing} of the {len(within)} sensors can see it, of {tried:,} places that were tried"
        return f"{at}, {few}; {needed} have to"
    return None


def _nearest(item: ObjectRequirement) -> Array:
    """(n, 4) places near the body, or without one near the origin: the nearest position in each direction."""
    base = item.stand.base
    body = item.stand.zone.body
    direction = np.floor(maths.atan2(base[:, 1], base[:, 0]) * (LOOKED_AT / (2 * math.pi)))
    distance_m = body.to_points_m(base[:, :2]) if body else np.linalg.norm(base[:, :2], axis=1)
    order = np.argsort(distance_m, kind="stable")
    return base[order[np.unique(direction[order], return_index=True)[1]]]


def _points(item: ObjectRequirement, place: Array) -> Array:
    """(26, 3) corners and middles of edges and faces of the object's bounding box."""
    low, high = item.target.box_m
    thirds = np.array([one for one in product((0.0, 0.5, 1.0), repeat=3) if one != (0.5, 0.5, 0.5)])
    points = low + thirds * (high - low)
    c = maths.cos(place[3])
    s = maths.sin(place[3])
    return np.asarray(points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + place[:3])


def _sees(sensors: Array, points: Array, tree: world.Bvh, origin_m: Array) -> bool:
    """Whether any of some places sees any of some points."""
    starts = np.repeat(sensors, len(points), axis=0) - origin_m
    ways = np.tile(points, (len(sensors), 1)) - origin_m - starts
    blocked: NDArray[np.bool_] = np.empty(len(starts), np.bool_)
    world.any_hits(tree, np.ascontiguousarray(starts.T), np.ascontiguousarray(ways.T), blocked)
    return not blocked.all()
