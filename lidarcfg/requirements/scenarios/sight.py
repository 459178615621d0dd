"""The earliest line of sight to a scenario's target: when a place within the bounds first sees a point of it.

Places and points are samples, so a sight between them may begin a little earlier: `LineOfSight` has their numbers.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from lidarcfg.core import world
from lidarcfg.geometry import Array
from lidarcfg.requirements.allowed_rigs import Bounds
from lidarcfg.requirements.scenarios.approach import Approach
from lidarcfg.requirements.scenarios.file import Scenario
from lidarcfg.world.tracer import Tracer, build_bvh
from lidarcfg.world.vehicle import Vehicle

PLACES_M = 0.25  # between places, at most
POINTS_M = 0.1  # between points of the target, about
STEP_S = 0.02  # in which the sight is looked for
EXACT_S = 1e-4  # to which its beginning is found


@dataclass(frozen=True)
class LineOfSight:
    """Whether, and from when on, some place sees the target without a break until the last moment to brake."""

    seconds: float | None  # since the start of the run; none: not before the impact
    places: int  # tried
    points: int  # of the target


def places_within(bounds: Bounds, vehicle: Vehicle | None = None) -> Array:
    """(N, 3) places on grids over boxes, their corners included; without those in closed bodies, unless allowed."""
    grids = []
    for low, high in bounds:
        counts = np.ceil((np.asarray(high) - low) / PLACES_M).astype(int) + 1
        axes = [
            np.linspace(a, b, count) if b > a else np.array([a]) for a, b, count in zip(low, high, counts, strict=True)
        ]
        grids.append(np.array(list(product(*axes))))
    places = np.unique(np.concatenate(grids), axis=0)
    if vehicle and not vehicle.allow_inside:
        for solid in vehicle.solids:
            places = places[~solid.inside(places)]
    return places


def points_of(scenario: Scenario) -> Array:
    """(M, 3) points of the target relative to its place: of a box on its edges, of a mesh some of its corners."""
    low, high = scenario.target.box_m
    if scenario.mesh is None:
        counts = np.ceil((high - low) / POINTS_M).astype(int) + 1
        axes = [np.linspace(a, b, count) for a, b, count in zip(low, high, counts, strict=True)]
        edges = []
        for axis in range(3):
            ends = [axes[other] if other == axis else axes[other][[0, -1]] for other in range(3)]
            edges.append(np.array(list(product(*ends))))
        return np.unique(np.concatenate(edges), axis=0)
    vertices = scenario.target.mesh[0] - scenario.target.origin_m
    extremes = np.concatenate([vertices.argmin(axis=0), vertices.argmax(axis=0)])
    _, first = np.unique(np.floor(vertices / POINTS_M), axis=0, return_index=True)
    return np.asarray(vertices[np.union1d(first, extremes)])


class _SightTest:
    """Tests whether any of some places sees any of the target's points at a time."""

    def __init__(self, approach: Approach, places: Array, vehicle: Vehicle | None) -> None:
        self._approach = approach
        self._places = places
        self._points = points_of(approach.scenario)
        self._cars = _cars(approach)
        self._bodies = Tracer(vehicle.scene, np.zeros(3)) if vehicle else None
        self._seen: tuple[Array, Array] | None = None  # a place and a point between which there was a sight

    @property
    def points(self) -> int:
        """Of the target."""
        return len(self._points)

    def __call__(self, seconds: float) -> bool:
        if self._seen and self._clear(*self._seen, seconds).any():
            return True
        place = np.repeat(self._places, len(self._points), axis=0)
        point = np.tile(self._points, (len(self._places), 1))
        clear = np.flatnonzero(self._clear(place, point, seconds))
        self._seen = (place[clear[:1]], point[clear[:1]]) if len(clear) else None
        return len(clear) > 0

    def _clear(self, places: Array, points: Array, seconds: float) -> Array:
        """(N,) whether nothing is between places (N, 3) of the vehicle and points (N, 3) of the target."""
        moved = np.append(self._approach.velocity_m_s * seconds, 0.0)
        targets = self._approach.target_points(points, seconds)
        blocked = np.empty(len(places), np.bool_)
        starts = np.ascontiguousarray((places + moved).T)
        world.any_hits(self._cars, starts, np.ascontiguousarray((targets - places - moved).T), blocked)
        if self._bodies is not None:
            blocked |= self._bodies.blocked(places, targets - moved)
        return np.asarray(~blocked)


def _cars(approach: Approach) -> world.Bvh:
    """The hierarchy over the parked cars."""
    scene = approach.scene
    parked = {car.name for car in approach.scenario.file.cars}
    return build_bvh(scene, np.array([name in parked for name in scene.names]), np.zeros(3))


def earliest_sight(approach: Approach, last_s: float, places: Array, vehicle: Vehicle | None) -> LineOfSight:
    """From when on places (N, 3) of the vehicle see the target at all times until `last_s`; or the first after it."""
    is_seen = _SightTest(approach, places, vehicle)
    if len(places) and is_seen(last_s):
        hidden_s = last_s
        while is_seen(hidden_s):
            if hidden_s <= 0.0:
                return LineOfSight(0.0, len(places), is_seen.points)
            hidden_s = max(hidden_s - STEP_S, 0.0)
        return LineOfSight(_bisected(is_seen, hidden_s, hidden_s + STEP_S), len(places), is_seen.points)
    for seen_s in np.arange(last_s + STEP_S, approach.lead_s, STEP_S).tolist():
        if len(places) and is_seen(seen_s):
            return LineOfSight(_bisected(is_seen, seen_s - STEP_S, seen_s), len(places), is_seen.points)
    return LineOfSight(None, len(places), is_seen.points)


def _bisected(is_seen: _SightTest, hidden_s: float, seen_s: float) -> float:
    """When the sight begins, between a time without and a time with it."""
    while seen_s - hidden_s > EXACT_S:
        middle_s = 0.5 * (hidden_s + seen_s)
        if is_seen(middle_s):
            seen_s = middle_s
        else:
            hidden_s = middle_s
    return seen_s
