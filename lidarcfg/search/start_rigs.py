"""Rigs of the user's that a search begins with, as points of a study's unit cube."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.search.combinations import Combination
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.file import COORDINATES
from lidarcfg.study.search_space import ROLL
from lidarcfg.study.study import Study
from lidarcfg.study.surfaces import mirrored

NEAR = 1e-6  # metres and radians, by which a coordinate may be off: that much is lost in a rig's file
OTHER = 1e6  # the distance from a sensor of another model


def point_of(study: Study, rig: Rig) -> Array:
    """(free coordinates,) the point of the unit cube at which a rig stands.

    Sensors are matched by their models, and so that they are off the study's bounds the least. Raises ConfigError for a
    rig with other sensors, or with a coordinate that the study does not allow.
    """
    has = sorted(mount.sensor.name for mount in rig.mounts)
    wanted = sorted(slot.sensor.name for slot in study.slots)
    if has != wanted:
        raise ConfigError(f"{rig.name}: its sensors are {', '.join(has)}; the study's are {', '.join(wanted)}")
    poses, names = _matched(study, rig)
    inside = poses.copy()
    for i, slot in enumerate(study.slots):
        if slot.surface:
            inside[i, :3] = slot.surface.bases_m(poses[i : i + 1])[0]
    turns = np.round(((study.space.lower + study.space.upper) / 2 - inside)[:, 3:] / (2 * math.pi))
    inside[:, 3:] += 2 * math.pi * turns
    inside = np.clip(inside, study.space.lower, study.space.upper)
    x = _unit(study, inside)
    allowed = study.space.poses(x[None])[0]
    off = poses - allowed
    off[:, 3:] -= 2 * math.pi * np.round(off[:, 3:] / (2 * math.pi))
    if (abs(off) > NEAR).any():
        i, k = np.unravel_index(abs(off).argmax(), off.shape)
        raise ConfigError(
            f"{rig.name}: {names[i]}: {_said(study, int(i), int(k), float(poses[i, k]), float(allowed[i, k]))}"
        )
    if study.space.violation(allowed[None])[0] > 0:
        what = "breaks the constraints: sensors are inside the body, off their surface, tilted too much or too near"
        raise ConfigError(f"{rig.name}: {what}")
    return x


def points_of(study: Study, rigs: Sequence[Rig]) -> Array:
    """(n, free coordinates) the points of rigs. Raises as point_of does."""
    return np.array([point_of(study, rig) for rig in rigs]).reshape(len(rigs), study.space.dimensions)


def points_by_combination(combinations: Sequence[Combination], rigs: Sequence[Rig]) -> dict[int, list[Array]]:
    """The points of rigs by the number of the combination whose models each has.

    Raises ConfigError for a rig that is of none, or outside the bounds.
    """
    found: dict[int, list[Array]] = {}
    for rig in rigs:
        number, x = _place_in(combinations, rig)
        found.setdefault(number, []).append(x)
    return found


def _place_in(combinations: Sequence[Combination], rig: Rig) -> tuple[int, Array]:
    """The first combination that allows a rig, and the rig's point in it. Raises as points_by_combination does."""
    has = sorted(mount.sensor.name for mount in rig.mounts)
    errors = []
    for number, one in enumerate(combinations):
        if sorted(one.all_sensors) == has:
            try:
                return number, point_of(one.study, rig)
            except ConfigError as error:
                errors.append(error)
    raise (
        errors[0]
        if errors
        else ConfigError(f"{rig.name}: no combination of the study has the sensors {', '.join(has)}")
    )


def _matched(study: Study, rig: Rig) -> tuple[Array, list[str]]:
    """(slots, 6) the poses of the rig's sensors, in the order of the study's, and their names."""
    at = np.array([(*mount.position_m, *mount.rpy_rad) for mount in rig.mounts])
    mount_models = [mount.sensor.name for mount in rig.mounts]
    slot_models = [slot.sensor.name for slot in study.slots]
    images = ~np.isnan(study.space.mirror)
    distance = np.zeros((len(at), len(at)))  # by slot and sensor
    for i in range(len(at)):
        low, high = study.space.lower[i, :3], study.space.upper[i, :3]
        seen = mirrored(at, study.space.mirror[i]) if images[i] else at
        distance[i] = np.linalg.norm(seen[:, :3] - np.clip(seen[:, :3], low, high), axis=1)
        distance[i] += [OTHER * (model != slot_models[i]) for model in mount_models]
    order: NDArray[np.int64] = linear_sum_assignment(distance)[1]
    seconds = np.flatnonzero(images)
    if len(seconds):  # which of them is the image of which
        pool = order[seconds]
        wanted = mirrored(at[order[seconds - 1]], study.space.mirror[seconds])
        apart = np.linalg.norm(wanted[:, None, :3] - at[None, pool, :3], axis=2)
        apart += np.array([[OTHER * (mount_models[n] != slot_models[i]) for n in pool] for i in seconds])
        order[seconds] = pool[linear_sum_assignment(apart)[1]]
    return at[order], [rig.mounts[n].name for n in order]


def _unit(study: Study, coordinates: Array) -> Array:
    """(free coordinates,) the point of the unit cube with these coordinates (slots, 6) within the bounds."""
    free = study.space.free
    low, high = study.space.lower[free], study.space.upper[free]
    unit = (coordinates[free] - low) / (high - low)
    for roll, pitch in study.space.freely_tilted:  # upright is in the middle: see search_space.center_on_upright
        unit[pitch] = (unit[pitch] - 0.5) % 1.0
        unit[roll] = ((unit[roll] - 0.5) * (-1.0 if unit[pitch] < 0.5 else 1.0)) % 1.0
    return unit


def _said(study: Study, slot: int, axis: int, has: float, there: float) -> str:
    """What is wrong with a coordinate of a sensor, and what is allowed."""
    low, high = study.space.lower[slot, axis], study.space.upper[slot, axis]
    free = np.isnan(study.space.mirror[slot]) and not (study.slots[slot].surface and axis < ROLL)
    angle = axis >= ROLL

    def text(value: float) -> str:
        return f"{math.degrees(value):.6g}°" if angle else f"{value:.6g} m"

    name = COORDINATES[axis]
    if not free:
        why = "on its surface" if np.isnan(study.space.mirror[slot]) else "as the mirror image of its pair"
        return f"{name} is {text(has)}; allowed: {text(there)}, {why}"
    if low == high:
        return f"{name} is {text(has)}; allowed: {text(low)}"
    return f"{name} is {text(has)}; allowed: {text(low)} to {text(high)}"
