"""Visibility: shadows, ranges and fields of view by hand, and what they make of labels."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.search.optimize import optimize
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.mounting import lidars_at
from lidarcfg.vsr.cones import lidar, rig_lidars
from lidarcfg.vsr.metric import max_vsr, vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import BLIND, segment
from lidarcfg.vsr.visibility import Visibility
from lidarcfg.world import solids
from lidarcfg.world.meshes import box_mesh, lathe
from lidarcfg.world.scene_file import Box
from lidarcfg.world.vehicle import Solid
from tests import visibility_cases
from tests.naive import visibility as naive
from tests.ray_cases import mesh_scene
from tests.refusals import exchanged, refused
from tests.studies import study_of
from tests.visibility_cases import GOBLET, seen_cuboids

STUDY = """
region: {min_m: [0, 0, 0], max_m: [10, 4, 2], cuboid_m: [0.5, 0.5, 0.5]}
sensors:
  - {elevation_deg: [-20, 0, 20], min: {position_m: [1, 2, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 2, 1], rpy_deg: [0, 0, 0]}}
objective: {max_vsr: 1}
"""
PLATE = "vehicle: {boxes: [{name: plate, center_m: [4, 2, 1], size_m: [0.1, 1, 9]}]}\n"


def study(tmp_path, text):
    return study_of(tmp_path, text)


def at(loaded):
    """The rig at the lower bounds, and the centres (nx, ny, nz, 3)."""
    return loaded.rig(loaded.space.lower), np.stack(np.meshgrid(*loaded.region.centres(), indexing="ij"), axis=-1)


def test_without_its_keys_a_study_is_the_papers(tmp_path):
    loaded = study(tmp_path, STUDY)
    assert loaded.visibility is None
    off = "visibility: {range: false, field_of_view: false, occlusion: false}\n"
    assert study(tmp_path, STUDY + PLATE + off).visibility is None
    spaces = segment(loaded.region, lidars_at(loaded.slots, loaded.space.lower))
    assert (spaces.seen_by == 1).all()
    assert spaces.gap.min() == 0


def test_a_plates_shadow_by_similar_triangles(tmp_path):
    loaded = study(tmp_path, STUDY + PLATE)
    rig, centres = at(loaded)
    x, y = centres[..., 0], centres[..., 1]
    along = (x - 1) / np.where(x > 4, 4.05 - 1, np.inf)  # from the sensor to the plate's far side is 1
    by_hand = (x > 4) & (abs(y - 2) < 0.5 * along)
    assert by_hand.any()
    (seen,) = seen_cuboids(loaded.region, rig_lidars(rig), loaded.visibility.sight(rig_lidars(rig)))
    near = abs(abs(y - 2) - 0.5 * along) < 0.05  # the near side casts the wider shadow
    assert (seen == ~by_hand)[~near].all()
    spaces = segment(loaded.region, rig_lidars(rig), loaded.visibility)
    assert np.array_equal(spaces.seen_by, seen.astype(int))
    assert ((spaces.gap[spaces.label, 0] == BLIND) == ~seen).all()


def test_a_range_is_a_shell(tmp_path):
    loaded = study(tmp_path, STUDY.replace("20], min", "20], range_m: [1.5, 6], min"))
    rig, centres = at(loaded)
    assert rig.mounts[0].range_m == (1.5, 6)
    distance = np.linalg.norm(centres - (1, 2, 1), axis=-1)
    (seen,) = seen_cuboids(loaded.region, rig_lidars(rig), loaded.visibility.sight(rig_lidars(rig)))
    assert np.array_equal(seen, (distance >= 1.5) & (distance <= 6))


@pytest.mark.parametrize(("low", "high"), [(270, 90), (300, 20), (20, 300), (0, 180), (0, 360), (90.5, 91)])
def test_a_field_of_view_is_a_sector(tmp_path, low, high):
    text = STUDY.replace("20], min", f"20], azimuth_fov_deg: [{low}, {high}], min")
    text = text.replace("[1, 2, 1], rpy_deg: [0, 0, 0]", "[5, 2, 1], rpy_deg: [0, 0, 30]")
    loaded = study(tmp_path, text)
    rig, centres = at(loaded)
    clockwise = 30 - np.degrees(np.arctan2(centres[..., 1] - 2, centres[..., 0] - 5))
    width = (high - low) % 360 or 360
    (seen,) = seen_cuboids(loaded.region, rig_lidars(rig), loaded.visibility.sight(rig_lidars(rig)))
    assert np.array_equal(seen, (clockwise - low) % 360 <= width)


def test_the_catalogues_range_counts_as_soon_as_anything_limits_sight(tmp_path):
    text = STUDY.replace("elevation_deg: [-20, 0, 20]", "model: vlp-16").replace("10, 4, 2", "10, 4, 2")
    assert study(tmp_path, text).visibility is None
    for more, least in (("", 0.5), ("visibility: {range: false}\n", 0.0)):
        loaded = study(tmp_path, text + "vehicle: {spheres: [{name: far, center_m: [0, 0, 90], radius_m: 1}]}\n" + more)
        rig, centres = at(loaded)
        (seen,) = seen_cuboids(loaded.region, rig_lidars(rig), loaded.visibility.sight(rig_lidars(rig)))
        distance = np.linalg.norm(centres - (1, 2, 1), axis=-1)
        assert np.array_equal(seen, distance >= least)


def test_excluded_bodies_are_no_part_of_the_region(tmp_path):
    box = "vehicle: {boxes: [{name: car, center_m: [5, 2, 0], size_m: [4, 2, 2.2], exclude: true}]}\n"
    loaded = study(tmp_path, STUDY + box)
    _, centres = at(loaded)
    inside = (abs(centres - (5, 2, 0)) < (2, 1, 1.1)).all(axis=-1)
    assert np.array_equal(loaded.region.included, ~inside)
    with pytest.raises(ConfigError, match=r"vehicle\.planes\[0\]\.exclude: 'lid' is not closed.* 4 of its edges"):
        study(tmp_path, STUDY + "vehicle: {planes: [{name: lid, size_m: [1, 1], exclude: true}]}\n")


@pytest.mark.slow
def test_what_a_region_hidden_from_all_is(tmp_path):
    loaded = study(
        tmp_path,
        STUDY + "vehicle: {spheres: [{name: hood, center_m: [1, 2, 1], radius_m: 0.01}], allow_inside: true}\n",
    )
    rig, _ = at(loaded)
    spaces = segment(loaded.region, rig_lidars(rig), loaded.visibility)
    assert len(spaces) == 1
    assert spaces.gap.tolist() == [[BLIND]]
    assert spaces.seen_by.max() == 0
    found = evaluate(loaded, rig)
    assert found.max_vsr_m == pytest.approx(10 * 4 * 2 / (2 * (40 + 20 + 8)))
    assert found.worst[0].between_deg == [[None, None]]


@pytest.mark.slow
@pytest.mark.parametrize("skip", [True, False])
def test_a_search_sees_what_an_evaluation_sees(tmp_path, skip):
    text = STUDY.replace(
        "max: {position_m: [1, 2, 1], rpy_deg: [0, 0, 0]}",
        "max: {position_m: [3, 3, 2], rpy_deg: [20, 20, 0]}, count: 2",
    )
    text = text.replace("20], min", "20], range_m: [0.3, 5], azimuth_fov_deg: [300, 100], min")
    loaded = study(tmp_path, text + PLATE + "solver: {method: abc, bees: 8, cycles: 12, seed: 3}\n")
    found = optimize(loaded, threads=2, skip=skip)
    assert found.objective == max_vsr(loaded.region, rig_lidars(found.rig), loaded.visibility)
    assert found.objective == optimize(loaded, threads=1, skip=not skip).objective
    assert found.objective != max_vsr(loaded.region, rig_lidars(found.rig))


@pytest.mark.slow
@pytest.mark.parametrize("triangles", visibility_cases.SHARE)
def test_what_is_hidden_is_what_a_loop_over_all_triangles_says(triangles):
    """Sensors in bowls, under a table's edge, on surfaces and inside; segments that touch an edge may go either way."""
    pairs = {50_000: 100, 5_000: 3_000}.get(triangles, 10_000)  # tools/stress.py has more
    found = visibility_cases.compared(triangles, pairs, np.random.default_rng(triangles))
    assert found.pairs >= pairs
    assert found.wrong == 0


