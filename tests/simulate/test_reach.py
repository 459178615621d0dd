"""Beams that are not cast: none of them would have met anything in range; an open field leaves out more than half."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.pcap import write_pcap
from lidarcfg.geometry import pose, transform
from lidarcfg.realism import Realism
from lidarcfg.rig import Rig
from lidarcfg.simulate import reach as reach_module
from lidarcfg.simulate.export import START_NS, export, in_time_order
from lidarcfg.simulate.reach import BALLS, PATIENCE, SECTORS, Reach, Still
from lidarcfg.simulate.reach_kernels import SMALL, gathered, mark_balls, mark_cap
from lidarcfg.simulate.simulator import NO_LISTS
from lidarcfg.units import SECOND_NS
from lidarcfg.world.kernels import may_meet
from lidarcfg.world.motion import Arc, Motion, TimedPose, Trajectory, prepared
from lidarcfg.world.raycast import Raycaster
from tests.capture_fixtures import datagrams_of, mount, scene, tilted_rig
from tests.naive import placement as naive
from tests.packets.velodyne.shaped import firings, rays

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
    reach, skipped = Reach(sensor, caster, Still(caster), way, 0.0), 0
    for first in range(0, 300, 100):
        fired = firings(sensor.sensor, 1200, START_NS, range(first, first + 100))
        time_ns = fired.time_ns.ravel()
        origins, axes = (values.reshape(-1, 3) for values in rays(sensor.sensor, fired))
        starts = way.world(transform(sensor.T_vehicle_sensor, origins), time_ns)
        along = way.world(transform(sensor.T_vehicle_sensor, origins + axes), time_ns) - starts
        tables, sights = reach.known(time_ns.min(), time_ns.max())
        sector = (fired.azimuth_rad * (SECTORS / (2 * np.pi))).astype(int) % SECTORS
        masks = tables[:, sector, np.arange(16)].reshape(-1, len(time_ns))
        rows, what, which = may_meet(fired.azimuth_rad.reshape(-1, 16), tables, sights.which if sights else NO_LISTS)
        assert (rows == np.flatnonzero(masks.any(axis=0))).all()
        assert (what == masks[:, rows]).all()
        if sights:
            assert (which == sights.which[sector, np.arange(16)].ravel()[rows]).all()
        assert len(masks) == 2 + len(caster.movers)
        assert masks[0].any() == bool(ground)
        for row, mask in enumerate(masks):
            without = np.zeros_like(masks)
            without[row] = ~mask
            hits = caster.cast(starts, along, time_ns, without)
            assert not (hits.range_m <= RANGE_M).any()
        skipped += (~masks.any(axis=0)).sum()
    assert skipped > 0


def test_an_open_field(tmp_path):
    """On flat ground, of the beams of -15 to 15 degrees the upper eight meet nothing at all, that of -1 at 115 m."""
    counted = []
    streams = export(
        Rig("one", (mount(),)), scene(tmp_path, "ground: {reflectivity: 9}"), np.eye(4), SECOND_NS // 10,
        on_rays=counted.append,
    )  # fmt: skip
    assert sum(len(frames.records) for frames in in_time_order(streams)) == 75 + 15
    assert np.sum(counted, axis=0).tolist() == [75 * 384, 75 * 384 * 9 // 16, 0]


GROUND = "ground: {reflectivity: 9}\n"
BOX = "boxes: [{{name: b, center_m: {}, size_m: {}, reflectivity: 9{}}}]"
MANY = boxes(np.random.default_rng(3), 20)
JUST_CLEARED_M = 2 + 9.5 * math.tan(math.radians(1)) - 1e-6  # at 9.5 m by the beam at 1 degree of a sensor at 2 m
WAYS = {
    "stands": Motion(velocity_m_s=(0.0, 0.0, 0.0)),
    "crawls": Motion(velocity_m_s=(0.4, -0.2, 0.0)),
    "turns": Motion(arc=Arc(speed_m_s=12, yaw_rate_deg_s=-30)),
    "sinks": Motion(velocity_m_s=(0.4, 0.0, -10.0)),  # into the ground
    "whirls": Motion(arc=Arc(speed_m_s=0.1, yaw_rate_deg_s=3000)),
}
SCENES = {
    "ground and movers": (GROUND + MANY, "tilted"),
    "no ground": (MANY, "tilted"),
    "ground alone": (GROUND, "tilted"),
    "a fast mover": (BOX.format([20, -20, 2], [1, 1, 2], ", motion: {velocity_m_s: [0, 160, 0]}"), "level"),
    "inside a room": (BOX.format([0, 0, 1], [7, 7, 5], ""), "tilted"),
    "close by": (GROUND + BOX.format([0, 0, 1.4], [0.5, 0.5, 0.5], ""), "tilted"),
    "an edge just cleared": (GROUND + BOX.format([10, 0, JUST_CLEARED_M / 2], [1, 30, JUST_CLEARED_M], ""), "level"),
    "an edge just met": (GROUND + BOX.format([10, 0, JUST_CLEARED_M / 2], [1, 30, JUST_CLEARED_M + 4e-6], ""), "level"),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", SCENES)
def test_the_same_bytes(tmp_path, name, way):
    """With and without, in any chunks."""
    text, rig = SCENES[name]
    stage, rig = scene(tmp_path, text), tilted_rig() if rig == "tilted" else Rig("level", (mount(),))
    along = Trajectory(np.eye(4), prepared(WAYS[way]), START_NS)
    for file, options in (("a", {}), ("b", {"skip": False}), ("c", {"chunk_ns": 30_000_000})):
        write_pcap(tmp_path / file, in_time_order(export(rig, stage, along, SECOND_NS // 4, **options)))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == (tmp_path / "c").read_bytes()


def test_only_the_ground(tmp_path):
    """Beams that can meet the ground alone are not cast at triangles, of which there are some to the right."""
    stage = scene(tmp_path, GROUND + BOX.format([0, -10, 1], [1, 1, 2], ""))
    caster = Raycaster(stage, np.zeros(3), START_NS)
    still = Trajectory(np.eye(4), prepared(WAYS["stands"]), START_NS)
    ground, box = Reach(mount(), caster, Still(caster), still, 0.0).known(START_NS, START_NS).tables
    down = 2 / np.sin(-mount().sensor.elevation_rad).clip(1e-9) < RANGE_M
    assert ground[:, down].all()
    assert not ground[:, ~down].any()
    right = abs((np.arange(SECTORS) + 0.5) / SECTORS * 360 - 90) < 10
    assert 0 < box[right].mean() < 1
    assert not box[~right].any()


def test_tables_that_do_not_pay_are_passed_over(tmp_path, monkeypatch):
    """A fast vehicle in a crowded place: they are made again once in a while, and leave nothing out."""
    made = []
    monkeypatch.setattr(reach_module, "mark_balls", lambda *a: made.append(1) or mark_balls(*a))
    stage = scene(tmp_path, BOX.format([0, 0, 0], [150, 150, 60], ""))
    caster = Raycaster(stage, np.zeros(3), START_NS)
    fast = Trajectory(np.eye(4), prepared(Motion(velocity_m_s=(20.0, 0.0, 0.0))), START_NS)
    reach = Reach(mount(), caster, Still(caster), fast, 0.0)
    for k in range(4 * PATIENCE):
        assert reach.known(START_NS + k * SECOND_NS // 20, START_NS + (k + 1) * SECOND_NS // 20) is None
    assert len(made) == 4


@pytest.mark.parametrize("divergence", [False, True])
def test_nothing_in_range_at_all(tmp_path, divergence):
    """Not a ray is cast, and the packets are sent all the same, empty."""
    stage = scene(tmp_path, "boxes: [{name: b, center_m: [500, 0, 0], size_m: [2, 2, 2], reflectivity: 9}]")
    poses = tuple(TimedPose(time_s=t, position_m=(t, 0, 0)) for t in (0.0, 1.0))
    way = Trajectory(np.eye(4), prepared(Motion(poses=poses)), START_NS)
    rig, counted = Rig("one", (replace(mount(), realism=Realism(divergence=divergence)),)), []
    streams = export(
        rig, stage, way, SECOND_NS // 10, on_rays=lambda counts: counted.append(counts.rays - counts.nothing)
    )
    write_pcap(tmp_path / "a.pcap", streams[0])
    data = [d.payload for d in datagrams_of(tmp_path / "a.pcap") if d.port == 2368]
    assert len(data) == 75
    assert not any(payload[100 * block + 4 : 100 * block + 100].strip(b"\0") for payload in data for block in range(12))
    assert sum(counted) == 0


@pytest.mark.parametrize(
    "more", ["", "- {name: huge, center_m: [1.0e+7, 0, 0], size_m: [1.0e+7, 2.0e+7, 3], reflectivity: 9}"]
)
def test_balls_hold_all_that_stands_still(tmp_path, more):
    """Points drawn on the triangles lie in a ball each, however large these must be."""
    rng = np.random.default_rng(5)
    caster = Raycaster(scene(tmp_path, boxes(rng, 20) + "\n" + more), np.zeros(3))
    held = Still(caster).balls
    assert len(held.radius_m) <= BALLS
    corners = caster.scene.vertices_m[caster.still_triangles]
    weights = rng.dirichlet(np.ones(3), (len(corners), 20))
    points = np.einsum("tnk,tkd->tnd", weights, corners).reshape(-1, 3)
    inside = np.linalg.norm(points[:, None] - held.centre_m, axis=2) <= held.radius_m + 1e-9
    assert inside.any(axis=1).all()


def test_pieces_are_gathered(tmp_path):
    """Bit for bit as in plain loops: small and large triangles, needles, points; until there are too many of them."""
    rng = np.random.default_rng(6)
    vertices = np.concatenate(
        [rng.normal(size=(40, 3)) * 3, rng.normal(size=(40, 3)) * 0.1 - 2, [[0, 0, 0], [60, 1, 0]]]
    )
    faces = np.concatenate([rng.integers(0, 82, (30, 3)), [[80, 81, 80], [7, 7, 7], [80, 81, 5]]])
    box = scene(tmp_path, BOX.format([1, 2, 3], [8, 8, 8], ""))  # edges as long as each other
    for vertices_m, triangles in ((vertices, faces), (box.vertices_m, box.triangles)):
        for size in (0.5, 4.0):
            boxes = naive.gathered(vertices_m.tolist(), triangles.tolist(), size, SMALL)
            low, high, enough = gathered(vertices_m, triangles, size, len(boxes))
            assert enough
            assert np.array_equal(np.stack([low, high], axis=1), boxes)
            assert not gathered(vertices_m, triangles, size, len(boxes) - 1)[2]
    assert [len(values) for values in gathered(vertices, faces[:0], 1.0, 8)[:2]] == [0, 0]
    needle = np.array([[0.1, 0.1, 0.1], [63.9, 0.1, 0.1], [63.9, 0.2, 0.1]])
    for beside, enough in ((50, True), (100, False)):  # too many cuts, though not too many boxes
        assert gathered(needle, np.tile([0, 1, 2], (beside, 1)), 1.0, 64)[2] == enough


def test_caps_are_marked():
    """Against each beam's own angle, for lasers up to the poles and caps of any size."""
    rng = np.random.default_rng(7)
    elevation, offset = np.radians([-90, -60.5, -15, 0, 0.3, 44, 90]), rng.uniform(-0.5, 0.5, 7)
    fan, marked = np.stack([np.sin(elevation), np.cos(elevation), offset]), []
    for half in [*rng.uniform(0, np.pi, 60), *10 ** rng.uniform(-3, -1, 60)]:
        towards = rng.normal(size=3)
        towards /= np.linalg.norm(towards)
        table = np.zeros((7, 24), np.bool_)
        mark_cap(towards, math.cos(half), fan, table)
        twin = [naive.comes_near(towards.tolist(), half, e, o, 24) for e, o in zip(elevation, offset, strict=True)]
        assert table.tolist() == twin
        marked.append(table.mean())
    assert min(marked) == 0
    assert max(marked) == 1


