"""The kinds of our YAML files, told apart by their keys."""

from collections.abc import Mapping
from typing import Any

OBJECTS = {"boxes", "spheres", "cylinders", "planes", "meshes"}
MOTIONS = {"velocity_m_s", "arc", "poses"}
MARKS = {  # the keys that only one kind has, the first that fits
    "sensor": {"beams"},
    "record of a capture": {"rig", "scene", "duration_s"},
    "plan": {"vary", "together"},
    "study": {"region"},
    "trajectory": MOTIONS,
    "scene": {"ground", "weather", "geo_origin", "height_fields", "models", "surfels"},
    "vehicle": {"allow_inside"},
}


def kind_of(values: object) -> str | None:
    """Of which kind a file with these values is; None: of none that is known."""
    if not isinstance(values, Mapping):
        return None
    for kind, marks in MARKS.items():
        if marks & values.keys():
            return kind
    if "sensors" in values:
        return _sensors(values["sensors"])
    if OBJECTS & values.keys():  # the objects of a scene must say what they reflect, and a scene its name
        return "scene" if "name" in values else "vehicle"
    return None


def _sensors(listed: Any) -> str | None:
    """What has sensors: a study if these have bounds, a rig if they have positions."""
    items = [item for item in listed if isinstance(item, Mapping)] if isinstance(listed, tuple) else []
    if any("position_m" in item for item in items):
        return "rig"
    return "study" if any({"min", "max", "on", "choose"} & item.keys() for item in items) else None
