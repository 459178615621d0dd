"""What an export notes beside the capture, and decoding by it."""

import hashlib

import numpy as np
import pytest
import yaml

from lidarcfg.cloud import load_cloud
from tests.command_line import lidarcfg


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """A VLS-128, which fires before its first packet's time, on timed poses that begin at 0."""
    folder = tmp_path_factory.mktemp("record")
    (folder / "drive.yaml").write_text("name: v\nsensors: [{name: a, model: vls-128, position_m: [0, 0, 2]}]\n")
    (folder / "motion.yaml").write_text(
        "poses:\n- {time_s: 0, position_m: [0, 0, 0]}\n- {time_s: 0.03, position_m: [0.3, 0, 0]}\n"
    )
    words = ("--trajectory", "motion.yaml", "--at", "1,2,5", "--start", "2026-03-01T12:00:00+01:00")
    lidarcfg(
        "export", "drive.yaml", "--scene", "data/scenes/street.yaml", *words, "--duration", 0.02, "-o", "drive.pcap",
        "--return-mode", "last", cwd=folder,
    )  # fmt: skip
    lidarcfg("decode", "drive.pcap", "--rig", "drive.yaml", *words, "-o", "said.npz", cwd=folder)
    return folder


def test_nothing_is_said_twice(here):
    """Deskewed by the record as by the options of the export, bit for bit."""
    lidarcfg("decode", "drive.pcap", "--deskew", "-o", "noted.npz", "--stats", cwd=here)
    noted, said = (load_cloud(here / f"{name}.npz", pytest.fail) for name in ("noted", "said"))
    assert len(noted.xyz) > 10_000
    for key in ("xyz", "time_ns", "ring", "sensor"):
        assert np.array_equal(getattr(noted, key), getattr(said, key))
    values = yaml.safe_load((here / "drive.pcap.yaml").read_text())
    assert values["rig"] == {
        "file": "drive.yaml",
        "sha256": hashlib.sha256((here / "drive.yaml").read_bytes()).hexdigest(),
    }
    assert (here / values["scene"]["file"]).resolve().name == "street.yaml"
    assert (values["return_mode"], values["duration_s"], values["at"]) == ("last", 0.02, "1,2,5")
    assert "record of a capture: 0.02 s" in lidarcfg("validate", "drive.pcap.yaml", cwd=here).stdout


def test_what_has_changed_is_not_taken(here):
    motion = (here / "motion.yaml").read_text()
    try:
        (here / "motion.yaml").write_text(motion + "# another\n")
        done = lidarcfg("decode", "drive.pcap", "--deskew", "-o", "no.npz", code=2, cwd=here)
        assert "drive.pcap.yaml:9:3: trajectory.file: motion.yaml has changed since the export" in done.stderr
        lidarcfg("decode", "drive.pcap", "--deskew", "--trajectory", "motion.yaml", "-o", "yes.npz", cwd=here)
        (here / "motion.yaml").unlink()
        done = lidarcfg("decode", "drive.pcap", "--deskew", "-o", "no.npz", code=2, cwd=here)
        assert "trajectory.file: motion.yaml: no such file" in done.stderr
    finally:
        (here / "motion.yaml").write_text(motion)
    done = lidarcfg("decode", "other.pcap", "--deskew", "-o", "no.npz", code=2, cwd=here)
    assert "other.pcap.yaml: there is no record of the capture; give --rig and --trajectory" in done.stderr
    assert not (here / "no.npz").exists()


def test_dual_of_thin_beams_is_said(here):
    words = ("export", "drive.yaml", "--scene", "data/scenes/street.yaml", "--duration", 0.01, "--return-mode", "dual")
    done = lidarcfg(*words, "-o", "dual.pcap", cwd=here)
    assert "warning: a: beams without divergence have one echo, so that both returns are the same" in done.stderr
    stats = lidarcfg("decode", "dual.pcap", "--stats", "-o", "dual.npz", cwd=here).stdout
    assert "vls-128, dual" in stats
