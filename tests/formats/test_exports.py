"""`lidarcfg.export` and `lidarcfg.decode`: what the commands write and read, from files or from what was loaded."""

import numpy as np
import pytest

import lidarcfg
from lidarcfg.cloud import load_cloud
from lidarcfg.errors import LidarcfgError
from tests import command_line
from tests.capture_fixtures import no_warning

RIG, STREET = "data/rigs/mixed.yaml", "data/scenes/street.yaml"


@pytest.mark.parametrize("name", ["a.pcap", "a.ply"])
@pytest.mark.parametrize("loaded", [True, False])
def test_it_is_what_the_command_writes(tmp_path, name, loaded):
    """Byte for byte, with what readers need beside it; the command's record aside, which names the files."""
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    rig = lidarcfg.load_rig(RIG) if loaded else RIG
    lidarcfg.export(rig, lidarcfg.load_scene(STREET) if loaded else STREET, str(ours / name), duration_s=0.02)
    command_line.lidarcfg("export", RIG, "--scene", STREET, "--duration", "0.02", "-o", theirs / name, "--quiet")
    (theirs / f"{name}.yaml").unlink()
    assert {path.name: path.read_bytes() for path in ours.iterdir()} == {
        path.name: path.read_bytes() for path in theirs.iterdir()
    }
    assert (ours / name).stat().st_size > 100_000


def test_a_capture_is_one_cloud(tmp_path):
    """That which the command decodes, in the frames of the vehicle or of the sensors."""
    lidarcfg.export(RIG, STREET, tmp_path / "a.pcap", duration_s=0.02, at=np.diag([-1.0, -1, 1, 1]))
    for given in ((), ("--rig", RIG)):
        command_line.lidarcfg("decode", tmp_path / "a.pcap", "-o", tmp_path / "a.npz", "--quiet", *given)
        told = load_cloud(tmp_path / "a.npz", no_warning)
        for rig in [None] if not given else [RIG, lidarcfg.load_rig(RIG)]:
            cloud = lidarcfg.decode(str(tmp_path / "a.pcap"), rig, no_warning)
            assert cloud.sensor_names == told.sensor_names
            assert np.array_equal(cloud.xyz, told.xyz)
            assert np.array_equal(cloud.time_ns, told.time_ns)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, np.nan, np.inf, 1e6])
def test_durations_that_are_none(tmp_path, duration_s):
    with pytest.raises(LidarcfgError, match=r"duration_s is .*; allowed: above 0, at most 86400"):
        lidarcfg.export(RIG, STREET, tmp_path / "a.pcap", duration_s)
    assert not list(tmp_path.iterdir())
