"""ROS 2 bags, by rosbags: a PointCloud2 per scan of each sensor, and the sensors' poses.

Points are laid out as the maker's driver has them, by the `point_fields` of their family, with nothing between the
fields. The message's stamp is the time of the scan's first point.
"""

import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.scans import scans
from lidarcfg.cloud import PointCloud
from lidarcfg.errors import ConversionError, PacketError, missing
from lidarcfg.files import check_replaceable
from lidarcfg.formats.folder import beside, replacing_folder
from lidarcfg.formats.frames import BASE_LINK, quaternion_xyzw, ros_name, ros_names
from lidarcfg.packets.codec import family
from lidarcfg.packets.point_fields import PointField
from lidarcfg.rig import Rig
from lidarcfg.units import SECOND_NS

AXES = "xyz"
FIELD_TYPES = {"<u2": 4, "<u4": 6, "<f4": 7, "<f8": 8}  # of sensor_msgs/PointField
TIME_END_NS = 2**31 * SECOND_NS  # builtin_interfaces/Time counts its seconds in an int32
BAG_VERSION: Final = 8  # of metadata.yaml: QoS as text, as rosbag2 had it before Jazzy
TF_STATIC = "/tf_static"
FOREVER = 9223372036, 854775807  # seconds and ns: rmw's infinite time
BAG_FILES = ("metadata.yaml", "*.db3", "*.mcap")
URI_SIGNS = "?#%"  # have other meanings in the file: URI that rosbags passes to SQLite

OnWarning = Callable[[str], None]


def save_bag(path: Path, source: Path, storage: str, rig: Rig | None, model: str | None, on_warning: OnWarning) -> int:
    """Write the capture `source` as a bag in the folder `path`, whole or not at all; return the number of messages.

    `storage` is sqlite3 or mcap. Raises ConversionError, and what `scans` raises.
    """
    if storage == "sqlite3" and (signs := set(URI_SIGNS) & set(str(path.resolve()))):
        raise ConversionError(f"{path.resolve()}: rosbags cannot write a bag to a path with {' '.join(sorted(signs))}")
    with replacing_folder(path, *BAG_FILES) as folder:
        return _write(folder, storage, source, rig, model, on_warning)


def save_mcap(path: Path, source: Path, rig: Rig | None, model: str | None, on_warning: OnWarning) -> int:
    """Write the capture `source` as one .mcap, whole or not at all; return the number of messages."""
    if path.exists() and not path.is_file():
        raise ConversionError(f"{path}: is not a file; give the name of a new one")
    check_replaceable(path)
    with beside(path) as aside:
        folder = aside / path.stem
        count = _write(folder, "mcap", source, rig, model, on_warning)
        (folder / f"{folder.name}.mcap").replace(path.resolve())
    return count


def _write(folder: Path, storage: str, source: Path, rig: Rig | None, model: str | None, on_warning: OnWarning) -> int:
    """The bag of the capture, in a new folder."""
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise missing("rosbags") from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    connections: dict[str, Any] = {}
    count = 0
    try:
        with Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            for topic, message, time_ns in _messages(store.types, source, rig, model, on_warning):
                kind = message.__msgtype__
                if topic not in connections:
                    qos = [_latched()] if topic == TF_STATIC else []
                    connections[topic] = writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=qos)
                writer.write(connections[topic], time_ns, store.serialize_cdr(message, kind))
                count += 1
    except sqlite3.Error as error:
        raise ConversionError(f"{folder.name}: {error}") from None
    if not count:
        raise PacketError(f"{source}: holds no returns to convert")
    return count


def _messages(
    types: Any, source: Path, rig: Rig | None, model: str | None, on_warning: OnWarning
) -> Iterator[tuple[str, Any, int]]:
    """Topic, message, and the time at which a driver would have sent it: at the end of the scan."""
    names = ros_names(rig, on_warning) if rig else {}
    seen: set[str] = set()
    families: dict[str, str] = {}
    for scan in scans(source, on_warning, rig, model, on_source=families.__setitem__, driver=True):
        first_ns, last_ns = int(scan.time_ns.min()), int(scan.time_ns.max())
        if last_ns >= TIME_END_NS:
            raise PacketError(f"{source}: goes on after 2038-01-19 03:14:07 UTC, the last second of ROS 2")
        if rig and not seen:
            yield TF_STATIC, _transforms(types, rig, names, first_ns), first_ns
        (name,) = scan.sensor_names
        if name not in names:
            names[name] = ros_name(name)
            on_warning(f"{name} is called {names[name]} in ROS; without a rig there is no {TF_STATIC}")
        seen.add(name)
        fields = family(families[name]).point_fields
        yield f"/{names[name]}/points", _points(types, scan, fields, names[name], first_ns), last_ns
    if absent := [name for name in names if name not in seen]:
        on_warning(f"{source}: holds nothing of {', '.join(absent)}")


def _points(types: Any, scan: PointCloud, fields: tuple[PointField, ...], frame: str, stamp_ns: int) -> Any:
    rows = np.empty(len(scan.xyz), [(field.name, field.kind) for field in fields])
    for field in fields:
        rows[field.name] = _column(scan, field.column, stamp_ns)
    layout: dict[str, Any] = dict(rows.dtype.fields or {})
    message = types["sensor_msgs/msg/PointField"]
    return types["sensor_msgs/msg/PointCloud2"](
        header=_header(types, frame, stamp_ns),
        height=1,
        width=len(rows),
        fields=[
            message(name=field.name, offset=layout[field.name][1], datatype=FIELD_TYPES[field.kind], count=1)
            for field in fields
        ],
        is_bigendian=False,
        point_step=rows.itemsize,
        row_step=rows.nbytes,
        data=rows.view(np.uint8),
        is_dense=True,
    )


def _column(scan: PointCloud, name: str, stamp_ns: int) -> NDArray[Any]:
    """What `PointField.column` calls so."""
    if name in AXES:
        return scan.xyz[:, AXES.index(name)]
    if name == "intensity":
        return scan.intensity
    if name == "ring":
        return scan.ring
    if name == "time_s":
        return scan.time_ns / SECOND_NS
    if name == "since_stamp_ns":
        return scan.time_ns - stamp_ns
    if name == "since_stamp_s":
        return (scan.time_ns - stamp_ns) / SECOND_NS
    return scan.driver[name]


def _transforms(types: Any, rig: Rig, names: dict[str, str], stamp_ns: int) -> Any:
    """The sensors' poses on the vehicle."""
    transforms = []
    for mount in rig.mounts:
        x, y, z, w = quaternion_xyzw(mount.T_vehicle_sensor)
        transforms.append(
            types["geometry_msgs/msg/TransformStamped"](
                header=_header(types, BASE_LINK, stamp_ns),
                child_frame_id=names[mount.name],
                transform=types["geometry_msgs/msg/Transform"](
                    translation=types["geometry_msgs/msg/Vector3"](*mount.position_m),
                    rotation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
                ),
            )
        )
    return types["tf2_msgs/msg/TFMessage"](transforms=transforms)


def _header(types: Any, frame: str, stamp_ns: int) -> Any:
    seconds, rest_ns = divmod(stamp_ns, SECOND_NS)
    return types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest_ns), frame_id=frame
    )


def _latched() -> Any:
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
