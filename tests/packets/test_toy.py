"""The maker of docs/codec.md as a user adds it, a folder and a line: exported, decoded and identified by the commands."""

import re
import struct
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import simulated_packets
from lidarcfg.capture.pcap import read_datagrams
from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import concatenate, load_cloud
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import inverse, transform
from lidarcfg.packets.families import FAMILIES
from lidarcfg.sensors.rig import load_rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import no_warning, write_datagrams

EXAMPLES = Path(__file__).parents[2] / "docs/examples"
SENSOR = (EXAMPLES / "toy/toy-4.yaml").read_text()
RIG = """
name: two
sensors:
  - {name: left, model: toy.yaml, position_m: [0, 1, 2], rpy_deg: [2, 3, 20], data_port: 4000, telemetry_port: 4001}
  - {name: right, model: vlp-16, position_m: [0, -1, 2]}
"""
SCENE = """
name: field
ground: {reflectivity: 12}
boxes: [{name: wall, center_m: [12, 0, 2], size_m: [1, 30, 4], reflectivity: 80}]
"""


def run(*words):
    assert not cli.main([*map(str, words), "--quiet"], prog_name="lidarcfg", standalone_mode=False)


@pytest.fixture(params=[10, 30])
def columns(request, tmp_path, monkeypatch):
    """Packets of 888 bytes, and of 2648, which leave as fragments."""
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.setitem(FAMILIES, "toy", "toy:Toy")
    (tmp_path / "toy.yaml").write_text(SENSOR.replace("columns: 10", f"columns: {request.param}"))
    (tmp_path / "rig.yaml").write_text(RIG)
    (tmp_path / "scene.yaml").write_text(SCENE)
    return request.param


def test_there_and_back(tmp_path, columns):
    """Beside a VLP-16: every return is that of the ground truth, with the rig's poses or identified by its companion."""
    rig = tmp_path / "rig.yaml"
    out = tmp_path / "a.pcap"
    run("export", rig, "--scene", tmp_path / "scene.yaml", "--duration", 0.3, "-o", out, "--truth", tmp_path / "t.npz")
    assert (tmp_path / "a-left.toy.json").is_file()
    assert not (tmp_path / "a-right.toy.json").exists()
    run("decode", out, "--rig", rig, "-o", tmp_path / "rig.npz")
    run("decode", out, "--rig", "none", "-o", tmp_path / "bare.npz")
    cloud, bare = (load_cloud(tmp_path / f"{name}.npz", no_warning) for name in ("rig", "bare"))
    mount = load_rig(rig).mounts[0]
    mine = cloud.sensor == 0
    alone = bare.sensor == bare.sensor_names.index("192.168.1.201:4000")
    xyz = transform(inverse(mount.T_vehicle_sensor), cloud.xyz[mine])
    np.testing.assert_allclose(xyz, bare.xyz[alone], rtol=0, atol=1e-12)
    with np.load(tmp_path / "t.npz") as truth:
        here = truth["sensor"] == 0
        assert here.sum() == mine.sum() > 6000
        assert (truth["time_ns"][here] == cloud.time_ns[mine]).all()
        assert (mount.sensor.ring[truth["laser"][here]] == cloud.ring[mine]).all()
        assert abs(np.linalg.norm(xyz, axis=1) - truth["range_m"][here]).max() <= 0.0005 + 1e-9
    sizes = {datagram.port: len(datagram.payload) for datagram in read_datagrams(out, no_warning)}
    assert sizes == {4000: 8 + 88 * columns, 4001: 36, 2368: 1206, 8308: 512}


def test_it_says_where_it_is(tmp_path, columns):
    """Once a second, after a quarter of a turn to the left: what is 1 m to the left is 1 m behind in the world."""
    run(
        *("export", tmp_path / "rig.yaml", "--scene", tmp_path / "scene.yaml", "--duration", 1.5),
        *("--at", "3,4,90", "-o", tmp_path / "a.pcap"),
    )
    told = [one.payload for one in read_datagrams(tmp_path / "a.pcap", no_warning) if one.port == 4001]
    magic, times_ns, *xyz_m = zip(*(struct.unpack("<4sq3d", payload) for payload in told), strict=True)
    assert magic == (b"TOYP", b"TOYP")
    assert times_ns[1] - times_ns[0] == 10**9
    assert np.transpose(xyz_m) == pytest.approx(np.array([[2, 4, 2]] * 2))


def test_lost_duplicate_and_overtaking_packets(tmp_path, columns):
    (tmp_path / "rig.yaml").write_text(RIG.rsplit("\n  -", 1)[0])
    run("export", tmp_path / "rig.yaml", "--scene", tmp_path / "scene.yaml", "--duration", 1, "-o", tmp_path / "a.pcap")
    sent = [one for one in read_datagrams(tmp_path / "a.pcap", no_warning) if one.port == 4000]
    kept = [one for i, one in enumerate(sent) if i not in (20, 30, 31)]
    kept[10], kept[11] = kept[11], kept[10]
    kept.insert(40, kept[39])
    write_datagrams(tmp_path / "b.pcap", kept)
    (tmp_path / "b.toy.json").write_bytes((tmp_path / "a.toy.json").read_bytes())
    stats = []
    found = concatenate(list(decode_pcap(tmp_path / "b.pcap", no_warning, on_stats=stats.append)))
    assert (np.diff(found.time_ns) >= 0).all()
    (one,) = stats
    assert (one.models, one.packets, one.lost) == (("toy-4",), len(sent) - 3, 3)
    assert (one.duplicates, one.reordered) == (1, 1)


def test_what_the_family_refuses(tmp_path, columns):
    text = RIG.replace("data_port: 4000", "return_mode: dual")
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(ConfigError, match="left: sensor 'toy-4' has no dual returns"):
        simulated_packets(load_rig(tmp_path / "rig.yaml"), load_scene(tmp_path / "scene.yaml"), np.eye(4), 10**9)
    (tmp_path / "toy.yaml").write_text(SENSOR.replace("columns: 10", "columns: many"))
    with pytest.raises(ConfigError, match=r"toy\.yaml:6:7: toy\.columns: 'many'"):
        simulated_packets(load_rig(tmp_path / "rig.yaml"), load_scene(tmp_path / "scene.yaml"), np.eye(4), 10**9)
    (tmp_path / "toy.yaml").write_text(SENSOR.replace("toy:", "tyo:").replace("codec: toy", "codec: tyo"))
    with pytest.raises(ConfigError, match=r"no codec is called 'tyo'; allowed: .*toy, velodyne"):
        simulated_packets(load_rig(tmp_path / "rig.yaml"), load_scene(tmp_path / "scene.yaml"), np.eye(4), 10**9)


def test_the_page_shows_its_lines():
    code = [path.read_text() for path in EXAMPLES.glob("toy/*.*")]
    page = (EXAMPLES.parent / "codec.md").read_text()
    shown = re.findall(r"^```(?:py|yaml)\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert len(shown) > 5
    assert [text for text in shown if not any(text in one for one in code)] == []
