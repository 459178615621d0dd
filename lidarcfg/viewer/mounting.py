"""A rig in a study: its bounds and constraints, mirrored pairs, and sensors that slide along the vehicle's surface."""

import math
from itertools import combinations

import numpy as np

from lidarcfg.geometry import Array, leaning, rotation, up
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.file import COORDINATES
from lidarcfg.study.study import Study
from lidarcfg.study.surfaces import Surface, mirrored, violation

TOLERANCE = 1e-9  # metres and radians
STEPS = 64  # of a move, and again of the step in which a base no longer fits: where it stops is known to 1/4096
SHIFTS = 3  # times that a base is shifted, until the sensor is where it is wanted


def mirrored_pairs(study: Study, rig: Rig) -> list[tuple[int, int, float]]:
    """A sensor, its mirror image and the y of the plane between them; none for a rig with other sensors."""
    if not has_its_sensors(study, rig):
        return []
    return [(i - 1, i, y_m) for i, y_m in enumerate(study.space.mirror.tolist()) if not np.isnan(y_m)]


def has_its_sensors(study: Study, rig: Rig) -> bool:
    """Whether a rig has exactly the sensors of a study."""
    ours, theirs = ([one.sensor for one in some] for some in (study.slots, rig.mounts))
    return [(one.beams, one.scan_pattern) for one in theirs] == [(one.beams, one.scan_pattern) for one in ours]


def poses_in_study(study: Study, rig: Rig) -> Array:
    """(slots, 6) of a rig with the study's sensors; (0, 6) of another."""
    if not has_its_sensors(study, rig):
        return np.empty((0, 6))
    return np.array([(*mount.position_m, *mount.rpy_rad) for mount in rig.mounts])


def violations(study: Study, rig: Rig) -> list[str]:
    """Which of the study's bounds and constraints a rig violates, in words; none for a rig with other sensors."""
    found: list[str] = []
    space = study.space
    poses = poses_in_study(study, rig)
    if not len(poses):
        return found
    tilt_deg = np.degrees(np.arccos(np.clip(up(poses[:, 3:])[:, 2], -1.0, 1.0)))
    for i, mount in enumerate(rig.mounts):
        surface = study.slots[i].surface
        if surface:
            found += [
                f"{mount.name}: {text}"
                for text in _surface_violations(surface, poses[i], space.lower[i], space.upper[i])
            ]
        elif np.isnan(space.mirror[i]):
            found += [f"{mount.name}: {text}" for text in _bound_violations(poses[i], space.lower[i], space.upper[i])]
        else:
            image = poses[i - 1] * (1, -1, 1, -1, 1, -1) + (0, 2 * space.mirror[i], 0, 0, 0, 0)
            if not (_is_close(poses[i, :3], image[:3]) and _is_close(up(poses[i, 3:]), up(image[3:]))):
                found.append(
                    f"{mount.name}: is not the mirror image of {rig.mounts[i - 1].name} in y = {space.mirror[i]:g} m"
                )
        if tilt_deg[i] > study.constraints.max_tilt_deg + TOLERANCE:
            found.append(f"{mount.name}: tilt {tilt_deg[i]:.2f}° is above {study.constraints.max_tilt_deg:g}°")
    for i, j in combinations(range(len(poses)), 2):
        apart_m = float(np.linalg.norm(poses[i, :3] - poses[j, :3]))
        if apart_m < study.constraints.min_distance_m - TOLERANCE:
            names = f"{rig.mounts[i].name} and {rig.mounts[j].name}"
            found.append(f"{names}: {apart_m:.3f} m apart; allowed: {study.constraints.min_distance_m:g} m and more")
    return found


def _surface_violations(surface: Surface, pose: Array, low: Array, high: Array) -> list[str]:
    """Whether a sensor does not sit on its surface, and which of its angles (6,) are out of bounds."""
    is_off = surface.violation(pose[None])[0] > 0
    found = [f"its base is not wholly on {surface.body.name} as seen from {surface.side}"] if is_off else []
    if not surface.upright or surface.is_image:
        return found
    anywhere = np.where(np.arange(6) < 3, np.inf, 0.0)
    return found + _bound_violations(pose, low - anywhere, high + anywhere)


def _is_close(a: Array, b: Array) -> bool:
    return bool((abs(a - b) <= TOLERANCE).all())


def _bound_violations(pose: Array, low: Array, high: Array) -> list[str]:
    """Which coordinates (6,) are out of bounds, for the better of the two sets of angles of the same orientation."""
    roll, pitch, yaw = pose[3:]
    equivalents = [pose, np.array([*pose[:3], roll + np.pi, np.pi - pitch, yaw + np.pi])]
    return min((_beyond(angles, low, high) for angles in equivalents), key=len)


def _beyond(pose: Array, low: Array, high: Array) -> list[str]:
    found = []
    for i, name in enumerate(COORDINATES):
        value = pose[i]
        least = low[i]
        most = high[i]
        if i < 3:
            if not least - TOLERANCE <= value <= most + TOLERANCE:
                found.append(f"{name} {value:.3f} m is outside {least:g} to {most:g} m")
        elif (value - least + TOLERANCE) % (2 * np.pi) > most - least + 2 * TOLERANCE:
            least, most, value = np.degrees((least, most, value))
            found.append(f"{name} {value:.2f}° is outside {least:g} to {most:g}°")
    return found


def surface_mounts(study: Study, rig: Rig) -> list[int]:
    """The sensors of a rig that sit on a surface; none for a rig with other sensors."""
    ours = has_its_sensors(study, rig)
    return [i for i, slot in enumerate(study.slots) if slot.surface and ours]


def slide(study: Study, poses: Array, number: int, wanted: Array, mirrors: bool) -> Array:
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
    for _ in range(SHIFTS if not surface.upright else 0):  # the normal there is another, which it stands off along
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
    low = study.space.lower[number, 3:5]
    high = study.space.upper[number, 3:5]
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
