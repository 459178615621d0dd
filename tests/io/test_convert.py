"""lidarcfg convert as a user types it: which format is meant, what is said, and each mistake in one line."""

import json
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lidarcfg.capture.pcap import Datagram
from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import save_clouds
from lidarcfg.errors import LidarcfgError
from lidarcfg.io.formats import FORMATS, INPUTS, choose_format
from tests.capture_fixtures import write_datagrams
from tests.clouds.test_cloud import cloud
from tests.command_line import lidarcfg

ROOT = Path(__file__).parents[2]
ROOF = ROOT / "data/rigs/roof.yaml"


def run(*words):
    return CliRunner().invoke(cli, ["convert", *map(str, words)])


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with an input of each kind."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOF, "roof.yaml")
    save_clouds("c.ply", [cloud()])
    write_datagrams("p.pcap", [Datagram(1_700_000_000 * 10**9, "192.168.1.201", 2368, 2368, bytes(1206))])
    return tmp_path


def test_help_lists_every_conversion():
    text = run("--help").output
    table, example = text.split("Examples:")
    for form in (form for form in FORMATS if form.kind != "drive"):  # those `export` writes
        assert form.name in re.split(r"[\s.,:]+", table)
        assert not form.suffix or form.suffix in table.split()
    for suffixes in INPUTS.values():
        assert all(suffix in re.split(r"[\s,]+", table) for suffix in suffixes)
    assert "lidarcfg convert" in example


