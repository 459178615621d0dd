"""Studies: loading, what an optimisation promises, and the evaluation of a rig."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.search.optimize import optimize
from lidarcfg.study.evaluation import evaluate, shadow
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.study import with_solver
from lidarcfg.vsr.metric import max_vsr
from tests.refusals import exchanged, refused
from tests.studies import study_of

STUDIES = Path(__file__).parents[2] / "data/studies"
SMALL = """
region: {min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 0.5, 0.25], exclude: [{min_m: [5, 3, 0], max_m: [7, 5, 3]}]}
sensors:
  - {elevation_deg: [-20, -8, 3, 12], count: 2, min: {position_m: [5, 3, 1], rpy_deg: [-20, -20, 0]}, max: {position_m: [7, 5, 2.5], rpy_deg: [20, 20, 0]}}
  - {model: fan-4, min: {position_m: [6, 4, 1.5], rpy_rad: [0, 0, 1]}, max: {position_m: [6, 4, 2.5], rpy_rad: [0, 0, 1]}}
solver: {method: abc, bees: 8, cycles: 6, limit: 3, seed: 4}
detection: [{name: box, size_m: [1, 1, 1]}]
"""


def study(tmp_path, text=SMALL):
    return study_of(tmp_path, text)


OWN = [path for path in sorted(STUDIES.glob("*.yaml")) if "\nvary:" not in path.read_text()]  # without plans


@pytest.mark.slow
@pytest.mark.parametrize("path", OWN, ids=lambda path: path.stem)
def test_the_studies_that_come_with_it(path):
    loaded = load_study(path)
    if path.stem.startswith("liu2018"):
        count, beams = map(int, path.stem.removeprefix("liu2018-").split("x"))
        assert len(loaded.slots) == count
        assert {slot.sensor.count for slot in loaded.slots} == {beams}
        assert loaded.space.lower.tolist() == [[28, 9, 2.2, 0, 0, 0]] * count
        assert loaded.space.upper.tolist() == [[31, 11, 3.0, 3.1415, 3.1415, 0]] * count
        assert loaded.space.free.sum() == 5 * count
        assert (loaded.solver.bees, loaded.solver.cycles) == (200, 800)
        assert loaded.region.included.sum() == 48000 - 960


def test_no_lidar_of_the_sedan_can_hang_upside_down():
    loaded = load_study(STUDIES / "sedan.yaml")
    corners = np.stack([loaded.space.lower, loaded.space.upper])
    tilt = np.abs(corners[..., 3:5]).max(axis=0).sum(axis=1)  # roll and pitch together bound the tilt
    assert np.degrees(tilt).max() <= 31
    rng = np.random.default_rng(1)
    for poses in loaded.space.poses(rng.random((100, loaded.space.dimensions))):
        assert min(lidar.axis[2] for lidar in lidars_at(loaded.slots, poses)) > 0.85


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("cycles: 6", "cycle: 6", "solver.cycle: unknown key; did you mean cycles?"),
        ("bees: 8", "bees: 1", "solver.bees: 1 is too small; allowed: at least 2"),
        ("method: abc", "method: de", "solver.method: 'de' is gone; use auto"),
        ("{name: box", "{name: box, size_m: [1, 1, 1]}, {name: box", "detection[1].name: 'box' is an object already"),
        ("[1, 1, 1]", "[1, 1, 9]", "study.yaml:7:13: detection[0]: box: size_m[2]: 9 is more than the region's 3 along z"),
        ("[5, 3, 0], max_m: [7, 5, 3]", "[0, 0.5, 0], max_m: [12, 7.5, 3]", "detection[0]: box: has no free place in the region"),
        ("[7, 5, 2.5]", "[7, 5, 0.5]", "sensors[0].max: its z is below min's"),
        ("model: fan-4, ", "model: fan-5, ", "study.yaml:5:6: sensors[1].model: no sensor is called 'fan-5'"),
        ("model: fan-4, ", "model: fan-4, name: lidar, count: 2, ", "study.yaml:5:5: sensors[1]: two are called 'lidar_0'"),
        ("[5, 3, 0], max_m: [7, 5, 3]", "[0, 0, 0], max_m: [12, 8, 3]", "region.exclude: leaves no cuboid"),
        ("[-20, -8, 3, 12]", "[-20, -8, 3, 120]", "sensors[0].elevation_deg[3]: 120 is outside the allowed -90 to 90"),
    ],
)  # fmt: skip
def test_refused(tmp_path, old, new, message):
    with refused(message, kind=ConfigError):
        study(tmp_path, exchanged(SMALL, old, new))


def test_fixed_coordinates_stay_and_bounds_are_reached_exactly(tmp_path):
    small = study(tmp_path)
    free = small.space.dimensions
    assert free == 2 * 5 + 1
    low, high, quarter = small.space.poses(np.repeat([[0.0], [1.0], [0.25]], free, axis=1))
    assert np.array_equal(low, small.space.lower)
    assert np.array_equal(high, small.space.upper)
    assert quarter[2].tolist() == [6, 4, 1.75, 0, 0, 1]


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_a_seed_gives_the_same_run_on_any_number_of_threads(tmp_path, threads):
    small = study(tmp_path)
    first = optimize(small, threads=1)
    again = optimize(small, threads=threads)
    assert again.rig == first.rig
    assert [(c.cycle, c.evaluations, c.best, c.mean) for c in again.history] == [
        (c.cycle, c.evaluations, c.best, c.mean) for c in first.history
    ]
    other = optimize(with_solver(small, seed=5), threads=threads)
    assert other.rig != first.rig


def test_what_a_run_reports(tmp_path):
    small = study(tmp_path)
    seen = []
    found = optimize(small, threads=2, on_cycle=lambda cycle, rig, log: seen.append(cycle))
    best = [c.best for c in found.history]
    assert best == sorted(best, reverse=True)  # the history never rises
    assert [c.cycle for c in found.history] == list(range(7))
    assert seen == list(found.history)
    assert found.evaluations == 8 * 2 * 6  # employed and onlooker bees, the paper's count
    assert found.first_evaluations == 8
    assert found.scout_evaluations > 0
    assert found.evaluation.max_vsr_m == best[-1]
    poses = np.array([[*m.position_m, *m.rpy_rad] for m in found.rig.mounts])
    assert (poses >= small.space.lower).all()
    assert (poses <= small.space.upper).all()
    assert max_vsr(small.region, lidars_at(small.slots, poses)) == best[-1]
    middle = (small.space.lower + small.space.upper) / 2
    assert found.midpoint_max_vsr_m == max_vsr(small.region, lidars_at(small.slots, middle))
    assert best[-1] < found.midpoint_max_vsr_m
    endpoints = {(m.host, m.data_port) for m in found.rig.mounts}
    assert len(endpoints) == 3


def test_budgets(tmp_path):
    small = study(tmp_path)
    assert optimize(with_solver(small, evaluations=21), threads=1).evaluations == 21
    assert with_solver(small, evaluations=21).solver.cycles is None
    quick = optimize(with_solver(small, seconds=0.2, cycles=10**6), threads=1)
    assert 0.19 <= quick.seconds < 5  # within 5 % below
    assert study(tmp_path, SMALL.replace("cycles: 6, ", "")).solver.cycles == 800


def test_an_interrupt_keeps_the_best_so_far(tmp_path):
    def interrupt(cycle, rig, log):
        if cycle.cycle == 3:
            raise KeyboardInterrupt

    found = optimize(study(tmp_path), threads=2, on_cycle=interrupt)
    assert found.interrupted
    assert len(found.history) == 4
    assert found.evaluation.max_vsr_m == found.history[-1].best


def test_nothing_free_to_move(tmp_path):
    fixed = (
        SMALL.split("  - {elevation_deg")[0]
        + "  - {model: fan-4, min: {position_m: [6, 4, 2], rpy_rad: [0, 0, 1]}, max: {position_m: [6, 4, 2], rpy_rad: [0, 0, 1]}}\n"
    )
    with pytest.raises(ConfigError, match="nothing to optimise"):
        optimize(study(tmp_path, fixed))


def test_an_evaluation_names_the_worst(tmp_path):
    small = study(tmp_path)
    found = evaluate(small, small.rig((small.space.lower + small.space.upper) / 2))
    vsr = [worst.vsr_m for worst in found.worst]
    assert len(vsr) == 10
    assert vsr == sorted(vsr, reverse=True)
    assert vsr[0] == found.max_vsr_m
    for worst in found.worst:
        assert worst.volume_m3 / worst.surface_m2 == pytest.approx(worst.vsr_m)
        sides = np.subtract(worst.max_m, worst.min_m)
        assert 0 < worst.inscribed_radius_m <= sides.min() / 2 + 1e-12
        assert 4 / 3 * np.pi * worst.inscribed_radius_m**3 < worst.volume_m3
        assert all(low < c < high for low, c, high in zip(worst.min_m, worst.centroid_m, worst.max_m, strict=True))
        assert len(worst.gap) == 3
        for (below, above), gap in zip(worst.between_deg[:2], worst.gap[:2], strict=True):
            assert [below, above] == [(None, -20, -8, 3, 12)[gap], (-20, -8, 3, 12, None)[gap]]
    assert 0 < found.detection["box"].rate <= 1


METHODS = ("auto", "abc", "annealing")


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_resumed_search_ends_where_an_unbroken_one_does(tmp_path, method):
    small = with_solver(study(tmp_path), method=method, evaluations=700)
    whole = optimize(small, threads=1)
    broken = optimize(with_solver(small, evaluations=333), threads=2)
    assert len(broken.log.cost) <= 333 + broken.first_evaluations + broken.scout_evaluations
    resumed = optimize(small, threads=1, log=broken.log)
    assert resumed.rig == whole.rig
    assert resumed.objective == whole.objective
    assert (resumed.evaluations, resumed.scout_evaluations) == (whole.evaluations, whole.scout_evaluations)
    assert np.array_equal(resumed.log.cost, whole.log.cost)
    assert resumed.full_evaluations < whole.full_evaluations


MIRRORED = SMALL.replace("{elevation_deg", "{mirror_y_m: 4, elevation_deg").replace("[5, 3, 1]", "[5, 4, 1]")


def test_coordinates_along_one_axis_within_equal_bounds_mean_the_same(tmp_path):
    """Four sensors: one shares x, z and pitch with two, another one nothing."""
    other = "  - {elevation_deg: [-5, 5], min: {position_m: [5, 2, 1], rpy_deg: [0, -20, 0]}, max: {position_m: [7, 3, 2.5], rpy_deg: [0, 20, 0]}}"
    text = SMALL.replace("sensors:", "sensors:\n" + other)
    loaded = study(tmp_path, text)
    found = loaded.space.coordinates
    assert np.array_equal(found.group, loaded.space.groups)
    axis = np.nonzero(loaded.space.free)[1]
    for i, j in itertools.combinations(range(len(found)), 2):
        a, b = (found.group[i], axis[i]), (found.group[j], axis[j])
        alike = a[1] == b[1] and (loaded.space.lower[a], loaded.space.upper[a]) == (
            loaded.space.lower[b],
            loaded.space.upper[b],
        )
        assert (found.kind[i] == found.kind[j]) == alike


@pytest.mark.slow
def test_mirrored_pairs_move_together(tmp_path):
    small = study(tmp_path, MIRRORED)
    assert small.space.free.sum() == 5 + 1
    poses = small.space.poses(np.random.default_rng(1).random((50, 6)))
    assert poses[:, 0, 1] + poses[:, 1, 1] == pytest.approx(np.full(50, 8.0))
    assert np.array_equal(poses[:, 1, [0, 2, 4]], poses[:, 0, [0, 2, 4]])
    for rows in poses:
        left, right, _ = lidars_at(small.slots, rows)
        assert right.axis == pytest.approx(left.axis * (1, -1, 1), abs=1e-15)
    found = optimize(small, threads=1).rig.mounts
    assert found[0].position_m[1] + found[1].position_m[1] == pytest.approx(8.0)
    with pytest.raises(ConfigError, match="mirror_y_m: needs pairs, and count is 3"):
        study(tmp_path, MIRRORED.replace("count: 2", "count: 3"))


@pytest.mark.slow
def test_constraints_are_kept(tmp_path):
    text = SMALL + "constraints: {max_tilt_deg: 12, min_distance_m: 0.9}\n"
    small = study(tmp_path, text)
    for method in METHODS:
        found = optimize(with_solver(small, method=method, evaluations=600), threads=1).rig
        poses = np.array([[*m.position_m, *m.rpy_rad] for m in found.mounts])
        axes = np.array([lidar.axis for lidar in lidars_at(small.slots, poses)])
        assert np.degrees(np.arccos(axes[:, 2])).max() <= 12 + 1e-9
        apart = [np.linalg.norm(poses[i, :3] - poses[j, :3]) for i in range(3) for j in range(i)]
        assert min(apart) >= 0.9


def test_the_violation_by_hand(tmp_path):
    small = study(tmp_path, SMALL + "constraints: {max_tilt_deg: 10, min_distance_m: 2}\n")
    pose = np.zeros((1, 3, 6))
    pose[0, :, 0] = (0, 3, 6)
    assert small.space.violation(pose).tolist() == [0.0]
    pose[0, 1, 3] = np.radians(25)
    assert small.space.violation(pose) == pytest.approx([np.radians(15)])
    pose[0, 2, 0] = 4.5
    assert small.space.violation(pose) == pytest.approx([np.radians(15) + 0.5])


def test_no_rigs_have_no_violation(tmp_path):
    """A search that ends before it has tried a plain rig has none to compare with."""
    body = "vehicle: {boxes: [{name: body, center_m: [0, 0, 0], size_m: [1, 1, 1]}]}\n"
    assert study(tmp_path, SMALL + body).space.violation(np.empty((0, 3, 6))).shape == (0,)


def test_constraints_that_nothing_keeps(tmp_path):
    with pytest.raises(ConfigError, match="found no rig that keeps the constraints"):
        optimize(study(tmp_path, SMALL + "constraints: {min_distance_m: 2.06}\n"))  # from corner to corner are 2.062


@pytest.mark.slow
@pytest.mark.parametrize(
    ("objective", "by_hand"),
    [
        ("{max_vsr: 3}", lambda e: e.max_vsr_m),
        ("{inscribed_radius: 1}", lambda e: max(w.inscribed_radius_m for w in e.worst)),
        ("{detection: {box: 2}}", lambda e: 1 - e.detection["box"].rate),
        ("{max_vsr: 1, detection: {box: 3}}", lambda e: (e.max_vsr_m + 3 * (1 - e.detection["box"].rate)) / 4),
    ],
)
def test_objectives(tmp_path, objective, by_hand):
    small = study(tmp_path, SMALL + f"objective: {objective}\n")
    found = optimize(small, threads=2)
    evaluation = evaluate(small, found.rig, worst_count=10**6)
    assert found.objective == pytest.approx(by_hand(evaluation), rel=1e-12)
    assert found.objective == found.history[-1].best
    start = optimize(with_solver(small, cycles=1), threads=1)
    assert found.objective <= start.objective


def test_an_objective_of_an_object_that_is_none(tmp_path):
    with pytest.raises(ConfigError, match=r"objective.detection.bus: no such object; allowed: box"):
        study(tmp_path, SMALL + "objective: {detection: {bus: 1}}\n")


def test_the_shadow_of_a_wall_by_hand(tmp_path):
    """A sensor at 1 m before a wall of 2 m: all behind it and below the line over its top is hidden, and nothing else."""
    path = tmp_path / "study.yaml"
    path.write_text(
        "region: {min_m: [-4, -2, 0], max_m: [8, 2, 4], cuboid_m: [0.5, 0.5, 0.5]}\n"
        "vehicle: {boxes: [{name: wall, center_m: [2, 0, 1], size_m: [0.02, 100, 2]}]}\n"
        "sensors:\n  - {model: vlp-16, min: {position_m: [0, 0, 1], rpy_deg: [0, 0, 0]}, "
        "max: {position_m: [0, 0, 1], rpy_deg: [0, 0, 0]}}\n"
    )
    study = load_study(path)
    rig = study.rig(study.space.midpoint)
    x, _, z = np.meshgrid(*study.region.centres(), indexing="ij")
    expected = (x > 2) & (z < 1 + x / 2)
    assert np.array_equal(shadow(study, rig), expected)
    assert study.region.mesh(expected).get_volume() == pytest.approx(expected.sum() * 0.125)
