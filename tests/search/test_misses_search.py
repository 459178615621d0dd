"""The search for fewest misses: the same however it is run, never worse than plain rigs, and of what it says it is of."""

import json
import math
from itertools import combinations

import numpy as np
import pytest

from lidarcfg.requirements.robustness import misplaced
from lidarcfg.search import misses_search
from lidarcfg.search.misses_search import NO_BETTER
from lidarcfg.search.optimize import optimize
from lidarcfg.search.plain_rigs import plain_points
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.objective_costs import ObjectiveCosts
from lidarcfg.study.study import with_solver
from lidarcfg.vsr.metric import max_vsr
from tests.studies import study_of

pytestmark = pytest.mark.slow

SENSOR = {
    "name": "turns",
    "beams": {"elevation_deg": [-48, -40, -33, -26, -20, -15, -11, -7, -3, 0]},
    "firing": {"step_deg": 2.5},
    "range": {"min_m": 0.5, "max_m": 8},
}
STUDY = """region: {min_m: [-6, -6, 0], max_m: [6, 6, 3], cuboid_m: [1, 1, 0.5]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.8], size_m: [3, 1.6, 1]}]}
sensors:
  - {name: a, model: turns.yaml, min: {position_m: [-1, -0.6, 1.4], rpy_deg: [-20, -20, 0]}, max: {position_m: [1, 0.6, 1.8], rpy_deg: [20, 20, 0]}}
  - {name: b, model: turns.yaml, min: {position_m: [1.6, -0.6, 0.5], rpy_deg: [-20, -20, 0]}, max: {position_m: [1.9, 0.6, 1], rpy_deg: [20, 20, 0]}}
solver: {method: auto, evaluations: 120, seed: 2}
"""
MISSES = "objective: {misses: {objects: {post: 2, tyre: 1}, within_m: [0.1, 5]}}\n"


def study(folder, more=MISSES, text=STUDY):
    (folder / "turns.yaml").write_text(json.dumps(SENSOR))
    return study_of(folder, text + more)


def doubled_soon(monkeypatch, every=2):
    monkeypatch.setattr(misses_search, "DOUBLED_EVERY", every)


def random_poses(loaded, count, seed=6):
    return loaded.space.poses(np.random.default_rng(seed).random((count, loaded.space.dimensions)))


def same(one, other):
    assert one.rig == other.rig
    assert one.objective == other.objective
    assert one.believed.objective == other.believed.objective
    assert one.believed.places == other.believed.places
    assert one.evaluations == other.evaluations


def test_threads_and_skipping_change_nothing(tmp_path, monkeypatch):
    doubled_soon(monkeypatch)
    loaded = study(tmp_path)
    one = optimize(loaded, threads=1)
    for other in (optimize(loaded, threads=1), optimize(loaded, threads=2)):
        same(one, other)
        np.testing.assert_array_equal(one.log.cost, other.log.cost)
    every = optimize(loaded, threads=2, skip=False)
    same(one, every)
    assert np.isfinite(every.log.cost).all()
    assert not np.isfinite(one.log.cost).all()
    assert one.believed.places > 64  # so that all of this is across a change of places


@pytest.mark.parametrize("broken_at", [10, 50])
def test_a_resumed_search_ends_as_an_unbroken_one(tmp_path, monkeypatch, broken_at):
    doubled_soon(monkeypatch)
    loaded = study(tmp_path)
    whole = optimize(loaded, threads=1)
    begun = optimize(with_solver(loaded, evaluations=broken_at), threads=1)
    assert len(begun.log.cost) < len(whole.log.cost)
    resumed = optimize(loaded, threads=1, log=begun.log)
    same(whole, resumed)
    np.testing.assert_array_equal(whole.log.cost, resumed.log.cost)


