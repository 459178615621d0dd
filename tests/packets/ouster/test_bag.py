"""A recording as a ROS 2 bag: the fields of ouster-ros, with ouster-sdk's values in them."""

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from lidarcfg.io.bag import save_bag
from tests.packets.ouster.judge import judged
from tests.packets.ouster.test_decode import DUAL, LOW, SINGLE, files

# ouster_ros::Point as os_point.h registers it, with the types of sensor_msgs/PointField
FIELDS = [
    ("x", 7),
    ("y", 7),
    ("z", 7),
    ("intensity", 7),
    ("t", 6),
    ("reflectivity", 4),
    ("ring", 4),
    ("ambient", 4),
    ("range", 6),
]
TYPES = {7: "<f4", 6: "<u4", 4: "<u2"}


@pytest.mark.parametrize("name", [SINGLE, DUAL, LOW])
def test_fields_are_those_of_ouster_ros(tmp_path, name):
    pcap, metadata = files(name)
    save_bag(tmp_path / "bag", pcap, "sqlite3", None, None, lambda warning: None)
    store = get_typestore(Stores.LATEST)
    with Reader(tmp_path / "bag") as reader:
        messages = [store.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages()]
    assert [[(field.name, field.datatype) for field in one.fields] for one in messages] == [FIELDS] * len(messages)
    kind = np.dtype([(key, TYPES[code]) for key, code in FIELDS])
    assert {(one.point_step, one.header.stamp.sec) for one in messages} == {
        (kind.itemsize, messages[0].header.stamp.sec)
    }
    stamps_ns = [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in messages]
    rows = np.concatenate([np.frombuffer(bytes(one.data), kind) for one in messages])
    time_ns = np.repeat(stamps_ns, [one.width for one in messages]) + rows["t"]

    theirs = judged(pcap, metadata)
    ends = [end for end in ("", "2") if f"range{end}" in theirs.fields]
    ranges = np.stack([theirs.fields[f"range{end}"] for end in ends], axis=-1)
    there = (ranges > 0) & theirs.valid[:, :, None, None]
    packet, column, row, which = np.nonzero(there)
    np.testing.assert_array_equal(rows["range"], ranges[there])
    np.testing.assert_array_equal(rows["ring"], row)
    np.testing.assert_array_equal(rows["ambient"], theirs.fields["near_ir"][packet, column, row])
    np.testing.assert_array_equal(time_ns, theirs.time_ns[packet, column])
    for key, field in (("reflectivity", "reflectivity"), ("intensity", "signal")):
        none = np.zeros_like(theirs.fields["range"])  # ouster-ros writes 0 where a profile has no signal
        both = np.stack([theirs.fields.get(f"{field}{end}", none) for end in ends], axis=-1)
        np.testing.assert_array_equal(rows[key], both[there])
    points = np.stack([theirs.points(f"range{end}") for end in ends], axis=3)[packet, column, row, which]
    np.testing.assert_allclose(np.stack([rows[axis] for axis in "xyz"], axis=1), points, rtol=1e-6, atol=1e-5)
