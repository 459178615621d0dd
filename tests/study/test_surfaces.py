"""Sensors on the surface of the vehicle."""

import math
import re

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidarcfg.errors import ConfigError
from lidarcfg.files import shipped
from lidarcfg.geometry import leaning, rotation, up
from lidarcfg.search.optimize import optimize
from lidarcfg.search.plain_rigs import IN_STEPS, plain_points
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.study import with_solver
from lidarcfg.viewer.bodies import base_area_m, base_discs_m
from lidarcfg.viewer.mounting import violations
from lidarcfg.vsr.region import Region
from tests.naive import surfaces as naive
from tests.studies import study_of
from tests.visibility_cases import seen_cuboids

SEDAN = shipped("data") / "vehicles" / "sedan.ply"
REGION = "region: {min_m: [-6, -4, 0], max_m: [6, 4, 3], cuboid_m: [1, 0.5, 0.25]}\n"
STEP = """
vehicle:
  boxes:
    - {name: cab, center_m: [1, 0, 1], size_m: [2, 2, 2], yaw_deg: 0}
    - {name: bed, center_m: [-1, 0, 0.5], size_m: [2, 2, 1], yaw_deg: 0}
"""
ROUND = "vehicle: {spheres: [{name: ball, center_m: [0.5, 0, 1], radius_m: 0.8}]}\n"
TANK = "vehicle: {cylinders: [{name: tank, base_m: [0, 0, 0.5], radius_m: 0.7, height_m: 1}]}\n"
CAR = f"vehicle: {{meshes: [{{name: body, file: {SEDAN}, exclude: true}}]}}\n"


def study(folder, vehicle, *groups, more="solver: {evaluations: 200}\n"):
    sensors = "".join(f"  - {{model: vlp-16, {group}}}\n" for group in groups)
    return study_of(folder, f"{REGION}{vehicle}sensors:\n{sensors}{more}")


@pytest.mark.slow
def test_plain_rigs_are_as_far_out_as_their_surfaces_allow():
    """On the saloon's roof and fenders the ends of the bounds are beside the body."""
    loaded = load_study(shipped("data") / "studies" / "mounts.yaml")
    points = plain_points(loaded)
    kept = loaded.space.violation(loaded.space.poses(points)) == 0
    assert kept.mean() > 0.7
    inside = (points[kept] > 0) & (points[kept] < 1) & (points[kept] != 0.5)
    assert inside.any()
    for point in points[kept][inside.any(axis=1)]:
        drawn_in = 2 * abs(point - 0.5)
        share = drawn_in[drawn_in > 0]
        assert share == pytest.approx(share[0])
        farther = [one for one in IN_STEPS if one > share[0] + 1e-9]
        further_out = np.where(point == 0.5, 0.5, 0.5 + np.array([1, *farther])[:, None] * np.sign(point - 0.5) / 2)
        assert (loaded.space.violation(loaded.space.poses(further_out)) > 0).all()


def on(body, side, low, high, **more):
    keys = {"base_radius_m": 0.05, **more}
    extra = "".join(f", {key}: {str(value).lower()}" for key, value in keys.items())
    return f"on: {{body: {body}, from: {side}, within: {{min_m: {list(low)}, max_m: {list(high)}}}{extra}}}"


def random(loaded, count, seed=1):
    unit = np.random.default_rng(seed).random((count, loaded.space.dimensions))
    return loaded.space.poses(unit)


def test_the_shortest_tilt_to_an_axis():
    """The witness is scipy: without its yaw, the frame is turned by the angle between the axes, no more."""
    rng = np.random.default_rng(1)
    axis = rng.normal(size=(200, 3))
    axis[:4] = [0, 0, 1], [1, 0, 0], [0, -1, 0], [1, 0, 1e-9]
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    yaw = rng.uniform(-3, 3, 200)
    found = leaning(axis, yaw)
    assert np.abs(up(found) - axis).max() < 1e-15 * 10
    tilt = [
        Rotation.from_matrix(rotation(row)) * Rotation.from_euler("z", -turn)
        for row, turn in zip(found, yaw, strict=True)
    ]
    angle = np.arctan2(np.hypot(axis[:, 0], axis[:, 1]), axis[:, 2])
    assert np.array([one.magnitude() for one in tilt]) == pytest.approx(angle, abs=1e-7)


