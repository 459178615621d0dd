"""LiDARs that fail, mounting errors and zones: against loops over all of them, and with and without skipping."""

import json
import math
import weakref
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.report.evaluation import lost_table
from lidarcfg.requirements.robustness import Robust, mounted
from lidarcfg.search.optimize import optimize
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.evaluation import changes_m, robustness
from lidarcfg.study.loading import load_study
from lidarcfg.study.objective_costs import rigs_of_trial
from lidarcfg.study.study import with_solver
from lidarcfg.study.zones import weights
from lidarcfg.vsr.subspaces import Links
from tests.naive import robust as naive
from tests.naive import vsr as naive_vsr
from tests.refusals import refused
from tests.studies import study_of

STUDY = """
region: {min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 0.5, 0.25], exclude: [{min_m: [5, 3, 0], max_m: [7, 5, 3]}]}
sensors:
  - {name: a, elevation_deg: [-20, -8, 3, 12], min: {position_m: [5, 3, 1], rpy_deg: [-40, -40, 0]}, max: {position_m: [7, 5, 2.5], rpy_deg: [40, 80, 0]}}
  - {name: b, elevation_deg: [-15, 0, 15], mirror_y_m: 4, count: 2, min: {position_m: [5, 4.5, 1], rpy_deg: [-40, -40, 0]}, max: {position_m: [7, 5, 2.5], rpy_deg: [40, 40, 90]}}
solver: {method: abc, bees: 10, cycles: 12, seed: 3}
"""
REGION = (0, 0, 0), (12, 8, 3), (1, 0.5, 0.25), [((5, 3, 0), (7, 5, 3))]
FRONT = (7.5, 0, 0), (13, 8, 1.1)
ZONES = "zones: [{name: front, min_m: [7.5, 0, 0], max_m: [13, 8, 1.1], weight: 2.5}]\n"
OBJECTS = "detection: [{name: box, size_m: [1, 0.5, 0.5]}]\n"
TOLERANCES = "robust: {position_sigma_m: 0.05, angle_sigma_deg: 2, samples: 5, quantile: 0.7}\n"
BOTH = "robust: {lost: 2, position_sigma_m: 0.05, angle_sigma_deg: 2, samples: 5, quantile: 0.7}\n"
BODY = "vehicle: {allow_inside: true, boxes: [{name: body, center_m: [6, 4, 0.6], size_m: [1.5, 1.5, 1.2]}]}\n"


def study(tmp_path, more="", text=STUDY):
    return study_of(tmp_path, text + more)


def lidars(loaded, poses):
    """As the plain loops take them."""
    return [
        (row[:3], naive_vsr.matrix(row[3:]), sorted(slot.sensor.beams.elevation_deg))
        for row, slot in zip(poses.tolist(), loaded.slots, strict=True)
    ]


def random_poses(loaded, count, seed):
    return loaded.space.poses(np.random.default_rng(seed).random((count, loaded.space.dimensions)))


@pytest.mark.parametrize("zones", [(), ((*FRONT, 2.5),)])
@pytest.mark.parametrize("lost", [1, 2])
def test_cost_without_lidars_is_that_of_the_worst_subset(tmp_path, lost, zones):
    loaded = study(tmp_path, f"robust: {{lost: {lost}}}\n" + ZONES * len(zones))
    for poses in random_poses(loaded, 3, lost):
        assert math.isclose(
            objective_of(loaded, poses), naive.without(REGION, lidars(loaded, poses), lost, zones), rel_tol=1e-12
        )


@pytest.mark.parametrize("fraction", [0.2, 0.7, 1.0])
def test_cost_with_mounting_errors_is_the_quantile_of_the_draws(tmp_path, fraction):
    loaded = study(tmp_path, TOLERANCES.replace("0.7", f"{fraction}"))
    draws = loaded.robust.errors(3).tolist()
    for poses in random_poses(loaded, 2, 5):
        expected = naive.quantile(REGION, lidars(loaded, poses), draws, fraction)
        assert math.isclose(objective_of(loaded, poses), expected, rel_tol=1e-12)


def test_of_both_the_larger_counts(tmp_path):
    both, lost, off = (study(tmp_path, more) for more in (BOTH, "robust: {lost: 2}\n", TOLERANCES))
    for poses in random_poses(both, 3, 7):
        assert objective_of(both, poses) == max(objective_of(lost, poses), objective_of(off, poses))


MAX_VSR = [
    "robust: {lost: 1}\n",
    "robust: {lost: 2}\n" + ZONES,
    TOLERANCES,
    BOTH + ZONES + BODY + "objective: {max_vsr: 1}\n",
    ZONES,
]
WEIGHTED = [
    "robust: {lost: 1}\nobjective: {max_vsr: 1, inscribed_radius: 0.2, detection: {box: 0.1}}\n" + OBJECTS,
    BOTH + ZONES + "objective: {max_vsr: 1, detection: {box: 0.5}}\n" + OBJECTS,
    "robust: {lost: 1}\n" + BODY + "objective: {blind_volume: 1, seen_by_two: 0.5}\n",
]


