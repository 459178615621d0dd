"""Wide beams: what is listed for a packet of them changes no result, wherever they hit."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.realism import Realism
from lidarcfg.rig import Rig
from lidarcfg.simulate import simulator
from lidarcfg.simulate.echo_kernels import merged
from lidarcfg.simulate.tasks import Drive, prepared
from lidarcfg.world.motion import Arc, Motion, Trajectory
from lidarcfg.world.motion import prepared as prepared_path
from lidarcfg.world.scene import load_scene
from lidarcfg.world.vehicle import load_vehicle
from tests.capture_fixtures import AT_NS, STREET, mount, scene
from tests.naive import echoes as naive

ROUND = """
ground: {reflectivity: 30}
spheres: [{name: ball, center_m: [6, 1, 1.5], radius_m: 1.2, reflectivity: 40}]
cylinders: [{name: post, base_m: [5, -2, 0], radius_m: 0.05, height_m: 4, reflectivity: 30}]
boxes:
  - {name: crossing, center_m: [8, -6, 1], size_m: [4, 2, 2], reflectivity: 50, motion: {velocity_m_s: [0, 9, 0]}}
  - {name: wall, center_m: [0, 12, 2], size_m: [30, 1, 4], reflectivity: 50}
planes: [{name: sheet, center_m: [-7, 0, 1], size_m: [3, 3], rpy_deg: [10, 70, 20], reflectivity: 50}]
"""
DRIVE = Trajectory(np.eye(4), prepared_path(Motion(arc=Arc(speed_m_s=12, yaw_rate_deg_s=30))), AT_NS)


def hit_by(stage, vehicle, listed, monkeypatch, rpy_deg=(4.0, 3.0, 20.0)):
    """What the rays of two revolutions of wide beams hit."""
    wide = replace(mount(0, (0.3, 0.5, 2.2), rpy_deg), realism=Realism(divergence=True))
    (task,) = prepared(Drive(Rig("one", (wide,)), stage, DRIVE, vehicle, AT_NS, 200_000_000), 10**9)
    rows = []
    traced = simulator.trace_beams

    def spy(*words):
        traced(*words[:6], listed, words[7])
        rows.append((words[7].range_m.copy(), words[7].slot.copy(), words[7].cosine.copy()))

    with monkeypatch.context() as patch:
        patch.setattr(simulator, "trace_beams", spy)
        batch = next(iter(task.timing.schedule(wide, AT_NS, 150, 150)))
        found, _ = task.simulator.echoes(batch.firings, 0)
    return [*rows[0], found.range_m, found.reflectivity, found.object]


@pytest.mark.parametrize("place", ["street", "round", "vehicle"])
def test_lists_of_shapes_change_nothing(place, tmp_path, monkeypatch):
    """Bit for bit: ranges, what is hit, angles, and the echoes that are made of them; against rays traced in full."""
    stage = load_scene(STREET) if place == "street" else scene(tmp_path, ROUND)
    bodies = None
    if place == "vehicle":
        text = "boxes: [{name: bonnet, center_m: [2, 0, 0.9], size_m: [3, 1.6, 0.3], reflectivity: 20}]\n"
        (tmp_path / "car.yaml").write_text(text)
        bodies = load_vehicle(tmp_path / "car.yaml")
    in_full = hit_by(stage, bodies, 0, monkeypatch)
    assert np.isfinite(in_full[0]).sum() > 100_000
    for listed in (1, 24):
        for ours, theirs in zip(hit_by(stage, bodies, listed, monkeypatch), in_full, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_rays_are_those_of_thin_beams(tmp_path, monkeypatch):
    """Each of the nine rays, against the tracer that rays of thin beams take, for the same directions."""
    stage = scene(tmp_path, ROUND)
    range_m, slot, cosine, *_ = hit_by(stage, None, 24, monkeypatch)
    wide = replace(mount(0, (0.3, 0.5, 2.2), (4.0, 3.0, 20.0)), realism=Realism(divergence=True))
    (task,) = prepared(Drive(Rig("one", (wide,)), stage, DRIVE, None, AT_NS, 200_000_000), 10**9)
    fired = next(iter(task.timing.schedule(wide, AT_NS, 150, 150))).firings
    one = task.simulator
    found = simulator.Found(
        np.full(len(range_m), np.inf), np.full(len(range_m), -2, np.int32), np.empty((0, 3)), np.ones(len(range_m))
    )
    columns = fired.time_ns, fired.laser, fired.encoder_rad
    limit_m = wide.sensor.range.reported_m[1] + simulator.BEYOND_M
    simulator.trace_firings(one._tracer.world, one._lasers, one._frames, columns, one._tracer.zero_ns, limit_m, found)
    np.testing.assert_array_equal(range_m, found.range_m)
    np.testing.assert_array_equal(slot, found.slot)
    np.testing.assert_array_equal(cosine, found.cosine)


@pytest.mark.parametrize("weather", [False, True])
def test_echoes_of_a_beam(weather):
    """Random hits on two or three surfaces, some out of range, black, edge-on or retro-reflecting; by plain loops."""
    rng = np.random.default_rng(5)
    count, most_m, step_rad, least = 1500, 90.0, 0.0013, 2e-6
    weights = np.outer([1, 4, 1], [1, 4, 1]).ravel() / 36
    near = rng.choice([3.0, 8.0, 9.5, 40.0, 95.0], (count, 9)) + rng.uniform(0, 0.6, (count, 9))
    near = np.where(rng.random((count, 9)) < 0.1, np.inf, np.where(rng.random((count, 1)) < 0.5, near, near[:, :1]))
    bright = rng.choice([0, 3, 30, 90, 100, 101, 255], (count, 9)).astype(np.uint8)
    objects, cosine = rng.integers(0, 3, (count, 9)).astype(np.int32), rng.choice([1e-9, 0.02, 0.5, 1.0], (count, 9))
    drops, fade = np.empty((0, 2)), np.empty((0, 0))
    if weather:
        drops = np.stack([rng.uniform(0.5, 18, count), rng.uniform(0, 1e-3, count)], axis=1)
        fade = np.exp(-0.02 * np.column_stack([near, drops[:, 0]]))
    lasers = rng.integers(0, 3, count).astype(np.uint8)
    out = np.empty((count, 6)), np.empty((count, 6), np.uint8), np.empty((count, 6), np.int32)
    merged((near, bright, objects, cosine), lasers, weights, (most_m, step_rad, least), drops, fade, out)
    several = 0
    for n in range(count):
        hits = list(zip(near[n].tolist(), bright[n].tolist(), objects[n].tolist(), cosine[n].tolist(), strict=True))
        drop, left = (drops[n].tolist(), fade[n].tolist()) if weather else (None, None)
        wanted = naive.echoes(hits, weights.tolist(), most_m, step_rad, least, drop, left)
        for k, echo in enumerate(wanted):
            if echo is None:
                assert out[0][n, k] == np.inf
                continue
            assert out[0][n, k] == pytest.approx(echo[0], rel=1e-12)
            assert out[1][n, k] == echo[1]
            assert out[2][n, k] == echo[2]
        several += wanted[0] is not None and wanted[2] != wanted[3]
    assert several > 300