@pytest.mark.parametrize(
    ("source", "output", "name", "meant"),
    [
        ("r.yaml", "a.urdf", None, "urdf"),
        ("r.YML", "a.launch.py", None, "launch"),
        ("r.json", "a.json", None, "carla"),
        ("r.yaml", "folder", None, "nuscenes"),
        ("r.yaml", "v1.0-mini", "nuscenes", "nuscenes"),
        ("c.ply", "a.LAZ", None, "laz"),
        ("c.laz", "a.bin", None, "kitti"),
        ("c.bin", "a.pcd", "pcd", "pcd"),
        ("p.pcap", "folder", None, "rosbag2"),
        ("p.pcapng", "folder", "rosbag2-mcap", "rosbag2-mcap"),
        ("p.pcap", "a.mcap", None, "mcap"),
        ("k.urdf", "a.yaml", None, "rig"),
        ("k.yaml", "a.yml", None, "rig"),
        ("k.json", "a.yaml", None, "rig"),
        ("calib.txt", "a.yaml", None, "rig"),
        ("k.mcap", "a.yaml", None, "rig"),
    ],
)
def test_which_format_is_meant(source, output, name, meant):
    assert choose_format(Path(source), Path(output), name).name == meant


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("roof.yaml", "-o", "a.las"), "a rig does not convert to 'a.las'; allowed: .urdf, .py, .json, or a folder, which has no suffix; or say which with --to"),
        (("c.ply", "-o", "a.urdf"), "a cloud does not convert to 'a.urdf'; allowed: .ply, .pcd, .npz, .las, .laz, .bin; or say which with --to"),
        (("c.ply", "-o", "bag"), "a cloud does not convert to 'bag'; allowed: .ply, .pcd, .npz, .las, .laz, .bin; or say which with --to"),
        (("p.pcap", "-o", "a.ply"), "a capture does not convert to 'a.ply'; allowed: .mcap, .bag, or a folder, which has no suffix; or say which with --to; lidarcfg decode turns it into a cloud"),
        (("p.pcap", "-o", "a.npz"), "a capture does not convert to 'a.npz'; allowed: .mcap, .bag, or a folder, which has no suffix; or say which with --to; lidarcfg decode turns it into a cloud"),
        (("p.pcap", "-o", "a.npz", "--to", "firings"), "a capture does not convert to firings; allowed: rosbag2, rosbag2-mcap, mcap, rosbag1, kitti-odometry, kitti-object, nuscenes; lidarcfg decode turns it into a cloud"),
        (("roof.yaml", "-o", "a.urdf", "--to", "las"), "a rig does not convert to las; allowed: urdf, launch, carla, nuscenes, crop-box, azimuth-windows"),
        (("roof.yaml", "-o", "a.urdf", "--to", "gazebo"), "a rig does not convert to gazebo; allowed: urdf, launch, carla, nuscenes, crop-box, azimuth-windows"),
        (("roof.yaml", "-o", "a.json", "--to", "urdf"), "a.json: does not end in .urdf, as urdf does"),
        (("notes.doc", "-o", "a.urdf"), "notes.doc: not a rig, a kit, a bag, a cloud or a capture by its suffix; rig: .yaml .yml .json; kit: .urdf .xacro .xml .yaml .yml .json .txt; bag: .bag .mcap .db3; cloud: .ply .pcd .npz .las .laz .bin; capture: .pcap .pcapng"),
        (("none.yaml", "-o", "a.urdf"), "none.yaml: no such file or directory"),
        (("none.las", "-o", "a.ply"), "none.las: no such file or directory"),
        (("none.pcap", "-o", "a.mcap"), "none.pcap: no such file or directory"),
        (("p.pcap", "-o", "a.mcap", "--rig", "none.yaml"), "none.yaml: no such file or directory"),
        (("p.pcap", "-o", "a.mcap", "--rig", "c.ply"), "c.ply: points or a mesh, no YAML"),
        (("p.pcap", "-o", "a.mcap", "--rig", "roof.yaml", "--model", "vlp16"), "no sensor is called 'vlp16'; did you mean vlp-16? allowed: "),
        (("p.pcap", "-o", "a.mcap"), "p.pcap: 192.168.1.201:2368 sends the unknown product id 0x00"),
        (("c.ply", "-o", "c.ply/a.las"), "c.ply/a.las"),
    ],
)  # fmt: skip
def test_mistakes_get_one_line(words, what, here):
    before = sorted(here.rglob("*"))
    done = run(*words)
    assert isinstance(done.exception, LidarcfgError | OSError), done.output
    error = done.exception
    text = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
    assert what in text
    assert "\n" not in text
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("roof.yaml", "-o", "a.urdf", "--rig", "roof.yaml"), "--rig, --truth and --model are for captures"),
        (("c.ply", "-o", "a.las", "--model", "vlp-16"), "--rig, --truth and --model are for captures"),
        (("roof.yaml",), "Missing option '-o' / '--output'"),
        (("-o", "a.las"), "Missing argument 'INPUT'"),
    ],
)
def test_options_that_do_not_belong(words, what, here):
    done = run(*words)
    assert done.exit_code == 2
    assert what in done.output


@pytest.mark.parametrize(
    "words",
    ["roof.yaml -o a", "roof.yaml -o a/b", "p.pcap -o a", "p.pcap -o a.mcap", "p.pcap -o a.bag", "c.ply -o a.las"],
)
def test_a_loop_of_links_as_output(words, here):
    """One line, and the links stay."""
    link = here / words.split()[-1].split("/")[0]
    link.symlink_to(link.name)
    said = lidarcfg("convert", *words.split(), code=2, cwd=here).stderr
    assert (said.count("\n"), words.split()[-1] in said) == (1, True)
    assert link.is_symlink()
    assert sorted(path.name for path in here.iterdir()) == sorted(["c.ply", "p.pcap", "roof.yaml", link.name])