@pytest.mark.slow
@pytest.mark.parametrize(("method", "more"), [*product(["abc", "annealing"], MAX_VSR), *product(["abc"], WEIGHTED)])
def test_skipping_changes_nothing(tmp_path, method, more):
    loaded = study(tmp_path, more)
    loaded = with_solver(loaded, method=method, **({"evaluations": 300} if method == "annealing" else {"cycles": 4}))
    runs = [optimize(loaded, threads=threads, skip=skip) for threads, skip in ((1, False), (2, True))]
    assert runs[1].rig == runs[0].rig
    assert [(c.cycle, c.best, c.mean) for c in runs[1].history] == [(c.cycle, c.best, c.mean) for c in runs[0].history]
    asked = runs[0].evaluations + runs[0].first_evaluations + runs[0].scout_evaluations
    assert runs[0].full_evaluations == asked * rigs_of_trial(loaded)
    assert runs[1].full_evaluations < runs[0].full_evaluations
    poses = np.array([[*mount.position_m, *mount.rpy_rad] for mount in runs[0].rig.mounts])
    assert objective_of(loaded, poses) == runs[0].objective


MODELS = """
region: {min_m: [-8, -6, 0], max_m: [8, 6, 2], cuboid_m: [1, 1, 0.5]}
sensors:
  - {name: a, model: vlp-16, min: {position_m: [-1, -1, 1.7], rpy_deg: [-10, -10, 0]}, max: {position_m: [1, 1, 2], rpy_deg: [10, 10, 90]}}
  - {name: b, model: hdl-32e, azimuth_fov_deg: [270, 90], min: {position_m: [2, -1, 0.5], rpy_deg: [-10, -10, 0]}, max: {position_m: [2, 1, 0.8], rpy_deg: [10, 10, 0]}}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.8], size_m: [3.8, 1.8, 1.6], exclude: true}]}
detection: [{name: post, size_m: [0.3, 0.2, 1], returns: 12, step_m: 4, headings_deg: [0]}]
objective: {max_vsr: 1, detection: {post: 1}}
robust: {lost: 1}
solver: {method: annealing, evaluations: 60}
"""


def test_what_is_left_of_different_models_detects_by_its_own_returns(tmp_path):
    """The cost of two with one lost is that of the worse one alone, in a study of its own."""
    path = tmp_path / "s.yaml"
    path.write_text(MODELS)
    loaded = load_study(path)
    alone = []
    for name in "ab":
        rows = [line for line in MODELS.splitlines() if f"name: {name}," not in line and "robust" not in line]
        path.write_text("\n".join(rows))
        alone.append(load_study(path))
    for poses in random_poses(loaded, 3, 1):
        assert objective_of(loaded, poses) == max(objective_of(alone[0], poses[1:]), objective_of(alone[1], poses[:1]))
    runs = [optimize(loaded, skip=skip) for skip in (False, True)]
    assert runs[0].rig == runs[1].rig
    assert runs[0].objective == runs[1].objective


def test_a_zone_of_weight_one_is_no_zone(tmp_path):
    everything = "zones: [{name: all, min_m: [0, 0, 0], max_m: [12, 8, 3]}]\n"
    zoned, plain = (optimize(study(tmp_path, more)) for more in (everything, ""))
    assert zoned.rig == plain.rig
    assert [(c.best, c.mean) for c in zoned.history] == [(c.best, c.mean) for c in plain.history]


def test_weights_are_those_of_the_zones_around_each_centre_in_a_byte_a_cuboid(tmp_path):
    """Some weigh less than what is in no zone, some overlap; by a loop over cuboids and zones."""
    boxes = [((0, 0, 0), (6, 8, 2), 0.5), ((4, 2, 1), (9, 6, 3), 3), ((5.5, 0, 0), (8, 4, 3), 0.25), (*FRONT, 3)]
    keys = ("name", "min_m", "max_m", "weight")
    zones = [dict(zip(keys, (f"z{i}", *map(list, box[:2]), box[2]), strict=True)) for i, box in enumerate(boxes)]
    loaded = study(tmp_path, f"zones: {json.dumps(zones)}\n")
    found = weights(loaded.zones, loaded.region)
    assert found.number.nbytes == loaded.region.included.size
    centres = np.stack(np.meshgrid(*loaded.region.centres(), indexing="ij"), axis=-1)
    for index in np.ndindex(loaded.region.shape):
        here = [w for low, high, w in boxes if (low <= centres[index]).all() and (centres[index] < high).all()]
        counts = loaded.region.included[index]
        assert found.number[index] == (1 + found.level.tolist().index(max(here, default=1)) if counts else 0)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_thread_holds_the_subspaces_of_one_case_at_a_time(tmp_path, monkeypatch, threads):
    """Three rigs may be left of three LiDARs; how many Subspaces there are, by weak references to all that were made."""
    loaded = study(tmp_path, OBJECTS + "objective: {detection: {box: 1}}\nrobust: {lost: 1}\n")
    made = []
    most = []
    of = Links.subspaces

    def noted(links, kept):
        found = of(links, kept)
        made.append(weakref.ref(found))
        most.append(sum(one() is not None for one in made))
        return found

    monkeypatch.setattr(Links, "subspaces", noted)
    optimize(with_solver(loaded, cycles=1), threads=threads, skip=False)
    assert len(made) >= 3 * 10
    assert max(most) <= threads


