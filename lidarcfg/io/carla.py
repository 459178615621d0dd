"""CARLA: where to spawn each sensor on a vehicle, and the attributes of its blueprint.

CARLA's axes are Unreal's: x forward, y right, z up, left-handed, in metres and degrees. Mirroring y turns
Rz(yaw) Ry(pitch) Rx(roll) into Unreal's rotation by roll, -pitch, -yaw: yaw is clockwise seen from above, and
a positive pitch lifts the nose.
"""

import json
import math
from collections.abc import Callable

import numpy as np

from lidarcfg.errors import ConversionError
from lidarcfg.packets.families import timing
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.sensor import catalogue

EVEN_DEG = 0.05  # beams further than that from CARLA's even spacing get a warning


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