def test_balls_are_marked():
    """Those in range as caps of their own; from inside a ball everything is."""
    rng = np.random.default_rng(8)
    T = pose((5, -3, 1), rng.uniform(-3, 3, 3))
    R, t = T[:3, :3].copy(), T[:3, 3].copy()
    centre, radius = rng.normal(size=(30, 3)) * 40, rng.uniform(0.1, 3, 30)
    elevation, offset = np.radians([-40.0, -1, 25]), np.array([0.1, -0.2, 0])
    fan, wide = np.stack([np.sin(elevation), np.cos(elevation), offset]), 0.02
    table, twin = np.zeros((3, 36), np.bool_), np.zeros((3, 36), np.bool_)
    mark_balls(centre, radius, R, t, 50.0, 0.5, wide, fan, table)
    for c, r in zip(centre, radius, strict=True):
        far = math.dist(c, t)
        if far - r - 0.5 <= 50:
            half = math.asin((r + 0.5) / far) + wide
            towards = [sum(R[k, j] * (c[k] - t[k]) for k in range(3)) / far for j in range(3)]
            twin |= [naive.comes_near(towards, half, e, o, 36) for e, o in zip(elevation, offset, strict=True)]
    assert table.tolist() == twin.tolist()
    assert 0 < table.mean() < 1
    mark_balls(t[None] + 0.3, np.array([0.1]), R, t, 50.0, 0.5, wide, fan, table)
    assert table.all()
