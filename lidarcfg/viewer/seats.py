"""Sensors on a surface that are moved on the page: they slide along it and stop where a base no longer fits."""

import math

import numpy as np

from lidarcfg.geometry import Array, leaning, rotation, up
from lidarcfg.placement.study import Study
from lidarcfg.placement.surfaces import Surface, mirrored, violation
from lidarcfg.sensors.rig import Rig
from lidarcfg.viewer.bodies import has_its_sensors

STEPS = 64  # of a move, and again of the step in which a base no longer fits: where it stops is known to 1/4096

SETTLED = 3  # times that a base is shifted, until the sensor is where it is wanted


def seats(study: Study, rig: Rig) -> list[int]:
    """The sensors of a rig that sit on a surface; none for a rig with other sensors."""
    ours = has_its_sensors(study, rig)
    return [i for i, slot in enumerate(study.slots) if slot.surface and ours]


def seated(study: Study, poses: Array, number: int, wanted: Array, mirrors: bool) -> Array:
    """(mounts, 6) the poses (mounts, 6) of a rig with one sensor moved towards a pose (6,), as far as it sits there.

    Its base stays on the surface, and its axis as the surface has it. The other one of a pair follows if it `mirrors`,
    and then both sit. A base that sits nowhere on the way goes to the nearest place that fits.
    """
    surface = study.slots[number].surface
    assert surface
    pair = [number]
    if mirrors and surface.mirror_y_m is not None:
        pair = [number - 1, number] if surface.is_image else [number, number + 1]
    start_m = surface.bases_m(poses[number, None])[0]
    goal = np.concatenate([start_m + (wanted - poses[number])[:3], _attitude(study, number, wanted[3:])])
    start = np.concatenate([start_m, goal[3:]])
    for _ in range(SETTLED if not surface.upright else 0):  # the normal there is another, which it stands off along
        ahead = (wanted - surface.poses(goal[None])[0])[:3]
        goal[list(surface.across)] += ahead[list(surface.across)]
    found = _farthest(study, pair, number, start, goal)
    if found is None:
        nearest_m = surface.patch.nearest_m(goal[:3], surface.across)
        found = _placed(study, pair, number, np.concatenate([nearest_m, goal[3:]])[None])[0]
    out = poses.copy()
    out[pair] = found
    return out


def _farthest(study: Study, pair: list[int], number: int, start: Array, goal: Array) -> Array | None:
    """(pair, 6) the poses farthest on the way between coordinates (6,) where the bases fit; None if there are none."""
    surfaces = [study.slots[i].surface for i in pair]
    first = 0.0
    last = 1.0
    best: Array | None = None
    for _ in range(2):
        part = np.linspace(first, last, STEPS + 1)[:, None]
        poses = _placed(study, pair, number, (1 - part) * start + part * goal)
        fits = np.flatnonzero(_misfit(surfaces, poses) == 0.0)
        if not len(fits):
            return best
        best = poses[fits[-1]]
        if fits[-1] == STEPS:
            return best
        first = part[fits[-1], 0]
        last = part[fits[-1] + 1, 0]
    return best


def _misfit(surfaces: list[Surface | None], poses: Array) -> Array:
    """(n,) by how much sensors at poses (n, sensors, 6) do not sit, in metres: one, or both of a pair."""
    if len(surfaces) > 1 or surfaces[0] is None:
        return violation(surfaces, poses)
    return surfaces[0].violation(poses[:, 0])


def _placed(study: Study, pair: list[int], number: int, coordinates: Array) -> Array:
    """(n, pair, 6) poses at coordinates (n, 6) of one of a pair, and at their images of the other."""
    found = []
    for i in pair:
        surface = study.slots[i].surface
        assert surface
        there = coordinates if i == number else mirrored(coordinates, surface.mirror_y_m or 0.0)
        found.append(surface.poses(there))
    return np.stack(found, axis=1)


def _attitude(study: Study, number: int, rpy_rad: Array) -> Array:
    """(3,) the angles of coordinates for wanted ones (3,): roll and pitch within their bounds, or only yaw."""
    surface = study.slots[number].surface
    assert surface
    if not surface.upright:
        tilted = rotation(leaning(up(rpy_rad), np.zeros(())))
        turn = tilted.T @ rotation(rpy_rad)
        return np.array([0.0, 0.0, math.atan2(turn[1, 0], turn[0, 0])])
    low = study.lower[number, 3:5]
    high = study.upper[number, 3:5]
    sides = np.array([-1.0 if surface.is_image else 1.0, 1.0])  # an image's roll is the other way round
    tilt = [
        _bounded(*bounds) for bounds in zip((sides * rpy_rad[:2]).tolist(), low.tolist(), high.tolist(), strict=True)
    ]
    return np.array([*(sides * tilt), rpy_rad[2]])


def _bounded(angle: float, low: float, high: float) -> float:
    """The angle, or the nearer end of its bounds."""
    if (angle - low) % math.tau <= high - low:
        return angle
    return min((low, high), key=lambda end: abs(math.remainder(angle - end, math.tau)))