def test_on_a_roof_by_hand(tmp_path):
    """A box's top is at 2 m: bases there, origins above; a base over its edge is not on it."""
    loaded = study(
        tmp_path, STEP, on("cab", "above", (0, -1, 1.5), (2, 1, 2.5), standoff_m=0.08) + ", yaw_deg: [-90, 90]"
    )
    assert loaded.space.free.tolist() == [[True, True, False, False, False, True]]
    poses = random(loaded, 2000)
    assert poses[:, 0, 2] == pytest.approx(2.08, abs=1e-12)
    assert (poses[:, 0, 3:5] == 0).all()
    assert poses[:, 0, 5].min() < -1.5
    inside = (poses[:, 0, 0] > 0.05) & (poses[:, 0, 0] < 1.95) & (abs(poses[:, 0, 1]) < 0.95)
    assert ((loaded.space.violation(poses) == 0) == inside).all()
    assert inside.mean() == pytest.approx(0.95 * 0.95, abs=0.03)
    low = study(tmp_path, STEP, on("bed", "above", (-2, -1, 0), (2, 1, 3)))
    poses = random(low, 500)
    fits = low.space.violation(poses) == 0
    assert (poses[fits, 0, 0] < -0.05).all()  # the cab is another body
    assert poses[fits, 0, 2] == pytest.approx(1.05)


def test_nothing_narrow_stays_under_a_base(tmp_path):
    """An aerial of 1 cm on a roof, and a roof with a gap of 12 mm: bases keep away from them by their radius."""
    aerial = "{name: aerial, center_m: [1, 0, 2.2], size_m: [0.01, 0.01, 0.4]}"
    vehicle = STEP.replace("yaw_deg: 0}\n", f"yaw_deg: 0}}\n    - {aerial}\n", 1)
    gap = tmp_path / "gap.obj"
    side = [(0, 1), (2, 1), (2, 2), (1.006, 2), (1.006, 1.8), (0.994, 1.8), (0.994, 2), (0, 2)]  # x and z
    corners = [f"v {x} {y} {z}" for y in (1, -1) for x, z in side]
    end = [(1, 6, 7), (1, 7, 8), (1, 2, 5), (1, 5, 6), (2, 3, 4), (2, 4, 5)]
    walls = [(i, i + 8, i % 8 + 1) for i in range(1, 9)] + [(i % 8 + 1, i + 8, i % 8 + 9) for i in range(1, 9)]
    faces = end + [(c + 8, b + 8, a + 8) for a, b, c in end] + walls
    gap.write_text("\n".join([*corners, *("f {} {} {}".format(*face) for face in faces)]))
    mesh = f"vehicle: {{meshes: [{{name: cab, file: {gap}}}]}}\n"
    for bodies, away in ((vehicle, (0.005, 0.005)), (mesh, (0.006, 1.0))):
        for upright in (True, False):
            loaded = study(tmp_path, bodies, on("cab", "above", (0.9, -0.1, 1.5), (1.1, 0.1, 2.5), upright=upright))
            poses = random(loaded, 400)
            clear = np.linalg.norm(np.maximum(abs(poses[:, 0, :2] - (1, 0)) - away, 0), axis=1) - 0.05
            fits = loaded.space.violation(poses) == 0
            sure = abs(clear) > 0.05 / 12
            assert ((clear > 0) == fits)[sure].all()
            assert 0.2 < fits.mean() < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("side", naive.OUT)
