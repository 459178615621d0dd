"""ROS messages, made by a store of rosbags' types: points, transforms, detections; of ROS 2 and of ROS 1."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.geometry import Array, quaternion_xyzw
from lidarcfg.packets.point_fields import PointField
from lidarcfg.units import SECOND_NS
from lidarcfg.world.boxes import Boxes

AXES = "xyz"
FIELD_TYPES = {"u1": 2, "<u2": 4, "<i4": 5, "<u4": 6, "<f4": 7, "<f8": 8}  # of sensor_msgs/PointField
TRANSFORMS = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"}
BOX = {"vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size"}
# vision_msgs 4, as of ROS 2 Humble, and vision_msgs 0.0.1, as of ROS 1 Noetic; rosbags has neither.
VISION_2 = BOX | {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
VISION_1 = BOX | {
    "vision_msgs/msg/ObjectHypothesisWithPose": "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nsensor_msgs/PointCloud2 source_cloud"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
# Raw packets as drivers of LiDARs record them, for bags that do not describe their own types.
STAMP = "builtin_interfaces/Time stamp"
DRIVERS = {
    "velodyne_msgs/msg/VelodynePacket": f"{STAMP}\nuint8[1206] data",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    "pandar_msgs/msg/PandarPacket": f"{STAMP}\nuint8[1500] data\nuint32 size",
    "pandar_msgs/msg/PandarScan": "std_msgs/Header header\npandar_msgs/PandarPacket[] packets",
    "nebula_msgs/msg/NebulaPacket": f"{STAMP}\nuint8[] data",
    "nebula_msgs/msg/NebulaPackets": "std_msgs/Header header\nnebula_msgs/NebulaPacket[] packets",
    "ouster_msgs/msg/PacketMsg": "uint8[] buf",
    "ouster_sensor_msgs/msg/PacketMsg": "uint8[] buf",
}


def ros_store(version: int) -> Any:
    """The message types of ROS 1 (Noetic) or 2 (Humble), those of detections and of drivers' packets too."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    texts = DRIVERS | (TRANSFORMS | VISION_1 if version == 1 else VISION_2)
    store.register({key: kind for name, text in texts.items() for key, kind in get_types_from_msg(text, name).items()})
    return store


@dataclass(frozen=True)
class Messages:
    """Makes messages of one version of ROS."""

    types: Any  # by name
    version: int  # of ROS

    def header(self, frame: str, stamp_ns: int) -> Any:
        """A header; ROS 1 numbers them, which nobody reads."""
        seconds, rest_ns = divmod(stamp_ns, SECOND_NS)
        stamp = self.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest_ns)
        number = {"seq": 0} if self.version == 1 else {}
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **number)

    def points(self, scan: PointCloud, fields: tuple[PointField, ...], frame: str, stamp_ns: int) -> Any:
        """A scan as a PointCloud2."""
        rows = np.empty(len(scan.xyz), [(field.name, field.kind) for field in fields])
        for field in fields:
            rows[field.name] = _column(scan, field.column, stamp_ns)
        return self._cloud(rows, fields, frame, stamp_ns)

    def _cloud(self, rows: NDArray[np.void], fields: tuple[PointField, ...], frame: str, stamp_ns: int) -> Any:
        layout: dict[str, Any] = dict(rows.dtype.fields or {})
        message = self.types["sensor_msgs/msg/PointField"]
        return self.types["sensor_msgs/msg/PointCloud2"](
            header=self.header(frame, stamp_ns),
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

    def transforms(self, poses: Mapping[str, Array], parent: str, stamp_ns: int) -> Any:
        """Poses (4, 4) of frames in a parent frame."""
        transforms = []
        for frame, T in poses.items():
            x, y, z, w = quaternion_xyzw(T)
            transforms.append(
                self.types["geometry_msgs/msg/TransformStamped"](
                    header=self.header(parent, stamp_ns),
                    child_frame_id=frame,
                    transform=self.types["geometry_msgs/msg/Transform"](
                        translation=self.types["geometry_msgs/msg/Vector3"](*T[:3, 3].tolist()),
                        rotation=self.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
                    ),
                )
            )
        return self.types["tf2_msgs/msg/TFMessage"](transforms=transforms)

    def detections(self, boxes: Boxes, T_frame_box: Array, frame: str, stamp_ns: int) -> Any:
        """Boxes as a Detection3DArray; each has the time of its returns, and poses (N, 4, 4) in the frame at that."""
        found = [
            self._detection(one.name, one.category or "", one.size_m, T, self.header(frame, time_ns), one.index)
            for one, T, time_ns in zip(boxes.objects, T_frame_box, boxes.time_ns.tolist(), strict=True)
        ]
        array = self.types["vision_msgs/msg/Detection3DArray"]
        return array(header=self.header(frame, stamp_ns), detections=found)

    def _detection(self, name: str, category: str, size_m: Array, T: Array, header: Any, number: int) -> Any:
        types = self.types
        x, y, z, w = quaternion_xyzw(T)
        pose = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](*T[:3, 3].tolist()),
            orientation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        )
        uncertain = types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36))
        result = types["vision_msgs/msg/ObjectHypothesisWithPose"]
        if self.version == 1:
            empty = self._cloud(np.empty(0, [("x", "<f4")]), (), header.frame_id, 0)
            own: dict[str, Any] = {"source_cloud": empty}
            hypothesis = result(id=number, score=1.0, pose=uncertain)
        else:
            own = {"id": name}
            kind = types["vision_msgs/msg/ObjectHypothesis"](class_id=category, score=1.0)
            hypothesis = result(hypothesis=kind, pose=uncertain)
        size = types["geometry_msgs/msg/Vector3"](*size_m.tolist())
        box = types["vision_msgs/msg/BoundingBox3D"](center=pose, size=size)
        return types["vision_msgs/msg/Detection3D"](header=header, results=[hypothesis], bbox=box, **own)


def _column(scan: PointCloud, name: str, stamp_ns: int) -> NDArray[Any]:
    """The column that a `PointField` names."""
    if name in AXES:
        return scan.xyz[:, AXES.index(name)]
    if name == "time_s":
        return scan.time_ns / SECOND_NS
    if name == "since_stamp_ns":
        return scan.time_ns - stamp_ns
    if name == "since_stamp_s":
        return (scan.time_ns - stamp_ns) / SECOND_NS
    column: NDArray[Any] = scan.driver[name] if name in scan.driver else getattr(scan, name)
    return column
