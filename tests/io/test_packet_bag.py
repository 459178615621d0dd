"""Recordings put into bags as drivers have them, by rosbags, and taken out again."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.errors import ConversionError
from tests.capture_fixtures import datagrams_of, decoded, recording

TIME = "builtin_interfaces/Time stamp\n"
TYPES = {  # as the drivers' packages have them
    "velodyne_msgs/msg/VelodynePacket": TIME + "uint8[1206] data",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    "hesai_lidar/msg/PandarPacket": TIME + "uint8[1500] data\nuint32 size",
    "hesai_lidar/msg/PandarScan": "std_msgs/Header header\nhesai_lidar/PandarPacket[] packets",
    "nebula_msgs/msg/NebulaPacket": TIME + "uint8[] data",
    "nebula_msgs/msg/NebulaPackets": "std_msgs/Header header\nnebula_msgs/NebulaPacket[] packets",
    "ouster_msgs/msg/PacketMsg": "uint8[] buf",
}
SCAN = 75  # packets of a message


def lidar_bag(path, version, topics, texts=()):
    """A bag of the datagrams of each topic, in messages of a type and with a frame; and of texts."""
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    for name, text in TYPES.items():
        store.register(get_types_from_msg(text, name))
    types = store.types
    writer = Writer1(path) if version == 1 else Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3)
    serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr

    def stamp(time_ns):
        return types["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9))

    def scans(kind, frame, datagrams):
        packet = types[kind.replace("Scan", "Packet").replace("NebulaPackets", "NebulaPacket")]
        for first in range(0, len(datagrams), SCAN):
            packets = []
            for one in datagrams[first : first + SCAN]:
                data = np.frombuffer(one.payload, np.uint8)
                size = ()
                if kind.endswith("PandarScan"):
                    data, size = np.pad(data, (0, 1500 - len(data))), (len(data),)
                packets.append(packet(stamp(one.time_ns), data, *size))
            number = {"seq": 0} if version == 1 else {}
            header = types["std_msgs/msg/Header"](stamp=packets[0].stamp, frame_id=frame, **number)
            yield datagrams[first].time_ns, types[kind](header, packets)

    with writer:
        for topic, text in texts:
            at = writer.add_connection(topic, "std_msgs/msg/String", typestore=store)
            writer.write(at, 0, serialize(types["std_msgs/msg/String"](text), "std_msgs/msg/String"))
        for topic, kind, frame, datagrams in topics:
            at = writer.add_connection(topic, kind, typestore=store)
            if kind.endswith("PacketMsg"):
                messages = ((one.time_ns, types[kind](np.frombuffer(one.payload, np.uint8))) for one in datagrams)
            else:
                messages = scans(kind, frame, datagrams)
            for time_ns, message in messages:
                writer.write(at, time_ns, serialize(message, kind))


def run(*words):
    return CliRunner().invoke(cli, [*map(str, words)])


@pytest.mark.parametrize(
    ("name", "size", "kind", "version", "model"),
    [
        ("nebula_vlp16.pcap", 1206, "velodyne_msgs/msg/VelodyneScan", 2, "vlp-16"),
        ("nebula_vlp16.pcap", 1206, "velodyne_msgs/msg/VelodyneScan", 1, "vlp-16"),
        ("hesai/nebula_xt32.pcap", 1080, "hesai_lidar/msg/PandarScan", 1, "pandar-xt32"),
        ("hesai/nebula_qt128.pcap", 1127, "nebula_msgs/msg/NebulaPackets", 2, "qt128"),
        ("robosense/nebula_helios16p.pcap", 1248, "nebula_msgs/msg/NebulaPackets", 2, "helios-16p"),
    ],
)
def test_what_went_in_comes_out(name, size, kind, version, model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sent = [one for one in datagrams_of(recording(name)) if len(one.payload) == size][:600]
    bag = "it.bag" if version == 1 else "it"
    lidar_bag(bag, version, [("/sensing/top/packets", kind, "top", sent)])
    done = run("convert", bag, "-o", "out.pcap")
    assert done.exit_code == 0, done.exception
    assert done.stderr == f"lidarcfg: warning: {bag}: /sensing/top/packets is 192.168.1.201:2368\n"
    found = datagrams_of("out.pcap")
    assert [one.payload for one in found] == [one.payload for one in sent]
    latest = np.maximum.accumulate([one.time_ns // 1000 for one in sent])
    assert [one.time_ns // 1000 for one in found] == latest.tolist()
    assert {(one.host, one.port) for one in found} == {("192.168.1.201", 2368)}
    done = run("decode", bag, "--model", model, "-o", "cloud.npz")
    assert done.exit_code == 0, done.exception
    cloud = load_cloud("cloud.npz", print)
    direct = decoded("out.pcap", model=model, on_warning=print)
    np.testing.assert_array_equal(cloud.xyz, direct.xyz)
    assert len(cloud.xyz) > 10_000


def test_an_ouster_comes_with_its_metadata(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pcap = recording("ouster/OS-2-128-U1_v2.3.0_1024x10.pcap")
    every = datagrams_of(pcap)
    large = max(len(one.payload) for one in every)
    lidar, inertial = ([one for one in every if (len(one.payload) == large) == wanted] for wanted in (True, False))
    kind = "ouster_msgs/msg/PacketMsg"
    topics = [("/ouster/lidar_packets", kind, "", lidar), ("/ouster/imu_packets", kind, "", inertial)]
    lidar_bag("it", 2, topics, [("/ouster/metadata", pcap.with_suffix(".json").read_text())])
    assert run("convert", "it", "-o", "out.pcap").exit_code == 0
    found = datagrams_of("out.pcap")
    assert {(one.host, one.port, len(one.payload)) for one in found} == {
        ("192.168.1.201", 7502, large),
        ("192.168.1.201", 7503, 48),
    }
    assert Path("out-ouster_metadata.json").read_text() == pcap.with_suffix(".json").read_text()
    ours, theirs = decoded("out.pcap", on_warning=print), decoded(pcap, on_warning=print)
    np.testing.assert_array_equal(ours.xyz, theirs.xyz)
    assert run("decode", "it", "-o", "cloud.npz").exit_code == 0
    np.testing.assert_array_equal(load_cloud("cloud.npz", print).xyz, theirs.xyz)


def test_topics_are_the_mounts_that_they_are_called_after(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sent = [one for one in datagrams_of(recording("nebula_vlp16.pcap")) if len(one.payload) == 1206][:200]
    kind = "velodyne_msgs/msg/VelodyneScan"
    lidar_bag(
        "it", 2, [("/a/packets", kind, "rear", sent), ("/left/packets", kind, "x", sent), ("/b", kind, "y", sent)]
    )
    mounts = [("left", "10.0.0.1", 0), ("rear", "10.0.0.2", 9)]
    text = "".join(f"  - {{name: {n}, model: vlp-16, position_m: [0, 0, {z}], host: {h}}}\n" for n, h, z in mounts)
    Path("rig.yaml").write_text(f"name: r\nsensors:\n{text}")
    assert run("convert", "it", "--rig", "rig.yaml", "-o", "out.pcap").exit_code == 0
    hosts = [one.host for one in datagrams_of("out.pcap")]
    assert {host: hosts.count(host) for host in hosts} == {"10.0.0.1": 200, "10.0.0.2": 200, "192.168.1.201": 200}


def test_bags_without_packets(tmp_path):
    lidar_bag(tmp_path / "it", 2, [], [("/notes", "hello")])
    done = run("convert", tmp_path / "it", "-o", tmp_path / "out.pcap")
    assert isinstance(done.exception, ConversionError)
    assert "has no packets of a driver; allowed: VelodyneScan, PandarScan, NebulaPackets, PacketMsg" in str(
        done.exception
    )
    assert "/notes (String)" in str(done.exception)
    assert not (tmp_path / "out.pcap").exists()
