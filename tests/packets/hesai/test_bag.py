"""A capture of Hesai's and Velodyne's sensors as a ROS 2 bag: each with the fields of its maker's driver."""

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.revolutions import revolutions
from lidarcfg.io.bag import save_bag
from lidarcfg.sensors.rig import Rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, mount, no_warning
from tests.packets.hesai.recorded import mount as hesai

FIELDS = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4)]  # HesaiLidar_ROS_2.0
STAMPED = np.dtype([("xyz", "<f4", 3), ("intensity", "<f4"), ("ring", "<u2"), ("timestamp", "<f8")])


@pytest.mark.slow
@pytest.mark.parametrize("model", ["pandar-xt16", "qt128", "ot128"])
def test_fields_as_the_makers_drivers_publish_them(model, tmp_path):
    mounts = (hesai(model), mount(1))
    topic = f"/{model.replace('-', '_')}/points"
    path = tmp_path / "two.pcap"
    streams = simulated_packets(Rig("two", mounts), load_scene(STREET), np.eye(4), 50_000_000)
    write_pcap(path, in_time_order(streams))
    save_sidecar_files(path, mounts)
    save_bag(tmp_path / "bag", path, "sqlite3", Rig("two", mounts), None, lambda warning: None)
    store = get_typestore(Stores.LATEST)
    with Reader(tmp_path / "bag") as reader:
        messages = {c.topic: store.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages()}
    fields = {
        name: [(field.name, field.offset, field.datatype) for field in message.fields]
        for name, message in messages.items()
        if name.endswith("/points")
    }
    assert fields["/lidar_1/points"] == [*FIELDS, ("time", 18, 7)]
    assert fields[topic] == [*FIELDS, ("timestamp", 18, 8)]
    message = messages[topic]
    assert message.point_step == 26
    rows = np.frombuffer(bytes(message.data), STAMPED)
    (scan,) = (scan for scan in revolutions(path, no_warning, Rig("two", mounts)) if scan.sensor_names == (model,))
    np.testing.assert_array_equal(rows["xyz"], scan.xyz.astype("<f4"))
    by_channel = mounts[0].sensor.elevation_rad[rows["ring"]]  # set_ring(ptinfo, channel_index) in the SDK's parsers
    np.testing.assert_allclose(by_channel, np.arcsin(scan.xyz[:, 2] / np.linalg.norm(scan.xyz, axis=1)), atol=1e-9)
    assert len(np.unique(rows["ring"])) > 5
    np.testing.assert_array_equal(rows["intensity"], scan.intensity)
    assert abs(rows["timestamp"] - scan.time_ns / 1e9).max() < 1e-6
    assert 0 < message.header.stamp.sec <= rows["timestamp"].min()
