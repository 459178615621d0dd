"""Four makers in one capture: identified, decoded, merged and handed on; witnesses are the ground truth and Open3D."""

import re
import socket
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from rosbags.highlevel import AnyReader

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.replay import replay
from lidarcfg.capture.selection import Selection
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import PacketError
from lidarcfg.geometry import inverse, pose, transform
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import load_rig
from lidarcfg.units import START_NS
from lidarcfg.world.motion import Motion, Trajectory, build_path
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, datagrams_of, no_warning, standing_street
from tests.command_line import lidarcfg
from tests.refusals import refused

RIG = Path(__file__).parents[2] / "data/rigs/mixed.yaml"
DURATION_NS = 100_000_000
FOUND = {
    "192.168.1.201:7502": ("os1-64", "strongest"),
    "192.168.1.202:2368": ("qt128", "strongest"),
    "192.168.1.203:2368": ("pandar-xt32", "last and strongest"),
    "192.168.1.204:6699": ("helios-16p", "first"),
    "192.168.1.205:2368": ("vlp-16", "last"),
}
DRIVEN = Trajectory(
    pose((-5.0, 0.0, 0.0), (0.0, 0.0, 0.1)), build_path(Motion(velocity_m_s=(12.0, 1.0, 0.0))), START_NS
)


def sent(folder, rig, at=None):
    """A capture in the street with what readers need beside it, and the ground truth."""
    path = folder / "mixed.pcap"
    truth = []
    streams = simulated_packets(
        rig, standing_street(), np.eye(4) if at is None else at, DURATION_NS, on_truth=truth.append
    )
    write_pcap(path, in_time_order(streams))
    save_sidecar_files(path, rig.mounts)
    return path, np.concatenate(truth)


@pytest.fixture(scope="module")
def rig():
    return load_rig(RIG)


@pytest.fixture(scope="module")
def still(rig, tmp_path_factory):
    return sent(tmp_path_factory.mktemp("still"), rig)


@pytest.fixture(scope="module")
def driven(rig, tmp_path_factory):
    return sent(tmp_path_factory.mktemp("driven"), rig, DRIVEN)


def decoded(path, rig=None, **options):
    return concatenate(list(decode_pcap(path, no_warning, rig, **options)))


def in_order(ring, kind, time_ns):
    """Beam by beam in time. A second strongest return stands where a pair has its strongest."""
    return np.lexsort((kind == 1, time_ns, ring))


def ring_of(rig, truth):
    rings = [mount.sensor.ring for mount in rig.mounts]
    return np.array([rings[s][laser] for s, laser in zip(truth["sensor"], truth["laser"], strict=True)])


def matched(rig, path, truth):
    """The decoded points and the records of the truth, row by row the same return of the same firing."""
    cloud = decoded(path, rig)
    ring = ring_of(rig, truth)
    assert len(cloud.xyz) == len(truth) > 100_000
    mine = []
    true = []
    for index in range(len(rig.mounts)):
        some = np.flatnonzero(cloud.sensor == index)
        records = np.flatnonzero(truth["sensor"] == index)
        assert len(some) == len(records) > 1000
        mine.append(some[in_order(cloud.ring[some], cloud.return_type[some], cloud.time_ns[some])])
        true.append(records[in_order(ring[records], truth["return_type"][records], truth["time_ns"][records])])
    return cloud, np.concatenate(mine), np.concatenate(true)


def test_families_are_told_from_each_other(rig, still):
    """By packets and what lies beside them, without a rig; the rig then adds poses and names, and nothing else."""
    path, truth = still
    stats = []
    alone = decoded(path, on_stats=stats.append)
    assert {one.name: (one.models[0], *one.return_modes) for one in stats} == FOUND
    assert {one.lost + one.duplicates + one.reordered for one in stats} == {0}
    merged = decoded(path, rig)
    assert len(alone.xyz) == len(merged.xyz) == len(truth)
    for mount in rig.mounts:
        here = alone.sensor == alone.sensor_names.index(f"{mount.host}:{mount.data_port}")
        there = merged.sensor == merged.sensor_names.index(mount.name)
        np.testing.assert_allclose(transform(mount.T_vehicle_sensor, alone.xyz[here]), merged.xyz[there], atol=1e-9)
        np.testing.assert_array_equal(alone.time_ns[here], merged.time_ns[there])