@pytest.mark.parametrize("upright", [True, False])
def test_on_a_car_as_plain_loops_have_it(tmp_path, side, upright):
    """Where bases fit, where they are, and which way axes point, by loops over all triangles."""
    loaded = study(tmp_path, CAR, on("body", side, (-2.5, -1.1, 0), (2.5, 1.1, 1.6), upright=upright, step_m=0.02))
    vertices, triangles = loaded.vehicle.scene.mesh()
    corners = vertices[triangles]
    slot = loaded.slots[0].surface
    poses = random(loaded, 20)
    fits = loaded.space.violation(poses) == 0
    axes = up(poses[:, 0, 3:])
    for pose, fit, axis in zip(poses[:, 0], fits, axes, strict=True):
        mount = np.array(naive.OUT[side]) if upright else axis
        base = pose[:3] - 0.05 * mount
        expected = naive.sits(corners, [0] * len(corners), 0, side, base, 0.05, 0.02, slot.low_m, slot.high_m, upright)
        assert fit == (expected is not None)
        if expected:
            assert base == pytest.approx(expected[0], abs=1e-6)
            near = (corners.min(axis=1) < base + 0.01).all(axis=1) & (corners.max(axis=1) > base - 0.01).all(axis=1)
            assert naive.distance(corners[near], base) < 1e-6
            assert upright or axis == pytest.approx(expected[1], abs=1e-9)
            assert axis == pytest.approx([0, 0, 1]) or not upright


@pytest.mark.slow
@pytest.mark.parametrize("side", naive.OUT)
def test_along_the_normal_of_a_sphere(tmp_path, side):
    """Bases are on the sphere, and axes as near to its radius as a disc's middle to its rim."""
    loaded = study(tmp_path, ROUND, on("ball", side, (-1, -1, 0), (2, 1, 2), upright=False, step_m=0.02))
    poses = random(loaded, 400)
    poses = poses[loaded.space.violation(poses) == 0][:, 0]
    assert len(poses) > 100
    axis = up(poses[:, 3:])
    base = poses[:, :3] - 0.05 * axis - (0.5, 0, 1)
    assert np.linalg.norm(base, axis=1) == pytest.approx(0.8, abs=1e-9)
    slope = (base / 0.8) @ naive.OUT[side]
    assert np.degrees(np.arccos((axis * base).sum(axis=1) / 0.8))[slope > 0.8].max() < 0.3


def test_along_the_normal_of_a_slope(tmp_path):
    """A box turned by 30° about the vertical: its side's normal is known."""
    box = "vehicle: {boxes: [{name: box, center_m: [0, 0, 1], size_m: [2, 1, 2], yaw_deg: 30}]}\n"
    loaded = study(tmp_path, box, on("box", "left", (-0.5, 0, 0.5), (0.5, 1, 1.5), upright=False))
    poses = random(loaded, 50)
    assert (loaded.space.violation(poses) == 0).all()
    normal = np.array([-math.sin(math.pi / 6), math.cos(math.pi / 6), 0])
    assert up(poses[:, 0, 3:]) == pytest.approx(np.tile(normal, (50, 1)), abs=1e-12)
    assert (poses[:, 0, :3] - (0, 0, 1)) @ normal == pytest.approx(0.5 + 0.05, abs=1e-12)


def test_a_tilt_that_a_surface_does_not_allow_is_refused_at_once(tmp_path):
    """A wall's normal is level, 90° from the vertical."""
    box = "vehicle: {boxes: [{name: box, center_m: [0, 0, 1], size_m: [2, 1, 2], yaw_deg: 30}]}\n"
    wall = ("box", "left", (-0.5, 0, 0.5), (0.5, 1, 1.5))
    with pytest.raises(
        ConfigError, match=r"constraints.max_tilt_deg: 79 is impossible: sensors\[0\] tilts by 90 or more"
    ):
        study(tmp_path, box, on(*wall, upright=False), more="constraints: {max_tilt_deg: 79}\n")
    for limit_deg, kept in ((90.001, True), (81, False)):  # within 10° of it the search decides
        loaded = study(tmp_path, box, on(*wall, upright=False), more=f"constraints: {{max_tilt_deg: {limit_deg}}}\n")
        assert ((loaded.space.violation(random(loaded, 20)) == 0) == kept).all()


