"""Which groups of sensors in a study are interchangeable: exchanging their models gives an equivalent rig.

Any two groups with the same bounds and choices are. If a plane mirrors everything, the bounds of all groups, the
bodies, and the zones, headings and objects of all requirements, then each combination also has an equivalent image:
all groups change places with those in mirrored bounds at the same time. Two things are not looked at: that sensors turn
one way only, which shifts the places of beams by less than the step between two of them, and that each sensor has its
own draws of mounting errors.
"""

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lidarcfg.geometry import Array
from lidarcfg.placement.objective import Objective
from lidarcfg.placement.study import Study
from lidarcfg.requirements.objects import ObjectRequirement
from lidarcfg.requirements.posts import PostRequirement
from lidarcfg.requirements.scenario_requirement import ScenarioRequirement
from lidarcfg.returns.places import Stand

NEAR_M = 1e-3  # by which corners of mirrored bodies may differ
SAME = 1e-9  # metres and radians, by which bounds may
BOUNDS = ("min", "max", "on", "mirror_y_m", "name")  # of a group, besides what it consists of


@dataclass(frozen=True)
class Symmetry:
    """The symmetry of a study's groups, by their numbers in its file."""

    kinds: tuple[int, ...]  # the first group with the same bounds and choices
    images: dict[int, int] | None  # of kinds, in mirrored bounds; None: no plane mirrors everything

    @classmethod
    def of(cls, study: Study) -> "Symmetry":
        """The symmetry of a study."""
        groups = [_Group(each, study.lower[first], study.upper[first]) for each, first in _firsts(study)]
        kinds: list[int] = []
        for i, group in enumerate(groups):
            kinds.append(next((j for j in range(i) if kinds[j] == j and group.is_alike(groups[j])), i))
        plane_y_m = float(study.reference_m[1]) if study.vehicle else 0.0
        if not is_mirrored(study, plane_y_m):
            return cls(tuple(kinds), None)
        images: dict[int, int] = {}
        for kind in set(kinds):
            for other in set(kinds):
                if kinds.count(kind) == kinds.count(other) and groups[kind].mirrors(groups[other], plane_y_m):
                    images[kind] = other
        return cls(tuple(kinds), images if len(images) == len(set(kinds)) else None)

    def key(self, chosen: Sequence[Hashable]) -> Hashable:
        """A key of the models chosen for each group, equal for symmetric combinations."""
        parts: dict[int, list[str]] = {}
        for kind, each in zip(self.kinds, chosen, strict=True):
            parts.setdefault(kind, []).append(repr(each))
        key = tuple((kind, tuple(sorted(parts[kind]))) for kind in sorted(parts))
        if self.images is None:
            return key
        return min(key, tuple((kind, tuple(sorted(parts[self.images[kind]]))) for kind in sorted(parts)))


@dataclass(frozen=True)
class _Group:
    """A group of sensors, and where its first one may be."""

    file: dict[str, Any]
    lower: Array  # (6,)
    upper: Array  # (6,)

    @property
    def consists_of(self) -> dict[str, Any]:
        """The group's values without its bounds."""
        return {key: value for key, value in self.file.items() if key not in BOUNDS}

    def is_alike(self, other: "_Group") -> bool:
        """Whether it may exchange its sensors with another one."""
        return (
            self.consists_of == other.consists_of
            and self.file.get("on") == other.file.get("on")
            and self.file.get("mirror_y_m") == other.file.get("mirror_y_m")
            and bool((self.lower == other.lower).all() and (self.upper == other.upper).all())
        )

    def mirrors(self, other: "_Group", plane_y_m: float) -> bool:
        """Whether it is the image of another one, or of itself; y, roll and yaw change sign."""
        given = self.file.keys() | other.file.keys()
        if self.consists_of != other.consists_of or "on" in given or "azimuth_fov_deg" in given:
            return False
        if "mirror_y_m" in given:  # of each pair one is the other's image
            return self.is_alike(other) and abs(self.file["mirror_y_m"] - plane_y_m) <= SAME
        sign = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
        images = np.sort([sign * other.lower, sign * other.upper], axis=0)
        images[:, 1] += 2 * plane_y_m
        off = images - [self.lower, self.upper]
        off[:, 3:] -= 2 * math.pi * np.rint(off[:, 3:] / (2 * math.pi))
        return bool((abs(off) <= SAME).all())


def _firsts(study: Study) -> Iterator[tuple[dict[str, Any], int]]:
    """Each group's values, and the number of its first sensor."""
    first = 0
    for each in study.file["sensors"]:
        yield each, first
        first += each["count"]


def is_mirrored(study: Study, plane_y_m: float) -> bool:
    """Whether the plane y = plane_y_m mirrors the bodies and all that requirements ask for."""
    if study.requirements is None or study.surroundings or not _objective_is_mirrored(study.objective, study):
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
        elif isinstance(item, ScenarioRequirement):  # traffic keeps right
            return False
    return True


def _objective_is_mirrored(objective: Objective, study: Study) -> bool:
    """Whether the plane mirrors what is minimised: misses all around, or nothing. Others have zones of their own."""
    all_around = objective.is_misses and objective.misses is not None and objective.misses.sector_deg is None
    return study.only_required or all_around


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
