"""Blind spots against similar triangles, areas by hand and plain loops."""

import math
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.placement.blind_spots import (
    AZIMUTHS,
    BISECTIONS,
    STEP_M,
    contour,
    directions,
    fraction_below,
    largest_m,
    looked_at,
    outline_m,
    seen_by_m3,
)
from lidarcfg.placement.evaluation import evaluate
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import load_study
from tests.naive import blind_spots as naive

ROOT = Path(__file__).parents[2]
REGION = Region.from_boxes((-30, -20, 0), (30, 20, 4), (1, 1, 0.5))
FINE = STEP_M / 2**BISECTIONS
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
SIDES = np.array([(a, *two) for a, b, c, d in FACES for two in ((b, c), (c, d))])


def box(low, high):
    """Vertices (8, 3) and triangles (12, 3)."""
    return np.array(low) + CORNERS * (np.array(high) - low), SIDES


def behind(origin, low, high):
    """Which points a box hides from an origin: the slab method, as on paper."""

    def seen(points):
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (np.stack([low, high])[:, None] - np.array(origin)) / (points - np.array(origin))
        enter, leave = np.fmin(*ends).max(axis=1), np.fmax(*ends).min(axis=1)
        return ~((enter < leave) & (enter < 1) & (leave > 0))

    return seen


def test_the_volumes_by_number_of_lidars_add_up_to_the_region():
    region = Region.from_boxes((0, 0, 0), (3, 2, 1), (1, 1, 0.5), (((2, 0, 0), (3, 1, 1)),))
    seen_by = np.zeros(region.shape, np.uint8)
    seen_by[0] = 2
    seen_by[1, 0] = 1
    # 10 cuboids of 0.5 m³ count: 4 seen by two, 2 by one, 4 by none
    assert seen_by_m3(region, seen_by, 3).tolist() == [2.0, 1.0, 2.0, 0.0]
    assert fraction_below(region, seen_by, 1) == 0.4
    assert fraction_below(region, seen_by, 2) == 0.6


def test_the_outline_of_a_box_from_a_point_inside():
    vertices, triangles = box((-2, -1, 0.2), (2, 1, 1.5))
    found = outline_m(np.array([0.5, 0.0]), vertices, triangles)
    assert found[[0, 90, 180, 270]] == pytest.approx([1.5, 1, 2.5, 1])
    for k in range(AZIMUTHS):
        a = math.radians(k)
        reach = min(
            (1.5 if math.cos(a) > 0 else 2.5) / max(abs(math.cos(a)), 1e-300), 1 / max(abs(math.sin(a)), 1e-300)
        )
        assert found[k] == pytest.approx(reach, rel=1e-12), k


def test_the_outline_of_any_triangles_is_the_plain_loops():
    rng = np.random.default_rng(4)
    for _ in range(20):
        vertices = rng.normal(size=(9, 3)) + np.array([rng.uniform(0, 3), 0, 0])
        triangles = rng.integers(0, 9, (6, 3))
        found = outline_m(np.array([0.1, 0.2]), vertices, triangles)
        for k in range(0, AZIMUTHS, 7):
            expected = naive.outline((0.1, 0.2), vertices[triangles].tolist(), math.radians(k))
            assert found[k] == pytest.approx(expected, abs=1e-9), k


@pytest.mark.parametrize("height_m", [0.25, 0.5, 1.0])
def test_a_roof_sensor_by_similar_triangles(height_m):
    """Half a metre above a roof 1.5 m high, the edge at r hides the level h out to r (2 − h) / 0.5."""
    vertices, triangles = box((-2, -1, 0), (2, 1, 1.5))
    around = directions(REGION, np.zeros(2), outline_m(np.zeros(2), vertices, triangles), height_m)
    found = contour(around, behind((0, 0, 2), (-2, -1, 0), (2, 1, 1.5)))
    expected = around.outline_m * ((2 - height_m) / 0.5 - 1)
    assert found.distance_m == pytest.approx(expected, abs=1.001 * FINE)
    assert (found.distance_m >= expected - 1e-9).all()
    assert not found.reaches_edge.any()
    assert found.largest_m == pytest.approx(expected.max(), abs=1.001 * FINE)
    assert found.largest_at_deg in (26, 27, 153, 154, 206, 207, 333, 334)  # next to a corner
    scale = ((2 - height_m) / 0.5) ** 2 - 1
    assert found.area_m2 == pytest.approx(8 * scale, rel=2e-3)  # the body's outline is 8 m²


def test_nothing_hidden_and_everything_hidden():
    around = directions(REGION, np.zeros(2), np.zeros(AZIMUTHS), 0.5)
    clear = contour(around, lambda points: np.ones(len(points), bool))
    assert (clear.distance_m == 0).all()
    assert (clear.largest_m, clear.area_m2) == (0, 0)
    dark = contour(around, lambda points: np.zeros(len(points), bool))
    assert dark.distance_m[[0, 90, 180, 270]] == pytest.approx([30, 20, 30, 20])
    assert dark.reaches_edge.all()
    assert dark.area_m2 == pytest.approx(60 * 40, rel=1e-3)


