"""What a writer makes of rays that others cast, held against `export`, which traces them itself."""

import socket
from dataclasses import replace
from threading import Thread

import numpy as np
import open3d
import pytest
from mcap.reader import make_reader

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.manifest import load_manifest
from lidarcfg.capture.pcap import read_datagrams, write_pcap
from lidarcfg.capture.writer import Writer
from lidarcfg.clouds.cloud import concatenate, load_cloud
from lidarcfg.errors import ConfigError
from lidarcfg.packets.families import timing
from lidarcfg.sensors.firing import RETURN_TYPES
from lidarcfg.sensors.rig import load_rig
from lidarcfg.sensors.sensor import catalogue
from lidarcfg.simulate.drive import Drive
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Motion, Trajectory, build_path
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import STREET, no_warning
from tests.command_line import lidarcfg
from tests.refusals import refused


def modes() -> list[tuple[str, str]]:
    """Each model with packets, with each of its return modes."""
    found = []
    for name in sorted(catalogue()):
        for mode in RETURN_TYPES:
            mount = rig_of(name, return_mode=mode).mounts[0]
            if not mount.sensor.codec:
                continue
            try:
                timing(mount.sensor).check(mount)
            except ConfigError:
                continue
            found.append((name, mode))
    return found


def rig_of(*names, **keys):
    """Sensors side by side."""
    sensors = [
        {"name": f"s{n}", "model": name, "position_m": [0.2 * n, 0.1, 1.8], "rpy_deg": [2, -1, 40 * n], **keys}
        for n, name in enumerate(names)
    ]
    return load_rig({"name": "rig", "sensors": sensors})


def driven() -> Trajectory:
    """An arc from the world's origin, so that rays have the same numbers in the world as near the vehicle."""
    arc = Motion(arc={"speed_m_s": 8, "yaw_rate_deg_s": 30})
    return Trajectory(np.eye(4), build_path(arc), START_NS)


def exported(path, rig, seconds, at=None):
    """The capture of an export in the street."""
    at = np.eye(4) if at is None else at
    write_pcap(path, in_time_order(simulated_packets(rig, load_scene(STREET), at, round(seconds * SECOND_NS))))
    return path.read_bytes()


class Street:
    """Casts rays with our tracer, as a simulator would: ranges, intensities."""

    def __init__(self) -> None:
        self.scene = load_scene(STREET)
        self.tracer = Tracer(self.scene, np.zeros(3), START_NS)
        self.bright = np.append(self.scene.reflectivity, np.uint8(0))

    def cast(self, rays):
        hits = self.tracer.cast(rays.origins_m, rays.directions, rays.time_ns)
        return hits.range_m, self.bright[hits.object]


def written(path, rig, seconds, step_s, at=None, others=()):
    """The capture of the same drive, cast here."""
    street = Street()
    drive = Drive(rig, at, origin=street.scene.file.geo_origin)
    with Writer(drive, path, *others) as writer:
        for rays in drive.firings(0, seconds, step_s):
            writer.write(rays, *street.cast(rays))
    return path.read_bytes()


@pytest.mark.parametrize(("name", "mode"), modes())
def test_all_models_and_modes_send_what_export_sends(tmp_path, name, mode):
    rig = rig_of(name, return_mode=mode)
    assert written(tmp_path / "a.pcap", rig, 0.03, 0.0071) == exported(tmp_path / "b.pcap", rig, 0.03)


def test_a_rig_on_the_move_sends_what_export_sends(tmp_path):
    """Six makers, position packets, inertial ones and DIFOP among the data, for longer than a second."""
    rig = rig_of("vlp-16", "airy", "os1-32", "pandar-xt32", "mid-360", "robin-w")
    ours = written(tmp_path / "a.pcap", rig, 1.3, 0.1, driven())
    assert ours == exported(tmp_path / "b.pcap", rig, 1.3, driven())
    times_ns = np.array([one.time_ns for one in read_datagrams(tmp_path / "a.pcap", no_warning)])
    assert (np.diff(times_ns) >= 0).all()