@pytest.mark.slow
def test_a_pair_sits_on_both_sides(tmp_path):
    """Each on its own side of the car, whose halves differ by a millimetre; on a box, exact images."""
    group = on("body", "left", (1.2, 0.5, 0.5), (2.1, 1.1, 0.8)) + ", count: 2, mirror_y_m: 0, yaw_deg: [0, 90]"
    loaded = study(tmp_path, CAR, group)
    assert loaded.space.free.tolist() == [[True, False, True, False, False, True], [False] * 6]
    poses = random(loaded, 300)
    poses = poses[loaded.space.violation(poses) == 0]
    assert len(poses) > 30
    apart = poses[:, 1] - poses[:, 0] * (1, -1, 1, -1, 1, -1)
    assert abs(apart[:, [0, 2, 3, 4, 5]]).max() < 1e-12
    assert 1e-6 < abs(apart[:, 1]).max() < 0.01
    vertices, triangles = loaded.vehicle.scene.mesh()
    for left, right in poses[:5]:
        for side, pose in (("left", left), ("right", right)):
            base = pose[:3] - 0.05 * np.array(naive.OUT[side])
            assert naive.first_hit(vertices[triangles], base, side)[0] == pytest.approx(abs(base[1]), abs=1e-6)
    lopsided = STEP.replace("center_m: [1, 0, 1]", "center_m: [1, 0.03, 1]")
    with pytest.raises(ConfigError, match=r"a base of 0\.05 m in radius and its image fits nowhere"):
        study(tmp_path, lopsided, on("cab", "left", (0.2, 0, 0.2), (1.8, 2, 1.8)) + ", count: 2, mirror_y_m: 0")


def test_the_roof_hides_what_it_truly_hides(tmp_path):
    """By hand: a line of sight from 5 cm above the middle of a roof clears its edge, or it does not."""
    loaded = study(tmp_path, STEP, on("cab", "above", (1, 0, 2), (1, 0, 2)), more="")
    poses = loaded.space.poses(np.empty((1, 0)))
    assert loaded.space.violation(poses) == [0]
    (lidar,) = lidars_at(loaded.slots, poses[0])
    for x in (2.5, 3.0, 4.0, 5.5):
        floor_m = 2.05 - 0.05 * (x - 1)  # through the roof's front edge at x = 2
        for apart_m in (0.02, 2e-6):  # the centres of two cuboids, one upon the other
            low, high = (x - 0.5, -0.5, floor_m - apart_m), (x + 0.5, 0.5, floor_m + apart_m)
            two = Region.from_boxes(low, high, (1, 1, apart_m))
            assert seen_cuboids(two, [lidar], loaded.visibility.sight([lidar])).ravel().tolist() == [False, True]


GROUPS = st.sampled_from(
    [
        (STEP, "cab", ("above", "front", "left", "right")),
        (STEP, "bed", ("above", "rear", "left", "right")),
        (ROUND, "ball", tuple(naive.OUT)),
        (TANK, "tank", tuple(naive.OUT)),
    ]
)


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(group=GROUPS, data=st.data())
def test_what_does_not_violate_is_on_the_surface(tmp_path_factory, group, data):
    """Any place, any size: what has no violation lies on its body, with all of its rim, and inside its box."""
    vehicle, body, sides = group
    side = data.draw(st.sampled_from(sides))
    upright = data.draw(st.booleans())
    radius = data.draw(st.floats(0.005, 0.3))
    text = on(body, side, (-2, -1, 0.2), (2, 1, 2), base_radius_m=radius, upright=upright, step_m=radius)
    loaded = study(tmp_path_factory.mktemp("any"), vehicle, text)
    poses = random(loaded, 100, data.draw(st.integers(0, 99)))
    fits = loaded.space.violation(poses) == 0
    assert (loaded.space.violation(loaded.space.midpoint[None]) == 0).all()
    out = np.array(naive.OUT[side])
    mount = np.tile(out, (100, 1)) if upright else up(poses[:, 0, 3:])
    base = poses[:, 0, :3] - 0.05 * mount
    assert (abs(_off(loaded, body, base[fits])) < 1e-9).all()
    for offset in naive.disc(side, radius)[1:]:
        under = base[fits] + offset
        lines = under[:, None] + np.linspace(-6, 6, 25)[:, None] * out  # the line of sight passes through the body
        assert (_off(loaded, body, lines.reshape(-1, 3)).reshape(-1, 25).min(axis=1) < 0.3).all()
    assert (loaded.vehicle.depth_m(poses[fits, 0, :3]) == 0).all()
    assert np.array_equal(
        np.concatenate([loaded.space.violation(one[None]) for one in poses[:20]]), loaded.space.violation(poses)[:20]
    )


