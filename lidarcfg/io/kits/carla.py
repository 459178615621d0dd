"""The JSON for CARLA, as `convert` writes it from a rig: axes x forward, y right, z up; degrees; see io/carla.py."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg.errors import ConversionError
from lidarcfg.inputs import read_regular
from lidarcfg.io.kits.frames import Pose
from lidarcfg.io.kits.kit import Frame, Kit

FILE_MAX = 64_000_000  # bytes
BLUEPRINTS = ("sensor.lidar.ray_cast", "sensor.lidar.ray_cast_semantic")
PLACE = ("x", "y", "z", "roll", "pitch", "yaw")
CHANNELS_MAX = 1024


def read_carla(path: Path) -> Kit:
    """The kit of a JSON for CARLA. Raises ConversionError, OSError."""
    try:
        values = json.loads(read_regular(path, FILE_MAX))
    except (ValueError, RecursionError) as error:
        raise ConversionError(f"{path}: not JSON: {error}") from None
    listed = values.get("sensors") if isinstance(values, dict) else None
    if not isinstance(listed, list) or not all(isinstance(one, dict) and "type" in one for one in listed):
        raise ConversionError(f"{path}: has no sensors with a type, as convert writes them for CARLA")
    frames = [_frame(f"{path}: sensors[{i}]", one) for i, one in enumerate(listed) if one["type"] in BLUEPRINTS]
    others = [str(one.get("id", one["type"])) for one in listed if one["type"] not in BLUEPRINTS]
    name = values.get("name")
    return Kit(str(path), name if isinstance(name, str) and name else path.stem, tuple(frames), tuple(others))


def _frame(where: str, sensor: Mapping[str, Any]) -> Frame:
    name = sensor.get("id")
    if not isinstance(name, str) or not name:
        raise ConversionError(f"{where}: has no id")
    x, y, z, roll, pitch, yaw = (_number(where, sensor, key) for key in PLACE)
    pose = Pose((x, -y + 0.0, z), (math.radians(roll), -math.radians(pitch) + 0.0, -math.radians(yaw) + 0.0))
    model = sensor.get("model")
    attributes = sensor.get("attributes")
    if not isinstance(attributes, Mapping):
        raise ConversionError(f"{where}: has no attributes")
    rpm = 60 * _number(where, attributes, "rotation_frequency")
    if isinstance(model, str) and model:
        return Frame(name, pose, model=model, rpm=rpm)
    channels = _number(where, attributes, "channels")
    if not (channels.is_integer() and 1 <= channels <= CHANNELS_MAX):
        raise ConversionError(f"{where}: channels is {channels:g}; allowed: 1 to {CHANNELS_MAX}")
    lower_deg = _number(where, attributes, "lower_fov")
    upper_deg = _number(where, attributes, "upper_fov")
    beams = np.linspace(lower_deg, upper_deg, int(channels)).tolist()
    return Frame(name, pose, elevation_deg=tuple(beams), rpm=rpm)


def _number(where: str, values: Mapping[str, Any], key: str) -> float:
    value = values.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConversionError(f"{where}: {key} is not a number")
    return float(value)
