"""Files that are no files, have no end, or unpack to more than memory holds: each refused in one line, before."""

import os
import re
import subprocess
import sys
import threading
import time
import zipfile

import numpy as np
import pytest
import yaml

from lidarcfg import inputs
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.clouds.cloud import load_cloud, read_arrays, save_clouds
from lidarcfg.clouds.las import load_las
from lidarcfg.config import document as yaml_document
from lidarcfg.config.document import LARGE, Document
from lidarcfg.config.models import load
from lidarcfg.errors import CloudError, ConfigError, LidarcfgError
from lidarcfg.io.kitti import load_kitti
from lidarcfg.sensors.rig import RigFile
from lidarcfg.sensors.sensor import Beams
from lidarcfg.study import bounded_costs
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.study.criterion import Criterion
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from lidarcfg.world.meshes import read_mesh
from lidarcfg.world.motion import load_path
from tests.capture_fixtures import no_warning
from tests.clouds.test_cloud import cloud
from tests.command_line import lidarcfg

READERS = {
    ".pcap": lambda path: list(decode_pcap(path, no_warning)),
    ".npz": lambda path: load_cloud(path, no_warning),
    ".ply": lambda path: load_cloud(path, no_warning),
    ".pcd": lambda path: load_cloud(path, no_warning),
    ".las": lambda path: load_las(path, no_warning),
    ".bin": lambda path: load_kitti(path, no_warning),
    ".tum": load_path,
    ".stl": read_mesh,
    ".obj": read_mesh,
}


SMALL_STUDY = """
region: {min_m: [-2, -2, 0], max_m: [2, 2, 2], cuboid_m: [1, 1, 1]}
sensors:
  - {name: a, model: vlp-16, min: {position_m: [0, 0, 1.8], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 1, 2], rpy_deg: [9, 9, 0]}}
"""


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")], ids=["pipe", "device"])
def test_what_is_no_file_is_not_waited_for(tmp_path, suffix, make):
    path = tmp_path / f"a{suffix}"
    make(path)
    with pytest.raises(LidarcfgError, match=rf"a{suffix}: is not a regular file$"):
        READERS[suffix](path)


@pytest.mark.parametrize("suffix", READERS)
def test_ten_gigabytes_that_take_no_room(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 8e9)
    with open(path := tmp_path / f"a{suffix}", "wb") as file:
        file.truncate(10**10)
    with pytest.raises(LidarcfgError, match=rf"a{suffix}(: | needs )"):
        READERS[suffix](path)


def test_a_pipe_is_read_as_it_is_written_and_not_waited_for_in_vain(tmp_path, monkeypatch):
    """A writer may be slow; that nobody writes is told."""
    monkeypatch.setattr(inputs, "WRITER_S", 0.2)
    os.mkfifo(path := tmp_path / "a.yaml")
    with pytest.raises(ConfigError, match="is a pipe to which nothing is written"):
        load(path, RigFile)

    def write():
        with open(path, "w") as file:
            time.sleep(0.4)
            file.write("name: slow\nsensors:\n  - {name: a, model: vlp-16,")
            file.flush()
            time.sleep(0.1)
            file.write(" position_m: [1, 2, 3]}\n")

    thread = threading.Thread(target=write)
    thread.start()
    assert load(path, RigFile).sensors[0].position_m == (1, 2, 3)
    thread.join()


