"""nuScenes: the sensors of a scene, by its tables sensor and calibrated_sensor.

Each scene has its own calibration of each sensor, to which the data of its samples lead; the tables alone, without
scenes, have one. A LiDAR's frame is the table's: that of nuScenes' own LIDAR_TOP has its y axis ahead.
"""

import json
import math
from pathlib import Path
from typing import Any

from lidarcfg.errors import ConversionError
from lidarcfg.inputs import check_memory, check_regular
from lidarcfg.io.rig_importers.sensor_kit import LidarFrame, SensorKit
from lidarcfg.world.frame_tree import listed, pose_of_quaternion

SENSOR = "sensor.json"
CALIBRATED = "calibrated_sensor.json"
COPIES = 10  # of a table's file, in memory at the same time
KEYS = {  # of the tables of version 1.0, those that are read
    SENSOR: ("token", "channel", "modality"),
    CALIBRATED: ("token", "sensor_token", "translation", "rotation"),
    "scene.json": ("name", "first_sample_token"),
    "sample_data.json": ("sample_token", "calibrated_sensor_token"),
}
OWN = {"LIDAR_TOP": "hdl-32e"}  # nuScenes' own LiDAR (Caesar et al. 2020, table 2)
OWN_YAW_DEG = -90.0  # of its frame, nearly
AROUND_DEG = 10.0
Row = dict[str, Any]


def tables_folder(path: Path) -> Path | None:
    """The folder of the tables: of one of them, the folder itself, or that of a version below; None if it has none."""
    folder = path if path.is_dir() else path.parent
    if path.is_file() and path.name not in KEYS:
        return None
    found = [one for one in (folder, *sorted(folder.glob("v1.0*"))) if (one / CALIBRATED).is_file()]
    return found[0] if found else None


def read_nuscenes(folder: Path, scene: str | None) -> SensorKit:
    """The kit of a scene, or of tables that have one calibration of each LiDAR. Raises ConversionError."""
    sensors = {row["token"]: row for row in _table(folder, SENSOR)}
    calibrated = _table(folder, CALIBRATED)
    where = f"{folder / CALIBRATED}"
    for i, row in enumerate(calibrated):
        if row["sensor_token"] not in sensors:
            raise ConversionError(f"{where}: row {i}: its sensor_token is not in {SENSOR}")
    if scene:
        tokens = _tokens(folder, scene)
        calibrated = [row for row in calibrated if row["token"] in tokens]
    frames: dict[str, LidarFrame] = {}
    others: dict[str, None] = {}
    for i, row in enumerate(calibrated):
        sensor = sensors[row["sensor_token"]]
        name = str(sensor["channel"])
        if sensor["modality"] != "lidar":
            others[name] = None
            continue
        if name in frames:
            count = sum(sensors[one["sensor_token"]]["channel"] == name for one in calibrated)
            raise ConversionError(f"{where}: has {count} calibrations of {name}; --scene chooses: {_scenes(folder)}")
        at = f"{where}: row {i}, {name}"
        pose = pose_of_quaternion(at, _numbers(at, row, "translation", 3), _numbers(at, row, "rotation", 4))
        hints = (OWN[name],) if name in OWN else ()
        frames[name] = LidarFrame(name, pose, hints)
    notes = tuple(note for frame in frames.values() for note in _turned(frame))
    return SensorKit(str(folder), scene or folder.resolve().name, tuple(frames.values()), tuple(others), (), notes)


def _turned(frame: LidarFrame) -> list[str]:
    """What is said of nuScenes' own LiDAR, whose y axis points ahead."""
    yaw_deg = math.degrees(frame.pose.rpy_rad[2])
    if frame.name not in OWN or abs(yaw_deg - OWN_YAW_DEG) > AROUND_DEG:
        return []
    what = "its y axis points ahead, and its x axis, where azimuths start, to the right"
    return [f"{frame.name}: yaw {yaw_deg:.1f}°, as nuScenes has it: {what}"]


def _table(folder: Path, name: str) -> list[Row]:
    """The rows of a table. Raises ConversionError unless it has the keys of version 1.0."""
    path = folder / name
    try:
        check_memory(str(path), COPIES * check_regular(path))
        rows = json.loads(path.read_bytes())
    except OSError as error:
        raise ConversionError.from_os(path, error) from None
    except (ValueError, RecursionError) as error:
        raise ConversionError(f"{path}: not JSON: {error}") from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ConversionError(f"{path}: is not a list of rows, as nuScenes' tables are")
    for i, row in enumerate(rows):
        if missing := [key for key in KEYS[name] if key not in row]:
            what = f"row {i} has no {', '.join(missing)}; allowed: the tables of nuScenes 1.0"
            raise ConversionError(f"{path}: {what}; it has {', '.join(map(str, row)) or 'nothing'}")
    return rows


def _tokens(folder: Path, scene: str) -> set[str]:
    """The calibrations of a scene's first sample."""
    first = [row["first_sample_token"] for row in _table(folder, "scene.json") if row["name"] == scene]
    if not first:
        raise ConversionError(f"{folder / 'scene.json'}: has no scene {scene!r}; it has {_scenes(folder)}")
    return {
        row["calibrated_sensor_token"] for row in _table(folder, "sample_data.json") if row["sample_token"] == first[0]
    }


def _scenes(folder: Path) -> str:
    if not (folder / "scene.json").is_file():
        return "but there is no scene.json"
    return listed(tuple(str(row["name"]) for row in _table(folder, "scene.json")))


def _numbers(where: str, row: Row, key: str, count: int) -> list[float]:
    values = row[key]
    if (
        not isinstance(values, list)
        or len(values) != count
        or any(isinstance(one, bool) or not isinstance(one, int | float) for one in values)
    ):
        raise ConversionError(f"{where}: {key} is not {count} numbers")
    return [float(one) for one in values]
