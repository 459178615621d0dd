"""Records of the ground truth and decoded points, one to one: every family, imperfect sensors, dual returns."""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.ground_truth import TruthFile, load_objects
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate, load_cloud
from lidarcfg.geometry import inverse, transform
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, no_warning
from tests.command_line import lidarcfg

RIG = Path(__file__).parents[2] / "data/rigs/mixed.yaml"
DURATION_NS = 60_000_000
INSIDE_M = 0.06  # within a sensor, where beams start


@pytest.fixture(scope="module", params=["dual", None])
def made(request, tmp_path_factory):
    """A capture of five sensors of four makers with dropouts, noise and wide beams, and its ground truth."""
    folder = tmp_path_factory.mktemp("truth")
    mounts = []
    for i, mount in enumerate(load_rig(RIG).mounts):
        realism = Realism(seed=i, range_noise_m=0.02, dropout_fraction=0.1, divergence=mount.sensor.optics is not None)
        mounts.append(replace(mount, realism=realism, return_mode=request.param or mount.return_mode))
    rig = replace(load_rig(RIG), mounts=tuple(mounts))
    street = load_scene(STREET)
    save_rig(rig, folder / "rig.yaml")
    with TruthFile(folder / "t.npz", [mount.name for mount in rig.mounts], street.names) as truth:
        write_pcap(
            folder / "a.pcap", in_time_order(simulated_packets(rig, street, np.eye(4), DURATION_NS, on_truth=truth.add))
        )
        save_sidecar_files(folder / "a.pcap", rig.mounts)
        truth.save()
    return folder, rig, request.param


def by_laser(sensor, ring, last, time_ns):
    """The rows of each laser's first and second returns, in the order of time, by plain loops."""
    found = defaultdict(list)
    for row, key in enumerate(zip(sensor.tolist(), ring.tolist(), last.tolist(), strict=True)):
        found[key].append(row)
    return {key: sorted(rows, key=lambda row: time_ns[row]) for key, rows in found.items()}


@pytest.mark.slow
def test_each_point_has_one_record_and_each_record_one_point(made):
    folder, rig, mode = made
    with np.load(folder / "t.npz") as arrays:
        truth = dict(arrays)
    cloud = concatenate(list(decode_pcap(folder / "a.pcap", no_warning, rig)))
    assert len(cloud.xyz) == len(truth["time_ns"]) > 50_000
    rings = [mount.sensor.ring for mount in rig.mounts]
    ring = np.array([rings[s][laser] for s, laser in zip(truth["sensor"], truth["laser"], strict=True)])
    ouster = [mount.sensor.codec == "ouster" for mount in rig.mounts].index(True)
    second = (cloud.return_type == 1) | ((cloud.return_type == 2) & (cloud.sensor == ouster))
    recorded = (truth["return_type"] == 1) | ((truth["return_type"] == 2) & (truth["sensor"] == ouster))
    points = by_laser(cloud.sensor, cloud.ring, second, cloud.time_ns)
    records = by_laser(truth["sensor"], ring, recorded, truth["time_ns"])
    assert points.keys() == records.keys()
    here = []
    there = []
    for key, rows in points.items():
        assert len(rows) == len(records[key])
        here = here + rows
        there = there + records[key]
    assert abs(cloud.time_ns[here] - truth["time_ns"][there]).max() <= 1000
    for i, mount in enumerate(rig.mounts):
        mine = cloud.sensor[here] == i
        own = transform(inverse(mount.T_vehicle_sensor), cloud.xyz[here][mine])
        off_m = np.linalg.norm(own, axis=1) - (truth["range_m"] + truth["noise_m"])[there][mine]
        assert abs(off_m).max() < INSIDE_M
        types = set(truth["return_type"][there][mine].tolist())
        assert (len(types) >= 2) == (mode == "dual" and mount.realism.divergence)
        np.testing.assert_array_equal(cloud.return_type[here][mine], truth["return_type"][there][mine])

    found = load_objects(folder / "t.npz", cloud, rig)
    np.testing.assert_array_equal(found.index[here], truth["object"][there])


def test_decode_writes_the_objects(made):
    folder, rig, _ = made
    for suffix in (".ply", ".pcd", ".npz"):
        out = folder / f"a{suffix}"
        lidarcfg(
            "decode", folder / "a.pcap", "--rig", folder / "rig.yaml", "--truth", folder / "t.npz", "-o", out, "--quiet"
        )
        cloud = load_cloud(out, no_warning)
        truth = load_objects(folder / "t.npz", cloud, rig)
        seen = [truth.names[i] for i in truth.index.tolist()]
        assert cloud.object is not None
        assert [cloud.object_names[i] for i in cloud.object.tolist()] == seen
        assert {"ground", "house_south_1"} <= set(seen)
