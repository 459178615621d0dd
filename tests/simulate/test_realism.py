"""Whole captures of sensors that are not perfect: the truth beside them, edges by another decoder, and the commands."""

import resource
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.ground_truth import TruthFile
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.geometry import inverse, transform
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Rig
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.units import SECOND_NS, START_NS
from tests.capture_fixtures import decoded, mount, scene, standing_street, tilted_rig
from tests.command_line import lidarcfg

ALL = Realism(seed=7, range_noise_m=0.02, dropout_fraction=0.1, range_10_percent_m=40.0, divergence=True)


@pytest.fixture(scope="module")
def street():
    return standing_street()


def with_truth(tmp_path, rig, stage, duration_ns=SECOND_NS // 10, **options):
    names = [one.name for one in rig.mounts]
    with TruthFile(tmp_path / "truth.npz", names, stage.names) as truth:
        streams = simulated_packets(rig, stage, np.eye(4), duration_ns, on_truth=truth.add, **options)
        write_pcap(tmp_path / "a.pcap", in_time_order(streams))
        count = truth.save()
    with np.load(tmp_path / "truth.npz") as arrays:
        columns = dict(arrays)
    assert len(columns["range_m"]) == count
    return decoded(tmp_path / "a.pcap", rig), columns


@pytest.mark.parametrize("return_mode", ["strongest", "last", "dual"])
@pytest.mark.parametrize("realism", [None, ALL])
def test_the_ground_truth_of_every_return(street, tmp_path, return_mode, realism):
    """One record a return: exact range plus noise is what decodes, within half a step; and so are time and laser."""
    rig = tilted_rig()
    rig = replace(rig, mounts=tuple(replace(m, return_mode=return_mode, realism=realism) for m in rig.mounts))
    cloud, truth = with_truth(tmp_path, rig, street)
    assert len(cloud.xyz) == len(truth["range_m"]) > 10_000
    for index, one in enumerate(rig.mounts):
        mine = cloud.sensor == index
        true = truth["sensor"] == index
        assert mine.sum() == true.sum()
        ring = one.sensor.ring[truth["laser"][true]]
        measured = truth["range_m"][true] + truth["noise_m"][true]
        order = np.lexsort((measured, ring, truth["time_ns"][true]))
        ours = transform(inverse(one.T_vehicle_sensor), cloud.xyz[mine])
        laser = np.argsort(one.sensor.ring)[cloud.ring[mine]]
        ours[:, 2] -= np.array(one.sensor.beams.vertical_offset_mm)[laser] / 1000
        range_m = np.linalg.norm(ours, axis=1)
        time_ns = truth["time_ns"][true][order]
        nearest = np.searchsorted(np.unique(time_ns), cloud.time_ns[mine] - 1000)  # stamps are rounded to 1 µs
        got = np.lexsort((range_m, cloud.ring[mine], nearest))
        assert abs(cloud.time_ns[mine][got] - time_ns).max() <= 1000
        assert (cloud.ring[mine][got] == ring[order]).all()
        assert abs(range_m[got] - measured[order]).max() <= 0.001 + 1e-9
    assert truth["object_names"].tolist() == list(street.names)
    assert (abs(truth["noise_m"]).max() > 0) == (realism is not None)


def test_edges_differ_between_the_returns(tmp_path):
    """A pole before a wall: at its edges a wide beam has two echoes, the pole's and the wall's; a thin one never."""
    stage = scene(
        tmp_path,
        "cylinders: [{name: pole, base_m: [10, 0, 0], radius_m: 0.1, height_m: 9, reflectivity: 40}]\n"
        "planes: [{name: wall, center_m: [20, 0, 0], size_m: [90, 90], rpy_deg: [0, 90, 0], reflectivity: 50}]",
    )
    for realism, pairs in ((None, False), (Realism(divergence=True), True)):
        rig = Rig("one", (replace(mount(), return_mode="dual", realism=realism),))
        cloud, truth = with_truth(tmp_path, rig, stage, SECOND_NS // 5)
        last = cloud.return_type == 1
        assert last.any() == pairs
        names = truth["object_names"][truth["object"]]
        assert set(names[truth["return_type"] == 1]) == ({"wall"} if pairs else set())
        if pairs:
            assert cloud.xyz[last, 0] == pytest.approx(20, abs=0.01)


def test_flat_ground_is_one_echo(tmp_path):
    """A wide beam that hits the ground at a flat angle covers many metres of it, and still is one echo."""
    stage = scene(tmp_path, "ground: {reflectivity: 40}")
    rig = Rig("one", (replace(mount(), return_mode="dual", realism=Realism(divergence=True)),))
    cloud, _ = with_truth(tmp_path, rig, stage)
    assert len(cloud.xyz) > 10_000
    assert not (cloud.return_type == 1).any()
    assert np.hypot(*cloud.xyz.T[:2]).max() > 30


def test_off_is_exact(street, tmp_path):
    """A seed alone changes nothing; each imperfection changes something, in the same way again."""
    made = {}
    for name, realism in (
        ("none", None),
        ("seed", Realism(seed=5)),
        ("noise", Realism(range_noise_m=0.02)),
        ("again", Realism(range_noise_m=0.02)),
        ("other", Realism(range_noise_m=0.02, seed=1)),
        ("dropout", Realism(dropout_fraction=0.01)),
        ("range", Realism(range_10_percent_m=20.0)),
    ):
        rig = Rig("one", (mount(),))
        rig = replace(rig, mounts=(replace(rig.mounts[0], realism=realism),))
        chunk_ns = 20_000_000 if name == "again" else 50_000_000
        streams = simulated_packets(
            rig, street, np.eye(4), SECOND_NS // 20, options=SimulationOptions(chunk_ns=chunk_ns)
        )
        made[name] = b"".join(record for frames in streams[0] for record in frames.records)
    assert made["seed"] == made["none"]
    assert made["again"] == made["noise"]
    assert len({made[name] for name in ("none", "noise", "other", "dropout", "range")}) == 5


@pytest.fixture
def here(tmp_path):
    sensors = [{"name": "a", "model": "vlp-16", "position_m": [0, 0, 2], "realism": {"range_noise_m": 0.01}}]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"name": "one", "sensors": sensors}))
    (tmp_path / "scene.yaml").write_text(
        "name: s\nboxes: [{name: b, center_m: [20, 0, 0], size_m: [2, 50, 9], reflectivity: 50}]"
    )
    (tmp_path / "trajectory.yaml").write_text("arc: {speed_m_s: 10, yaw_rate_deg_s: 45}")
    return tmp_path


