"""Wide beams: their rays hit what they would hit alone, wherever that is; and the echoes made of it."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.core import simulate
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Rig
from lidarcfg.simulate import simulator
from lidarcfg.simulate.echoes import Echoes, SubRays
from lidarcfg.simulate.tasks import Drive, build_tasks
from lidarcfg.world.motion import Arc, Motion, Trajectory, build_path
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
DRIVE = Trajectory(np.eye(4), build_path(Motion(arc=Arc(speed_m_s=12, yaw_rate_deg_s=30))), AT_NS)


def shards(tmp_path, triangles=4000):
    """A scene of small triangles everywhere, half of them a floor without gaps, and slivers among the others."""
    rng = np.random.default_rng(3)
    side = int((triangles / 4) ** 0.5)
    x, y = (across.ravel() for across in np.meshgrid(*2 * [np.linspace(-8, 8, side + 1)], indexing="ij"))
    floor = np.stack([x, y, rng.uniform(0.1, 0.4, len(x))], axis=1)
    at = np.arange(len(x)).reshape(side + 1, side + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    corners = rng.uniform((-20, -20, 0), (20, 20, 5), (triangles // 2, 1, 3)) + rng.normal(
        0, 0.4, (triangles // 2, 3, 3)
    )
    corners[::5, 2] = corners[::5, 1] + rng.normal(0, 1e-4, (len(corners[::5]), 3))
    faces = np.concatenate(
        [np.stack([a, b, c], 1), np.stack([a, c, d], 1), len(x) + np.arange(3 * len(corners)).reshape(-1, 3)]
    )
    points = np.concatenate([floor, corners.reshape(-1, 3)])
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *(f"property double {k}" for k in "xyz")]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{u!r} {v!r} {w!r}" for u, v, w in points.tolist()] + [f"3 {i} {j} {k}" for i, j, k in faces.tolist()]
    (tmp_path / "shards.ply").write_text("\n".join(lines) + "\n")
    return scene(tmp_path, "meshes: [{name: shards, file: shards.ply, position_m: [0, 0, 0], reflectivity: 30}]")


def together(*words):
    """What the rays of wide beams hit, traced beam by beam."""
    simulate.trace_firings(*words)


def one_by_one(world, bodies, surfaces, lasers, mounting, fired, zero_ns, limit_m, hits):
    """The same, each ray of a beam traced as if it were a thin one."""
    for k in range(len(lasers.across)):
        thin = lasers._replace(across=lasers.across[k : k + 1], above=lasers.above[k : k + 1])
        columns = [np.empty((len(values), 1), values.dtype) for values in list(vars(hits).values())[:4]]
        alone = SubRays(*columns, hits.laser)
        simulate.trace_firings(world, bodies, surfaces, thin, mounting, fired, zero_ns, limit_m, alone)
        for key, values in list(vars(hits).items())[:4]:
            values[:, k] = getattr(alone, key)[:, 0]


def hit_by(trace, stage, vehicle, divergence, monkeypatch):
    """What the rays of two revolutions of wide beams hit, as a function traces them."""
    wide = replace(mount(0, (0.3, 0.5, 2.2), (4.0, 3.0, 20.0)), realism=Realism(divergence=divergence))
    (task,) = build_tasks(Drive(Rig("one", (wide,)), stage, DRIVE, vehicle, AT_NS, 200_000_000), 10**9)
    traced = []

    class Spy:
        @staticmethod
        def trace_firings(*words):
            trace(*words)
            traced.append(words[-1])

    with monkeypatch.context() as patch:
        patch.setattr(simulator, "simulate", Spy)
        batch = next(iter(task.timing.schedule(wide, AT_NS, 150, 150)))
        found, _ = task.simulator.echoes(batch.firings, 0)
    return [*vars(traced[0]).values(), found.range_m, found.reflectivity, found.object]


@pytest.mark.parametrize(
    ("place", "divergence"),
    [
        ("street", True),
        ("round", True),
        ("vehicle", (20.0, 30.0)),
        ("shards", True),
        ("shards", (1e-6, 1e-6)),
        ("shards", (5.0, 40.0)),
        ("round", (1500.0, 1200.0)),
    ],
)
def test_rays_are_those_of_thin_beams(place, divergence, tmp_path, monkeypatch):
    """Bit for bit: ranges, what is hit, angles, and the echoes made of them; against rays that are traced one by one."""
    stage = load_scene(STREET) if place == "street" else scene(tmp_path, ROUND)
    bodies = None
    if place == "vehicle":
        text = "boxes: [{name: bonnet, center_m: [2, 0, 0.9], size_m: [3, 1.6, 0.3], reflectivity: 20}]\n"
        (tmp_path / "car.yaml").write_text(text)
        bodies = load_vehicle(tmp_path / "car.yaml")
    if place == "shards":
        stage = shards(tmp_path)
    wide = hit_by(together, stage, bodies, divergence, monkeypatch)
    thin = hit_by(one_by_one, stage, bodies, divergence, monkeypatch)
    assert np.isfinite(wide[0]).sum() > 100_000
    assert len(np.unique(wide[3])) > 5
    for ours, theirs in zip(wide, thin, strict=True):
        np.testing.assert_array_equal(ours, theirs)


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
    rays = SubRays(near, bright, objects, cosine, lasers)
    shape = count, 6
    found = Echoes(np.empty(shape), np.zeros(shape), np.empty(shape, np.uint8), np.empty(shape, np.int32), np.empty(0))
    simulate.merge_echoes(rays, weights, most_m, step_rad, least, drops, fade, np.arange(6, dtype=np.uint8), found)
    out = found.range_m, found.reflectivity, found.object
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