def test_places_double_while_they_do_not_tell_rigs_apart(tmp_path, monkeypatch):
    """And what it believes of its best rig is what is missed there; the result's value is that at fresh places."""
    loaded = study(tmp_path)
    doubled_soon(monkeypatch, 10**6)
    assert optimize(loaded).believed.places == 1024  # the best of the last rigs is chosen there
    doubled_soon(monkeypatch)
    found = optimize(loaded)
    assert found.believed.places in (1024, 2048, 4096)
    assert found.remarks == ()
    known = loaded.misses.known(found.believed.places)
    assert found.believed.objective == pytest.approx(loaded.misses.found_at(known, found.rig.mounts).mean, rel=1e-12)
    assert found.objective == pytest.approx(loaded.misses.found(found.rig.mounts).mean, rel=1e-12)
    assert found.evaluation.misses.mean == pytest.approx(found.objective, rel=1e-12)
    assert len(found.evaluation.misses.objects[0].places) == 4096


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_result_is_worse_than_the_best_plain_rigs(tmp_path, seed):
    """Those that miss least at the places of the search, by all plain rigs one by one."""
    loaded = with_solver(study(tmp_path), seed=seed, evaluations=30)
    found = optimize(loaded)
    mounts = [loaded.rig(poses).mounts for poses in loaded.space.poses(plain_points(loaded))]
    known = loaded.misses.known(64)
    searched = [loaded.misses.found_at(known, one).mean for one in mounts]
    best = np.argsort(searched, kind="stable")[:4]
    fresh = [loaded.misses.found(mounts[n]).mean for n in best]
    assert found.believed.plain.objective == pytest.approx(min(fresh), rel=1e-12)
    assert found.objective <= min(fresh) * (1 + 1e-12)
    assert found.believed.midpoint.mean == pytest.approx(
        loaded.misses.found(loaded.rig(loaded.space.midpoint).mounts).mean, rel=1e-12
    )


FLAT = """region: {min_m: [-6, -6, 0], max_m: [6, 6, 3], cuboid_m: [1, 1, 0.5]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.5], size_m: [0.4, 0.4, 1]}]}
sensors:
  - {name: a, model: turns.yaml, min: {position_m: [0, 0, 1.4], rpy_deg: [-20, -20, 0]}, max: {position_m: [0, 0, 1.4], rpy_deg: [20, 20, 0]}}
solver: {method: auto, evaluations: 60, seed: 2}
"""


def test_where_a_plain_rig_is_the_best_it_is_the_result(tmp_path, monkeypatch):
    """A sensor over the middle of a small body is best upright. A search at few places finds tilts that suit these."""
    monkeypatch.setattr(misses_search, "SEARCH_PLACES", 8)
    monkeypatch.setattr(misses_search, "CHOSEN_AT", 8)
    doubled_soon(monkeypatch, 10**6)
    loaded = study(tmp_path, "objective: {misses: {objects: {tyre: 1}, within_m: [0.1, 7]}}\n", FLAT)
    found = optimize(loaded)
    assert found.remarks == (NO_BETTER,)
    assert found.rig.mounts[0].rpy_rad == (0, 0, 0)
    assert found.rig.mounts[0].position_m == (0, 0, 1.4)
    assert found.objective == pytest.approx(loaded.misses.found(found.rig.mounts).mean, rel=1e-12)
    known = loaded.misses.known(8)
    upright = loaded.misses.found_at(known, found.rig.mounts).mean
    assert found.believed.objective < upright  # it believed in another rig
    assert found.rig == found.believed.plain.rig


def test_with_failures_the_worst_rig_that_is_left_counts(tmp_path):
    """By the misses of each rig of fewer sensors; in full, and by the search's evaluator."""
    loaded = study(tmp_path, MISSES + "robust: {lost: 1}\n")
    poses = random_poses(loaded, 3)
    known = loaded.misses.known(64)
    wanted = []
    for row in poses:
        mounts = loaded.rig(row).mounts
        left = [list(kept) for kept in combinations(mounts, len(mounts) - 1)]
        assert objective_of(loaded, row) == pytest.approx(max(loaded.misses.found(one).mean for one in left), rel=1e-12)
        wanted.append(max(loaded.misses.found_at(known, one).mean for one in left))
    with ObjectiveCosts(loaded) as objective:
        costs = objective.costs(poses, np.zeros(3, np.int64), poses[:1], np.full(3, math.inf))
    np.testing.assert_allclose(costs, wanted, rtol=1e-12)