@pytest.mark.parametrize("seed", [0, 2, 4, 5])
def test_most_of_a_triangles_shadow_takes_no_segments(seed):
    """Fine cuboids in and beside the shadows of a few triangles, as the plain loop has them."""
    rng = np.random.default_rng(seed)
    vertices = rng.uniform((-1, -2, -2), (1, 2, 2), (12, 3))
    body = mesh_scene(vertices, np.arange(12).reshape(4, 3))
    region = Region.from_boxes((2, -2, -2), (8, 2, 2), (0.05, 0.25, 0.25))
    lidars = [lidar(np.array([-3, *rng.uniform(-1, 1, 2)]), np.zeros(3), np.zeros(1))]
    visibility = Visibility.of([body], region)
    (seen,) = seen_cuboids(region, lidars, visibility.sight(lidars))
    targets = np.stack(np.meshgrid(*region.centres(), indexing="ij"), axis=-1).reshape(-1, 3)
    hidden = np.empty(len(targets), bool)
    naive.hidden(vertices.reshape(4, 3, 3), lidars[0].position_m, targets, hidden)
    assert 0.02 < hidden.mean() < 0.98
    assert np.array_equal(seen.ravel(), ~hidden)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, 1, 3, 4, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (2, *range(5, 12)))]
)
def test_the_whole_pipeline_cuboid_by_cuboid(seed):
    """Labels, blind ones too, and max VSR, against asin, atan2 and breadth-first search, with bodies, ranges and fields."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(-4, -2, 3)
    edges = rng.uniform(0.5, 1, 3)
    shape = (9, 7, 6)
    high = low + np.array(shape) * edges
    region = Region(low, high, rng.random(shape) < 0.95)
    mesh = lathe(GOBLET * (1.5, 1.2), 9, tuple(rng.uniform(-1, 0, 3)))
    known = []
    plain = []
    for _ in range(rng.integers(1, 4)):
        position = rng.uniform(low, high)
        rpy = rng.uniform(-0.6, 0.6, 3)
        elevation_deg = np.sort(rng.uniform(-40, 40, 3))
        range_m = tuple(np.sort(rng.uniform(0, 7, 2))) if rng.random() < 0.7 else None
        fov_deg = tuple(rng.uniform(0, 360, 2)) if rng.random() < 0.7 else None
        one = lidar(position, rpy, np.sin(np.radians(elevation_deg)))
        known.append(replace(one, range_m=range_m, azimuth_fov=fov_deg and tuple(np.radians(fov_deg))))
        plain.append((position.tolist(), rpy.tolist(), elevation_deg.tolist(), range_m, fov_deg))
    visibility = Visibility.of([mesh_scene(*mesh)], region)
    spaces = segment(region, known, visibility)
    label, seen, worst = naive.subspaces(low, high, edges, region.included, plain, mesh[0][mesh[1]])
    assert np.array_equal(spaces.label, label)
    assert np.array_equal(seen_cuboids(region, known, visibility.sight(known)), np.array(seen) & region.included)
    assert np.array_equal(spaces.seen_by, np.sum(seen, axis=0) * region.included)
    assert vsr_m(spaces).max() == pytest.approx(worst, rel=1e-12)


CAR = "vehicle: {boxes: [{name: car, center_m: [5, 2, 0.5], size_m: [4, 2, 1]}]MORE}\n"


@pytest.mark.slow
def test_a_sensor_inside_a_body(tmp_path):
    """Refused where it is evaluated, never placed by a search, and told at once where the bounds leave no other place."""
    inside = STUDY.replace("[1, 2, 1]", "[5, 2, 0.5]")
    with pytest.raises(ConfigError, match=r"sensors\[0\]: every place within its bounds is inside the vehicle's 'car'"):
        study(tmp_path, inside + CAR.replace("MORE", ""))
    allowed = study(tmp_path, inside + CAR.replace("MORE", ", allow_inside: true"))
    rig, _ = at(allowed)
    assert (evaluate(allowed, rig).subspaces.seen_by == 1).sum() == 8 * 4 * 2  # the cuboids in the car
    outside = study(tmp_path, STUDY + CAR.replace("MORE", ""))
    with pytest.raises(ConfigError, match="lidar_0 is inside the vehicle's 'car'; move it, or set allow_inside: true"):
        evaluate(outside, rig)
    wide = STUDY.replace("max: {position_m: [1, 2, 1]", "count: 3, max: {position_m: [9, 3, 1.2]")
    loaded = study(tmp_path, wide.replace("[1, 2, 1]", "[1, 1, 0.1]") + CAR.replace("MORE", ""))
    rng = np.random.default_rng(1)
    poses = loaded.space.poses(rng.random((300, loaded.space.dimensions)))
    depth = np.minimum(poses[..., :3] - (3, 1, 0), (7, 3, 1) - poses[..., :3]).min(axis=-1)
    assert loaded.space.violation(poses) == pytest.approx(np.maximum(depth, 0).sum(axis=1))
    for mount in optimize(replace(loaded, solver=loaded.solver.model_copy(update={"evaluations": 300}))).rig.mounts:
        assert (np.minimum(mount.position_m - np.array((3, 1, 0)), (7, 3, 1) - np.array(mount.position_m)) <= 0).any()


def test_ground_hides_what_is_below_it_and_what_moves_hides_nothing(tmp_path):
    (tmp_path / "yard.yaml").write_text(
        "name: yard\nground: {z_m: 0.75, reflectivity: 10}\nboxes:\n"
        "  - {name: gate, center_m: [5, 2, 1], size_m: [0.1, 9, 9], reflectivity: 9, motion: {velocity_m_s: [1, 0, 0]}}\n"
    )
    loaded = study(tmp_path, STUDY + "surroundings: yard.yaml\n")
    rig, centres = at(loaded)
    (seen,) = seen_cuboids(loaded.region, rig_lidars(rig), loaded.visibility.sight(rig_lidars(rig)))
    assert np.array_equal(seen, centres[..., 2] >= 0.75)  # centres on the ground are seen
    assert loaded.file["surroundings"] == str(tmp_path / "yard.yaml")
    with pytest.raises(ConfigError, match=r"study\.yaml:6:1: surroundings: .*none\.yaml: no such file"):
        study(tmp_path, STUDY + "surroundings: none.yaml\n")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("20], min", "20], azimuth_fov_deg: [0, 361], min", "azimuth_fov_deg[1]: 361 is too large; allowed: at most 360"),
        ("20], min", "20], azimuth_fov_deg: [40, 40], min", "sensors[0].azimuth_fov_deg: 40 to 40 is empty"),
        ("20], min", "20], range_m: [5, 5], min", "sensors[0].range_m[0]: 5 is not below 5"),
        ("20], min", "20], range_m: [-1, 5], min", "sensors[0].range_m[0]: -1 is too small; allowed: at least 0"),
        ("region", "vehicle: {}\nregion", "vehicle: has no body; give some of boxes, spheres"),
        ("region", "vehicle: {boxes: [{name: a, size_m: [1, 1, 1], motion: {}}]}\nregion", "motion: a map is not allowed here"),
        ("region", "vehicle: {meshes: [{name: a, file: a.ply}]}\nregion", "vehicle.meshes[0].file: "),
        ("region", "vehicle: {boxes: [{name: a, center_m: [5, 2, 1], size_m: [99, 99, 99], exclude: true}]}\nregion", "vehicle: leaves no cuboid"),
        ("region", "visibility: {ranges: true}\nregion", "visibility.ranges: unknown key; did you mean range?"),
    ],
)  # fmt: skip
def test_refused(tmp_path, old, new, message):
    with refused(message, kind=ConfigError):
        study(tmp_path, exchanged(STUDY, old, new))


def test_points_inside_a_closed_mesh_by_its_convex_parts():
    """Two boxes that overlap, and a bowl whose hollow is outside; on a grid and one by one."""
    boxes = [
        box_mesh(Box(name="b", reflectivity=0, center_m=at, size_m=(2, 2, 2), yaw_deg=20))
        for at in ((0, 0, 0), (1, 0.5, 0))
    ]
    mesh = solids.merge_vertices(visibility_cases.join_meshes(boxes))
    assert not len(solids.open_edges(mesh))
    axes = np.linspace(-2, 3, 41), np.linspace(-2, 2, 31), np.linspace(-1.5, 1.5, 21)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    turn = np.radians(20)
    into = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    by_hand = np.zeros(len(points), bool)
    for centre in ((0, 0, 0), (1, 0.5, 0)):
        by_hand |= (abs((points - centre) @ into.T) < 1).all(axis=1)
    assert np.array_equal(solids.inside_points(solids.connected_components(mesh), points), by_hand)
    assert np.array_equal(solids.inside_grid(solids.connected_components(mesh), *axes).ravel(), by_hand)
    body = Solid("two", mesh[0].min(axis=0), mesh[0].max(axis=0), mesh)
    assert np.array_equal(body.inside(points), by_hand)
    assert body.contains_box(np.array([-0.55, -0.3, -0.9]), np.array([-0.35, 0.3, 0.9]))
    assert not body.contains_box(np.array([-0.55, -0.3, -0.9]), np.array([-0.35, 0.3, 1.1]))
    bowl = solids.merge_vertices(lathe(GOBLET, 400, (0.0, 0.0, 0.0)))
    hollow = np.array([[0, 0, 1.5], [0.5, 0, 1.6], [0, 0, 1.05], [0.65, 0, 1.25], [0.05, 0, 0.5], [0.3, 0, 0.5]])
    assert solids.inside_points(solids.connected_components(bowl), hollow).tolist() == [
        False,
        False,
        True,
        True,
        True,
        False,
    ]
    assert solids.contains_box(
        solids.connected_components(bowl), np.array([-0.05, -0.05, 0.4]), np.array([0.05, 0.05, 0.6])
    )
    assert not solids.contains_box(
        solids.connected_components(bowl), np.array([-0.05, -0.05, 0.4]), np.array([0.05, 0.05, 1.6])
    )