def test_commands(here):
    """Out with a motion, back without it: the wall stands where it stood. The truth and the counts are printed."""
    words = ("--trajectory", "trajectory.yaml", "--at", "1,2,5", "--start", "2026-03-01T12:59:59.9")
    done = lidarcfg("export", "rig.yaml", "--scene", "scene.yaml", "--duration", 0.2, *words, "--truth", "t.npz", "--stats", "-o", "a.pcap", cwd=here)  # fmt: skip
    assert "a.pcap: 180 packets, 0.2 s" in done.stdout
    assert "57,600 rays" in done.stdout
    done = lidarcfg("decode", "a.pcap", "--rig", "rig.yaml", *words, "-o", "a.npz", cwd=here)
    cloud = load_cloud(here / "a.npz", print)
    with np.load(here / "t.npz") as truth:
        assert len(truth["range_m"]) == len(cloud.xyz) > 1000
    near = abs(cloud.xyz[:, 1]) < 10
    assert abs(cloud.xyz[near, 0] - 19).max() < 0.06
    done = lidarcfg("replay", "a.pcap", "127.0.0.1:9", "--speed", 100, cwd=here)
    assert "180 datagrams to 127.0.0.1:9" in done.stdout


def test_counts_of_no_rays(here):
    """A sector that the head has not reached yet: nothing is fired, nothing is divided by it."""
    sensors = [{"name": "a", "model": "vlp-16", "position_m": [0, 0, 2], "azimuth_fov_deg": [350, 355]}]
    (here / "rig.yaml").write_text(yaml.safe_dump({"name": "one", "sensors": sensors}))
    done = lidarcfg(
        "export", "rig.yaml", "--scene", "scene.yaml", "--duration", 0.01, "--stats", "-o", "a.pcap", cwd=here
    )
    assert "0 rays traced, of which 0 (0.0%) hit something in range" in done.stdout


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (("export", "rig.yaml", "--scene", "scene.yaml", "--duration", 1, "-o", "a.pcap", "--truth", "t.txt"), "'t.txt' does not end in .npz"),
        (("export", "rig.yaml", "--scene", "scene.yaml", "--duration", 1, "-o", "a.pcap", "--trajectory", "no.yaml"), "no.yaml: no such file"),
        (("export", "rig.yaml", "--scene", "scene.yaml", "--duration", 1, "-o", "a.pcap", "--truth", "scene.yaml/t.npz"), "scene.yaml/t.npz: not a directory"),
        (("decode", "a.pcap", "--trajectory", "trajectory.yaml", "-o", "a.npz"), "--trajectory needs --rig"),
        (("decode", "a.pcap", "--at", "1,2,3", "-o", "a.npz"), "--at and --start say where and when a --trajectory starts"),
        (("replay", "a.pcap", "127.0.0.1:x"), "'x' is not a port"),
        (("replay", "a.pcap", "127.0.0.1", "--speed", "0"), "--speed"),
        (("replay", "a.pcap", "127.0.0.1", "--speed", "fast"), "'fast' is not a valid float"),
        (("replay", "a.pcap", "127.0.0.1", "--from", "2", "--to", "1"), "there is nothing from 2 s to 1 s"),
        (("replay", "none.pcap", "127.0.0.1"), "none.pcap: no such file"),
    ],
)  # fmt: skip
def test_mistakes(here, words, match):
    done = lidarcfg(*words, code=2, cwd=here)
    *warnings, said = done.stderr.splitlines()
    assert match in said
    assert all(": warning: s: no object has a category" in line for line in warnings)
    assert not (here / "a.pcap").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "words", "name"), [(100_000, (), "a.pcap"), (1_500_000, ("--truth", "t.npz"), "t.npz")]
)
def test_a_full_disk_is_one_line(here, size, words, name):
    """A limit on the size of files stands for the disk's end; nothing of the capture stays."""

    def limit():
        import signal

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    before = sorted(path.name for path in here.iterdir())
    call = [sys.executable, "-m", "lidarcfg", "export", "rig.yaml", "--scene", "scene.yaml", "--duration", "1"]
    call += ["-o", "a.pcap", "--quiet", *words]
    done = subprocess.run(call, capture_output=True, text=True, cwd=here, preexec_fn=limit)
    assert done.returncode == 2
    assert done.stderr == f"lidarcfg: {name}: file too large\n"
    assert sorted(path.name for path in here.iterdir()) == before


@pytest.mark.slow
def test_streams_are_made_as_they_are_read(street):
    """The first datagram of a day comes after a chunk is cast, not after the day."""
    done = []
    stream = in_time_order(
        simulated_packets(tilted_rig(), street, np.eye(4), 86_400 * SECOND_NS, options=SimulationOptions(done.append))
    )
    first = next(stream)
    assert first.time_ns[0] - START_NS < 10_000_000
    assert max(done, default=0) <= 200_000_000
