"""The savings change nothing: searches with and without them, and costs against the plain evaluation."""

from itertools import product

import numpy as np
import pytest

from lidarcfg.search import sweep
from lidarcfg.search.optimize import optimize
from lidarcfg.solvers import annealing
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.loading import load_study
from lidarcfg.study.objective_costs import ObjectiveCosts
from lidarcfg.study.study import with_solver
from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.metric import max_vsr, vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment

STUDY = """
region: {{min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 0.5, 0.25], exclude: [{{min_m: [5, 3, 0], max_m: [7, 5, 3]}}]}}
sensors:
  - {{elevation_deg: {beams}, count: {count}, min: {{position_m: [5, 3, 1], rpy_deg: [-40, -40, 0]}}, max: {{position_m: [7, 5, 2.5], rpy_deg: [40, 190, 0]}}}}
solver: {{method: abc, bees: 12, cycles: 25, limit: {limit}, seed: {seed}}}
"""
REGION = Region.from_boxes((0, 0, 0), (6, 4, 2), (0.5, 0.5, 0.25), (((2, 1, 0), (3, 2, 1)),))


def history(found):
    return [(c.cycle, c.evaluations, c.best, c.mean) for c in found.history]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "beams", "limit", "seed"),
    [
        (1, 6, 1000, 1),
        (2, 8, 1000, 2),
        (3, 4, 6, 3),
        (4, 5, 1000, 4),
        (9, 3, 8, 5),
        (1, 1, 4, 6),
        (2, 300, 1000, 7),
        (16, 16, 9, 8),
    ],
)
def test_skipping_changes_nothing(tmp_path, count, beams, limit, seed):
    path = tmp_path / "s.yaml"
    elevation = np.round(np.linspace(-25, 25, beams), 6).tolist() if beams > 1 else [3.0]
    path.write_text(STUDY.format(beams=elevation, count=count, limit=limit, seed=seed))
    study = load_study(path)
    runs = [optimize(study, threads=threads, skip=skip) for threads, skip in ((1, False), (1, True), (3, True))]
    for run in runs[1:]:
        assert run.rig == runs[0].rig
        assert history(run) == history(runs[0])
    assert runs[0].evaluations == 12 * 2 * 25
    assert runs[1].scout_evaluations == runs[0].scout_evaluations
    assert (runs[1].scout_evaluations > 0) == (limit < 1000)
    assert runs[1].full_evaluations == runs[2].full_evaluations
    assert runs[1].full_evaluations < 0.9 * runs[0].full_evaluations
    if beams > 1:  # one beam leaves two subspaces, and a flood is half the region
        assert runs[1].cuboids < runs[0].cuboids


@pytest.mark.parametrize(
    "body", ["", "vehicle: {boxes: [{name: cab, center_m: [6, 4, 1], size_m: [2, 2, 1.6]}], allow_inside: true}\n"]
)
def test_what_a_source_takes_over_is_what_would_be_computed(tmp_path, body):
    """Links, and what is clear, of sources that took the places of trials, bit by bit as of a new evaluator."""
    path = tmp_path / "s.yaml"
    path.write_text(STUDY.format(beams=[-20, -8, 4, 15], count=3, limit=1000, seed=1) + body)
    study = load_study(path)
    rng = np.random.default_rng(3)
    lidars = [slot.lidar for slot in study.slots]
    every = np.arange(6)
    x = rng.random((6, study.space.dimensions))
    with BoundedCosts(study.region, lidars, 2, visibility=study.visibility) as evaluator:
        taken_over = 0
        for cycle in range(12):
            sources = study.space.poses(x)
            step = x + np.where(study.space.groups == cycle % 3, rng.normal(0, 0.05, x.shape), 0.0)
            trials = np.clip(step, 0, 1)
            before = evaluator._linked_poses.copy()
            cost = evaluator.costs(study.space.poses(trials), every, sources, np.full(6, 10.0))
            taken_over += int(cycle > 1 and not (before == evaluator._linked_poses).all())
            x = np.where((cost < 10.0)[:, None], trials, x)
        assert taken_over
        evaluator._sync(study.space.poses(x))
        assert (evaluator._linked_poses == study.space.poses(x)).all()  # nothing is left to compute
        with BoundedCosts(study.region, lidars, 1, visibility=study.visibility) as other:
            other._sync(study.space.poses(x))
            other._recompute_links(every)
            assert (evaluator._links == other._links).all()
            assert evaluator._clear.shape == other._clear.shape == (6 * bool(body), *other._clear.shape[1:])
            assert (evaluator._clear == other._clear).all()


