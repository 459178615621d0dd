"""ROS bags, by rosbags: a PointCloud2 per scan of each sensor, and the sensors' poses; for a drive also ground truth.

Points are laid out as the maker's driver has them, by the `point_fields` of their family, with nothing between the
fields. The message's stamp is the time of the scan's first point.
"""

import os
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from lidarcfg.capture.revolutions import revolutions
from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import ConversionError, PacketError, missing
from lidarcfg.files import check_replaceable, commit, replacing_folder, resolve, temporary_folder
from lidarcfg.geometry import inverse
from lidarcfg.io.drive_dataset import DriveDataset, stamp_ns
from lidarcfg.io.ros_messages import Messages, ros_store
from lidarcfg.io.ros_names import BASE_LINK, MAP, ros_name, ros_names
from lidarcfg.packets.families import family
from lidarcfg.packets.point_fields import OBJECT, PLAIN, PointField
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import SECOND_NS

TIME_END_NS = 2**31 * SECOND_NS  # builtin_interfaces/Time counts its seconds in an int32
BAG_VERSION: Final = 8  # of metadata.yaml: with QoS as text, as in rosbag2 before Jazzy
TF = "/tf"
TF_STATIC = "/tf_static"
TF_STEP_NS = 10_000_000  # from one pose of the vehicle to the next
FOREVER = 9223372036, 854775807  # seconds and ns: rmw's infinite time
BAG_FILES = ("metadata.yaml", "*.db3", "*.mcap")
URI_SIGNS = "?#%"  # have other meanings in the file: URI that rosbags passes to SQLite

OnWarning = Callable[[str], None]
TimedMessages = Iterator[tuple[str, Any, int]]  # topic, message, and the time at which a driver would have sent it
MessageSource = Callable[[Messages], TimedMessages]


def save_bag(path: Path, source: Path, storage: str, rig: Rig | None, model: str | None, on_warning: OnWarning) -> int:
    """Write the capture `source` as a bag, whole or not at all; return the number of messages.

    `storage` is sqlite3 or mcap, a folder, or ros1, a file. Raises ConversionError, and what `scans` raises.
    """
    return write_bag(path, storage, _capture_messages(source, rig, model, on_warning))


def save_mcap(path: Path, source: Path, rig: Rig | None, model: str | None, on_warning: OnWarning) -> int:
    """Write the capture `source` as one .mcap, whole or not at all; return the number of messages."""
    return write_mcap(path, _capture_messages(source, rig, model, on_warning))


def write_bag(path: Path, storage: str, made: MessageSource) -> int:
    """Write messages as a bag, whole or not at all, and return their number. Raises ConversionError, OSError."""
    if storage == "ros1":
        return _write_file(path, lambda aside: (_write(aside / path.name, storage, made), aside / path.name))
    whole = Path(os.path.realpath(resolve(path)))
    if storage == "sqlite3" and (signs := set(URI_SIGNS) & set(str(whole))):
        raise ConversionError(f"{whole}: rosbags cannot write a bag to a path with {' '.join(sorted(signs))}")
    with replacing_folder(path, *BAG_FILES) as folder:
        return _write(folder, storage, made)


def write_mcap(path: Path, made: MessageSource) -> int:
    """Write messages as one .mcap, whole or not at all, and return their number."""

    def write(aside: Path) -> tuple[int, Path]:
        folder = aside / path.stem
        return _write(folder, "mcap", made), folder / f"{folder.name}.mcap"

    return _write_file(path, write)


def _write_file(path: Path, write: Callable[[Path], tuple[int, Path]]) -> int:
    """Have a file written in a temporary folder, then move it into place; returns what `write` counted."""
    if path.exists() and not path.is_file():
        raise ConversionError(f"{path}: is not a file; give the name of a new one")
    check_replaceable(path)
    with temporary_folder(path) as folder:
        count, written = write(folder)
        commit(written, resolve(path))
    return count


def _write(path: Path, storage: str, made: MessageSource) -> int:
    """Write messages to a new bag, and return their number."""
    try:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
    except ImportError:
        raise missing("rosbags") from None
    version = 1 if storage == "ros1" else 2
    store = ros_store(version)
    connections: dict[str, Any] = {}
    count = 0
    writer: Any
    if version == 1:
        writer = Writer1(path)
        serialize = store.serialize_ros1
    else:
        writer = Writer2(path, version=BAG_VERSION, storage_plugin=StoragePlugin[storage.upper()])
        serialize = store.serialize_cdr
    try:
        with writer:
            for topic, message, time_ns in made(Messages(store.types, version)):
                kind = message.__msgtype__
                if topic not in connections:
                    lasting = topic == TF_STATIC
                    qos: dict[str, Any] = {"latching": int(lasting)}
                    if version == 2:
                        qos = {"offered_qos_profiles": [_latched_qos()] * lasting}
                    connections[topic] = writer.add_connection(topic, kind, typestore=store, **qos)
                writer.write(connections[topic], time_ns, serialize(message, kind))
                count += 1
    except sqlite3.Error as error:
        raise ConversionError(f"{path.name}: {error}") from None
    return count