def _off(loaded, body, points):
    """Signed distances to a body, from formulas."""
    scene = loaded.vehicle.scene.file
    (item,) = [one for one in (*scene.boxes, *scene.spheres, *scene.cylinders) if one.name == body]
    if body == "ball":
        return np.linalg.norm(points - item.center_m, axis=1) - item.radius_m
    if body == "tank":
        flat = np.hypot(*(points - item.base_m)[:, :2].T)
        up_m = points[:, 2] - item.base_m[2] - item.height_m / 2
        away = np.stack([flat - item.radius_m, abs(up_m) - item.height_m / 2], axis=1)
    else:
        away = abs(points - item.center_m) - np.array(item.size_m) / 2
    return np.linalg.norm(np.maximum(away, 0), axis=1) + np.minimum(away.max(axis=1), 0)


@pytest.mark.slow
def test_a_search_stays_on_the_surface(tmp_path):
    """On one thread or two: the same rig, and plain loops find its bases on the car."""
    groups = (
        "count: 2, roll_deg: [-10, 10], pitch_deg: [-10, 10], " + on("body", "above", (-1.3, -0.8, 1), (0.8, 0.8, 2)),
        "count: 2, mirror_y_m: 0, " + on("body", "left", (0.5, 0.5, 0.3), (2.2, 1.1, 1), upright=False, step_m=0.02),
    )
    loaded = study(tmp_path, CAR, *groups, more="solver: {method: abc, bees: 20, evaluations: 150}\n")
    found = [optimize(loaded, threads) for threads in (1, 2)]
    assert found[0].rig == found[1].rig
    poses = np.array([[*mount.position_m, *mount.rpy_rad] for mount in found[0].rig.mounts])
    assert loaded.space.violation(poses[None]).tolist() == [0]
    vertices, triangles = loaded.vehicle.scene.mesh()
    for pose, slot in zip(poses, loaded.slots, strict=True):
        surface = slot.surface
        mount = np.array(naive.OUT[surface.side]) if surface.upright else up(pose[3:])
        base = pose[:3] - 0.05 * mount
        corners = vertices[triangles]
        args = surface.radius_m, surface.step_m, surface.low_m, surface.high_m, surface.upright
        assert naive.sits(corners, [0] * len(corners), 0, surface.side, base, *args)


@pytest.mark.slow
def test_the_resolved_study_says_the_same(tmp_path):
    loaded = study(tmp_path, CAR, on("body", "left", (1.2, 0.5, 0.5), (2.1, 1.1, 0.8)) + ", yaw_deg: [0, 90]")
    again = tmp_path / "again.yaml"
    again.write_text(yaml.safe_dump(with_solver(loaded, seed=2).file))
    assert np.array_equal(random(load_study(again), 5), random(loaded, 5))


