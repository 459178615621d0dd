"""nuScenes: the tables sensor.json and calibrated_sensor.json, linked by tokens."""

import json
import uuid

from lidarcfg.io.frames import quaternion_xyzw
from lidarcfg.sensors.rig import Rig

TOKENS = uuid.UUID("4d0e4bd4-9c4e-5b7c-8a55-0d6c2f9b7a11")  # ours; the same rig gives the same tokens


def nuscenes(rig: Rig) -> dict[str, str]:
    """The two tables by file name: translation in metres, rotation as w x y z, sensor to ego vehicle."""
    sensors = []
    calibrated = []
    for mount in rig.mounts:
        key = json.dumps([rig.name, mount.name])
        token, sensor_token = (uuid.uuid5(TOKENS, f"{table} {key}").hex for table in ("calibrated_sensor", "sensor"))
        x, y, z, w = quaternion_xyzw(mount.T_vehicle_sensor)
        sensors.append({"token": sensor_token, "channel": mount.name, "modality": "lidar"})
        calibrated.append(
            {
                "token": token,
                "sensor_token": sensor_token,
                "translation": list(mount.position_m),
                "rotation": [w, x, y, z],
                "camera_intrinsic": [],
            }
        )
    tables = {"sensor.json": sensors, "calibrated_sensor.json": calibrated}
    return {name: json.dumps(rows, indent=2) + "\n" for name, rows in tables.items()}
