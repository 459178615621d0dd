"""Autoware's calibration of sensors: sensors_calibration.yaml below base_link, sensor_kit_calibration.yaml below that.

Each is a map of parents to a map of frames to x, y, z in metres and roll, pitch, yaw in radians, as in URDF.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lidarcfg.config.document import Document, document
from lidarcfg.errors import ConversionError
from lidarcfg.io.rig_importers.sensor_kit import SensorKit, kit_of_tree
from lidarcfg.world.frame_tree import FrameTree, Joint, Pose

FILES = ("sensors_calibration.yaml", "sensor_kit_calibration.yaml")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
BASE = "base_link"


def is_calibration(values: Any) -> bool:
    """Whether the values of a file are those of a calibration."""
    if not isinstance(values, Mapping) or not values:
        return False
    below = [frame for frames in values.values() if isinstance(frames, Mapping) for frame in frames.values()]
    return any(isinstance(frame, Mapping) and {"x", "roll"} <= frame.keys() for frame in below)


def read_autoware(path: Path, models: Mapping[str, str]) -> SensorKit:
    """The kit of a calibration and the one beside it, or of those in a folder. Raises ConversionError, ConfigError."""
    folder = path if path.is_dir() else path.parent
    paths = [folder / name for name in FILES if (folder / name).is_file()]
    if path.is_file() and not any(path.samefile(one) for one in paths):
        paths = [path]
    joints: dict[str, Joint] = {}
    for one in paths:
        read = document(one)
        for parent, frames in _map(read, ()).items():
            for child in _map(read, (parent,)) if frames is not None else ():
                if child in joints:
                    raise read.error((parent, child), f"is below {joints[child].parent} already")
                joints[child] = Joint(parent, _pose(read, (parent, child)))
    tree = FrameTree(str(path), joints)
    if BASE not in tree.frames:
        missing = " and ".join(name for name in FILES if folder / name not in paths)
        hint = f"; {missing} belongs beside it" if missing else ""
        raise ConversionError(f"{path}: no path leads from {', '.join(tree.roots)} to {BASE}{hint}")
    return kit_of_tree(str(path), folder.resolve().name if path.is_dir() else path.stem, tree, models, {})


def _map(read: Document, key: tuple[str, ...]) -> Mapping[str, Any]:
    values = read.at(key)
    if not isinstance(values, Mapping):
        raise read.error(key, f"is not a map of {'frames' if key else 'parents'}")
    return values


def _pose(read: Document, key: tuple[str, ...]) -> Pose:
    """The pose under a key. Raises ConfigError."""
    values = _map(read, key)
    for name in values:
        if name not in KEYS:
            raise read.error((*key, name), f"unknown key; allowed: {', '.join(KEYS)}")
    x, y, z, roll, pitch, yaw = (_number(read, (*key, name), values.get(name)) for name in KEYS)
    return Pose((x, y, z), (roll, pitch, yaw))


def _number(read: Document, key: tuple[str, ...], value: Any) -> float:
    if value is None:
        raise read.error(key, "missing; a frame has x, y, z, roll, pitch, yaw")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise read.error(key, f"{str(value)[:40]!r} is not a number")
    return float(value)