def test_a_gap_far_out_counts_and_what_is_excluded_does_not():
    region = Region.from_boxes((-10, -10, 0), (10, 10, 2), (1, 1, 1), (((6, -1, 0), (10, 1, 2)),))
    around = directions(region, np.zeros(2), np.zeros(AZIMUTHS), 0.5)
    found = contour(around, lambda points: (abs(points[:, 0]) < 4) | (abs(points[:, 0]) > 4.5))
    assert found.distance_m[[0, 180]] == pytest.approx(
        [4.5, 4.5], abs=1.001 * FINE
    )  # 4 to 4.5 m is blind, what is beyond is not
    beyond = contour(around, lambda points: points[:, 0] < 5.0)
    assert beyond.distance_m[0] == pytest.approx(6.0, abs=1.001 * FINE)
    assert beyond.reaches_edge[30]
    assert beyond.distance_m[180] == 0


def test_a_reference_point_beside_the_region():
    around = directions(REGION, np.array([40.0, 0.0]), np.zeros(AZIMUTHS), 0.5)
    found = contour(around, lambda points: points[:, 0] < 25)
    assert np.isnan(found.distance_m[[0, 90, 270]]).all()
    assert found.distance_m[180] == pytest.approx(15, abs=1.001 * FINE)  # x = 30 to 25 is blind


def random_box(rng):
    low = rng.uniform((-3, -2, 0), (0, 0, 0.5))
    return low, low + rng.uniform((1, 1, 0.3), (4, 3, 1.5))


def test_any_box_is_the_plain_loops():
    rng = np.random.default_rng(5)
    for _ in range(3):
        (low, high), origin = random_box(rng), rng.uniform((-4, -3, 0.2), (4, 3, 3))
        vertices, triangles = box(low, high)
        center = (low + high)[:2] / 2
        around = directions(REGION, center, outline_m(center, vertices, triangles), 0.5)
        found = contour(around, behind(origin, low, high))
        corners = vertices[triangles].tolist()
        eye = origin.tolist()

        def hidden(point, eye=eye, corners=corners):
            return any(naive.crosses(eye, point, one) for one in corners)

        for k in range(3, AZIMUTHS, 40):
            expected = naive.distance(
                center, math.radians(k), 0.5, around.start_m[k], around.end_m[k], around.step_m, hidden
            )
            assert found.distance_m[k] == pytest.approx(expected, abs=2 * FINE), k


def test_the_largest_distance_is_the_contours_and_ends_early_only_above_the_limit():
    rng = np.random.default_rng(6)
    for _ in range(10):
        (low, high), origin = random_box(rng), rng.uniform((-4, -3, 0.2), (4, 3, 3))
        seen = behind(origin, low, high)
        center = (low + high)[:2] / 2
        around = directions(REGION, center, outline_m(center, *box(low, high)), 0.5)
        points = looked_at(around)
        value, point = largest_m(around, points, seen)
        assert value == contour(around, seen).largest_m
        for limit in (0.0, value / 2, value, np.nextafter(value, 99), value + 1):
            for first in (np.empty(0, int), np.array([point]), np.array([0, 500, 900])):
                early, _ = largest_m(around, points, seen, limit, first)
                assert early == value or limit <= early <= value


BOXED = """
region: {{min_m: [-12, -8, 0], max_m: [12, 8, 3], cuboid_m: [1, 1, 0.5]}}
vehicle:
  boxes: [{{name: cab, center_m: [0, 0, 0.75], size_m: [4, 2, 1.5], exclude: true}}]
sensors:
  - {{elevation_deg: [-20, -8, 3, 12], count: 2, min: {{position_m: [-1.5, -0.9, 1.6], rpy_deg: [-20, -20, 0]}}, max: {{position_m: [1.5, 0.9, 2.2], rpy_deg: [20, 20, 0]}}}}
solver: {{method: {method}, {budget}, seed: 3}}
detection: [{{name: post, size_m: [0.5, 0.5, 1], on_ground: true}}]
objective: {objective}
"""


@pytest.fixture
def boxed(tmp_path):
    def make(objective="{}", method="abc, bees: 6", budget="cycles: 12"):
        path = tmp_path / "s.yaml"
        path.write_text(BOXED.format(objective=objective, method=method, budget=budget))
        return load_study(path)

    return make