@pytest.mark.slow
def test_an_archive_that_unpacks_to_gigabytes(tmp_path):
    """By the size that it declares, whether that is true or not; and one that memory does not hold."""
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("xyz.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**7, 3)})
        for _ in range(240):
            file.write(bytes(10**6))
    assert path.stat().st_size < 10**6
    with pytest.raises(CloudError, match=r"a\.npz: [\d,]+ bytes that say they unpack to 240,000,128"):
        read_arrays(path, ["xyz"])
    save_clouds(path, [cloud()])
    assert len(load_cloud(path, no_warning).xyz)


def test_what_memory_does_not_hold_is_refused_with_what_it_needs(tmp_path, monkeypatch):
    save_clouds(tmp_path / "a.npz", [cloud()])
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 100.0)
    with pytest.raises(LidarcfgError, match=r"a\.npz needs 0\.0 GB of memory; 0\.0 GB are free"):
        load_cloud(tmp_path / "a.npz", no_warning)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (
            "view rig.yaml --png a.png --size 5000x5000",
            r"of 5000 x 5000 pixels needs 0\.6 GB of memory; 0\.0 GB are free",
        ),
        ("evaluate study.yaml rig.yaml", r"comparing 1,536 cuboids with 16 beams on 1 threads needs .* fewer beams"),
        ("evaluate study.yaml rig.yaml --tolerance 0.1", r"tolerance, of 2,048 cuboids, needs 0\.0 GB .* no tolerance"),
        ("optimize study.yaml -o o", r"comparing 1,536 cuboids with 16 beams on \d+ threads needs .* fewer beams"),
    ],
)
def test_commands_refuse_what_memory_does_not_hold(tmp_path, monkeypatch, words, what):
    """By hand: rows of 64 cuboids, of which there are 4 and one more on either side, in 2 layers and 2 more."""
    (tmp_path / "rig.yaml").write_text("name: r\nsensors:\n  - {name: a, model: vlp-16, position_m: [0, 0, 1.8]}\n")
    (tmp_path / "study.yaml").write_text(SMALL_STUDY)
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 2000.0)
    assert re.search(what, lidarcfg(*words.split(), code=2, cwd=tmp_path).stderr)
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["rig.yaml", "study.yaml"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "kind", "what"),
    [
        (
            "name: r\nsensors:\n" + "  - {name: a, model: vlp-16, position_m: [0, 0, 1]}\n" * 1001,
            RigFile,
            "1,001 values.*1000",
        ),
        (f"elevation_deg: {list(range(10_001))}\n", Beams, "10,001 values; allowed: at most 10000"),
    ],
)
def test_longer_than_any_sensor_or_rig(tmp_path, text, kind, what):
    (path := tmp_path / "a.yaml").write_text(text)
    with pytest.raises(ConfigError, match=what):
        load(path, kind)


def test_a_search_that_numbers_cuboids(tmp_path, monkeypatch):
    """For the largest sphere, as for detection, each thread has a number for every cuboid, and for every LiDAR lost."""
    (tmp_path / "study.yaml").write_text(SMALL_STUDY + "objective: {inscribed_radius: 1}\n")
    study = load_study(tmp_path / "study.yaml")
    monkeypatch.setattr(bounded_costs, "check_grid", lambda *_: None)
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 6 * 32 * 3 - 1.0)
    with pytest.raises(LidarcfgError, match="numbering 32 cuboids on 3 threads needs"):
        lidars = lidars_at(study.slots, study.space.lower)
        BoundedCosts(study.region, lidars, 3, criterion=Criterion.of_study(study))


def test_voxels_that_memory_does_not_hold(monkeypatch):
    """Of a region, of the subspaces in it, and of a grid with two voxels at its ends."""
    region = Region.from_boxes((0, 0, 0), (4, 4, 2), (1, 1, 1))
    spaces = segment(region, [lidar((2.0, 2.0, 1.0), (0, 0, 0), np.array([0.0]))])
    grid = region.voxel_grid([[0, 0, 0], [3, 3, 1]], np.ones((2, 3)))
    assert Region.from_voxel_grid(grid).included.sum() == 2
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 32 * 11 - 1.0)
    for make, what in (
        (lambda: Region.from_voxel_grid(grid), "a region of 32 cuboids needs"),
        (lambda: region.voxel_grid([[0, 0, 0], [3, 3, 1]], np.ones((2, 3))), "a grid of 2 voxels needs"),
        (lambda: spaces.voxel_grid(np.ones(len(spaces))), "a grid of 32 voxels needs"),
    ):
        with pytest.raises(LidarcfgError, match=what):
            make()


