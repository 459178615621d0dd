"""Captures as ROS 2 bags and MCAP: read by rosbags, mcap and pyquaternion, and compared with what decode gives."""

import sys
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pyquaternion import Quaternion
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import Datagram, write_pcap
from lidarcfg.capture.revolutions import Head, revolutions
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import ConversionError, PacketError
from lidarcfg.io.bag import save_bag, save_mcap
from lidarcfg.packets.velodyne.layout import PACKET
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, datagrams_of, no_warning, recording, tilted_rig, write_datagrams

DURATION_NS = 350_000_000


def named_rig() -> Rig:
    left, right = tilted_rig().mounts
    return Rig("tilted", (replace(left, name="left"), replace(right, name="right.2")))


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Three and a half revolutions of two VLP-16 in the street."""
    path = tmp_path_factory.mktemp("capture") / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(named_rig(), load_scene(STREET), np.eye(4), DURATION_NS)))
    return path


def bag_messages(folder) -> list:
    """Topic, time, message, QoS and type of a bag, by rosbags."""
    store = get_typestore(Stores.LATEST)
    with Reader(folder) as reader:
        return [
            (c.topic, time_ns, store.deserialize_cdr(raw, c.msgtype), c.ext.offered_qos_profiles, c.msgtype)
            for c, time_ns, raw in reader.messages()
        ]


def mcap_messages(path) -> list:
    """The same of an MCAP file, by the MCAP project's own libraries; QoS as its text."""
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message.log_time, decoded, channel.metadata["offered_qos_profiles"], schema.name)
            for schema, channel, message, decoded in reader.iter_decoded_messages()
        ]