def test_with_mounting_errors_the_quantile_of_the_draws_counts(tmp_path):
    """The third least of four, by the misses of each drawn rig."""
    loaded = study(
        tmp_path, MISSES + "robust: {position_sigma_m: 0.05, angle_sigma_deg: 3, samples: 4, quantile: 0.75}\n"
    )
    for row in random_poses(loaded, 2):
        mounts = loaded.rig(row).mounts
        drawn = [loaded.misses.found(misplaced(mounts, errors)).mean for errors in loaded.robust.errors(2)]
        assert len(set(drawn)) == 4
        assert objective_of(loaded, row) == pytest.approx(sorted(drawn)[2], rel=1e-9)


def tilt_deg(rpy_rad):
    """Of the sensor's axis: cos(roll) cos(pitch) is its upward part."""
    return math.degrees(math.acos(math.cos(rpy_rad[0]) * math.cos(rpy_rad[1])))


def test_a_rig_that_breaks_a_constraint_never_wins(tmp_path, monkeypatch):
    """Though without constraints a rig that breaks them does."""
    doubled_soon(monkeypatch)
    free = optimize(study(tmp_path)).rig
    apart_m = math.dist(*(one.position_m for one in free.mounts)) + 0.05
    most_deg = 10
    loaded = study(tmp_path, MISSES + f"constraints: {{max_tilt_deg: {most_deg}, min_distance_m: {apart_m}}}\n")
    found = optimize(loaded)
    rigs = [found.rig, found.believed.plain.rig] if found.believed.plain else [found.rig]
    for rig in rigs:
        assert max(tilt_deg(one.rpy_rad) for one in rig.mounts) < most_deg + 1e-6
        assert math.dist(*(one.position_m for one in rig.mounts)) > apart_m - 1e-9


def test_misses_and_max_vsr_are_mixed_by_weight(tmp_path):
    """The mean of misses, thrice, and of max VSR in metres, once; a search reports the same at fresh places."""
    mixed = "objective: {misses: {objects: {post: 2, tyre: 1}, within_m: [0.1, 5], weight: 3}, max_vsr: 1}\n"
    loaded = with_solver(study(tmp_path, mixed), evaluations=20)
    found = optimize(loaded)
    for row in (*random_poses(loaded, 2), np.array([(*m.position_m, *m.rpy_rad) for m in found.rig.mounts])):
        missed = loaded.misses.found(loaded.rig(row).mounts).mean
        gaps_m = max_vsr(loaded.region, lidars_at(loaded.slots, row), loaded.visibility)
        assert objective_of(loaded, row) == pytest.approx((3 * missed + gaps_m) / 4, rel=1e-12)
    assert found.objective == pytest.approx((3 * missed + gaps_m) / 4, rel=1e-9)


def test_misses_are_minimised_where_a_study_has_a_vehicle_and_says_nothing(tmp_path):
    """By the file as it is resolved: six objects, fewer than three returns, up to 20 m; max VSR without a vehicle."""
    plain = study(tmp_path, "")
    assert plain.objective.is_misses
    assert {one.name: one.weight for one in plain.misses.objects} == dict.fromkeys(
        ("pedestrian", "child", "cyclist", "tyre", "post", "dog"), 1
    )
    assert (plain.misses.returns, plain.misses.within_m) == (3, (0.1, 20.0))
    without = STUDY.replace(STUDY.splitlines()[1] + "\n", "")
    assert study(tmp_path, "", without).is_max_vsr
