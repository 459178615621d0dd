"""`lidarcfg.export` and `lidarcfg.decode`: what the commands write and read, from files or from what was loaded."""

import numpy as np
import pytest

import lidarcfg
from lidarcfg.cloud import load_cloud
from lidarcfg.errors import LidarcfgError
from lidarcfg.geometry import pose
from lidarcfg.simulate.tasks import START_NS
from lidarcfg.world.motion import standing
from tests import command_line
from tests.capture_fixtures import no_warning

RIG, STREET = "data/rigs/mixed.yaml", "data/scenes/street.yaml"


@pytest.mark.parametrize("name", ["a.pcap", "a.ply"])
@pytest.mark.parametrize("loaded", [True, False])
def test_it_is_what_the_command_writes(tmp_path, name, loaded):
    """Byte for byte, with what readers need beside it; the record aside where it cannot name the files."""
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    rig = lidarcfg.load_rig(RIG) if loaded else RIG
    lidarcfg.export(rig, lidarcfg.load_scene(STREET) if loaded else STREET, str(ours / name), duration_s=0.02)
    command_line.lidarcfg("export", RIG, "--scene", STREET, "--duration", "0.02", "-o", theirs / name, "--quiet")
    if loaded:
        (theirs / f"{name}.yaml").unlink()
    assert {path.name: path.read_bytes() for path in ours.iterdir()} == {
        path.name: path.read_bytes() for path in theirs.iterdir()
    }
    assert (ours / name).stat().st_size > 100_000


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


def test_a_record_of_a_drive_says_all_that_reading_it_needs(tmp_path):
    """Deskewed, each point is where its own time's pose of the drive, by hand, puts it."""
    (tmp_path / "drive.yaml").write_text("velocity_m_s: [20, 0, 0]\n")
    T = pose((1.25, -2.0, 0.0), (0.0, 0.0, np.radians(30)))
    out = tmp_path / "a.pcap"
    lidarcfg.export(RIG, STREET, out, duration_s=0.05, at=T, trajectory=tmp_path / "drive.yaml")
    skewed, deskewed = lidarcfg.decode(out), lidarcfg.decode(out, deskew=True)
    far_m = 20 * (skewed.time_ns - START_NS) / 1e9
    assert np.ptp(far_m) > 0.9
    moved = skewed.xyz + far_m[:, None] * (1, 0, 0)
    np.testing.assert_allclose(deskewed.xyz, moved @ T[:3, :3].T + T[:3, 3], rtol=0, atol=1e-9)
    with pytest.raises(LidarcfgError, match="to deskew needs the rig"):
        lidarcfg.decode(out, "none", deskew=True)


def test_a_capture_whose_rig_is_gone_says_what_to_do(tmp_path):
    (tmp_path / "rig.yaml").write_text("name: r\nsensors: [{name: a, model: vlp-16, position_m: [0, 0, 2]}]\n")
    lidarcfg.export(tmp_path / "rig.yaml", STREET, tmp_path / "a.pcap", duration_s=0.002)
    (tmp_path / "rig.yaml").unlink()
    done = command_line.lidarcfg("decode", tmp_path / "a.pcap", "-o", tmp_path / "a.ply", code=2)
    assert "a.pcap.yaml:3:3: rig.file: " in done.stderr
    assert "no such file or directory; name what fits it, or none, which leaves points in" in done.stderr
    command_line.lidarcfg("decode", tmp_path / "a.pcap", "--rig", "none", "-o", tmp_path / "a.ply")


def test_no_record_of_another_export_stays_beside(tmp_path):
    """A pose that X,Y,YAW_DEG cannot say, what was loaded, and a trajectory have none."""
    out, record = tmp_path / "a.pcap", tmp_path / "a.pcap.yaml"
    raised = pose((0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    rig = lidarcfg.load_rig(RIG)
    for given, at in ((RIG, raised), (rig, None), (RIG, standing(np.eye(4)))):
        lidarcfg.export(RIG, STREET, out, duration_s=0.002)
        assert record.exists()
        lidarcfg.export(given, STREET, out, duration_s=0.002, at=at)
        assert not record.exists()
    with pytest.raises(LidarcfgError, match="at is a trajectory, and a file of another is given"):
        lidarcfg.export(RIG, STREET, out, 0.002, at=standing(np.eye(4)), trajectory="drive.yaml")


@pytest.mark.parametrize("duration_s", [0.0, -1.0, np.nan, np.inf, 1e6])
def test_durations_that_are_none(tmp_path, duration_s):
    with pytest.raises(LidarcfgError, match=r"duration_s is .*; allowed: above 0, at most 86400"):
        lidarcfg.export(RIG, STREET, tmp_path / "a.pcap", duration_s)
    assert not list(tmp_path.iterdir())
