"""Requirements that no rig within a study's bounds can meet: out of range, too many returns, too dear.

Only what is certain is reported. A requirement that passes here may be out of reach all the same, for example out of
sight, of which some places within the bounds prove nothing.
"""

import math
from dataclasses import replace

import numpy as np

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.packets.families import pattern
from lidarcfg.placement.slots import Slot
from lidarcfg.placement.study import Study
from lidarcfg.requirements.objects import ObjectRequirement, reached
from lidarcfg.requirements.prices import PriceRequirement, total_price
from lidarcfg.returns.scanners import PHASES
from lidarcfg.sensors.firing import CycleBeams
from lidarcfg.sensors.sensor import Sensor

ROUNDING = 1e-9  # metres, radians, and beams


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
            why = _beyond_range(study, item) or _too_few_beams(study, item)
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
    return total_price(least) or min(some)


def _sensors(slot: Slot) -> list[Sensor]:
    """The models that a slot may have."""
    return [choice.sensor for choice in slot.choices if choice] or [slot.sensor]


def _reach_m(study: Study) -> tuple[float, float]:
    """The greatest range of any sensor that may be chosen, and the farthest that a beam starts from its sensor."""
    ranges_m = [0.0]
    starts_m = [0.0]
    for slot in study.slots:
        for sensor in _sensors(slot):
            own = sensor.range.max_m if sensor.range else math.inf
            ranges_m.append(slot.range_m[1] if slot.range_m else own)
            offsets_m = sensor.forward_offset_m, sensor.lateral_offset_m, sensor.vertical_offset_m
            starts_m.append(float(np.linalg.norm(offsets_m, axis=0).max(initial=0.0)))
    return max(ranges_m), max(starts_m)


def _beyond_range(study: Study, item: ObjectRequirement) -> str | None:
    """Whether some place is farther from all bounds than any sensor's range."""
    if item.at_least < 1:
        return None
    at = item.stand.base[:, :3]
    distance_m = _from_bounds_m(study, at)
    low, high = item.target.box_m
    radius_m = math.hypot(*np.maximum(abs(low), abs(high)))
    far = int(distance_m.argmax())
    most_m, start_m = _reach_m(study)
    if distance_m[far] <= most_m + start_m + radius_m + ROUNDING:
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
    radius_m = 0.5 * math.dist(low, high)
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
        within = 2 * maths.asin(sine[narrow]) / max(spacing_rad, 1e-12) + ROUNDING
        number[narrow] = np.minimum(within + 2, len(heads_rad))  # one more where a revolution ends
        before = np.concatenate([[0], np.cumsum(number)])
        last = np.searchsorted(elevation_rad, elevation_rad + 2 * half_rad + ROUNDING, side="right")
        most = max(most, int((before[last] - before[:-1]).max()))
    return most
