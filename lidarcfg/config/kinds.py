"""The kinds of files: our YAML files, told apart by their keys, and other programs' files, by suffix."""

from collections.abc import Mapping
from typing import Any

YAML_SUFFIXES = (".yaml", ".yml", ".json")  # of our files
OBJECTS = {"boxes", "spheres", "cylinders", "planes", "meshes"}
MOTIONS = {"velocity_m_s", "arc", "poses"}
DISCRIMINATING_KEYS = {  # keys that only one kind has; the first kind that matches counts
    "sensor": {"beams", "scan_pattern"},
    "capture manifest": {"rig", "scene", "duration_s"},
    "plan": {"vary", "together"},
    "study": {"region"},
    "scenario": {"target", "impacts", "cars", "speeds_km_h", "before_impact_s", "from_m", "backwards"},
    "trajectory": MOTIONS,
    "scene": {"ground", "weather", "geo_origin", "height_fields", "models", "surfels"},
    "vehicle": {"allow_inside"},
}

LISTS = ("requirements", "faults")  # kinds of files that are lists

_POINTS = "points, no YAML; a scene names them under surfels, with a radius"
_MESH = "a mesh, no YAML; a scene or a vehicle names it under meshes"
OTHERS = {  # by suffix, what a file of another program is, and where it belongs
    ".xodr": "an OpenDRIVE map, no YAML; export a mesh of it, as an OBJ with libOpenDRIVE, and name it under meshes",
    **dict.fromkeys((".pcd", ".las", ".laz", ".xyz", ".pts", ".e57"), _POINTS),
    **dict.fromkeys((".obj", ".stl", ".off"), _MESH),
    **dict.fromkeys((".glb", ".gltf"), "a glTF file, no YAML; a scene names it under models"),
    ".urdf": "a robot in URDF, no YAML; convert reads its sensors, and a vehicle names it under meshes",
    ".ply": "points or a mesh, no YAML; a scene names points under surfels, with a radius, and a mesh under meshes",
    **dict.fromkeys((".pcap", ".pcapng"), "a capture, no YAML; decode, convert and view read it"),
}


def a_file_of(kind: str) -> str:
    """A kind of file with its article: a rig, a file of faults."""
    return f"a file of {kind}" if kind in LISTS else f"a {kind}"


def kind_of(values: object) -> str | None:
    """The kind of a file with these values; None if no kind fits."""
    if not isinstance(values, Mapping):
        return None
    for kind, marks in DISCRIMINATING_KEYS.items():
        if marks & values.keys():
            return kind
    if "sensors" in values:
        return _sensors(values["sensors"])
    for kind in LISTS:  # a study, and a rig, may have them, too
        if kind in values:
            return kind
    if OBJECTS & values.keys():  # of a scene without a ground they are told from a vehicle's bodies by its name
        return "scene" if "name" in values else "vehicle"
    return None


def likely_kind_of(values: Mapping[str, Any]) -> str | None:
    """As `kind_of`; what has sensors of which nothing can be told is taken for a rig, whose errors say more."""
    return kind_of(values) or ("rig" if "sensors" in values else None)


def _sensors(listed: Any) -> str | None:
    """The kind of a file with `sensors`: a study if they have bounds, a rig if they have positions."""
    items = [item for item in listed if isinstance(item, Mapping)] if isinstance(listed, tuple) else []
    if any("position_m" in item for item in items):
        return "rig"
    return "study" if any({"min", "max", "on", "choose"} & item.keys() for item in items) else None