def test_what_the_system_has_no_memory_for_is_one_line_that_says_what():
    """numpy's error says the bytes; threads, libraries and files say it in words of their own."""
    with pytest.raises(MemoryError) as raised:
        np.empty((10**9, 10**6))
    said = str(inputs.out_of_memory(raised.value, "evaluating a.yaml"))
    assert re.match(
        r"out of memory at: evaluating a\.yaml; 8,000,000,000\.0 MB more were asked for, [\d,]+ MB are free; ", said
    )
    for error in (
        MemoryError("std::bad_alloc"),
        RuntimeError("can't start new thread"),
        ImportError("libblas.so.3: failed to map segment from shared object"),
        OSError(12, "Cannot allocate memory"),
    ):
        assert inputs.is_out_of_memory(error)
        assert "asked" not in str(inputs.out_of_memory(error, ""))
    for error in (RuntimeError("a bug"), ImportError("no module"), OSError(2, "no such file"), ValueError()):
        assert not inputs.is_out_of_memory(error)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")
@pytest.mark.parametrize(
    ("megabytes", "words", "what"),
    [
        (
            3000,
            "evaluate large.yaml rig.yaml",
            r"a region of 40,000,000 cuboids needs to reserve 4\.4 GB of memory; ulimit",
        ),
        (
            450,
            "evaluate study.yaml rig.yaml -o o",
            r"any command needs to reserve 0\.6 GB of memory; ulimit -v leaves 0\.[34] GB$",
        ),
    ],
)
def test_a_limit_of_addresses(tmp_path, megabytes, words, what):
    """Under `ulimit -v`: by what a region reserves, measured, and by what libraries do."""
    (tmp_path / "rig.yaml").write_text("name: r\nsensors:\n  - {name: a, model: vlp-16, position_m: [0, 0, 1.8]}\n")
    (tmp_path / "study.yaml").write_text(SMALL_STUDY)
    (tmp_path / "large.yaml").write_text(SMALL_STUDY.replace("[1, 1, 1]", "[0.01, 0.008, 0.01]"))
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({megabytes * 10**6},) * 2)"
    code = f"{limit}; import sys; sys.argv[1:] = {words.split()!r}; from lidarcfg.cli.main import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert re.match(f"lidarcfg: {what}", done.stderr)
    assert not list(tmp_path.glob("o/*"))


def test_memory_is_what_the_machine_has():
    assert 1e8 < inputs.memory_bytes() <= os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


LONG = "# " + "x" * LARGE + "\n"


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="a wheel of PyYAML without libyaml")
def test_a_large_file_says_what_a_small_one_does():
    """Read by libyaml, the other by PyYAML: the same values at the same places, and errors at the same."""
    text = "a: [1, 0x10, 0o17, 1e-5, .5, true, ~, on, 'x', \"\\u00e4\"]\nb:\n  - {c: &d [1, 2], e: *d}\n  - |\n    two\n    lines\n"
    small = Document("#\n" + text, "a")
    large = Document(LONG + text, "a")
    assert large.value == small.value
    assert large.places == small.places
    assert small.value["a"] == (1, 16, 15, 1e-5, 0.5, True, None, "on", "x", "ä")
    for bad, where in (
        ("a: 1\na: 2\n", "3:1"),
        ("a: [1\nb: 2\n", "3:2"),
        ("a: !x 1\n", "2:1"),
        ("? [1]\n: 2\n", "2:3"),
    ):
        for head in ("#\n", LONG):
            with pytest.raises(ConfigError, match=rf"^f:{where}: "):
                Document(head + bad, "f")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("[" * 10**6, "nested too deeply"),
        ("- " * 10**5, "nested too deeply"),
        ("[" + "1," * (yaml_document.NODES_MAX + 1), "has more than the 500,000 keys and values"),
        ("[" * 10, "not YAML: "),
    ],
)
def test_large_files_that_are_no_configuration(text, what):
    with pytest.raises(ConfigError, match=what) as error:
        Document(LONG + text, "f")
    assert str(error.value).startswith("f:2:") or what == "not YAML: "