def test_each_return_of_the_ground_truth(rig, still):
    """Its firing, its kind; and its range, but for where within the sensor the beam starts."""
    path, truth = still
    cloud, mine, true = matched(rig, path, truth)
    assert abs(cloud.time_ns[mine] - truth["time_ns"][true]).max() <= 1000
    np.testing.assert_array_equal(cloud.ring[mine], ring_of(rig, truth)[true])
    np.testing.assert_array_equal(cloud.return_type[mine], truth["return_type"][true])
    reflectivity = load_scene(STREET).reflectivity[truth["object"][true]]  # above 100: retro-reflecting signs
    np.testing.assert_array_equal(cloud.intensity[mine], reflectivity)
    assert set(cloud.sensor[mine][reflectivity > 100].tolist()) == {0, 1, 2, 3, 4}
    for index, mount in enumerate(rig.mounts):
        some = cloud.sensor[mine] == index
        own = transform(inverse(mount.T_vehicle_sensor), cloud.xyz[mine][some])
        inside_m = {"helios-16p": 0.036, "vlp-16": 0.01, "os1-64": 0.045}.get(mount.model, 1e-9)
        step_m = mount.sensor.range.resolution_m / 2
        off_m = abs(np.linalg.norm(own, axis=1) - truth["range_m"][true][some])
        assert off_m.max() <= inside_m + step_m + 1e-9
        assert off_m.max() > inside_m / 3


def surface(stage):
    """How far points are from the scene: its ground and boxes by formula, all else by Open3D.

    Open3D's distances are up to 5 cm off for triangles as long as a kerb's: 85 m to 12 cm.
    """
    caster = o3d.t.geometry.RaycastingScene()
    vertices, triangles = stage.mesh(0.001)
    caster.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(triangles.astype(np.uint32)))

    def distance(xyz):
        least = np.minimum(abs(xyz[:, 2]), caster.compute_distance(o3d.core.Tensor(xyz.astype(np.float32))).numpy())
        for box in stage.file.boxes:
            own = transform(inverse(pose(box.center_m, (0.0, 0.0, np.radians(box.yaw_deg)))), xyz)
            beyond = abs(own) - np.array(box.size_m) / 2
            outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
            least = np.minimum(least, np.where(outside > 0, outside, -beyond.max(axis=1)))
        return least

    return distance


def test_merged_points_lie_on_the_street(rig, still):
    """Whatever the maker's frame and offsets: half a step along the beam, and 5 mm for azimuths in hundredths."""
    cloud = decoded(still[0], rig)
    off_m = surface(standing_street())(cloud.xyz[::4])
    for index, mount in enumerate(rig.mounts):
        some = cloud.sensor[::4] == index
        assert off_m[some].max() < mount.sensor.range.resolution_m / 2 + 0.005
        assert np.median(off_m[some]) < 0.001


def test_deskewed_points_lie_on_the_street(rig, driven):
    """While the vehicle drives 1.2 m: each point belongs where the vehicle was when its laser fired."""
    cloud = decoded(driven[0], rig)
    distance = surface(standing_street())
    at_start = transform(DRIVEN.T_world_start, cloud.xyz)
    world = DRIVEN.world(cloud.xyz, cloud.time_ns)
    for index in range(len(rig.mounts)):
        some = np.flatnonzero(cloud.sensor == index)[::10]
        assert distance(world[some]).max() < 0.008
        assert np.quantile(distance(at_start[some]), 0.9) > 0.03


