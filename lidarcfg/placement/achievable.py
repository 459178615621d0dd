"""Requirements that no rig within a study's bounds can meet: beyond all ranges, out of sight, or too dear.

It is said only of what is certain, as far as places go that were tried: the bounds every 0.25 m, and 26 points on the
object's bounding box. What is not found here may be out of reach all the same.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import world
from lidarcfg.geometry import Array
from lidarcfg.placement.study import Study
from lidarcfg.requirements.objects import ObjectRequirement
from lidarcfg.requirements.prices import PriceRequirement
from lidarcfg.requirements.sight import places_within

LOOKED_AT = 48  # places of an object, the nearest to the body, that are looked at from everywhere
FROM = 512  # places of sensors, from which they are


def unachievable(study: Study) -> dict[str, str]:
    """Why no rig can meet a requirement, by its name; those of which it is certain."""
    if study.requirements is None:
        return {}
    found = {}
    for item in study.requirements.items:
        why = None
        if isinstance(item, PriceRequirement) and (least := cheapest_price(study, item)) > item.at_most:
            why = f"the cheapest rig costs {least:,.6g}"
        elif isinstance(item, ObjectRequirement) and item.at_least == 1:
            why = _beyond_range(study, item) or _out_of_sight(study, item)
        if why:
            found[item.name] = why
    return found


def cheapest_price(study: Study, item: PriceRequirement) -> float:
    """Of the cheapest rig; where models are to choose, at least one sensor."""
    if not study.to_choose:
        return item.price(study.rig(study.lower).mounts)
    least = []
    some = []
    for slot in study.slots:
        prices = [choice.price for choice in slot.choices if choice]
        some.append(min(prices))
        least.append(0.0 if None in slot.choices else min(prices))
    return sum(least) or min(some)


def _range_m(study: Study) -> float:
    """The greatest range of any sensor that may be chosen."""
    found = []
    for slot in study.slots:
        sensors = [choice.sensor for choice in slot.choices if choice] or [slot.sensor]
        ranges = (
            [slot.range_m] if slot.range_m else [(one.range.min_m, one.range.max_m) for one in sensors if one.range]
        )
        found += [most for _, most in ranges]
    return max(found, default=np.inf)


def _beyond_range(study: Study, item: ObjectRequirement) -> str | None:
    """Whether some place is farther from all bounds than any sensor's range."""
    assert study.requirements
    bounds = study.requirements.site.bounds
    if not bounds:
        return None
    low, high = item.target.box_m
    radius_m = float(np.linalg.norm(np.maximum(abs(low), abs(high))))
    at = item.stand.base[:, :3]
    nearest = np.full(len(at), np.inf)
    for least, most in bounds:
        nearest = np.minimum(nearest, np.linalg.norm(at - np.clip(at, least, most), axis=1))
    far = int(nearest.argmax())
    if nearest[far] - radius_m <= (most_m := _range_m(study)):
        return None
    x, y = at[far, :2]
    far_m = f"({x:.2f}, {y:.2f}) is {nearest[far]:.1f} m from the bounds of all sensors"
    return f"{far_m}, and no range exceeds {most_m:g} m"


def _out_of_sight(study: Study, item: ObjectRequirement) -> str | None:
    """Whether from nowhere within the bounds there is a line of sight to an object at some place."""
    assert study.requirements
    site = study.requirements.site
    if not site.bounds:
        return None
    sensors = places_within(site.bounds, site.vehicle)
    if not len(sensors) or len(sensors) > FROM:
        return None
    base = item.stand.base
    for place in base[np.argsort(item.stand.distance_m(base), kind="stable")[:LOOKED_AT]]:
        if not _sees(sensors, _points(item, place), site.obstacles.tree, site.obstacles.origin_m):
            at = f"at ({place[0]:.2f}, {place[1]:.2f}), heading {np.degrees(place[3]):.0f}°"
            return f"{at}, it is hidden from all {len(sensors):,} places that were tried within the bounds"
    return None


def _points(item: ObjectRequirement, place: Array) -> Array:
    """(26, 3) corners and middles of edges and faces of the object's bounding box."""
    low, high = item.target.box_m
    thirds = np.array([one for one in product((0.0, 0.5, 1.0), repeat=3) if one != (0.5, 0.5, 0.5)])
    points = low + thirds * (high - low)
    c, s = np.cos(place[3]), np.sin(place[3])
    return np.asarray(points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + place[:3])


def _sees(sensors: Array, points: Array, tree: world.Bvh, origin_m: Array) -> bool:
    """Whether any of some places sees any of some points."""
    starts = np.repeat(sensors, len(points), axis=0) - origin_m
    ways = np.tile(points, (len(sensors), 1)) - origin_m - starts
    blocked: NDArray[np.bool_] = np.empty(len(starts), np.bool_)
    world.any_hits(tree, np.ascontiguousarray(starts.T), np.ascontiguousarray(ways.T), blocked)
    return not blocked.all()