def test_a_study_with_a_box_has_the_contours_of_similar_triangles(boxed):
    study = boxed()
    rig = study.rig(np.array([[0, 0, 2, 0, 0, 0]] * 2, float))
    found = evaluate(study, rig).blind
    assert [contour.directions.height_m for contour in found.contours] == [0.25, 0.5, 1.0]
    for one in found.contours:
        expected = one.directions.outline_m * ((2 - one.directions.height_m) / 0.5 - 1)
        inside = expected + one.directions.outline_m < one.directions.end_m
        assert inside.any()
        assert one.distance_m[inside] == pytest.approx(expected[inside], abs=1.001 * FINE)
        assert one.reaches_edge[~inside].all()
    assert found.seen_by_m3[1] == 0  # both sensors stand at one point
    assert found.seen_by_m3.sum() == pytest.approx(24 * 16 * 3 - 4 * 2 * 1.5)


def test_the_shadow_of_a_plate_has_the_volume_of_a_frustum(tmp_path):
    """From the origin a plate of 0.8 m × 0.6 m at x = 1 hides a frustum: ∫ 0.48 x² dx from 1 to 4 m is 10.08 m³."""
    text = """
region: {min_m: [0.2, -2, -2], max_m: [4, 2, 2], cuboid_m: [0.05, 0.05, 0.05]}
vehicle: {planes: [{name: plate, center_m: [1, 0, 0], size_m: [0.6, 0.8], rpy_deg: [0, 90, 0]}]}
objective: {max_vsr: 1}
sensors: [{elevation_deg: [0], min: {position_m: [0, 0, 0], rpy_deg: [0, 0, 0]}, max: {position_m: [0, 0, 0], rpy_deg: [0, 0, 0]}}]
"""
    (tmp_path / "p.yaml").write_text(text)
    study = load_study(tmp_path / "p.yaml")
    volume = evaluate(study, study.rig(study.poses(np.zeros((1, 0)))[0])).blind.seen_by_m3
    assert volume[0] == pytest.approx(0.48 * (4**3 - 1) / 3, rel=0.002)
    assert volume.sum() == pytest.approx(3.8 * 16)


def test_nothing_is_blind_where_nothing_limits_the_sight():
    study = load_study(ROOT / "data/studies/liu2018-2x4.yaml")
    found = evaluate(study, study.rig(study.poses(np.full((1, int(study.free.sum())), 0.5))[0])).blind
    assert found.contours == ()
    assert found.seen_by_m3[:2].tolist() == [0, 0]


OBJECTIVES = [
    "{blind_volume: 1}",
    "{seen_by_two: 1}",
    "{blind_spot_m: {height_m: 0.5}}",
    "{max_vsr: 1, blind_volume: 2, seen_by_two: 1, blind_spot_m: {height_m: 0.25, weight: 0.02}}",
    "{blind_spot_m: {height_m: 1.0, weight: 0.1}, detection: {post: 1}, inscribed_radius: 0.1}",
]


@pytest.mark.parametrize(
    ("objective", "method", "budget"),
    [
        *((one, "abc, bees: 6", "cycles: 4") for one in OBJECTIVES),
        (OBJECTIVES[0], "annealing", "evaluations: 220"),
        *(pytest.param(one, "annealing", "evaluations: 220", marks=pytest.mark.nightly) for one in OBJECTIVES[1:]),
    ],
)
def test_skipping_changes_no_search(boxed, objective, method, budget):
    study = boxed(objective, method, budget)
    runs = [optimize(study, threads=threads, skip=skip) for threads, skip in ((1, False), (1, True), (3, True))]
    for run in runs[1:]:
        assert run.rig == runs[0].rig
        assert run.objective == runs[0].objective
        assert [(c.best, c.mean) for c in run.history] == [(c.best, c.mean) for c in runs[0].history]
        assert (run.full_evaluations, run.cuboids) == (runs[1].full_evaluations, runs[1].cuboids)
        assert run.full_evaluations < runs[0].full_evaluations
    poses = np.array([[*mount.position_m, *mount.rpy_rad] for mount in runs[0].rig.mounts])
    assert study.cost(poses) == runs[0].objective


def test_the_objective_is_what_the_evaluation_says(boxed):
    study = boxed(OBJECTIVES[3])
    poses = study.poses(np.full((1, int(study.free.sum())), 0.3))[0]
    found = evaluate(study, study.rig(poses))
    part = found.blind.seen_by_m3 / found.blind.seen_by_m3.sum()
    expected = found.max_vsr_m + 2 * part[0] + part[:2].sum() + 0.02 * found.blind.contours[0].largest_m
    assert study.cost(poses) == pytest.approx(expected / 4.02, rel=1e-12)


def test_the_objectives_need_something_that_limits_the_sight(tmp_path):
    text = BOXED.format(objective="{max_vsr: 1, blind_volume: 2}", method="abc, bees: 6", budget="cycles: 2")
    (tmp_path / "s.yaml").write_text(text.replace("vehicle:\n  boxes:", "# "))
    with pytest.raises(ConfigError, match=r"s\.yaml:\d+:\d+: objective\.blind_volume: is the same for every rig"):
        load_study(tmp_path / "s.yaml")