@pytest.mark.parametrize("name", ["os1-64", "vlp-16", "pandar-xt32"])
def test_a_narrow_view_and_a_phase_lock_change_nothing_of_that(tmp_path, name):
    rig = rig_of(name, azimuth_fov_deg=[30, 60], rpm=600, phase_deg=123)
    assert written(tmp_path / "a.pcap", rig, 0.2, 0.013) == exported(tmp_path / "b.pcap", rig, 0.2)


def test_noise_is_that_of_an_export(tmp_path):
    realism = {"seed": 3, "range_noise_m": 0.02, "dropout_fraction": 0.1, "intensity_noise": 3, "laser_error_m": 0.01}
    rig = rig_of("vlp-16", "os1-32", realism=realism)
    ours = written(tmp_path / "a.pcap", rig, 0.1, 0.02)
    assert ours == exported(tmp_path / "b.pcap", rig, 0.1)
    assert ours != exported(tmp_path / "c.pcap", rig_of("vlp-16", "os1-32"), 0.1)


def test_the_capture_has_what_decoding_needs_beside_it(tmp_path):
    """The points of a decoded capture are the rays' ends, but for the wire's millimetres; the manifest has the motion."""
    rig = rig_of("os1-32", "pandar-xt32")
    written(tmp_path / "a.pcap", rig, 0.1, 0.05, driven(), [tmp_path / "a.ply"])
    drawn = load_cloud(tmp_path / "a.ply", no_warning)
    decoded = concatenate(list(decode_pcap(tmp_path / "a.pcap", no_warning, rig)))
    xyz = load_manifest(tmp_path / "a.pcap").motion().world(decoded.xyz, decoded.time_ns)
    assert len(xyz) == len(drawn.xyz) > 10_000
    order, same = (np.lexsort((one.ring, one.time_ns, one.sensor)) for one in (drawn, decoded))
    assert np.abs(drawn.xyz[order] - xyz[same]).max() < 0.01
    assert (drawn.intensity[order] == decoded.intensity[same]).all()


def test_another_library_casts_the_rays(tmp_path):
    """Open3D's RaycastingScene and a wall: all points are on it; nothing is NaN or inf on the wire."""
    wall = open3d.t.geometry.TriangleMesh.create_box(0.1, 40, 40).translate([5, -20, -20])
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(wall)
    rig = rig_of("vlp-16")
    drive = Drive(rig)
    with Writer(drive, tmp_path / "a.pcap") as writer:
        for rays in drive.firings(0, 0.1):
            six = np.hstack([rays.origins_m, rays.directions]).astype(np.float32)
            hit_m = scene.cast_rays(open3d.core.Tensor(six))["t_hit"]
            writer.write(rays, hit_m, np.full(len(six), 40))
    cloud = concatenate(list(decode_pcap(tmp_path / "a.pcap", no_warning, rig)))
    assert len(cloud.xyz) > 5000
    assert np.abs(cloud.xyz[:, 0] - 5).max() < 0.01
    assert (cloud.intensity == 40).all()


def test_two_returns_are_the_mode_s_and_a_lonely_one_is_both(tmp_path):
    rig = rig_of("vlp-16", return_mode="dual")
    drive = Drive(rig)
    with Writer(drive, tmp_path / "a.pcap") as writer:
        for rays in drive.firings(0, 0.01):
            range_m = np.tile([4.0, 9.0], (len(rays.time_ns), 1))
            range_m[::3, 0] = np.nan
            range_m[1::3, 1] = np.nan
            writer.write(rays, range_m, np.tile([80, 20], (len(range_m), 1)))
    cloud = concatenate(list(decode_pcap(tmp_path / "a.pcap", no_warning, rig)))
    range_m = np.linalg.norm(cloud.xyz - rig.mounts[0].position_m, axis=1).round(1)
    counts = {
        (at, kind): int(((range_m == at) & (cloud.return_type == kind)).sum()) for at in (4, 9) for kind in (0, 1)
    }
    third = len(np.unique(cloud.time_ns * 16 + cloud.ring)) / 3
    assert counts[4, 0] == pytest.approx(2 * third, abs=2)  # with both, and alone
    assert counts[9, 1] == pytest.approx(third, abs=2)
    assert counts[9, 0] == pytest.approx(third, abs=2)


