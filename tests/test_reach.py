"""Beams that are not cast: none of them would have met anything in range; an open field leaves out the upper half."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.export import START_NS, export, in_time_order
from lidarcfg.capture.firing import firings, rays
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.ray_kernels import may_meet
from lidarcfg.capture.raycast import Raycaster
from lidarcfg.capture.reach import SECTORS, Reach, balls
from lidarcfg.capture.trajectory import Arc, Motion, TimedPose, Trajectory, prepared
from lidarcfg.geometry import pose, transform
from lidarcfg.realism import Realism
from lidarcfg.rig import Rig
from tests.capture_fixtures import datagrams_of, mount, scene, tilted_rig

SECOND_NS = 10**9
RANGE_M = 100.0


def boxes(rng, count):
    """Boxes and balls all over, some further than any sensor sees; every third moves."""
    lines = ["boxes:"]
    for i in range(count):
        x, y = rng.uniform(-160, 160, 2)
        size = rng.uniform(0.2, 30 if i % 5 == 0 else 3, 3)
        moves = f", motion: {{velocity_m_s: [{rng.uniform(-20, 20):.2f}, 3, 0]}}" if i % 3 == 0 else ""
        lines.append(
            f"- {{name: b{i}, center_m: [{x:.2f}, {y:.2f}, {rng.uniform(-3, 8):.2f}],"
            f" size_m: [{', '.join(f'{v:.2f}' for v in size)}], reflectivity: 9{moves}}}"
        )
    return "\n".join(lines)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_left_out_meets_nothing(tmp_path, seed):
    """Each ray is cast in spite of the proof, against what it was said not to meet."""
    rng = np.random.default_rng(seed)
    ground = "ground: {z_m: -1, reflectivity: 9}\n" if seed % 2 else ""
    stage = scene(tmp_path, ground + boxes(rng, 12))
    sensor = mount(0, tuple(rng.uniform(-2, 3, 3)), tuple(rng.uniform(-30, 30, 3)), 1200)
    motion = Motion(arc=Arc(speed_m_s=15, yaw_rate_deg_s=40)) if seed % 3 else Motion(velocity_m_s=(0.0, 0.0, 0.0))
    way = Trajectory(pose((3, -2, 0), (0, 0, 1)), prepared(motion), START_NS)
    caster = Raycaster(stage, np.zeros(3), START_NS)
    reach, skipped = Reach(sensor, caster, balls(caster), way, 0.0), 0
    for first in range(0, 300, 100):
        fired = firings(sensor.sensor, 1200, START_NS, range(first, first + 100))
        time_ns = fired.time_ns.ravel()
        origins, axes = (values.reshape(-1, 3) for values in rays(sensor.sensor, fired))
        starts = way.world(transform(sensor.T_vehicle_sensor, origins), time_ns)
        along = way.world(transform(sensor.T_vehicle_sensor, origins + axes), time_ns) - starts
        tables, sector = (
            reach.tables(fired.time_ns),
            (fired.azimuth_rad * (SECTORS / (2 * np.pi))).astype(int) % SECTORS,
        )
        masks = tables[:, sector, np.arange(16)].reshape(-1, len(time_ns))
        rows, what = may_meet(fired.azimuth_rad.reshape(-1, 16), tables)
        assert (rows == np.flatnonzero(masks.any(axis=0))).all()
        assert (what == masks[:, rows]).all()
        assert len(masks) == 1 + len(caster.movers)
        for row, mask in enumerate(masks):
            without = np.zeros_like(masks)
            without[row] = ~mask
            hits = caster.cast(starts, along, time_ns, without)
            assert not (hits.range_m <= RANGE_M).any()
        skipped += (~masks.any(axis=0)).sum()
    assert skipped > 0


def test_an_open_field(tmp_path):
    """On flat ground, of the beams of -15 to 15 degrees the upper eight can meet nothing at all."""
    counted = []
    streams = export(
        Rig("one", (mount(),)), scene(tmp_path, "ground: {reflectivity: 9}"), np.eye(4), SECOND_NS // 10,
        on_rays=lambda rays, cast: counted.append((rays, cast)),
    )  # fmt: skip
    assert sum(len(frames.records) for frames in in_time_order(streams)) == 75 + 15
    assert np.sum(counted, axis=0).tolist() == [75 * 384, 75 * 384 // 2]


@pytest.mark.parametrize("turning", [False, True])
def test_the_same_bytes(tmp_path, turning):
    """With and without, in any chunks."""
    stage = scene(tmp_path, "ground: {reflectivity: 9}\n" + boxes(np.random.default_rng(3), 20))
    motion = Motion(arc=Arc(speed_m_s=12, yaw_rate_deg_s=-30)) if turning else Motion(velocity_m_s=(0.0, 0.0, 0.0))
    way = Trajectory(np.eye(4), prepared(motion), START_NS)
    for name, options in (("a", {}), ("b", {"skip": False}), ("c", {"chunk_ns": 30_000_000})):
        write_pcap(tmp_path / name, in_time_order(export(tilted_rig(), stage, way, SECOND_NS // 4, **options)))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == (tmp_path / "c").read_bytes()


@pytest.mark.parametrize("divergence", [False, True])
def test_nothing_in_range_at_all(tmp_path, divergence):
    """Not a ray is cast, and the packets are sent all the same, empty."""
    stage = scene(tmp_path, "boxes: [{name: b, center_m: [500, 0, 0], size_m: [2, 2, 2], reflectivity: 9}]")
    poses = tuple(TimedPose(time_s=t, position_m=(t, 0, 0)) for t in (0.0, 1.0))
    way = Trajectory(np.eye(4), prepared(Motion(poses=poses)), START_NS)
    rig, counted = Rig("one", (replace(mount(), realism=Realism(divergence=divergence)),)), []
    streams = export(rig, stage, way, SECOND_NS // 10, on_rays=lambda rays, cast: counted.append(cast))
    write_pcap(tmp_path / "a.pcap", streams[0])
    data = [d.payload for d in datagrams_of(tmp_path / "a.pcap") if d.port == 2368]
    assert len(data) == 75
    assert not any(payload[100 * block + 4 : 100 * block + 100].strip(b"\0") for payload in data for block in range(12))
    assert sum(counted) == 0


def test_balls_hold_all_that_stands_still(tmp_path):
    """Points drawn on the triangles lie in a ball each."""
    rng = np.random.default_rng(5)
    caster = Raycaster(scene(tmp_path, boxes(rng, 20)), np.zeros(3))
    held = balls(caster)
    corners = caster.scene.vertices_m[caster.still_triangles]
    weights = rng.dirichlet(np.ones(3), (len(corners), 20))
    points = np.einsum("tnk,tkd->tnd", weights, corners).reshape(-1, 3)
    inside = np.linalg.norm(points[:, None] - held.centre_m, axis=2) <= held.radius_m + 1e-9
    assert inside.any(axis=1).all()
