"""A capture as a ROS 2 bag: the fields of seyond_ros_driver's PointXYZIT, read by rosbags, and what decode gives."""

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.io.bag import save_bag
from lidarcfg.sensors.rig import Rig
from tests.capture_fixtures import decoded, no_warning, scene
from tests.packets.seyond.fixtures import mount

UINT8, UINT16, FLOAT32, FLOAT64 = 2, 4, 7, 8
FIELDS = [  # point_types.h of tier4/seyond_ros_driver, without what aligns them
    *[("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("timestamp", 12, FLOAT64), ("intensity", 20, FLOAT32)],
    *[("flags", 24, UINT8), ("elongation", 25, UINT8), ("scan_id", 26, UINT16), ("scan_idx", 28, UINT16)],
    *[("is_2nd_return", 30, UINT8), ("roi", 31, UINT8)],
]
ROW = np.dtype(
    [
        *[("xyz", "<f4", (3,)), ("timestamp", "<f8"), ("intensity", "<f4"), ("flags", "u1"), ("elongation", "u1")],
        *[("scan_id", "<u2"), ("scan_idx", "<u2"), ("is_2nd_return", "u1"), ("roi", "u1")],
    ]
)


@pytest.mark.slow
def test_points_are_laid_out_as_the_drivers(tmp_path):
    rig = Rig("rig", (mount("robin-w"),))
    path = tmp_path / "a.pcap"
    there = scene(tmp_path, "ground: {reflectivity: 12}")
    write_pcap(path, in_time_order(simulated_packets(rig, there, np.eye(4), 160_000_000)))
    assert save_bag(tmp_path / "bag", path, "sqlite3", rig, None, no_warning) == 3  # two frames, and the pose
    store = get_typestore(Stores.LATEST)
    with Reader(tmp_path / "bag") as reader:
        messages = [store.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic != "/tf_static"]
    assert [(one.name, one.offset, one.datatype) for one in messages[0].fields] == FIELDS
    rows = np.concatenate([one.data.view(ROW) for one in messages])
    cloud = decoded(path)  # in the sensor's own frame, as the bag is
    assert (rows["xyz"] == cloud.xyz.astype(np.float32)).all()
    assert (rows["intensity"] == cloud.intensity * 16.0).all()
    assert abs(rows["timestamp"] - cloud.time_ns / 1e9).max() < 1e-6
    assert rows["scan_id"].min() >= 96 - 24  # the upper half sees no ground
    assert rows["scan_id"].max() == 191
    assert rows["scan_idx"].max() == 639
    first, second = (one.data.view(ROW)["timestamp"] for one in messages)
    assert first.max() < second.min()
    assert 0.05 < second.min() - first.min() < 0.15