@pytest.mark.parametrize(("more", "own"), [("", False), ("robust: {lost: 1}\n", False), (ZONES, True)])
def test_the_table_of_failures_has_the_objective_where_it_is_another(tmp_path, more, own):
    loaded = study(tmp_path, more)
    found = robustness(loaded, loaded.rig(loaded.space.midpoint))
    table = lost_table(found, loaded)
    assert ("objective" in [column.head for column in table.columns]) == own
    for row, left in zip(table.texts, (found.whole, *found.without), strict=True):
        worth = max((zone.weight * zone.max_vsr_m for zone in left.zones), default=left.max_vsr_m)
        assert row[-1] == f"{worth:.6f}" if own else left.objective == worth


@pytest.mark.parametrize("more", ["", ZONES + OBJECTS + "objective: {detection: {box: 1}}\n"])
def test_what_failures_and_mounting_errors_do(tmp_path, more):
    """Rigs evaluated one by one, by loops over all cuboids."""
    loaded = study(tmp_path, more)
    poses = random_poses(loaded, 1, 4)[0]
    found = robustness(loaded, loaded.rig(poses))
    beams = lidars(loaded, poses)
    rigs = [beams, *([*beams[:i], *beams[i + 1 :]] for i in range(3))]
    for left, kept in zip((found.whole, *found.without), rigs, strict=True):
        assert left.max_vsr_m == pytest.approx(naive.max_vsr(REGION, kept), rel=1e-12)
        if more:
            assert left.zones[0].max_vsr_m == pytest.approx(naive.zone_max_vsr(REGION, kept, *FRONT), rel=1e-12)
            assert left.zones[1].name == "elsewhere"
        else:
            assert left.objective == left.max_vsr_m
    assert [left.lost for left in (found.whole, *found.without)] == [None, "a", "b_0", "b_1"]
    assert found.worst.max_vsr_m == max(left.max_vsr_m for left in found.without)
    changes = changes_m(loaded, loaded.rig(poses), 0.1, 2)
    for lidar, axis, offset in ((0, 0, 0), (0, 3, 3), (1, 2, 1), (2, 4, 2), (1, 5, 3)):
        moved = poses.copy()
        moved[lidar, axis] += (-5, -1, 1, 5)[offset] * (0.1 if axis < 3 else math.radians(2))
        change = naive.max_vsr(REGION, lidars(loaded, moved)) - naive.max_vsr(REGION, beams)
        assert changes[lidar, axis, offset] == pytest.approx(change, abs=1e-12)
    line = replace(found, change_m=np.multiply.outer(found.change_m[:, :, 0], (-5, -1, 1, 5)))
    assert line.slope_m == pytest.approx(found.change_m[:, :, 0])
    assert line.largest_m(True) == pytest.approx(5 * np.abs(found.change_m[:, 3:, 0]).max())


def test_a_rig_of_one_lidar_and_a_large_region(tmp_path):
    loaded = study(tmp_path)
    rig = loaded.rig(random_poses(loaded, 1, 4)[0])
    alone = robustness(loaded, replace(rig, mounts=rig.mounts[:1]))
    assert (alone.without, alone.worst) == ((), None)
    fine = study(tmp_path, text=STUDY.replace("[1, 0.5, 0.25]", "[0.05, 0.05, 0.05]"))
    assert robustness(fine, rig) is None


def test_draws_are_normal_and_each_lidars_own():
    robust = Robust(position_sigma_m=0.02, angle_sigma_deg=0.5, samples=1000)
    errors = robust.errors(4)
    sigma = np.repeat([0.02, math.radians(0.5)], 3)
    assert np.abs(errors.mean(axis=0) / sigma).max() < 5 / math.sqrt(1000)
    assert np.abs(errors.std(axis=0) / sigma - 1).max() < 5 / math.sqrt(2000)
    correlation = np.corrcoef(errors.reshape(1000, -1).T) - np.eye(24)
    assert np.abs(correlation).max() < 5 / math.sqrt(1000)
    assert (replace_samples(robust, 10).errors(2) == errors[:10, :2]).all()