@pytest.mark.parametrize(("robust", "trials"), [("", 4), ("robust: {lost: 1}\n", 2)])
def test_a_deadline_is_kept_between_a_few_rigs_of_many_cuboids(tmp_path, monkeypatch, robust, trials):
    """2,304 cuboids in 1 rig or in the 2 that may be left: 10,000 are so many trials of the first 12."""
    path = tmp_path / "s.yaml"
    path.write_text(STUDY.format(beams=[-5, 5], count=2, limit=1000, seed=1) + robust)
    study = with_solver(load_study(path), seconds=1e-9)
    assert study.region.included.size == 12 * 16 * 12
    monkeypatch.setattr("lidarcfg.study.bounded_costs.SLICE_CUBOIDS", 10_000)
    cut = optimize(study, threads=1)
    assert cut.evaluated == trials
    assert cut.objective == optimize(study, threads=1, skip=False).objective


def test_the_time_of_a_sweep_is_estimated_by_a_few_rigs_where_these_take_long(tmp_path, monkeypatch):
    """As if 300 evaluations took too long: the first four rigs of twelve, one by one."""
    path = tmp_path / "s.yaml"
    path.write_text(STUDY.format(beams=[-5, 5], count=2, limit=1000, seed=1))
    found = []
    monkeypatch.setattr("lidarcfg.study.bounded_costs.SLICE_CUBOIDS", 10_000)
    monkeypatch.setattr(sweep, "TRIAL_S", 1e-9)
    monkeypatch.setattr(sweep, "optimize", lambda *args, **keys: found.append(optimize(*args, **keys)) or found[0])
    pace = sweep.pace(load_study(path))
    assert found[0].evaluated == 4
    assert pace.evaluation_s == found[0].seconds / 4


@pytest.mark.slow
@pytest.mark.parametrize("robust", ["", "robust: {lost: 1}\n", "robust: {position_sigma_m: 0.02, samples: 4}\n"])
def test_a_search_with_a_deadline_evaluates_no_more_in_full(tmp_path, monkeypatch, robust):
    """There a batch is cut into slices, and what an earlier slice has found must not be forgotten by a later one."""
    path = tmp_path / "s.yaml"
    path.write_text(STUDY.format(beams=[-20, -8, 4, 15], count=3, limit=1000, seed=1) + robust)
    study = load_study(path)
    whole = optimize(with_solver(study, method="annealing", evaluations=800), threads=1)
    monkeypatch.setattr("lidarcfg.study.bounded_costs.SLICE", 5)
    sliced = optimize(with_solver(study, method="annealing", evaluations=800, seconds=1e6), threads=1)
    assert history(sliced) == history(whole)
    assert sliced.full_evaluations < 1.02 * whole.full_evaluations


OBJECTS = """
detection:
  - {name: box, size_m: [1, 0.5, 0.5]}
  - {name: post, size_m: [0.3, 0.2, 1], on_ground: true, threshold: 2}
  - {name: drawn, size_m: [1.2, 0.6, 0.7], samples: 24}
"""


OBJECTIVES = (
    "{max_vsr: 1, inscribed_radius: 0.01}",
    "{max_vsr: 2, inscribed_radius: 1, detection: {box: 0.1}}",
    "{inscribed_radius: 3}",
    "{detection: {box: 1, post: 2}}",
    "{max_vsr: 1, detection: {box: 0.05, drawn: 0.05}}",
    "{detection: {drawn: 0.7}}",
)
BY_NIGHT = ("annealing", OBJECTIVES[4]), ("abc", OBJECTIVES[5]), ("annealing", OBJECTIVES[5])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "objective"),
    [
        pytest.param(*case, marks=[pytest.mark.nightly] * (case in BY_NIGHT))
        for case in product(("abc", "annealing"), OBJECTIVES)
    ],
)
def test_skipping_changes_nothing_for_any_objective(tmp_path, objective, method):
    path = tmp_path / "s.yaml"
    path.write_text(
        STUDY.format(beams="[-20, -8, 3, 12]", count=2, limit=9, seed=5) + OBJECTS + f"objective: {objective}\n"
    )
    study = load_study(path)
    few = "drawn" in objective  # whose places are drawn anew in every evaluation, which takes long
    if method == "abc":
        study = with_solver(study, cycles=4 if few else 10)
    else:
        study = with_solver(study, method="annealing", evaluations=220 if few else 300)
    runs = [optimize(study, threads=threads, skip=skip) for threads, skip in ((1, False), (1, True), (3, True))]
    trials = runs[0].full_evaluations
    assert trials == runs[0].evaluations + runs[0].first_evaluations + runs[0].scout_evaluations
    for run in runs[1:]:
        assert run.rig == runs[0].rig
        assert run.objective == runs[0].objective
        assert history(run) == history(runs[0])
        assert (run.full_evaluations, run.cuboids) == (runs[1].full_evaluations, runs[1].cuboids)
        assert run.full_evaluations < (0.7 if method == "abc" else 0.95) * trials
    poses = np.array([[*mount.position_m, *mount.rpy_rad] for mount in runs[0].rig.mounts])
    assert objective_of(study, poses) == runs[0].objective