@pytest.mark.slow
def test_noise_is_that_of_the_ground_truth(rig, still, tmp_path):
    """Along each beam, whatever the maker: the point moves by the noise that the truth says, to half a step each."""
    noisy = replace(
        rig,
        mounts=tuple(replace(one, realism=Realism(seed=i, range_noise_m=0.05)) for i, one in enumerate(rig.mounts)),
    )
    path, truth = sent(tmp_path, noisy)
    cloud, mine, true = matched(noisy, path, truth)
    clean, its, exact = matched(rig, *still)
    key, other = (
        np.stack([one["sensor"], one["laser"], one["time_ns"], one["return_type"]], axis=1)[order].astype(np.int64)
        for one, order in ((truth, true), (still[1], exact))
    )
    where = {tuple(row): n for n, row in enumerate(other.tolist())}
    same = [(n, where[tuple(row)]) for n, row in enumerate(key.tolist()) if tuple(row) in where]  # some left the range
    assert len(same) > 0.99 * len(key)
    here, there = np.array(same).T
    moved_m = np.linalg.norm(cloud.xyz[mine[here]] - clean.xyz[its[there]], axis=1)
    step_m = np.array([mount.sensor.range.resolution_m for mount in rig.mounts])[cloud.sensor[mine[here]]]
    noise_m = abs(truth["noise_m"][true[here]])
    assert (abs(moved_m - noise_m) <= step_m + 1e-6).all()
    assert noise_m.std() == pytest.approx(0.05 * np.sqrt(1 - 2 / np.pi), rel=0.02)


def test_windows_and_chunks_make_no_difference(rig, still):
    """Any split in time, any number of packets at once: the same points in the same order of each sensor."""
    whole = decoded(still[0], rig)
    windows = [Selection(low, high) for low, high in ((0, 0.03), (0.03, 0.0701), (0.0701, 9))]
    split = [decoded(still[0], rig, selection=window) for window in windows]
    small = decoded(still[0], rig, chunk_packets=7)
    for index in range(len(rig.mounts)):
        ours = whole.xyz[whole.sensor == index]
        np.testing.assert_array_equal(ours, np.concatenate([part.xyz[part.sensor == index] for part in split]))
        np.testing.assert_array_equal(ours, small.xyz[small.sensor == index])


def test_one_sensor_needs_what_is_its_own_only(rig, still, tmp_path):
    """Without the Ouster's metadata the others are read; all together say what is missing, in one line."""
    path = tmp_path / "mixed.pcap"
    path.write_bytes(still[0].read_bytes())
    for beside in still[0].parent.glob("*.csv"):
        (tmp_path / beside.name).write_bytes(beside.read_bytes())
    front = decoded(path, selection=Selection(sensors=("192.168.1.204:6699",)))
    assert len(front.xyz) == (still[1]["sensor"] == 3).sum()
    with pytest.raises(PacketError, match=r"mixed.pcap: 192.168.1.201:7502: an Ouster's .* need the sensor's metadata"):
        decoded(path)
    metadata = (still[0].parent / "mixed-roof.json").read_bytes()
    (tmp_path / "mixed-roof.json").write_bytes(metadata[:3000])
    with pytest.raises(PacketError, match=r"a .json named as the capture .*; .*/mixed-roof.json is not that$"):
        decoded(path)
    (tmp_path / "mixed-roof.json").write_bytes(metadata)
    (tmp_path / "mixed-left-192.168.1.202-2368-angles.csv").unlink()
    said = []
    concatenate(list(decode_pcap(path, said.append)))
    assert said == [f"{path}: 192.168.1.202:2368: no *-angles.csv beside it; the nominal angles of qt128 are taken"]


