"""Reads a kit of sensors in any of the formats, told apart by name or by content."""

from collections.abc import Mapping
from pathlib import Path

from lidarcfg.config.kinds import kind_of
from lidarcfg.config.models import load_keys
from lidarcfg.errors import ConversionError
from lidarcfg.io.bag_reader import is_bag
from lidarcfg.io.carla import read_carla
from lidarcfg.io.rig_importers.autoware import FILES, is_calibration, read_autoware
from lidarcfg.io.rig_importers.kitti import is_kitti, read_kitti
from lidarcfg.io.rig_importers.nuscenes import read_nuscenes, tables_folder
from lidarcfg.io.rig_importers.sensor_kit import SensorKit
from lidarcfg.io.rig_importers.tf_static import read_tf_static
from lidarcfg.io.urdf import read_urdf
from lidarcfg.world.robot import SUFFIXES

ALLOWED = "a URDF, Autoware's calibration, nuScenes' tables, a bag, KITTI's calibration, JSON for CARLA"


def read_kit(path: Path, models: Mapping[str, str], scene: str | None = None) -> SensorKit:
    """The kit in a file or a folder; `scene` is for nuScenes. Raises ConversionError, ConfigError, OSError."""
    if not path.exists():
        raise ConversionError(f"{path}: no such file or directory")
    if tables := tables_folder(path):
        return read_nuscenes(tables, scene)
    if scene:
        raise ConversionError(f"{path}: has no table calibrated_sensor.json; --scene is for nuScenes")
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        return read_urdf(path, models)
    if is_bag(path):
        return read_tf_static(path, models)
    if path.is_dir() and any((path / name).is_file() for name in FILES):
        return read_autoware(path, models)
    if is_kitti(path):
        return read_kitti(path)
    if path.is_dir():
        raise ConversionError(f"{path}: holds no kit; allowed: {ALLOWED}")
    if suffix == ".json":
        return read_carla(path)
    values = load_keys(path)
    if is_calibration(values):
        return read_autoware(path, models)
    what = f"this is a {found} of lidarcfg already" if (found := kind_of(values)) else "is not a kit"
    raise ConversionError(f"{path}: {what}; allowed: {ALLOWED}")
