"""Volumes by the number of LiDARs that see them, against volumes by hand; and searches that minimise what is unseen."""

from pathlib import Path

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.search.optimize import optimize
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.visibility import fraction_below, seen_by_m3

ROOT = Path(__file__).parents[2]


def test_the_volumes_by_number_of_lidars_add_up_to_the_region():
    region = Region.from_boxes((0, 0, 0), (3, 2, 1), (1, 1, 0.5), (((2, 0, 0), (3, 1, 1)),))
    seen_by = np.zeros(region.shape, np.uint8)
    seen_by[0] = 2
    seen_by[1, 0] = 1
    # 10 cuboids of 0.5 m³ count: 4 seen by two, 2 by one, 4 by none
    assert seen_by_m3(region, seen_by, 3).tolist() == [2.0, 1.0, 2.0, 0.0]
    assert fraction_below(region, seen_by, 1) == 0.4
    assert fraction_below(region, seen_by, 2) == 0.6


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
    def make(objective, method="abc", budget="bees: 6, cycles: 12"):
        path = tmp_path / "s.yaml"
        path.write_text(BOXED.format(objective=objective, method=method, budget=budget))
        return load_study(path)

    return make


@pytest.mark.slow
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
    volume = evaluate(study, study.rig(study.space.poses(np.zeros((1, 0)))[0])).seen_by_m3
    assert volume[0] == pytest.approx(0.48 * (4**3 - 1) / 3, rel=0.002)
    assert volume.sum() == pytest.approx(3.8 * 16)


def test_nothing_is_blind_where_nothing_limits_the_sight():
    study = load_study(ROOT / "data/studies/liu2018-2x4.yaml")
    found = evaluate(study, study.rig(study.space.poses(np.full((1, study.space.dimensions), 0.5))[0]))
    assert found.seen_by_m3[:2].tolist() == [0, 0]


OBJECTIVES = [
    "{blind_volume: 1}",
    "{seen_by_two: 1}",
    "{max_vsr: 1, blind_volume: 2, seen_by_two: 1}",
    "{seen_by_two: 1, detection: {post: 1}, inscribed_radius: 0.1}",
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("objective", "method", "budget"),
    [
        *((one, "abc", "bees: 6, cycles: 4") for one in OBJECTIVES),
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
    assert objective_of(study, poses) == runs[0].objective


@pytest.mark.slow
def test_the_objective_is_what_the_evaluation_says(boxed):
    study = boxed(OBJECTIVES[2])
    poses = study.space.poses(np.full((1, study.space.dimensions), 0.3))[0]
    found = evaluate(study, study.rig(poses))
    part = found.seen_by_m3 / found.seen_by_m3.sum()
    expected = found.max_vsr_m + 2 * part[0] + part[:2].sum()
    assert objective_of(study, poses) == pytest.approx(expected / 4, rel=1e-12)


def test_the_objectives_need_something_that_limits_the_sight(tmp_path):
    text = BOXED.format(objective="{max_vsr: 1, blind_volume: 2}", method="abc", budget="bees: 6, cycles: 2")
    (tmp_path / "s.yaml").write_text(text.replace("vehicle:\n  boxes:", "# "))
    with pytest.raises(ConfigError, match=r"s\.yaml:\d+:\d+: objective\.blind_volume: is the same for every rig"):
        load_study(tmp_path / "s.yaml")


def test_the_blind_spots_distance_is_no_term_and_the_error_names_what_to_do(boxed):
    with pytest.raises(
        ConfigError, match=r"objective\.blind_spot_m: no longer a key; ask for posts or a shadow under `requ"
    ):
        boxed("{blind_spot_m: {height_m: 0.5}}")