def replace_samples(robust, samples):
    return Robust(position_sigma_m=robust.position_sigma_m, angle_sigma_deg=robust.angle_sigma_deg, samples=samples)


@pytest.mark.parametrize("rpy_deg", [(0, 0, 0), (30, -80, 170), (10, 90, 40), (0, -90, 0), (180, 0, 90)])
def test_a_lidar_turns_about_its_own_axes(rpy_deg):
    pose = np.array([[1, 2, 3, *np.radians(rpy_deg)]])
    error = np.array([[0.1, 0.2, 0.3, 0.01, -0.02, 0.03]])
    moved = mounted(pose, error)[0]
    expected = naive_vsr.times(naive_vsr.matrix(pose[0, 3:]), naive_vsr.matrix(error[0, 3:]))
    assert moved[:3].tolist() == pytest.approx([1.1, 2.2, 3.3])
    assert np.array(naive_vsr.matrix(moved[3:])) == pytest.approx(np.array(expected), abs=1e-7)
    error[0, 3:] = 0
    assert (mounted(pose, error)[0, 3:] == pose[0, 3:]).all()


@pytest.mark.parametrize(
    ("more", "where"),
    [
        ("robust: {lost: 3}\n", "robust.lost: losing 3 of 3 LiDARs leaves none; allowed: 1 to 2"),
        ("robust: {lost: 0}\n", "robust.lost: 0 is too small; allowed: at least 1"),
        ("robust: {}\n", "robust: asks for nothing; allowed: lost, position_sigma_m, angle_sigma_deg"),
        ("robust: {lost: 1, samples: 4}\n", "robust.samples: needs errors to draw"),
        ("robust: {position_sigma_m: -0.1}\n", "robust.position_sigma_m: -0.1 is too small"),
        ("robust: {position_sigma_m: 0, angle_sigma_deg: 0.0}\n", "robust.position_sigma_m: all errors are 0"),
        ("robust: {angle_sigma_deg: 0.1, samples: 0}\n", "robust.samples: 0 is too small; allowed: at least 1"),
        ("robust: {angle_sigma_deg: 0.1, samples: 1001}\n", "robust.samples: 1001 is too large"),
        ("robust: {angle_sigma_deg: 0.1, quantile: 0}\n", "robust.quantile: 0 is too small; allowed: above 0"),
        ("robust: {angle_sigma_deg: 0.1, quantile: 1.5}\n", "robust.quantile: 1.5 is too large; allowed: at most 1"),
        ("zones: [{name: x, min_m: [20, 0, 0], max_m: [30, 8, 3]}]\n", "zones[0]: 'x' is outside the region"),
        ("zones: [{name: x, min_m: [5, 3, 0], max_m: [7, 5, 3]}]\n", "all cuboids in it are excluded"),
        ("zones: [{name: x, min_m: [0.6, 0, 0], max_m: [1.4, 8, 3]}]\n", "no cuboid's centre is in it"),
        ("zones: [{name: x, min_m: [0, 0, 0], max_m: [1, 0, 3]}]\n", "zones[0].max_m[1]: 0 is not above min_m's 0"),
        (
            ZONES.replace("}]\n", "}, {name: front, min_m: [0, 0, 0], max_m: [1, 1, 1]}]\n"),
            "zones[1].name: 'front' is a zone",
        ),
        (
            "zones: [{name: elsewhere, min_m: [0, 0, 0], max_m: [1, 1, 1]}]\n",
            "zones[0].name: 'elsewhere' is what lies in no zone",
        ),
        ("zones: [{name: x, min_m: [0, 0, 0], max_m: [1, 1, 1], weight: 0}]\n", "zones[0].weight: 0 is too small"),
    ],
)
def test_mistakes(tmp_path, more, where):
    with refused(where, kind=ConfigError):
        study(tmp_path, more)


def test_one_lidar_cannot_be_lost(tmp_path):
    text = "\n".join(line for line in STUDY.splitlines() if "name: b" not in line)
    with pytest.raises(ConfigError, match="the only LiDAR leaves none; allowed: studies of two LiDARs or more"):
        study(tmp_path, "\nrobust: {lost: 1}\n", text)
    many = STUDY.replace("count: 2", "count: 20")
    with pytest.raises(ConfigError, match="10 of 21 LiDARs can fail in 352,716 ways; allowed: at most 1,000"):
        study(tmp_path, "\nrobust: {lost: 10}\n", many)