def test_all_that_a_rig_becomes(here):
    for output, there in (("a.urdf", "<robot"), ("a.launch.py", "static_transform"), ("a.json", "ray_cast")):
        done = run("roof.yaml", "-o", output)
        assert done.exit_code == 0
        assert done.stdout == f"{output}: 2 sensors\n"
        assert done.stderr.startswith(f"lidarcfg: warning: {output}: ")
        assert " has no " in done.stderr
        assert there in Path(output).read_text()
    assert run("roof.yaml", "-o", "tables").stdout == "tables: 2 sensors\n"
    assert {item.name for item in Path("tables").iterdir()} == {"sensor.json", "calibrated_sensor.json"}
    first = Path("tables/sensor.json").read_text()
    Path("tables/sensor.json").write_text("[]")
    run("roof.yaml", "-o", "tables", "--quiet")  # such a folder is replaced
    assert Path("tables/sensor.json").read_text() == first
    assert json.loads(first)[0]["channel"] == "left"
    (Path("tables") / "scene.json").write_text("[]")  # a dataset's folder is not
    done = run("roof.yaml", "-o", "tables")
    assert str(done.exception) == (
        "tables: holds 'scene.json'; only a folder of sensor.json, calibrated_sensor.json is replaced"
    )


def test_a_cloud_of_another_program(here):
    """As CloudCompare writes it: ASCII, floats, no time."""
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    Path("f.ply").write_text(f"{head}property float scalar_Intensity\nend_header\n1 2 3 7\n4 5 6 8\n")
    done = run("f.ply", "-o", "f.npz")
    assert done.stdout == "f.npz: 2 points\n"
    assert done.stderr == ("lidarcfg: warning: f.ply: has no ring, time_ns, sensor, return_type; 0 is assumed\n")
    with np.load("f.npz") as arrays:
        assert arrays["xyz"].tolist() == [[1, 2, 3], [4, 5, 6]]
        assert (arrays["intensity"].tolist(), arrays["sensor_names"].tolist()) == ([7, 8], ["f"])


def test_a_cloud_there_and_back(here):
    done = run("c.ply", "-o", "c.las")
    assert (done.stdout, done.stderr) == ("c.las: 50 points\n", "")
    done = run("c.las", "-o", "c.bin", "--quiet")
    assert (done.stdout, done.stderr) == ("", "")
    done = run("c.bin", "-o", "d.npz")
    assert done.stdout == "d.npz: 50 points\n"
    assert done.stderr == "lidarcfg: warning: c.bin: has no ring, time_ns, sensor, return_type; 0 is assumed\n"
    with np.load("d.npz") as arrays:
        assert abs(arrays["xyz"] - cloud().xyz).max() < 1e-4


@pytest.mark.slow
def test_a_capture_by_the_command(tmp_path):
    """The whole trip with the real exit codes; a full disk in a process of its own."""
    run = partial(lidarcfg, cwd=tmp_path)
    run("export", ROOF, "--scene", ROOT / "data/scenes/street.yaml", "--duration", 0.11, "-o", "a.pcap", "--quiet")
    done = run("convert", "a.pcap", "--rig", ROOF, "-o", "bag")
    assert done.stdout == "bag: 5 messages\n"
    assert done.stderr == "lidarcfg: warning: bag: rosbag2 has no return type\n"
    assert {item.name for item in (tmp_path / "bag").iterdir()} == {"bag.db3", "metadata.yaml"}
    done = run("convert", "a.pcap", "--rig", "bag", "-o", "a.mcap", code=2)
    assert len(done.stderr.splitlines()) == 1
    for output in ("full", "full.mcap"):  # a full disk, as files may grow to 100 kB
        words = f"ulimit -f 100; {sys.executable} -m lidarcfg convert a.pcap --rig {ROOF} -o {output}"
        done = subprocess.run(["bash", "-c", words], capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 2, done.stderr
        assert done.stderr.startswith(f"lidarcfg: {output}: ")
        assert len(done.stderr.splitlines()) == 1
    assert {item.name for item in tmp_path.iterdir()} == {"a.pcap", "a.pcap.yaml", "bag"}


def test_loading_the_command_loads_no_library_of_others():
    code = (
        "from lidarcfg.cli.main import cli; cli(['convert', '--help'], standalone_mode=False); import sys; "
        "print(sorted({'laspy', 'rosbags', 'scipy', 'open3d', 'numpy', 'pydantic'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