WALL = "on: {body: cab, from: above, within: {min_m: [0.2, -0.8, 1], max_m: [1.8, 0.8, 2.5]}, standoff_m: 0.05,\n     base_radius_m: 0.05, upright: false}"
BOUNDS = "min: {position_m: [0, 0, 0], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 1, 1], rpy_deg: [0, 0, 0]}"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("body: cab", "body: roof", "on.body: 'roof' is no body of the vehicle; allowed: cab, bed"),
        ("body: cab", "body: wing", "on.body: 'wing' is not closed; allowed: cab, bed"),
        ("body: cab", "body: skin", "on.body: 'skin' is not closed; allowed: cab, bed"),
        ("from: above", "from: below", "on.from: 'below' is not allowed; allowed: 'above', 'front', 'rear', 'left' or"),
        ("from: above", "fron: above", "on.fron: unknown key; did you mean from? allowed: body, from, within"),
        ("standoff_m: 0.05", "standoff_m: -1", "on.standoff_m: -1 is too small; allowed: at least 0.001"),
        ("base_radius_m: 0.05", "base_radius_m: 0", "on.base_radius_m: 0 is too small; allowed: above 0"),
        ("base_radius_m: 0.05", "base_radius_m: 1.1", "on.within: a base of 1.1 m in radius fits nowhere on what it"),
        ("base_radius_m: 0.05, ", "", "on: the housing of sensor 'fan-4' is not known; give base_radius_m"),
        ("-0.8, 1]", "-0.8, 2.2]", "on.within: holds nothing of 'cab' as seen from above"),
        ("-0.8, 1]", "0.9, 1]", "on.within.max_m[1]: 0.8 is below min_m's 0.9"),
        (
            "0.2, -0.8, 1], max_m: [1.8",
            "-1.8, -0.8, 0], max_m: [-0.2",
            "on.within: holds nothing of 'cab' as seen from",
        ),
        ("yaw_deg: [0, 9]", BOUNDS, "min: conflicts with on; give min and max, or on"),
        ("yaw_deg: [0, 9]", "yaw_deg: [9, 0]", "yaw_deg[1]: 0 is below 9; allowed: at or above it"),
        ("yaw_deg: [0, 9]", "roll_deg: [0, 9]", "roll_deg: goes with upright: true; this sensor's axis is the normal"),
        (WALL, BOUNDS, "yaw_deg: goes with on; otherwise min and max bound the angles"),
        (WALL, "count: 1", "min: missing; give min and max, or on"),
        (STEP, "", "on: needs the study's vehicle, and there is none"),
    ],
)
def test_what_is_not_allowed(tmp_path, old, new, says):
    """Every mistake is one line with file, line and key."""
    skin = tmp_path / "skin.obj"
    skin.write_text("v 0 0 3\nv 1 0 3\nv 0 1 3\nv 0 0 4\nf 1 2 3\nf 1 2 4\n")
    more = (
        f"  planes: [{{name: wing, center_m: [0, 0, 3], size_m: [1, 1]}}]\n  meshes: [{{name: skin, file: {skin}}}]\n"
    )
    text = f"{REGION}{STEP}{more if old != STEP else ''}sensors:\n  - {{model: fan-4, yaw_deg: [0, 9],\n     {WALL}}}\n"
    assert old in text
    path = tmp_path / "bad.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError) as error:
        load_study(path)
    line = str(error.value)
    assert re.match(rf"{path}:\d+:\d+: sensors\[0\].{re.escape(says)}", line)


def test_what_the_page_shows_of_a_roof(tmp_path):
    """By hand: where bases may be is the roof without a rim, less a cell; a base is a disc; off the roof is told."""
    keys = on("cab", "above", (0, -1, 1.9), (2, 1, 2.1)) + ", count: 2, name: cab, yaw_deg: [0, 90]"
    loaded = study(tmp_path, STEP, keys)
    cells = base_area_m(loaded)
    area = np.linalg.norm(np.cross(cells[:, 1] - cells[:, 0], cells[:, 3] - cells[:, 0]), axis=1).sum()
    assert 1.85**2 < area <= 1.9**2
    assert cells[..., 2] == pytest.approx(2.002)
    poses = loaded.space.poses(np.tile([0.2, 0.7, 0.5], (1, 2)))[0]
    rig = loaded.rig(poses)
    discs = base_discs_m(loaded, rig)
    size = np.linalg.norm(np.cross(discs[:, 1] - discs[:, 0], discs[:, 2] - discs[:, 0]), axis=1).sum() / 2
    assert size == pytest.approx(2 * math.pi * 0.05**2, rel=0.01)
    assert discs[:32].reshape(-1, 3).mean(axis=0) == pytest.approx([0.4, 0.4, 2.004], abs=1e-9)
    assert violations(loaded, rig) == []
    poses[0, 2] += 0.2
    poses[1, 5] += math.pi
    assert violations(loaded, loaded.rig(poses)) == [
        "cab_0: its base is not wholly on cab as seen from above",
        "cab_1: yaw 225.00° is outside 0 to 90°",
    ]
    other = study(
        tmp_path,
        STEP,
        "min: {position_m: [1, 0, 2.1], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 0, 2.1], rpy_deg: [0, 0, 0]}",
    )
    assert len(base_discs_m(loaded, other.rig(other.space.lower))) == 0
