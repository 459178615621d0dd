"""`lidarcfg.export` and `lidarcfg.decode`: what the commands write and read, from files or from what was loaded."""

from dataclasses import replace

import numpy as np
import pytest

import lidarcfg
from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.errors import LidarcfgError
from lidarcfg.geometry import pose
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.units import START_NS
from lidarcfg.world.motion import Motion, Trajectory, build_path
from tests import command_line
from tests.capture_fixtures import no_warning

RIG = "data/rigs/mixed.yaml"
ROOF = "data/rigs/roof.yaml"
STREET = "data/scenes/street.yaml"
WALL = """name: wall
ground: {reflectivity: 12}
boxes: [{name: wall, center_m: [10.5, 0, 2], size_m: [1, 40, 4], reflectivity: 40}]
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.pcap", "a.ply"])
@pytest.mark.parametrize("loaded", [True, False])
def test_it_is_what_the_command_writes(tmp_path, name, loaded):
    """Byte for byte, with what readers need beside it; the manifest aside where it names a file of its own."""
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    rig = lidarcfg.load_rig(RIG) if loaded else RIG
    lidarcfg.export(rig, lidarcfg.load_scene(STREET) if loaded else STREET, str(ours / name), duration_s=0.02)
    command_line.lidarcfg("export", RIG, "--scene", STREET, "--duration", "0.02", "-o", theirs / name, "--quiet")
    if loaded:
        for path in (theirs / f"{name}.yaml", ours / f"{name}.yaml", ours / f"{name}.rig.yaml"):
            path.unlink()
    assert {path.name: path.read_bytes() for path in ours.iterdir()} == {
        path.name: path.read_bytes() for path in theirs.iterdir()
    }
    assert (ours / name).stat().st_size > 100_000


@pytest.mark.slow
def test_a_capture_is_one_cloud(tmp_path):
    """That which the command decodes, in the frames of the vehicle or of the sensors."""
    lidarcfg.export(RIG, STREET, tmp_path / "a.pcap", duration_s=0.02, at=np.diag([-1.0, -1, 1, 1]))
    for given in ((), ("--rig", "none")):
        command_line.lidarcfg("decode", tmp_path / "a.pcap", "-o", tmp_path / "a.npz", "--quiet", *given)
        told = load_cloud(tmp_path / "a.npz", no_warning)
        for rig in [None, RIG, lidarcfg.load_rig(RIG)] if not given else ["none"]:
            cloud = lidarcfg.decode(str(tmp_path / "a.pcap"), rig, no_warning)
            assert cloud.sensor_names == told.sensor_names
            assert np.array_equal(cloud.xyz, told.xyz)
            assert np.array_equal(cloud.time_ns, told.time_ns)


def test_a_manifest_of_a_drive_says_all_that_reading_it_needs(tmp_path):
    """Deskewed, each point is where its own time's pose of the drive, by hand, puts it."""
    (tmp_path / "drive.yaml").write_text("velocity_m_s: [20, 0, 0]\n")
    T = pose((1.25, -2.0, 0.0), (0.0, 0.0, np.radians(30)))
    out = tmp_path / "a.pcap"
    lidarcfg.export(RIG, STREET, out, duration_s=0.05, at=T, trajectory=tmp_path / "drive.yaml")
    skewed = lidarcfg.decode(out)
    deskewed = lidarcfg.decode(out, deskew=True)
    far_m = 20 * (skewed.time_ns - START_NS) / 1e9
    assert np.ptp(far_m) > 0.9
    moved = skewed.xyz + far_m[:, None] * (1, 0, 0)
    np.testing.assert_allclose(deskewed.xyz, moved @ T[:3, :3].T + T[:3, 3], rtol=0, atol=1e-9)
    with pytest.raises(LidarcfgError, match="deskewing needs the rig"):
        lidarcfg.decode(out, "none", deskew=True)


def test_a_capture_whose_rig_is_gone_says_what_to_do(tmp_path):
    (tmp_path / "rig.yaml").write_text("name: r\nsensors: [{name: a, model: vlp-16, position_m: [0, 0, 2]}]\n")
    lidarcfg.export(tmp_path / "rig.yaml", STREET, tmp_path / "a.pcap", duration_s=0.002)
    (tmp_path / "rig.yaml").unlink()
    done = command_line.lidarcfg("decode", tmp_path / "a.pcap", "-o", tmp_path / "a.ply", code=2)
    assert "a.pcap.yaml:3:3: rig.file: " in done.stderr
    assert "no such file or directory; name what fits it, or none, which leaves points in" in done.stderr
    command_line.lidarcfg("decode", tmp_path / "a.pcap", "--rig", "none", "-o", tmp_path / "a.ply")