def _capture_messages(source: Path, rig: Rig | None, model: str | None, on_warning: OnWarning) -> MessageSource:
    """The messages of a capture. Raises PacketError if it holds no return."""

    def made(messages: Messages) -> TimedMessages:
        names = ros_names(rig, on_warning) if rig else {}
        seen: set[str] = set()
        families: dict[str, str] = {}
        for scan in revolutions(source, on_warning, rig, model, on_source=families.__setitem__, driver=True):
            _check_time(int(scan.time_ns.max()), source)
            if rig and not seen:
                yield TF_STATIC, _sensor_transforms(messages, rig, names, stamp_ns(scan)), stamp_ns(scan)
            (name,) = scan.sensor_names
            if name not in names:
                names[name] = ros_name(name)
                on_warning(f"{name} is called {names[name]} in ROS; without a rig there is no {TF_STATIC}")
            seen.add(name)
            yield _points(messages, scan, family(families[name]).point_fields, names[name])
        if not seen:
            raise PacketError(f"{source}: has no returns to convert")
        if absent := [name for name in names if name not in seen]:
            on_warning(f"{source}: has no returns from {', '.join(absent)}")

    return made


def dataset_messages(dataset: DriveDataset, where: Path, on_warning: OnWarning) -> MessageSource:
    """The messages of a drive: poses of the vehicle and its sensors, points with their objects, boxes of objects.

    If the points' objects are not known, there are boxes of all objects that have one.
    """
    rig = dataset.drive.rig

    def made(messages: Messages) -> TimedMessages:
        names = ros_names(rig, on_warning)
        start_ns = dataset.drive.start_ns
        _check_time(start_ns + dataset.drive.duration_ns, where)
        yield TF_STATIC, _sensor_transforms(messages, rig, names, start_ns), start_ns
        pose_ns = start_ns
        for scan in dataset.scans:
            name = names[scan.sensor_names[0]]
            last_ns = int(scan.time_ns.max())
            while pose_ns <= last_ns:
                vehicle = {BASE_LINK: dataset.T_world_vehicle(pose_ns)}
                yield TF, messages.transforms(vehicle, MAP, pose_ns), pose_ns
                pose_ns += TF_STEP_NS
            yield _points(messages, scan, _fields(dataset, scan), name)
            if not dataset.drive.scene.names:
                continue
            boxes = dataset.boxes(scan)
            boxes = boxes if scan.object is None else boxes.with_returns()
            poses = [
                inverse(dataset.T_world_sensor(scan, time_ns)) @ T
                for time_ns, T in zip(boxes.time_ns.tolist(), boxes.T_world_box, strict=True)
            ]
            found = messages.detections(boxes, np.array(poses).reshape(-1, 4, 4), name, stamp_ns(scan))
            yield f"/{name}/objects", found, last_ns

    return made


def _fields(dataset: DriveDataset, scan: PointCloud) -> tuple[PointField, ...]:
    """The fields of a scan's points; of packets, as the sensor's driver has them, and the object."""
    if not dataset.packets:
        return PLAIN
    fields = family(dataset.mount(scan).sensor.codec or "").point_fields
    return fields if scan.object is None else (*fields, OBJECT)


def _check_time(last_ns: int, where: Path) -> None:
    """Raises PacketError for times that ROS 2 cannot represent."""
    if last_ns >= TIME_END_NS:
        raise PacketError(f"{where}: goes on after 2038-01-19 03:14:07 UTC, the last second of ROS 2")


def _points(messages: Messages, scan: PointCloud, fields: tuple[PointField, ...], frame: str) -> tuple[str, Any, int]:
    """Topic, PointCloud2 and time of a scan."""
    message = messages.points(scan, fields, frame, stamp_ns(scan))
    return f"/{frame}/points", message, int(scan.time_ns.max())


def _sensor_transforms(messages: Messages, rig: Rig, names: dict[str, str], at_ns: int) -> Any:
    """The sensors' poses on the vehicle."""
    poses = {names[mount.name]: mount.T_vehicle_sensor for mount in rig.mounts}
    return messages.transforms(poses, BASE_LINK, at_ns)


def _latched_qos() -> Any:
    """The QoS of transforms that never change: late subscribers get them, too."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    always = QosTime(*FOREVER)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=always,
        lifespan=always,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=always,
        avoid_ros_namespace_conventions=False,
    )