def test_a_host_gets_the_datagrams_of_the_capture(tmp_path):
    rig = rig_of("vlp-16")
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(5)
    captured = []
    path = tmp_path / "a.pcap"

    def listen():
        while (data := receiver.recv(2000)) != b"end":
            captured.append(data)

    listener = Thread(target=listen)
    listener.start()
    written(path, rig, 0.1, 0.03, None, [f"udp://127.0.0.1:{receiver.getsockname()[1]}"])
    receiver.sendto(b"end", receiver.getsockname())
    listener.join()
    receiver.close()
    assert captured == [one.payload for one in read_datagrams(path, no_warning)]


def test_after_an_error_nothing_is_written(tmp_path):
    drive = Drive(rig_of("vlp-16"))
    with (
        refused("ranges_m is of shape (3,); allowed: "),
        Writer(drive, tmp_path / "a.pcap", tmp_path / "a.ply") as writer,
    ):
        writer.write(next(drive.firings(0, 0.1)), np.ones(3), np.ones(3))
    assert list(tmp_path.iterdir()) == []


def test_a_capture_without_a_scene_becomes_a_bag_by_its_rig(tmp_path):
    """KITTI needs a scene."""
    written(tmp_path / "a.pcap", rig_of("os1-32", "vlp-16"), 0.2, 0.1, driven())
    alone = "a.pcap.yaml: names no scene; --rig takes the sensors' poses alone"
    assert alone in lidarcfg("convert", "a.pcap", "-o", "a.mcap", cwd=tmp_path, code=2).stderr
    lidarcfg("convert", "a.pcap", "-o", "a.mcap", "--rig", "a.pcap.rig.yaml", cwd=tmp_path)
    with open(tmp_path / "a.mcap", "rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert "/tf_static" in topics
    assert any("s0" in topic for topic in topics)
    words = "convert", "a.pcap", "-o", "kitti", "--to", "kitti-odometry", "--truth", "x.npz"
    assert "a.pcap.yaml: names no scene; export with" in lidarcfg(*words, cwd=tmp_path, code=2).stderr


def test_where_one_output_fails_none_is_left(tmp_path):
    drive = Drive(rig_of("vlp-16"))
    (tmp_path / "file").write_text("no folder")
    with refused("a.ply: "), Writer(drive, tmp_path / "a.pcap", tmp_path / "file/a.ply") as writer:
        for rays in drive.firings(0, 0.02):
            writer.write(rays, np.full(len(rays.time_ns), 5.0), np.full(len(rays.time_ns), 5))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_earlier_manifest_is_not_left_beside_a_capture_that_can_have_none(tmp_path):
    """The sensor's range was changed in Python, which no file says."""
    path = tmp_path / "a.pcap"
    written(path, rig_of("vlp-16"), 0.01, 0.01)
    assert load_manifest(path)
    rig = rig_of("vlp-16")
    sensor = rig.mounts[0].sensor.model_copy(update={"name": "mine"})
    rig = replace(rig, mounts=(replace(rig.mounts[0], sensor=sensor, model=None),))
    drive = Drive(rig)
    said = []
    with Writer(drive, path, on_warning=said.append) as writer:
        for rays in drive.firings(0, 0.01):
            writer.write(rays, np.full(len(rays.time_ns), 5.0), np.full(len(rays.time_ns), 5))
    assert [one.name for one in tmp_path.iterdir()] == ["a.pcap"]
    assert "is not written, as sensors of the rig are in no file" in said[0]


def test_modes_may_be_mixed(tmp_path):
    """The second return of a ray is for the sensor that reports two."""
    sensors = [
        {"name": "one", "model": "vlp-16", "position_m": [0, 0, 2]},
        {"name": "both", "model": "vlp-16", "position_m": [0, 1, 2], "return_mode": "dual"},
    ]
    rig = load_rig({"name": "rig", "sensors": sensors})
    drive = Drive(rig)
    with Writer(drive, tmp_path / "a.pcap") as writer:
        for rays in drive.firings(0, 0.02):
            range_m = np.tile([4.0, 9.0], (len(rays.time_ns), 1))
            range_m[rays.sensor == 0, 1] = np.nan
            writer.write(rays, range_m, np.tile([80, 20], (len(range_m), 1)))
    cloud = concatenate(list(decode_pcap(tmp_path / "a.pcap", no_warning, rig)))
    assert set(cloud.return_type[cloud.sensor == 0].tolist()) == {0}
    assert set(cloud.return_type[cloud.sensor == 1].tolist()) == {0, 1}


def test_wrong_ranges_are_said(tmp_path):
    drive = Drive(rig_of("vlp-16"))
    rays = next(drive.firings(0, 0.01))
    count = len(rays.time_ns)
    ones = np.ones(count)

    def wrong(message, range_m=ones, intensity=ones, rays=rays):
        with refused(message), Writer(drive, tmp_path / "a.pcap") as writer:
            writer.write(rays, range_m, intensity)

    wrong(f"ranges_m is of shape ({count}, 3); allowed: ({count},), ({count}, 1) and ({count}, 2)", np.ones((count, 3)))
    wrong(f"intensity is of shape (), not of that of ranges_m, ({count},)", intensity=1)
    wrong(
        "2 returns of a ray of s0; allowed: 1, as its return mode is strongest",
        np.ones((count, 2)),
        np.ones((count, 2)),
    )
    wrong("ranges_m has -1 for ray 0; allowed: from 0 on", -ones)
    wrong("intensity has 256 for ray 0; allowed: 0 to 255", intensity=256 * ones)
    wrong("intensity has nan for ray 0; allowed: 0 to 255", intensity=np.nan * ones)
    wrong("ranges_m is no array of numbers on the CPU: its numbers are <U1", np.full(count, "x"))
    wrong("the rays are of another drive", rays=next(Drive(rig_of("vlp-16")).firings(0, 0.01)))
    with refused("write each batch of the drive once, in its order"), Writer(drive, tmp_path / "a.pcap") as writer:
        writer.write(rays, ones, ones)
        writer.write(rays, ones, ones)
    with refused("a.txt: is no output; allowed: .pcap, .ply, .pcd, .npz, udp://HOST[:PORT]"):
        Writer(drive, "a.txt")
    with refused("no output; allowed: each a .pcap, udp://HOST[:PORT], or a cloud"):
        Writer(drive)
    with refused("a.ply, a.ply: one is given twice"):
        Writer(drive, "a.ply", "a.ply")
    with refused("a writer writes from entering to leaving it"):
        Writer(drive, tmp_path / "a.pcap").write(rays, ones, ones)
    with refused("no rays were written"), Writer(drive, tmp_path / "a.pcap", tmp_path / "a.ply"):
        pass
    assert list(tmp_path.iterdir()) == []
    with refused("udp://127.0.0.1:x: 'x' is not a port, 1 to 65535"):
        Writer(drive, "udp://127.0.0.1:x")


def test_points_need_no_packets(tmp_path):
    """A sensor without a codec has points; a capture of it is refused before anything is written."""
    rig = load_rig(
        {
            "name": "own",
            "sensors": [{"name": "top", "elevation_deg": [-10, 0, 10], "position_m": [0, 0, 2], "range_m": [0.5, 50]}],
        }
    )
    drive = Drive(rig)
    with Writer(drive, tmp_path / "a.ply") as writer:
        for rays in drive.firings(0, 0.2):
            writer.write(rays, np.full(len(rays.time_ns), 7.0), np.full(len(rays.time_ns), 30))
    cloud = load_cloud(tmp_path / "a.ply", no_warning)
    np.testing.assert_allclose(np.linalg.norm(cloud.xyz - [0, 0, 2], axis=1), 7, rtol=0, atol=1e-9)
    with refused("has no codec, and so no packets"):
        Writer(drive, tmp_path / "a.pcap")
