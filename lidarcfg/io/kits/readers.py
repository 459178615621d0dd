"""Reads a kit in any of the formats, told apart by name or by content."""

from collections.abc import Mapping
from pathlib import Path

from lidarcfg.config.kinds import kind_of
from lidarcfg.config.models import load_keys
from lidarcfg.errors import ConversionError
from lidarcfg.io.bag_reader import is_bag, open_bag
from lidarcfg.io.carla import read_carla
from lidarcfg.io.kits.autoware import FILES, is_calibration, read_autoware
from lidarcfg.io.kits.frames import FrameTree, Joint, pose_of_quaternion
from lidarcfg.io.kits.kit import Kit, kit_of_tree
from lidarcfg.io.kits.kitti import is_kitti, read_kitti
from lidarcfg.io.kits.nuscenes import read_nuscenes, tables_folder
from lidarcfg.io.urdf import SUFFIXES, read_urdf

TF_STATIC = "/tf_static"


def read_tf_static(path: Path, models: Mapping[str, str]) -> Kit:
    """The kit of a bag's static transforms; of a frame that is sent again the last counts. Raises ConversionError."""
    joints: dict[str, Joint] = {}
    with open_bag(path) as bag:
        if TF_STATIC not in bag.topics:
            raise ConversionError(f"{path}: has no {TF_STATIC}; its topics: {', '.join(sorted(bag.topics)) or 'none'}")
        for message in bag.messages(TF_STATIC):
            for one in message.value.transforms:
                child = one.child_frame_id.strip("/")
                at = one.transform.translation
                turn = one.transform.rotation
                where = f"{path}: {TF_STATIC} of {child}"
                pose = pose_of_quaternion(where, (at.x, at.y, at.z), (turn.w, turn.x, turn.y, turn.z))
                joints[child] = Joint(one.header.frame_id.strip("/"), pose)
    if not joints:
        raise ConversionError(f"{path}: {TF_STATIC} has no transforms")
    return kit_of_tree(str(path), path.stem, FrameTree(str(path), joints), models, {})


ALLOWED = "a URDF, Autoware's calibration, nuScenes' tables, a bag, KITTI's calibration, JSON for CARLA"


def read_kit(path: Path, models: Mapping[str, str], scene: str | None = None) -> Kit:
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
