"""A capture as a ROS 2 bag: the fields of rslidar_sdk's XYZIRT, read by rosbags, and what decode gives."""

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.io.bag import save_bag
from lidarcfg.sensors.rig import Rig
from tests.capture_fixtures import decoded, no_warning, scene
from tests.packets.robosense.fixtures import mount

FLOAT32 = 7
FLOAT64 = 8
UINT16 = 4
FIELDS = [
    *[("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("intensity", 12, FLOAT32)],
    *[("ring", 16, UINT16), ("timestamp", 18, FLOAT64)],
]
ROW = np.dtype([("xyz", "<f4", (3,)), ("intensity", "<f4"), ("ring", "<u2"), ("timestamp", "<f8")])


@pytest.mark.parametrize("model", ["helios-32", "airy"])
def test_points_are_laid_out_as_the_drivers(model, tmp_path):
    rig = Rig("rig", (mount(model, rpy_rad=(0.8, 0.0, 0.0)),))
    path = tmp_path / "a.pcap"
    there = scene(tmp_path, "ground: {reflectivity: 12}")
    write_pcap(path, in_time_order(simulated_packets(rig, there, np.eye(4), 220_000_000)))
    assert save_bag(tmp_path / "bag", path, "sqlite3", rig, None, no_warning) == 4  # three revolutions, and the pose
    store = get_typestore(Stores.LATEST)
    with Reader(tmp_path / "bag") as reader:
        messages = [store.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic != "/tf_static"]
    assert [(one.name, one.offset, one.datatype) for one in messages[0].fields] == FIELDS
    rows = np.concatenate([one.data.view(ROW) for one in messages])
    cloud = decoded(path)  # in the sensor's own frame, as the bag is
    assert (rows["xyz"] == cloud.xyz.astype(np.float32)).all()
    assert (rows["intensity"] == cloud.intensity).all()
    assert (rows["ring"] == cloud.ring).all()
    assert (rows["timestamp"] == cloud.time_ns / 1e9).all()
