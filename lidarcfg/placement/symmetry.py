"""Which groups of a study's sensors are interchangeable: a rig with their models exchanged is another one's equal.

Two groups with the same bounds and choices are. Two groups in bounds that mirror each other are, too, if the plane
mirrors everything that is to be met: the bodies and the zones, headings and objects of all requirements. That sensors
turn one way only is not looked at: it shifts the places of beams by less than the step between two of them.
"""

import math
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lidarcfg.geometry import Array
from lidarcfg.placement.study import Study
from lidarcfg.requirements.objects import ObjectRequirement
from lidarcfg.requirements.places import Stand
from lidarcfg.requirements.posts import PostRequirement

NEAR_M = 1e-3  # by which corners of mirrored bodies may differ
BOUNDS = ("min", "max", "on", "mirror_y_m", "name")  # of a group, besides what it consists of


def alike_groups(study: Study) -> list[int]:
    """For each group of the study's file the number of the first one with which it is interchangeable."""
    groups = study.file["sensors"]
    firsts = np.cumsum([0, *(group["count"] for group in groups)])[:-1].tolist()
    plane_y_m = float(study.reference_m[1]) if study.vehicle else 0.0
    mirrors = is_mirrored(study, plane_y_m)
    out: list[int] = []
    for i, group in enumerate(groups):
        same = (
            j
            for j in range(i)
            if out[j] == j
            and _consists_of(groups[j]) == _consists_of(group)
            and (
                _same_bounds(study, firsts[j], firsts[i], groups[j], group)
                or (mirrors and _mirrored_bounds(study, firsts[j], firsts[i], plane_y_m, groups[j], group))
            )
        )
        out.append(next(same, i))
    return out


def _consists_of(group: dict[str, Any]) -> dict[str, Any]:
    """Its values but for where it is."""
    return {key: value for key, value in group.items() if key not in BOUNDS}


def _same_bounds(study: Study, one: int, other: int, first: dict[str, Any], second: dict[str, Any]) -> bool:
    return (
        first.get("on") == second.get("on")
        and first.get("mirror_y_m") == second.get("mirror_y_m")
        and bool((study.lower[one] == study.lower[other]).all() and (study.upper[one] == study.upper[other]).all())
    )


def _mirrored_bounds(
    study: Study, one: int, other: int, plane_y_m: float, first: dict[str, Any], second: dict[str, Any]
) -> bool:
    """Whether the bounds of two groups, by their first slots, are each other's images; y, roll and yaw change sign."""
    if any("on" in group or "mirror_y_m" in group or "azimuth_fov_deg" in group for group in (first, second)):
        return False
    sign = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    shift = np.array([0.0, 2 * plane_y_m, 0.0, 0.0, 0.0, 0.0])
    images = shift + sign * study.lower[other], shift + sign * study.upper[other]
    return bool(
        np.allclose(np.minimum(*images), study.lower[one], rtol=0, atol=1e-9)
        and np.allclose(np.maximum(*images), study.upper[one], rtol=0, atol=1e-9)
    )


def is_mirrored(study: Study, plane_y_m: float) -> bool:
    """Whether the plane y = plane_y_m mirrors the bodies and all that requirements ask for."""
    if study.requirements is None or study.surroundings or study.detection:
        return False
    if study.vehicle and not _mirrors(study.vehicle.scene.mesh()[0], plane_y_m):
        return False
    for item in study.requirements.items:
        if isinstance(item, ObjectRequirement):
            corners = item.target.mesh[0]
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
            if not (_mirrors(corners, float(middle[1])) and _stands_mirrored(item.stand, plane_y_m)):
                return False
        elif isinstance(item, PostRequirement):
            counts = item.posts.counts
            if not (counts[1:] == counts[:0:-1]).all():
                return False
    return True


def _mirrors(points_m: Array, plane_y_m: float) -> bool:
    """Whether each point has an image among them."""
    images = points_m * [1.0, -1.0, 1.0] + [0.0, 2 * plane_y_m, 0.0]
    return bool((cKDTree(points_m).query(images)[0] <= NEAR_M).all())


def _stands_mirrored(stand: Stand, plane_y_m: float) -> bool:
    zone = stand.zone
    if zone.box_m is not None and abs(zone.box_m[0][1] + zone.box_m[1][1] - 2 * plane_y_m) > 1e-9:
        return False
    if zone.sector_rad is not None:
        first, last = zone.sector_rad
        turn = (first + last) / math.pi
        if abs(turn - 2 * round(turn / 2)) > 1e-9 and last - first < 2 * math.pi - 1e-9:
            return False
    turned = np.sort(np.mod(-stand.headings_rad + 1e-12, 2 * math.pi))
    return bool(np.allclose(turned, np.sort(stand.headings_rad), rtol=0, atol=1e-9))
