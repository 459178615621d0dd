"""The front of price against objective: the same as by trying everything, and what its search promises."""

import math
from itertools import product

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.search.combinations import combinations
from lidarcfg.search.front import FrontRun, front, on_front, required_growth
from lidarcfg.search.optimize import optimize
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
from tests.naive import vsr as naive
from tests.studies import study_of

REGION = "region: {min_m: [0, 0, 0], max_m: [8, 6, 3], cuboid_m: [1, 0.5, 0.5]}\n"
PRICES = {"fan-4": 100, "fan-8": 250, "fan-16": 400, "none": 0}
CHOICE = "choose: [fan-4, fan-8, none], "
TWO = f"""\
  - {{name: roof, {CHOICE}count: 2, min: {{position_m: [3, 2, 1], rpy_deg: [-20, -20, 0]}}, max: {{position_m: [5, 4, 2], rpy_deg: [20, 20, 0]}}}}
  - {{name: nose, choose: [fan-16, none], min: {{position_m: [6, 2, 1], rpy_deg: [0, 0, 0]}}, max: {{position_m: [7, 4, 2], rpy_deg: [0, 0, 0]}}}}
"""


def study(tmp_path, sensors=TWO, solver="method: auto, evaluations: 6000, seed: 2"):
    prices = ", ".join(f"{model}: {price}" for model, price in PRICES.items() if price)
    return study_of(tmp_path, f"{REGION}prices: {{{prices}}}\nsensors:\n{sensors}solver: {{{solver}}}\n")


def undominated(pairs):
    """Of (price, objective) those that no other dominates, each once, by trying all."""
    worse = {a for a in pairs for b in pairs if b[0] <= a[0] and b[1] <= a[1] and b != a}
    return sorted(set(pairs) - worse)


def pairs_of(found):
    return [(point.combination.price, point.placement.objective) for point in found.points]


def costs(found):
    return [[log.cost.tolist() for log in record.logs] for record in found.log.records.values()]


def naive_max_vsr(mounts):
    """Of (model, position, rpy) by plain loops over the cuboids of REGION."""
    edges = (1, 0.5, 0.5)
    size = (8, 6, 3)
    axes = [naive.centres(0, high, edge) for high, edge in zip(size, edges, strict=True)]
    beams = [(at, rpy, sorted(load_sensor(model).beams.elevation_deg)) for model, at, rpy in mounts]
    gaps = [
        [[tuple(naive.digit((x, y, z), *beam) for beam in beams) for z in axes[2]] for y in axes[1]] for x in axes[0]
    ]
    label, count = naive.breadth_first(gaps, np.ones(np.shape(gaps)[:3], bool).tolist())
    spaces = [set(map(tuple, np.argwhere(np.array(label) == number).tolist())) for number in range(count)]
    return max(naive.vsr(cells, edges) for cells in spaces)


@pytest.mark.slow
def test_with_fixed_poses_it_is_what_trying_every_model_gives(tmp_path):
    """Three sensors, each by itself of any model or absent; costs by plain loops."""
    places = [((3, 3, 1.5), (0, 0, 0)), ((6, 2, 1), (0, 0.2, 0)), ((2, 5, 2), (0.3, 0, 1))]
    sensors = ""
    for i, (position, rpy) in enumerate(places):
        at = f"{{position_m: {list(position)}, rpy_rad: {list(rpy)}}}"
        sensors += f"  - {{name: s{i}, {CHOICE}min: {at}, max: {at}}}\n"
    expected = []
    for models in product(("fan-4", "fan-8", "none"), repeat=3):
        mounts = [(model, *place) for model, place in zip(models, places, strict=True) if model != "none"]
        if mounts:
            expected.append((sum(PRICES[model] for model in models), naive_max_vsr(mounts)))
    found = front(study(tmp_path, sensors), threads=2)
    assert pairs_of(found) == [(price, pytest.approx(value, rel=1e-12)) for price, value in undominated(expected)]
    assert len(found.candidates) == found.evaluations == len(expected) == 26
    assert len(found.points) >= 3


@pytest.mark.slow
def test_with_a_height_to_choose_it_is_what_a_fine_grid_gives(tmp_path):
    """One sensor moves up and down, another is fixed; the objective is constant between steps of the grid."""
    moving = "min: {position_m: [3, 3, 0.5], rpy_deg: [0, 10, 0]}, max: {position_m: [3, 3, 2.5], rpy_deg: [0, 10, 0]}"
    fixed = "min: {position_m: [6, 2, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [6, 2, 1], rpy_deg: [0, 0, 0]}"
    sensors = f"  - {{name: a, {CHOICE}{moving}}}\n  - {{name: b, choose: [fan-16, none], {fixed}}}\n"
    loaded = study(tmp_path, sensors, "method: annealing, evaluations: 3000, seed: 2")
    expected = []
    for one in combinations(loaded):
        dimensions = one.study.space.dimensions
        poses = one.study.space.poses(np.linspace(0, 1, 601)[:, None] if dimensions else np.empty((1, 0)))
        expected += [(one.price, objective_of(one.study, row)) for row in poses]
    assert pairs_of(front(loaded, threads=2)) == undominated(expected)