def points(message) -> np.ndarray:
    """The points by the message's own description of its fields (sensor_msgs/PointField)."""
    kinds = {2: "u1", 4: "<u2", 7: "<f4", 8: "<f8"}
    dtype = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [kinds[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    assert all(field.count == 1 for field in message.fields)
    assert not message.is_bigendian
    assert (message.height, message.row_step) == (1, message.width * message.point_step)
    rows = np.frombuffer(bytes(message.data), dtype)
    assert len(rows) == message.width
    return rows


def stamp_ns(message) -> int:
    return message.header.stamp.sec * SECOND_NS + message.header.stamp.nanosec


def written(way: str, capture, folder, rig=None, model=None, on_warning=lambda warning: None):
    """The capture handed over in one of the three ways, and its messages."""
    if way == "mcap":
        count = save_mcap(folder / "a.mcap", capture, rig, model, on_warning)
        messages = mcap_messages(folder / "a.mcap")
    else:
        count = save_bag(folder / "bag", capture, way, rig, model, on_warning)
        messages = bag_messages(folder / "bag")
    assert len(messages) == count
    return messages


@pytest.mark.slow
@pytest.mark.parametrize("way", ["sqlite3", "mcap-bag", "mcap"])
def test_points_and_places_are_those_that_decode_merges(capture, tmp_path, way):
    rig = named_rig()
    warnings = []
    if way == "mcap-bag":
        save_bag(tmp_path / "bag", capture, "mcap", rig, None, warnings.append)
        messages = bag_messages(tmp_path / "bag")
    else:
        messages = written(way, capture, tmp_path, rig, None, warnings.append)
    assert warnings == ["'right.2' is called right_2 in ROS"]
    assert messages[0][0] == "/tf_static"
    assert messages[0][4] == "tf2_msgs/msg/TFMessage"
    places = {}
    for transform in messages[0][2].transforms:
        assert transform.header.frame_id == "base_link"
        r = transform.transform.rotation
        t = transform.transform.translation
        places[transform.child_frame_id] = Quaternion(r.w, r.x, r.y, r.z), np.array([t.x, t.y, t.z])
    assert set(places) == {"left", "right_2"}
    decoded = concatenate(list(decode_pcap(capture, no_warning, rig)))
    seen = defaultdict(list)
    for topic, time_ns, message, _, kind in messages[1:]:
        assert kind == "sensor_msgs/msg/PointCloud2"
        frame = message.header.frame_id
        assert topic == f"/{frame}/points"
        rows = points(message)
        scan_ns = stamp_ns(message) + np.rint(rows["time"].astype(np.float64) * 1e9).astype(np.int64)
        assert rows["time"].min() == 0
        assert abs(scan_ns.max() - time_ns) < 10  # logged at the end of the scan
        q, t = places[frame]
        xyz = np.column_stack([rows[key] for key in "xyz"]).astype(np.float64)
        seen[frame].append((xyz @ q.rotation_matrix.T + t, rows["intensity"], rows["ring"], scan_ns))
    for i, frame in enumerate(("left", "right_2")):
        xyz, intensity, ring, time_ns = (np.concatenate(column) for column in zip(*seen[frame], strict=True))
        mine = decoded.sensor == i
        assert abs(xyz - decoded.xyz[mine]).max() < 1e-5  # half a step of float32 at 100 m is 4e-6
        assert (intensity == decoded.intensity[mine]).all()
        assert (ring == decoded.ring[mine]).all()
        assert abs(time_ns - decoded.time_ns[mine]).max() < 10  # float32 has 7.5 ns at 0.1 s


def test_the_points_are_laid_out_as_velodyne_driver_does(capture, tmp_path):
    messages = written("sqlite3", capture, tmp_path, named_rig())
    fields = [(field.name, field.offset, field.datatype, field.count) for field in messages[1][2].fields]
    # velodyne_pointcloud's PointXYZIRT, packed as PointCloud2Modifier does; FLOAT32 is 7, UINT16 is 4
    assert fields == [
        ("x", 0, 7, 1),
        ("y", 4, 7, 1),
        ("z", 8, 7, 1),
        ("intensity", 12, 7, 1),
        ("ring", 16, 4, 1),
        ("time", 18, 7, 1),
    ]
    assert messages[1][2].point_step == 22
    assert messages[1][2].is_dense


def test_who_comes_late_is_told_where_the_sensors_are(capture, tmp_path):
    (qos,) = written("sqlite3", capture, tmp_path, named_rig())[0][3]
    assert qos.durability == QosDurability.TRANSIENT_LOCAL
    assert (qos.reliability, qos.history, qos.depth) == (QosReliability.RELIABLE, QosHistory.KEEP_LAST, 1)
    text = written("mcap", capture, tmp_path, named_rig())[0][3]
    assert "durability: 1" in text  # rmw's TRANSIENT_LOCAL


def test_the_mcap_file_is_ros_2_and_indexed(capture, tmp_path):
    messages = written("mcap", capture, tmp_path, named_rig())
    with open(tmp_path / "a.mcap", "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        assert summary.statistics.message_count == len(messages)
        assert sum(1 for _ in reader.iter_messages(topics=["/left/points"])) == 4
        assert len(summary.chunk_indexes) >= 1


def test_a_message_is_a_scan(capture):
    found = defaultdict(list)
    for scan in revolutions(capture, no_warning, named_rig()):
        found[scan.sensor_names[0]].append(scan)
    decoded = concatenate(list(decode_pcap(capture, no_warning, named_rig())))
    for i, (name, rpm) in enumerate((("left", 600), ("right.2", 660))):
        parts = found[name]
        assert sum(len(part.xyz) for part in parts) == (decoded.sensor == i).sum()
        assert len(parts) == int(DURATION_NS * rpm // (60 * SECOND_NS)) + 1
        for k, part in enumerate(parts):
            azimuth = np.degrees(np.arctan2(-part.xyz[:, 1], part.xyz[:, 0])) % 360
            order = np.argsort(part.time_ns, kind="stable")
            turned = np.unwrap(azimuth[order], period=360)
            assert turned[-1] - turned[0] < 365  # a packet more or less is 4.8 degrees
            if k:  # the first is cut where the capture begins
                assert azimuth[order[0]] < 6
            if 0 < k < len(parts) - 1:
                assert turned[-1] - turned[0] > 350
        for before, after in pairwise(parts):
            assert before.time_ns.max() < after.time_ns.min()


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [1, 5, 100])
def test_scans_whatever_the_chunks(capture, chunk):
    def ordered(found):
        return sorted(found, key=lambda scan: (scan.sensor_names, scan.time_ns[0]))

    whole = ordered(revolutions(capture, no_warning))
    parts = ordered(revolutions(capture, no_warning, chunk_packets=chunk))
    for one, other in zip(whole, parts, strict=True):
        assert one.sensor_names == other.sensor_names
        assert (one.xyz == other.xyz).all()


@pytest.mark.parametrize("name", ["veloview_hdl32e_monterey.pcap", "nebula_vlp16.pcap", "mrpt_vlp16_gps.pcap"])
def test_scans_of_real_recordings_by_a_plain_loop(name):
    """Packets counted one by one: a scan ends where the azimuth falls; its points are the distances above zero."""
    path = recording(name)
    counts = [0]
    last = None
    packets = [datagram.payload for datagram in datagrams_of(path) if len(datagram.payload) == 1206]
    dual = packets[0][1204] == 0x39
    for packet in packets:
        azimuth = packet[2] + 256 * packet[3]
        if last is not None and azimuth < last:
            counts.append(0)
        last = azimuth
        blocks = [packet[100 * b : 100 * b + 100] for b in range(12)]
        for b, block in enumerate(blocks):
            for at in range(4, 100, 3):
                there = block[at] or block[at + 1]
                twin = dual and b % 2 == 1 and block[at : at + 3] == blocks[b - 1][at : at + 3]
                counts[-1] += bool(there and not twin)
    messages = list(revolutions(path, lambda warning: None))
    assert len(counts) > 1
    assert [len(scan.xyz) for scan in messages] == counts


def starts(azimuths, times_ns) -> list[int]:
    """When a head's revolutions begin: azimuths in hundredths of a degree, in pieces of 7 packets."""
    head = Head()
    for i in range(0, len(times_ns), 7):
        head.add(np.array(times_ns[i : i + 7]), np.radians(np.array(azimuths[i : i + 7]) / 100))
    return sorted(set(head.starts_ns))


def test_overtaken_and_duplicate_packets_make_no_scans():
    step_ns = 2_000_000
    step = 720
    times_ns = [START_NS + i * step_ns for i in range(120)]
    azimuths = [i * step % 36000 for i in range(120)]
    plain = list(zip(azimuths, times_ns, strict=True))
    right = [times_ns[i] for i in (0, 50, 100)]
    assert starts(azimuths, times_ns) == right
    for at in (20, 49, 50, 51, 99):
        odd = plain.copy()
        odd[at], odd[at + 1] = odd[at + 1], odd[at]
        found = starts(*zip(*odd, strict=True))
        assert len(found) == 3
        assert np.abs(np.array(found) - right).max() <= step_ns
    assert starts(*zip(*[one for one in plain for _ in range(2)], strict=True)) == right


def test_a_head_that_does_not_turn_has_a_scan_a_second():
    times_ns = [START_NS + i * 10_000_000 for i in range(250)]
    assert starts([12345] * 250, times_ns) == [times_ns[i] for i in (0, 100, 200)]
    wobbling = [12345 + i % 2 for i in range(250)]
    assert starts(wobbling, times_ns) == [times_ns[i] for i in (0, 100, 200)]


def test_a_narrow_field_of_view_has_scans():
    times_ns = [START_NS + i * 100_000_000 + j * 1_300_000 for i in range(4) for j in range(4)]
    azimuths = [10000 + 500 * j for _ in range(4) for j in range(4)]
    assert starts(azimuths, times_ns) == times_ns[::4]


def test_a_clock_that_is_set_back_begins_anew():
    step_ns = 2_000_000
    times_ns = [START_NS + 3 * SECOND_NS + i * step_ns for i in range(80)]
    times_ns += [START_NS + 10**9 + i * step_ns for i in range(80)]
    azimuths = [i * 720 % 36000 for i in range(160)]
    found = starts(azimuths, times_ns)
    assert found == sorted(times_ns[i] for i in (0, 50, 80, 100, 150))


def test_without_a_rig(capture, tmp_path):
    warnings = []
    messages = written("mcap", capture, tmp_path, on_warning=warnings.append)
    assert {topic for topic, *_ in messages} == {
        "/lidar_192_168_1_201_2368/points",
        "/lidar_192_168_1_202_2368/points",
    }
    assert sorted(warnings)[0] == (
        "192.168.1.201:2368 is called lidar_192_168_1_201_2368 in ROS; without a rig there is no /tf_static"
    )
    assert len(warnings) == 2


def test_a_rig_that_does_not_fit(capture, tmp_path):
    rig = named_rig()
    with pytest.raises(PacketError, match=r"192\.168\.1\.202:2368 is not in the rig 'one'"):
        save_bag(tmp_path / "bag", capture, "sqlite3", Rig("one", rig.mounts[:1]), None, no_warning)
    third = replace(rig.mounts[0], name="third", host="192.168.1.99")
    warnings = []
    save_mcap(tmp_path / "a.mcap", capture, Rig("three", (*rig.mounts, third)), None, warnings.append)
    assert warnings[-1] == f"{capture}: has no returns from third"
    clash = Rig("clash", (replace(rig.mounts[0], name="a.b"), replace(rig.mounts[1], name="a-b")))
    with pytest.raises(ConversionError, match="'a-b' would be a_b in ROS"):
        save_mcap(tmp_path / "b.mcap", capture, clash, None, lambda warning: None)
    assert [item.name for item in tmp_path.iterdir()] == ["a.mcap"]


def spoilt(capture, path):
    """The capture with a packet of another model after two revolutions."""
    datagrams = datagrams_of(capture)
    at = [i for i, one in enumerate(datagrams) if len(one.payload) == 1206][400]
    datagrams[at] = replace(datagrams[at], payload=datagrams[at].payload[:1205] + b"\x77")
    write_datagrams(path, datagrams)


@pytest.mark.slow
def test_whole_or_not_at_all(capture, tmp_path):
    spoilt(capture, tmp_path / "bad.pcap")
    save_bag(tmp_path / "bag", capture, "sqlite3", named_rig(), None, lambda warning: None)
    save_mcap(tmp_path / "a.mcap", capture, named_rig(), None, lambda warning: None)
    before = {item: item.read_bytes() for item in [tmp_path / "a.mcap", *(tmp_path / "bag").iterdir()]}
    for storage in ("sqlite3", "mcap"):
        with pytest.raises(PacketError, match="product id 0x77"):
            save_bag(tmp_path / "bag", tmp_path / "bad.pcap", storage, named_rig(), None, lambda warning: None)
    with pytest.raises(PacketError, match="product id 0x77"):
        save_mcap(tmp_path / "a.mcap", tmp_path / "bad.pcap", named_rig(), None, lambda warning: None)
    assert before == {item: item.read_bytes() for item in [tmp_path / "a.mcap", *(tmp_path / "bag").iterdir()]}
    assert {item.name for item in tmp_path.iterdir()} == {"bad.pcap", "bag", "a.mcap"}
    save_bag(tmp_path / "bag", capture, "mcap", named_rig(), None, lambda warning: None)  # a bag is replaced, whole
    assert {item.name for item in (tmp_path / "bag").iterdir()} == {"metadata.yaml", "bag.mcap"}


def test_ctrl_c_leaves_nothing(capture, tmp_path):
    """Interrupted at the second sensor's first scan, when the first sensor's is written."""
    for save in (
        lambda *words: save_bag(tmp_path / "bag", capture, "sqlite3", *words),
        lambda *words: save_bag(tmp_path / "bag", capture, "mcap", *words),
        lambda *words: save_mcap(tmp_path / "a.mcap", capture, *words),
    ):
        begun = []

        def stop(warning, begun=begun):
            if "in ROS" in warning:
                begun.append([path for path in tmp_path.rglob("*") if path.is_file()])
                if len(begun) == 2:
                    raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            save(None, None, stop)
        assert begun[1]  # files that could be left behind
        assert list(tmp_path.iterdir()) == []


def test_what_is_no_bag_is_left_alone(capture, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/cat.jpg").write_text("meow")
    with pytest.raises(
        ConversionError, match=r"photos: holds 'cat.jpg'; only a folder of metadata.yaml, \*\.db3, \*\.mcap"
    ):
        save_bag(tmp_path / "photos", capture, "sqlite3", named_rig(), None, no_warning)
    with pytest.raises(ConversionError, match="photos: is not a file"):
        save_mcap(tmp_path / "photos", capture, named_rig(), None, no_warning)
    with pytest.raises(ConversionError, match=r"cat\.jpg: is not a folder"):
        save_bag(tmp_path / "photos/cat.jpg", capture, "sqlite3", named_rig(), None, no_warning)
    with pytest.raises(OSError, match="Not a directory") as error:
        save_bag(tmp_path / "photos/cat.jpg/new/bag", capture, "sqlite3", named_rig(), None, no_warning)
    assert error.value.filename == str(tmp_path / "photos/cat.jpg/new/bag")
    with pytest.raises(ConversionError, match="rosbags cannot write a bag to a path with #"):
        save_bag(tmp_path / "a#b", capture, "sqlite3", named_rig(), None, no_warning)
    assert [item.name for item in tmp_path.iterdir()] == ["photos"]
    assert (tmp_path / "photos/cat.jpg").read_text() == "meow"


def test_nothing_to_hand_over(tmp_path):
    times_ns = [START_NS + i * 1_327_104 for i in range(40)]
    packets = np.zeros(40, PACKET)
    packets["blocks"]["flag"] = 0xEEFF
    packets["return_mode"] = 0x37
    packets["product_id"] = 0x22
    packets["blocks"]["azimuth"] = (np.arange(40) * 480)[:, None]
    packets["stamp_us"] = np.array(times_ns) // 1000 % (3600 * 10**6)
    datagrams = [
        Datagram(time_ns, "192.168.1.201", 2368, 2368, packet.tobytes())
        for time_ns, packet in zip(times_ns, packets, strict=True)
    ]
    write_datagrams(tmp_path / "a.pcap", datagrams)
    with pytest.raises(PacketError, match=r"a\.pcap: has no returns to convert"):
        save_mcap(tmp_path / "a.mcap", tmp_path / "a.pcap", None, None, no_warning)
    assert [item.name for item in tmp_path.iterdir()] == ["a.pcap"]


def test_the_seconds_of_ros_2_end(capture, tmp_path):
    later = [replace(one, time_ns=one.time_ns + 13 * 365 * 86_400 * SECOND_NS) for one in datagrams_of(capture)[:300]]
    write_datagrams(tmp_path / "later.pcap", later)
    with pytest.raises(PacketError, match="goes on after 2038-01-19 03:14:07 UTC, the last second of ROS 2"):
        save_mcap(tmp_path / "a.mcap", tmp_path / "later.pcap", named_rig(), None, lambda warning: None)


def test_without_rosbags(capture, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(ConversionError, match=r"rosbags is not installed; pip install 'lidarcfg\[convert\]'"):
        save_mcap(tmp_path / "a.mcap", capture, named_rig(), None, no_warning)
    assert list(tmp_path.iterdir()) == []