def random_poses(rng, count, lidars):
    return np.concatenate(
        [rng.uniform((0, 0, 0), (6, 4, 2), (count, lidars, 3)), rng.uniform(-3, 3, (count, lidars, 3))], axis=2
    )


def costs(beams, lidars, **settings):
    """Of 30 trials: the plain evaluations, what each is to beat, and the evaluator's costs, asked for twice."""
    rng = np.random.default_rng(beams + lidars)
    sine = np.sort(np.sin(rng.uniform(-0.6, 0.6, beams)))
    sources = random_poses(rng, 6, lidars)
    source = np.repeat(np.arange(6), 5)
    trials = sources[source].copy()
    trials[np.arange(30), rng.integers(lidars, size=30), rng.integers(5, size=30)] += rng.normal(0, 0.2, 30)
    plain = np.array([max_vsr(REGION, [lidar(row[:3], row[3:], sine) for row in poses]) for poses in trials])
    with BoundedCosts(REGION, [lidar((0, 0, 0), (0, 0, 0), sine)] * lidars, threads=2, **settings) as evaluator:
        upper_bound = evaluator.costs(sources, np.arange(6), sources, np.full(6, np.inf))[source]
        found = [evaluator.costs(trials, source, sources, upper_bound) for _ in range(2)]
    own = [max_vsr(REGION, [lidar(row[:3], row[3:], sine) for row in poses]) for poses in sources]
    assert upper_bound.tolist() == np.array(own)[source].tolist()
    return plain, upper_bound, found


@pytest.mark.parametrize("beams", [1, 3, 16, 40])
@pytest.mark.parametrize("lidars", [1, 2, 5])
def test_costs_are_the_plain_evaluations(beams, lidars):
    plain, upper_bound, found = costs(beams, lidars)
    expected = np.where(plain < upper_bound, plain, np.inf)
    for cost in found:  # the second time with what the first one remembered
        assert np.array_equal(cost, expected)


def test_nothing_is_kept_where_it_would_not_fit():
    plain, upper_bound, found = costs(16, 2, cache_bytes=1000)
    for cost in found:
        assert np.array_equal(cost, np.where(plain < upper_bound, plain, np.inf))


def norm(values, smoothing):
    """The p-norm of the twelve greatest, one after the other."""
    greatest = sorted(values, reverse=True)[:12]
    total = 0.0
    for value in greatest:
        total += (value / greatest[0]) ** (1 / smoothing)
    return greatest[0] * total**smoothing


