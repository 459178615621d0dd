"""A rig's evaluation as the page shows it, and again after each move."""

from dataclasses import replace
from typing import Any

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.report.verdict import conclusion, demanded, quantity, signed, worst_place
from lidarcfg.requirements.verify import Verifier
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.detection import detection_rates
from lidarcfg.study.study import Study
from lidarcfg.viewer.bodies import (
    base_discs_m,
    has_obstacles,
    other_max_vsr_m,
    packed_quads,
    packed_triangles,
    score_subspaces,
    visibility_of,
)
from lidarcfg.viewer.mounting import violations
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.subspaces import Subspaces, segment


def evaluation(study: Study, rig: Rig, worst: int, transparent: bool = False) -> dict[str, Any]:
    """Max VSR and where it is worst, where nothing hides anything if it is `transparent`."""
    other_m = other_max_vsr_m(study, rig, transparent) if has_obstacles(study) else None
    return _as_json(study, rig, worst, transparent, _spaces(study, rig, transparent)) | {"other_max_vsr_m": other_m}


def evaluations(study: Study, rig: Rig, worst: int, with_rates: bool) -> list[dict[str, Any] | None]:
    """The evaluation as it is and, where something hides, also as if nothing did; with detection rates if asked for."""
    found: list[dict[str, Any] | None] = [None, None]
    for transparent in (False, True) if has_obstacles(study) else (False,):
        spaces = _spaces(study, rig, transparent)
        shown = _as_json(study, rig, worst, transparent, spaces)
        shown |= {"other_max_vsr_m": None, "rates": None}
        try:
            shown["rates"] = _rates(study, rig, transparent, spaces) if with_rates else None
        except ConfigError as error:  # of an object that finds no place, or sensors whose firing is not known
            shown["violations"].append(str(error))
        found[transparent] = shown
        del spaces  # before the next ones: they are large
    one, other = found
    if one and other:
        one["other_max_vsr_m"], other["other_max_vsr_m"] = other["max_vsr_m"], one["max_vsr_m"]
    return found


def _spaces(study: Study, rig: Rig, transparent: bool) -> Subspaces:
    return segment(study.region, rig_lidars(rig), visibility_of(study, transparent))


def _as_json(study: Study, rig: Rig, worst: int, transparent: bool, spaces: Subspaces) -> dict[str, Any]:
    found = score_subspaces(study, spaces, worst)
    return {
        "transparent": transparent,
        "blind": found.blind
        and {
            "volume_m3": found.blind.volume_m3,
            "fraction": found.blind.fraction,
            "mesh": packed_quads(found.blind.faces_m),
        },
        "max_vsr_m": found.max_vsr_m,
        "subspaces": found.subspaces,
        "zones": [{"name": zone.name, "max_vsr_m": zone.max_vsr_m} for zone in found.zones],
        "violations": violations(study, rig),
        "bases": packed_triangles(base_discs_m(study, rig)),
        "worst": [
            {
                "vsr_m": body.vsr_m,
                "volume_m3": body.volume_m3,
                "centroid_m": body.centroid_m.tolist(),
                "mesh": packed_quads(body.faces_m),
            }
            for body in found.worst
        ],
    }


def rates(study: Study, rig: Rig, transparent: bool = False) -> list[dict[str, Any]]:
    """How often each of the study's objects is detected. Raises ConfigError where an object finds no place."""
    return _rates(study, rig, transparent, _spaces(study, rig, transparent))


def _rates(study: Study, rig: Rig, transparent: bool, spaces: Subspaces) -> list[dict[str, Any]]:
    found = detection_rates(replace(study, visibility=visibility_of(study, transparent)), rig, spaces)
    return [
        {"name": name, "rate": one.rate, "half_width": one.half_width, "places": one.places}
        for name, one in found.items()
    ]


def verdict(verifier: Verifier, rig: Rig) -> dict[str, Any]:
    """The verdict on a rig as the page lists it. Raises ConfigError as `Verifier.verify` does."""
    found = verifier.verify(rig.mounts)
    return {
        "pass": found.passed,
        "text": conclusion(found),
        "requirements": [
            {
                "name": one.name,
                "pass": one.passed,
                "margin": signed(one.margin, one.unit),
                "detail": ", ".join(
                    text for text in (f"{demanded(one)}; {quantity(one.reached, one.unit)}", worst_place(one)) if text
                ),
            }
            for one in found.requirements
        ],
    }


def with_poses(rig: Rig, poses: Array) -> Rig:
    """The rig with other poses (mounts, 6) of x, y, z, roll, pitch, yaw in metres and radians."""
    mounts = [
        replace(mount, position_m=(x, y, z), rpy_rad=(roll, pitch, yaw))
        for mount, (x, y, z, roll, pitch, yaw) in zip(rig.mounts, poses.tolist(), strict=True)
    ]
    return replace(rig, mounts=tuple(mounts))
