"""CARLA: where to spawn each sensor on a vehicle, and the attributes of its blueprint; written and read as JSON.

CARLA's axes are Unreal's: x forward, y right, z up, left-handed, in metres and degrees. Mirroring y turns
Rz(yaw) Ry(pitch) Rx(roll) into Unreal's rotation by roll, -pitch, -yaw: yaw is clockwise seen from above, and
a positive pitch lifts the nose.
"""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg.errors import ConversionError
from lidarcfg.inputs import read_regular
from lidarcfg.io.rig_importers.sensor_kit import LidarFrame, SensorKit
from lidarcfg.packets.families import timing
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.sensor import catalogue
from lidarcfg.world.frame_tree import Pose

EVEN_DEG = 0.05  # beams further than that from CARLA's even spacing get a warning
FILE_MAX = 64_000_000  # bytes
BLUEPRINTS = ("sensor.lidar.ray_cast", "sensor.lidar.ray_cast_semantic")
PLACE = ("x", "y", "z", "roll", "pitch", "yaw")
CHANNELS_MAX = 1024


def carla(rig: Rig, on_warning: Callable[[str], None]) -> str:
    """The rig's sensors as JSON; each with its blueprint, its pose on the vehicle and its attributes."""
    sensors = []
    for mount in rig.mounts:
        x, y, z = mount.position_m
        roll, pitch, yaw = (math.degrees(angle) for angle in mount.rpy_rad)
        place = {"x": x, "y": -y, "z": z, "roll": roll, "pitch": -pitch, "yaw": -yaw}
        sensors.append(
            {
                "type": "sensor.lidar.ray_cast",
                "id": mount.name,
                **({"model": mount.model} if mount.model in catalogue() else {}),  # for reading it back
                **{key: value + 0.0 for key, value in place.items()},  # no minus zeros
                "attributes": _attributes(mount, on_warning),
            }
        )
    axes = "x forward, y right, z up, from the vehicle frame's origin; metres, degrees"
    return json.dumps({"name": rig.name, "axes": axes, "sensors": sensors}, indent=2) + "\n"


def _attributes(mount: Mount, on_warning: Callable[[str], None]) -> dict[str, float]:
    """The blueprint's attributes; for what is unknown of the sensor, CARLA's defaults hold."""
    sensor = mount.sensor
    realism = mount.realism
    if sensor.scan_pattern:
        raise ConversionError(f"{mount.name}: {sensor.name} has a scan pattern; CARLA's lidars turn")
    elevation_deg = np.sort(sensor.beams.elevation_deg)
    attributes = {
        "channels": sensor.count,
        "upper_fov": float(elevation_deg[-1]),
        "lower_fov": float(elevation_deg[0]),
        "rotation_frequency": mount.rpm / 60,
        "noise_stddev": realism.range_noise_m if realism else 0.0,
        "dropoff_general_rate": realism.dropout_fraction if realism else 0.0,  # CARLA's default drops 45 %
        "dropoff_zero_intensity": 0.0,
    }
    if sensor.range:
        attributes["range"] = sensor.range.reported_m[1]
    if sensor.fires:
        pace = timing(sensor).pace(mount)
        attributes["points_per_second"] = round(pace.firings * 1e9 / pace.period_ns)
    if not (sensor.range and sensor.fires):
        on_warning(f"{mount.name}: {sensor.name} has beams only; its range and points_per_second are CARLA's defaults")
    away_deg = abs(elevation_deg - np.linspace(elevation_deg[0], elevation_deg[-1], sensor.count)).max()
    if away_deg > EVEN_DEG:
        on_warning(
            f"{mount.name}: CARLA spaces channels evenly; {sensor.name}'s are up to {away_deg:.2f} deg from there"
        )
    if mount.azimuth_fov_deg:
        low, high = mount.azimuth_fov_deg
        on_warning(f"{mount.name}: CARLA fires all around, not only from {low:g} to {high:g} deg")
    return attributes


def read_carla(path: Path) -> SensorKit:
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
    return SensorKit(str(path), name if isinstance(name, str) and name else path.stem, tuple(frames), tuple(others))


def _frame(where: str, sensor: Mapping[str, Any]) -> LidarFrame:
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
        return LidarFrame(name, pose, model=model, rpm=rpm)
    channels = _number(where, attributes, "channels")
    if not (channels.is_integer() and 1 <= channels <= CHANNELS_MAX):
        raise ConversionError(f"{where}: channels is {channels:g}; allowed: 1 to {CHANNELS_MAX}")
    lower_deg = _number(where, attributes, "lower_fov")
    upper_deg = _number(where, attributes, "upper_fov")
    beams = np.linspace(lower_deg, upper_deg, int(channels)).tolist()
    return LidarFrame(name, pose, elevation_deg=tuple(beams), rpm=rpm)


def _number(where: str, values: Mapping[str, Any], key: str) -> float:
    value = values.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConversionError(f"{where}: {key} is not a number")
    return float(value)