@pytest.mark.slow
@pytest.mark.parametrize("smoothing", [1.0, 1 / 32, 0.001])
@pytest.mark.parametrize(("beams", "lidars"), [(1, 1), (3, 2), (16, 1), (16, 5)])
def test_smoothed_costs_are_norms_of_the_worst_subspaces(beams, lidars, smoothing):
    rng = np.random.default_rng(beams)
    sine = np.sort(np.sin(rng.uniform(-0.6, 0.6, beams)))
    sources = random_poses(rng, 6, lidars)
    source = np.repeat(np.arange(6), 20)
    trials = sources[source].copy()
    trials[np.arange(120), rng.integers(lidars, size=120), rng.integers(5, size=120)] += rng.normal(0, 0.05, 120)
    every = np.concatenate([sources, trials])
    placed = [[lidar(row[:3], row[3:], sine) for row in poses] for poses in every]
    plain = np.array([norm(vsr_m(segment(REGION, rig)).tolist(), smoothing) for rig in placed])
    greatest = np.array([max_vsr(REGION, rig) for rig in placed])
    upper_bound = plain[:6][source] * 1.001
    expected = np.where(plain[6:] < upper_bound, plain[6:], np.inf)
    with BoundedCosts(REGION, [lidar((0, 0, 0), (0, 0, 0), sine)] * lidars, threads=2) as evaluator:
        first = evaluator.costs(sources, np.arange(6), sources, np.full(6, np.inf), smoothing)
        before = evaluator.full_evaluations
        found = [evaluator.costs(trials, source, sources, upper_bound, smoothing) for _ in range(2)]
        full = evaluator.full_evaluations - before
    assert first == pytest.approx(plain[:6], rel=1e-14)
    assert (first >= greatest[:6]).all()
    for cost in found:
        assert np.array_equal(cost < np.inf, expected < np.inf)
        assert cost[cost < np.inf] == pytest.approx(expected[expected < np.inf], rel=1e-14)
    assert np.isinf(expected).any()
    assert full < 2 * 120
    if smoothing == 1.0 and beams == 16:  # of 12 or more, no single one refutes; several together do
        assert (greatest[6:] < upper_bound).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "more", ["", "robust: {lost: 1}\n", "zones: [{name: left, min_m: [0, 0, 0], max_m: [6, 8, 3], weight: 3}]\n"]
)
def test_skipping_changes_nothing_in_rounds_that_smooth(tmp_path, monkeypatch, more):
    """Short rounds, so that there are several; the result's cost is that of its rig, unsmoothed."""
    path = tmp_path / "s.yaml"
    path.write_text(STUDY.format(beams=[-20, -8, 4, 15], count=3, limit=1000, seed=1) + more)
    monkeypatch.setattr(annealing, "FIRST_WORK", 20)
    monkeypatch.setattr(annealing, "SECOND_WORK", 400)
    study = with_solver(load_study(path), method="annealing", evaluations=4000)
    smoothed = []
    asked = ObjectiveCosts.costs

    def costs(self, poses, source, source_poses, upper_bound, smoothing=0.0):
        smoothed.append(smoothing)
        return asked(self, poses, source, source_poses, upper_bound, smoothing)

    monkeypatch.setattr(ObjectiveCosts, "costs", costs)
    runs = [optimize(study, threads=threads, skip=skip) for threads, skip in ((1, False), (1, True), (3, True))]
    assert set(smoothed) == {0.0, 1 / 32}
    for run in runs[1:]:
        assert run.rig == runs[0].rig
        assert history(run) == history(runs[0])
        assert run.full_evaluations < 0.9 * runs[0].full_evaluations
    poses = np.array([[*mount.position_m, *mount.rpy_rad] for mount in runs[0].rig.mounts])
    assert runs[0].objective == objective_of(study, poses)


@pytest.mark.parametrize(
    ("more", "smooths"),
    [
        ("", True),
        ("robust: {lost: 1}\n", True),
        ("objective: {max_vsr: 1, inscribed_radius: 0.01}\n", False),
        ("robust: {lost: 1, position_sigma_m: 0.02, samples: 4}\n", False),
        ("robust: {position_sigma_m: 0.02, samples: 4}\n", False),
    ],
)
def test_only_max_vsr_is_smoothed(tmp_path, more, smooths):
    """Not where other terms or mounting errors count: costs are those that count there."""
    path = tmp_path / "s.yaml"
    path.write_text(STUDY.format(beams=[-20, -8, 4, 15], count=3, limit=1000, seed=1) + more)
    study = load_study(path)
    poses = study.space.poses(np.random.default_rng(1).random((4, study.space.dimensions)))
    asked = poses, np.arange(4), poses, np.full(4, np.inf)
    with ObjectiveCosts(study, threads=2) as evaluator:
        assert evaluator.smooths == smooths
        exact = evaluator.costs(*asked)
        smoothed = evaluator.costs(*asked, 1 / 32)
    assert exact.tolist() == [objective_of(study, one) for one in poses]
    assert ((smoothed > exact) if smooths else (smoothed == exact)).all()


def test_lidars_in_odd_places():
    """Outside the region, on a cuboid's centre, in an excluded box; a region one cuboid thick."""
    sine = np.sin(np.radians([-20, 0, 20]))
    for region in (REGION, Region.from_boxes((0, 0, 0), (6, 4, 0.25), (0.5, 0.5, 0.25))):
        for position in ((-50, 2, 1), (0.25, 0.25, 0.125), (2.5, 1.5, 0.5), (0, 0, 0)):
            pose = np.array([[[*position, 0.0, 0.0, 0.0]]])
            with BoundedCosts(region, [lidar((0, 0, 0), (0, 0, 0), sine)], threads=1) as evaluator:
                cost = evaluator.costs(pose, np.zeros(1, int), pose, np.full(1, np.inf))[0]
            assert cost == max_vsr(region, [lidar(position, (0, 0, 0), sine)])


def test_of_many_lidars_fewer_trials_are_between_two_looks_at_the_clock():
    """In proportion: 64 LiDARs are eight times as many as those for which cuboids alone count."""
    region = Region.from_boxes((0, 0, 0), (100, 100, 20), (1, 1, 0.1), ())
    one = lidar((50.0, 50.0, 2.0), (0.0, 0.0, 0.0), np.sin(np.radians([-10.0, 10.0])))
    found = {}
    for count in (1, 8, 64):
        with BoundedCosts(region, [one] * count, threads=1) as evaluator:
            found[count] = evaluator.slice
    assert found == {1: 25, 8: 25, 64: 3}