def test_dominance_and_its_ties():
    """Against the definition, with many equal prices and objectives; of equal pairs the first is on the front."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        price = rng.integers(5, size=30).tolist()
        cost = rng.integers(5, size=30).astype(float).tolist()
        front_of = on_front(price, cost)
        chosen = [pair for pair, there in zip(zip(price, cost, strict=True), front_of, strict=True) if there]
        assert sorted(chosen) == undominated(list(zip(price, cost, strict=True)))
        for i in np.flatnonzero(front_of):
            assert (price[i], cost[i]) not in list(zip(price, cost, strict=True))[:i]
    assert on_front([1.0, 2.0, 3.0], [math.inf, 1.0, 1e6]) == [False, True, False]


def test_who_is_next():
    """Worked out by hand: 0 on the front, 2 % above it at 40 % an e-fold, far above it, and not feasible."""
    found = required_growth(np.array([1.0, 2.0, 2.0, 3.0, 4.0]), np.array([1.0, 1.02, 2.0, 0.5, math.inf]))
    np.testing.assert_allclose(found, [0.0, 0.05, math.log(4), 0.0, math.log(4)], rtol=1e-12)


@pytest.mark.slow
def test_each_search_is_the_ordinary_one(tmp_path):
    """As far as its own search came, it is what `optimize` finds; and the front's got the most."""
    search = FrontRun(study(tmp_path), threads=2)
    assert not search.run()
    found = search.result(False)
    assert found.evaluations == 6000 == sum(c.evaluations for c in found.candidates) == found.history[-1].evaluations
    for one in search.searches[::3]:
        alone = optimize(with_solver(one.combination.study, evaluations=one.own.evaluations), threads=1)
        assert alone.objective == one.own.best_cost.objective >= one.objective
    for point in found.points:
        poses = [(*mount.position_m, *mount.rpy_rad) for mount in point.placement.rig.mounts]
        assert objective_of(point.combination.study, np.array(poses)) == point.placement.objective
    even = 6000 / len(found.candidates)
    assert min(point.placement.evaluations for point in found.points) > even
    assert found.dominated_evaluations < even * sum(not one.on_front for one in found.candidates)


@pytest.mark.slow
def test_any_number_of_threads_and_a_resumed_search_give_the_same(tmp_path):
    loaded = study(tmp_path, solver="method: auto, evaluations: 4000, seed: 2")
    whole = front(loaded, threads=1)
    broken = front(with_solver(loaded, evaluations=2345), threads=3, skip=False)
    resumed = front(loaded, threads=3, log=broken.log)
    for found in (front(loaded, threads=3), resumed):
        assert pairs_of(found) == pairs_of(whole)
        assert [one.evaluations for one in found.candidates] == [one.evaluations for one in whole.candidates]
        rigs = [[point.placement.rig for point in each.points] for each in (found, whole)]
        assert rigs[0] == rigs[1]
    assert costs(resumed) == costs(whole)


def test_an_interrupt_keeps_the_front_so_far(tmp_path):
    def interrupt(search):
        if len(search.history) == 4:
            raise KeyboardInterrupt

    found = front(study(tmp_path), threads=2, on_turn=interrupt)
    assert found.interrupted
    assert 1 <= len(found.points) <= 4
    assert sum(one.evaluations == 0 for one in found.candidates) == len(found.candidates) - 4


def test_what_there_is_no_front_of(tmp_path):
    loaded = study(tmp_path)
    with pytest.raises(ConfigError, match="the study has models to choose; `front` searches"):
        optimize(loaded)
    with pytest.raises(ConfigError, match="nothing to choose in the study"):
        front(combinations(loaded)[0].study)
    apart = "constraints: {min_distance_m: 2.99}\nsolver: {"  # of 3 from corner to corner of the bounds
    text = (tmp_path / "study.yaml").read_text().replace("solver: {", apart).replace(", none", "")
    (tmp_path / "study.yaml").write_text(text.replace("evaluations: 6000", "evaluations: 300"))
    with pytest.raises(ConfigError, match="found no rig that keeps the constraints"):
        front(load_study(tmp_path / "study.yaml"))
