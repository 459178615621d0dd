"""Poses of a rig that are at a bound of the study: a wider bound might give a better rig."""

import math

import numpy as np

from lidarcfg.placement.study import Study
from lidarcfg.placement.study_file import COORDINATES
from lidarcfg.report.text import truncate
from lidarcfg.sensors.rig import Rig

NEAR = 1e-3  # of the room between two bounds
TURN = 2 * math.pi - 1e-6
ANGLES = 3  # the coordinates from here on


def poses_at_bounds(study: Study, rig: Rig) -> list[str]:
    """A line for each free coordinate that is at its bound; none for a rig whose sensors are not the study's."""
    if len(rig.mounts) != len(study.slots):
        return []
    lines = []
    for n, mount in enumerate(rig.mounts):
        pose = (*mount.position_m, *mount.rpy_rad)
        for axis, (value, name) in enumerate(zip(pose, COORDINATES, strict=True)):
            low, high = study.lower[n, axis], study.upper[n, axis]
            if not study.free[n, axis] or (axis >= ANGLES and high - low > TURN):  # all around there is no bound
                continue
            near = NEAR * (high - low)
            for word, bound in (("lower", low), ("upper", high)):
                if abs(value - bound) <= near:
                    lines.append(f"{truncate(mount.name)}: {name} is at its {word} bound of {_quantity(bound, axis)}")
    return lines


def _quantity(value: float, axis: int) -> str:
    return f"{np.degrees(value):g}°" if axis >= ANGLES else f"{value:g} m"
