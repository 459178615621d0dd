"""KITTI's calibrations: of the raw data, of the object benchmark, and of odometry.

The raw data and the object benchmark have the LiDAR's pose relative to the inertial sensor, whose axes are the
vehicle's: x forward, y left, z up. Odometry has it relative to camera 0 alone.
"""

import math
from pathlib import Path

import numpy as np

from lidarcfg.errors import ConversionError
from lidarcfg.geometry import Array, inverse
from lidarcfg.inputs import read_regular
from lidarcfg.io.rig_importers.sensor_kit import LidarFrame, SensorKit
from lidarcfg.world.frame_tree import Pose

RAW = "calib_imu_to_velo.txt"
ODOMETRY = "calib.txt"
OBJECT_KEY = "Tr_imu_to_velo"
ODOMETRY_KEY = "Tr"
FILE_MAX = 1_000_000  # bytes
LIDAR = "velodyne"
MODEL = "hdl-64e-s2"  # Geiger et al. 2013: a Velodyne HDL-64E
IMU_HEIGHT_M = 0.93  # above the ground: KITTI's drawing of its sensors
AXES = np.array(
    [[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
)  # forward, left, up ← right, down, forward
ORTHONORMAL = 1e-4  # KITTI's rotations have seven digits


def is_kitti(path: Path) -> bool:
    """Whether a path is a calibration of KITTI: a .txt, or a folder with one."""
    if path.is_dir():
        return any((path / name).is_file() for name in (RAW, ODOMETRY))
    return path.suffix.lower() == ".txt"


def read_kitti(path: Path) -> SensorKit:
    """The kit of a calibration. Raises ConversionError, OSError."""
    if path.is_dir():
        path = next(path / name for name in (RAW, ODOMETRY) if (path / name).is_file())
    elif path.name != RAW and (path.parent / RAW).is_file() and path.name.startswith("calib_"):
        path = path.parent / RAW
    rows = _rows(path)
    cameras = tuple(sorted({f"camera {key[-1]}" for key in rows if key[:-1] == "P"}))
    if {"R", "T"} <= rows.keys():
        numbers = np.column_stack([np.reshape(rows["R"], (3, 3)), rows["T"]]) if len(rows["R"]) == 9 else None
        T_lidar_vehicle = _motion(path, "R", None if numbers is None else numbers.ravel().tolist())
        cameras = ("camera 0", "camera 1", "camera 2", "camera 3")
    elif OBJECT_KEY in rows:
        T_lidar_vehicle = _motion(path, OBJECT_KEY, rows[OBJECT_KEY])
    elif ODOMETRY_KEY in rows:
        T_vehicle_lidar = AXES @ _motion(path, ODOMETRY_KEY, rows[ODOMETRY_KEY])
        note = "odometry has no vehicle frame; its origin is camera 0, its axes forward, left, up"
        return _kit(path, T_vehicle_lidar, cameras, note)
    else:
        what = f"allowed: R and T ({RAW}), {OBJECT_KEY} or {ODOMETRY_KEY}; it has {', '.join(rows) or 'nothing'}"
        raise ConversionError(f"{path}: has no calibration of KITTI's LiDAR; {what}")
    note = f"the vehicle frame is the inertial sensor's; in KITTI's car it is {IMU_HEIGHT_M} m above the ground"
    return _kit(path, inverse(T_lidar_vehicle), cameras, note)


def _kit(path: Path, T_vehicle_lidar: Array, cameras: tuple[str, ...], note: str) -> SensorKit:
    frame = LidarFrame(LIDAR, Pose.of(T_vehicle_lidar), (MODEL,))
    return SensorKit(str(path), path.stem, (frame,), cameras, notes=(note,))


def _rows(path: Path) -> dict[str, list[float]]:
    """The numbers of each line `key: numbers`; lines of other values are skipped. Raises ConversionError."""
    rows: dict[str, list[float]] = {}
    try:
        lines = read_regular(path, FILE_MAX).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise ConversionError(f"{path}: not text in UTF-8 (byte {error.start})") from None
    for line in lines:
        key, colon, values = line.partition(":")
        try:
            rows[key.strip()] = [float(word) for word in values.split()]
        except ValueError:
            continue
        if not colon:
            del rows[key.strip()]
    return rows


def _motion(path: Path, key: str, numbers: list[float] | None) -> Array:
    """A rigid motion (4, 4) of twelve numbers, by rows. Raises ConversionError."""
    if numbers is None or len(numbers) != 12 or not all(map(math.isfinite, numbers)):
        raise ConversionError(f"{path}: {key} is not a rotation and a translation")
    T = np.vstack([np.reshape(numbers, (3, 4)), (0.0, 0.0, 0.0, 1.0)])
    R = T[:3, :3]
    if abs(R @ R.T - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(R) < 0:
        raise ConversionError(f"{path}: {key} is not a rotation and a translation")
    return T