def paths():
    """Trajectories made in Python: a line, an arc, timed poses by keys and by arrays; all tilted and raised at first."""
    T = pose((1.0, 2.0, 0.5), (0.02, -0.03, 0.7))
    timed = [{"time_s": s, "position_m": (9 * s, s * s, 0.1), "rpy_deg": (0, 5 * s, 30 * s)} for s in (0.9, 1, 1.2)]
    keys = build_path(Motion(poses=tuple(timed)))
    arrays = replace(keys, motion=Motion.model_construct(poses=()))  # as of a .tum file
    line = Motion(velocity_m_s=(20, 1, 0))
    arc = Motion(arc={"speed_m_s": 9, "yaw_rate_deg_s": 40, "heading_deg": 10})
    late_ns = START_NS - 10**9  # their time 0: they are under way for a second
    return [
        Trajectory.static(T),
        *(Trajectory(T, path, late_ns) for path in (build_path(line), build_path(arc), keys, arrays)),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("moved", paths(), ids=["stands", "line", "arc", "keys", "arrays"])
def test_a_manifest_of_what_is_in_no_file_says_all_that_reading_it_needs(tmp_path, moved):
    """Whatever is given: deskewed, each point is where the trajectory itself puts it."""
    (tmp_path / "wall.yaml").write_text(WALL)
    out = tmp_path / "a.pcap"
    rig = lidarcfg.load_rig(ROOF)
    scene = lidarcfg.load_scene(tmp_path / "wall.yaml")
    (tmp_path / "wall.yaml").unlink()
    lidarcfg.export(rig, scene, out, 0.02, at=moved, on_warning=no_warning)
    skewed = lidarcfg.decode(out)
    deskewed = lidarcfg.decode(out, deskew=True)
    assert len(skewed.xyz) > 5000
    np.testing.assert_allclose(deskewed.xyz, moved.world(skewed.xyz, skewed.time_ns), rtol=0, atol=1e-6)
    assert lidarcfg.load_rig(tmp_path / "a.pcap.rig.yaml") == rig
    assert lidarcfg.load_scene(tmp_path / "a.pcap.scene.yaml").file == scene.file
    command_line.lidarcfg("decode", out, "--deskew", "-o", tmp_path / "a.npz", "--quiet")
    assert np.array_equal(load_cloud(tmp_path / "a.npz", no_warning).xyz, deskewed.xyz)


def test_what_a_manifest_lacks_is_said(tmp_path):
    """A scene that names files and is in none, facts of a sensor that are in none."""
    rig = lidarcfg.load_rig(ROOF)
    told = []
    np.save(tmp_path / "flat.npy", np.zeros((2, 2)))
    field = "{name: f, file: flat.npy, cell_m: 50, position_m: [-25, -25, 0], reflectivity: 9}"
    (tmp_path / "scene.yaml").write_text(f"name: s\nheight_fields: [{field}]\n")
    scene = lidarcfg.load_scene(tmp_path / "scene.yaml")
    sensor = Sensor.model_validate(rig.mounts[0].sensor.model_dump(exclude_unset=True))  # which names no file
    own = replace(rig.mounts[0], sensor=sensor, model=None)
    out = tmp_path / "a.pcap"
    manifest = tmp_path / "a.pcap.yaml"
    lidarcfg.export(rig, scene, out, 0.002, on_warning=no_warning)
    assert lidarcfg.decode(out).sensor_names == ("left", "right")
    (tmp_path / "scene.yaml").write_text("name: another\nground: {}\n")
    lidarcfg.export(rig, scene, out, 0.002, on_warning=told.append)
    assert told == [f"{manifest}: names no scene, which is in no file; view needs it, and convert to data sets"]
    assert lidarcfg.decode(out).sensor_names == ("left", "right")
    truth = "--to", "kitti-object", "--truth", tmp_path / "a.npz"
    done = command_line.lidarcfg("convert", out, "-o", tmp_path / "kitti", *truth, code=2)
    assert "a.pcap.yaml: names no scene; export with the scene's file" in done.stderr
    lidarcfg.export(rig, scene, out, 0.002, on_warning=told.append)
    assert manifest.exists()
    lidarcfg.export(replace(rig, mounts=(own,)), scene, out, 0.002, on_warning=told.append)
    assert "sensors of the rig are in no file" in told[-1]
    assert not list(tmp_path.glob("a.pcap.*"))
    with pytest.raises(LidarcfgError, match="at is a trajectory, and a file of another is given"):
        lidarcfg.export(RIG, STREET, out, 0.002, at=Trajectory.static(np.eye(4)), trajectory="drive.yaml")


def test_what_an_export_wrote_beside_another_may_be_given_to_the_next(tmp_path):
    """It stays; what is no longer needed goes."""
    out = tmp_path / "a.pcap"
    own = tmp_path / "a.pcap.rig.yaml"
    moved = Trajectory(np.eye(4), build_path(Motion(velocity_m_s=(3, 0, 0))), START_NS)
    lidarcfg.export(lidarcfg.load_rig(ROOF), STREET, out, 0.002, at=moved)
    assert (tmp_path / "a.pcap.trajectory.yaml").exists()
    lidarcfg.export(own, STREET, out, 0.002)
    assert not (tmp_path / "a.pcap.trajectory.yaml").exists()
    assert lidarcfg.decode(out).sensor_names == ("left", "right")


@pytest.mark.parametrize("duration_s", [0.0, -1.0, np.nan, np.inf, 1e6])
def test_durations_that_are_none(tmp_path, duration_s):
    with pytest.raises(LidarcfgError, match=r"duration_s is .*; allowed: above 0, at most 86400"):
        lidarcfg.export(RIG, STREET, tmp_path / "a.pcap", duration_s)
    assert not list(tmp_path.iterdir())