def test_replayed_payloads_are_the_sensors(still):
    """The first 300 datagrams arrive whole on their ports, the Ouster's 12,544 bytes as well."""
    datagrams = datagrams_of(still[0])[:300]
    ports = sorted({one.port for one in datagrams})
    receivers = {port: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for port in ports}
    try:
        for receiver in receivers.values():
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(5)
        taken = {port: receiver.getsockname()[1] for port, receiver in receivers.items()}
        replay([replace(one, port=taken[one.port]) for one in datagrams], "127.0.0.1", None, 100.0)
        for port, receiver in receivers.items():
            expected = [one.payload for one in datagrams if one.port == port]
            assert [receiver.recv(1 << 16) for _ in expected] == expected
    finally:
        for receiver in receivers.values():
            receiver.close()
    assert {2368, 6699, 7502, 7788} <= set(ports)
    assert max(len(one.payload) for one in datagrams) == 12_544


def test_a_bag_has_each_sensor(rig, still, tmp_path):
    """A topic a sensor, all of its points in its own frame, and the poses; read back by rosbags."""
    lidarcfg("convert", still[0], "-o", tmp_path / "mixed.mcap", "--rig", RIG, "--quiet")
    cloud = decoded(still[0], rig)
    found = {}
    with AnyReader([tmp_path / "mixed.mcap"]) as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    assert set(found) == {"/tf_static", *(f"/{mount.name}/points" for mount in rig.mounts)}
    for index, mount in enumerate(rig.mounts):
        messages = found[f"/{mount.name}/points"]
        xyz = []
        for message in messages:
            raw = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height * message.width, -1)
            at = {field.name: field.offset for field in message.fields}
            xyz.append(np.stack([raw[:, at[k] : at[k] + 4].copy().view("<f4")[:, 0] for k in "xyz"], axis=1))
        own = transform(inverse(mount.T_vehicle_sensor), cloud.xyz[cloud.sensor == index])
        kept = np.concatenate(xyz)
        kept = kept[np.isfinite(kept).all(axis=1) & (kept != 0).any(axis=1)]
        np.testing.assert_allclose(kept[np.lexsort(kept.T)][:, 2], np.sort(own[:, 2]), atol=1e-4)


def test_the_view_of_the_capture_is_that_of_its_cloud(still, tmp_path):
    lidarcfg("decode", still[0], "--rig", RIG, "-o", tmp_path / "mixed.ply", "--quiet")
    for source, name in ((still[0], "a.png"), (tmp_path / "mixed.ply", "b.png")):
        lidarcfg("view", source, "--rig", RIG, "--png", tmp_path / name, "--size", "640x360", "--quiet")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_several_sensors_behind_one_address(tmp_path):
    """Four RoboSenses of one host, by their ports; DIFOP packets of two of them go to one port."""
    text = "".join(
        f"  - {{name: s{i}, model: {model}, position_m: [0, 0, {1 + i}], host: 192.168.1.77, data_port: {6699 + i},\n"
        f"     telemetry_port: {7788 + i // 2}, return_mode: {mode}}}\n"
        for i, (model, mode) in enumerate(
            (("helios-32", "last"), ("helios-16p", "dual"), ("helios-32", "dual"), ("helios-16p", "strongest"))
        )
    )
    (tmp_path / "rig.yaml").write_text("name: r\nsensors:\n" + text)
    four = load_rig(tmp_path / "rig.yaml")
    path, truth = sent(tmp_path, four)
    stats = []
    cloud = decoded(path, on_stats=stats.append)
    assert {one.name: (one.models, one.return_modes) for one in stats} == {
        "192.168.1.77:6699": (("helios-32",), ("last",)),
        "192.168.1.77:6700": (("helios-16p",), ("dual",)),
        "192.168.1.77:6701": (("helios-32",), ("dual",)),
        "192.168.1.77:6702": (("helios-16p",), ("strongest",)),
    }
    assert len(cloud.xyz) == len(truth)


def test_default_ports_are_the_makers(rig):
    """Those of the manuals: Ouster 7502 and 7503, RoboSense 6699 and 7788, Hesai 2368, Velodyne 2368 and 8308."""
    ports = {mount.model: (mount.data_port, mount.telemetry_port) for mount in rig.mounts}
    assert ports["os1-64"] == (7502, 7503)
    assert ports["helios-16p"] == (6699, 7788)
    assert ports["qt128"][0] == ports["pandar-xt32"][0] == 2368
    assert ports["vlp-16"] == (2368, 8308)


