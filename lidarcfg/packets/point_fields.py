"""The fields of points as makers' ROS drivers publish them in a PointCloud2."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PointField:
    """One field: what it is called, its type as numpy writes it, and the column that it holds.

    Columns are x, y, z, intensity, ring, return_type and object of the cloud; since_stamp_s and since_stamp_ns, after
    the message's stamp; time_s, since 1970; and those that the decoder gives besides.
    """

    name: str
    kind: str
    column: str


PLACE = tuple(PointField(name, "<f4", name) for name in "xyz")
SHARED = (*PLACE, PointField("intensity", "<f4", "intensity"), PointField("ring", "<u2", "ring"))
TIMED = (*SHARED, PointField("time", "<f4", "since_stamp_s"))  # velodyne_driver's PointXYZIRT
STAMPED = (*SHARED, PointField("timestamp", "<f8", "time_s"))  # rslidar_sdk
HESAI = (  # HesaiLidar_ROS_2.0: the ring is the channel, from 0, which of most models is the highest beam
    *PLACE,
    PointField("intensity", "<f4", "intensity"),
    PointField("ring", "<u2", "channel"),
    PointField("timestamp", "<f8", "time_s"),
)
OBJECT = PointField("object", "<i4", "object")  # of ground truth
PLAIN = (*TIMED, PointField("return_type", "u1", "return_type"), OBJECT)  # of points without packets
OUSTER = (  # ouster-ros: intensity is the signal, the ring the pixel's row from the top, the range in mm
    *PLACE,
    PointField("intensity", "<f4", "signal"),
    PointField("t", "<u4", "since_stamp_ns"),
    PointField("reflectivity", "<u2", "intensity"),
    PointField("ring", "<u2", "row"),
    PointField("ambient", "<u2", "near_ir"),
    PointField("range", "<u4", "range_mm"),
)
LIVOX = (  # livox_ros_driver2's PointXYZRTLT: the timestamp is in nanoseconds
    *PLACE,
    PointField("intensity", "<f4", "intensity"),
    PointField("tag", "u1", "tag"),
    PointField("line", "u1", "ring"),
    PointField("timestamp", "<f8", "time_ns"),
)
SEYOND = (  # seyond_ros_driver's PointXYZIT
    *PLACE,
    PointField("timestamp", "<f8", "time_s"),
    PointField("intensity", "<f4", "strength"),
    PointField("flags", "u1", "flags"),
    PointField("elongation", "u1", "elongation"),
    PointField("scan_id", "<u2", "scan_id"),
    PointField("scan_idx", "<u2", "scan_idx"),
    PointField("is_2nd_return", "u1", "is_2nd_return"),
    PointField("roi", "u1", "roi"),
)