@pytest.mark.slow
@pytest.mark.parametrize("change", ["missing", "twice", "overlapping", "out of order"])
def test_an_ousters_fragments(still, tmp_path, change):
    """One datagram of its nine-fragment packets is lost or told twice; no other packet of anybody changes."""
    path = tmp_path / "mixed.pcap"
    for beside in still[0].parent.glob("mixed-*"):
        (tmp_path / beside.name).write_bytes(beside.read_bytes())
    raw = still[0].read_bytes()
    records = []
    at = 24
    while at < len(raw):
        end = at + 16 + int.from_bytes(raw[at + 8 : at + 12], "little")
        records.append(raw[at:end])
        at = end
    second = [n for n, one in enumerate(records) if int.from_bytes(one[36:38]) & 0x1FFF == 1480 // 8]
    chosen = second[len(second) // 2]  # the second fragment of a datagram in the middle
    if change == "missing":
        del records[chosen]
    elif change == "twice":
        records.insert(chosen, records[chosen])
    elif change == "overlapping":  # 8 bytes nearer: a hole behind it, and octets that two fragments tell
        moved = int.from_bytes(records[chosen][36:38]) - 1
        records[chosen] = records[chosen][:36] + moved.to_bytes(2) + records[chosen][38:]
    else:
        records[chosen - 1 : chosen + 3] = reversed(records[chosen - 1 : chosen + 3])
    path.write_bytes(raw[:24] + b"".join(records))
    said = []
    stats = []
    cloud = concatenate(list(decode_pcap(path, said.append, on_stats=stats.append)))
    whole = decoded(still[0])
    lost = change in ("missing", "overlapping")
    assert [one.lost for one in stats] == [int(lost and one.models[0] == "os1-64") for one in stats]
    assert len(said) == int(lost)
    for number, name in enumerate(whole.sensor_names):
        theirs, ours = whole.xyz[whole.sensor == number], cloud.xyz[cloud.sensor == cloud.sensor_names.index(name)]
        if lost and name == "192.168.1.201:7502":
            assert 0 < len(theirs) - len(ours) <= 16 * 64
            assert set(map(tuple, ours.tolist())) < set(map(tuple, theirs.tolist()))
        else:
            np.testing.assert_array_equal(ours, theirs)


def test_metadata_of_another_sensor(still, tmp_path):
    """One line that says whose it is."""
    path = tmp_path / "mixed.pcap"
    path.write_bytes(still[0].read_bytes())
    text = (still[0].parent / "mixed-roof.json").read_text()
    (tmp_path / "mixed-roof.json").write_text(re.sub(r'"prod_sn": "\d+"', '"prod_sn": "122001"', text))
    with refused("/mixed-roof.json is of OS-1-64 122001", r"mixed.pcap: 192.168.1.201:7502: .*122001$", PacketError):
        list(decode_pcap(path, lambda warning: None))


@pytest.mark.slow
def test_memory_does_not_grow_with_the_capture(still, tmp_path):
    """The same packets three times as often: as much memory at most, of what Python and numpy take."""
    for one in still[0].parent.iterdir():
        (tmp_path / one.name).write_bytes(one.read_bytes())
    path = tmp_path / still[0].name
    data = still[0].read_bytes()

    def taken(times):
        path.write_bytes(data[:24] + data[24:] * times)
        tracemalloc.start()
        points = sum(len(cloud.xyz) for cloud in decode_pcap(path, lambda warning: None, chunk_packets=64))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return points, peak

    taken(1)
    (few, short), (many, long) = taken(2), taken(6)
    assert many > 2.9 * few
    assert long < 1.2 * short, f"{short / 1e6:.1f} and {long / 1e6:.1f} MB"
