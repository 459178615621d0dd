"""The solvers behind ask and tell: they minimise, repeat by their seed, and leave the world alone."""

import itertools

import numpy as np
import pytest

from lidarcfg.placement.solvers.annealing import AnnealingRounds
from lidarcfg.placement.solvers.auto import Auto
from lidarcfg.placement.solvers.bee_colony import BeeColony
from lidarcfg.placement.solvers.cma_es import CmaEs
from lidarcfg.placement.solvers.lshade import Lshade, LshadeRestarts
from lidarcfg.placement.solvers.search import Coordinates


def pairs(dimensions):
    """Groups of two coordinates, the first of which mean the same, and the second."""
    number = np.arange(dimensions)
    return Coordinates(number // 2, number % 2)


SOLVERS = {
    "abc": lambda dimensions, seed: BeeColony(dimensions, 20, 20 * dimensions, seed),
    "cmaes": CmaEs,
    "de": LshadeRestarts,
    "annealing": lambda dimensions, seed: AnnealingRounds(pairs(dimensions), seed),
    "auto": lambda dimensions, seed: Auto(pairs(dimensions), seed),
}


def bowl(x):
    """Least at 0.3 + 0.1 i, where it is 0; narrow in one direction."""
    target = 0.3 + 0.1 * np.arange(x.shape[1])
    return ((x - target) ** 2 * 10.0 ** np.arange(x.shape[1])).sum(axis=1)


def run(solver, function, trials):
    seen = []
    told = 0
    while told < trials:
        asked = solver.ask()
        assert asked.x.min() >= 0
        assert asked.x.max() <= 1
        assert asked.source.max() < len(solver.sources)
        cost = function(asked.x)
        seen.append(asked.x.copy())
        solver.tell(cost)
        told += len(cost)
    return np.concatenate(seen)


@pytest.mark.parametrize("name", SOLVERS)
def test_one_dimension_is_enough(name):
    solver = SOLVERS[name](1, 1)
    x = run(solver, bowl, 2000)
    assert x.shape[1] == len(solver.best_x) == 1
    assert solver.best_x == pytest.approx([0.3], abs=0.01)


@pytest.mark.parametrize("name", SOLVERS)
def test_they_find_the_bottom_of_a_bowl(name):
    solver = SOLVERS[name](4, 1)
    x = run(solver, bowl, 60_000 if name == "annealing" else 9000)  # a round of annealing ends cold
    assert solver.best_cost < 1e-3
    assert solver.best_x == pytest.approx([0.3, 0.4, 0.5, 0.6], abs=0.05)
    assert solver.best_cost == bowl(x).min()
    assert np.array_equal(solver.best_x, x[bowl(x).argmin()])
    assert solver.cycles > 0
    assert np.isfinite(solver.mean_cost)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_seed_gives_the_same_run(name):
    runs = [run(SOLVERS[name](3, seed), bowl, 4500) for seed in (5, 5, 6)]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0][:100], runs[2][:100])


@pytest.mark.parametrize("name", SOLVERS)
def test_numpys_own_generator_is_left_alone(name):
    np.random.seed(3)  # noqa: NPY002  # the very thing that must not be touched
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    run(SOLVERS[name](3, 1), bowl, 500)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


@pytest.mark.parametrize("name", SOLVERS)
def test_a_flat_objective_ends_no_search(name):
    assert len(run(SOLVERS[name](2, 1), lambda x: np.zeros(len(x)), 5000)) >= 5000


def test_cma_es_begins_anew_with_twice_the_population():
    solver = CmaEs(2, 1)
    sizes = []
    while len(set(sizes)) < 3:
        sizes.append(len(solver.ask().x))
        solver.tell(bowl(solver.ask().x))
    first, second, third = sorted(set(sizes))
    assert (second, third) == (2 * first, 4 * first)
    assert sizes == sorted(sizes)


def test_auto_walks_from_the_best_of_its_points():
    solver = Auto(Coordinates(np.zeros(3, int), np.arange(3)), 1)
    points = solver.ask().x
    assert len(points) == 200
    solver.tell(bowl(points))
    best = points[bowl(points).argmin()]
    assert np.abs(solver.ask().x - best).mean() < 0.15
    assert solver.best_cost == bowl(points).min()


@pytest.mark.parametrize("flat", [True, False])  # CMA-ES gives up where all costs are equal
def test_auto_is_one_run_of_cma_es_and_rounds_of_annealing(flat):
    """200 evaluations a dimension of CMA-ES at most. Its best is refined, then rounds begin at random points."""
    solver = Auto(pairs(8), 1)
    dimensions = 8
    solver.tell(bowl(solver.ask().x))
    spent = 0
    while len(solver.ask().x) == 30:
        asked = solver.ask().x
        solver.tell(np.zeros(30) if flat else np.cos(1e6 * asked).sum(axis=1))
        spent += 30
    assert spent < 200 * dimensions if flat else 0 <= spent - 200 * dimensions < 30
    assert np.array_equal(solver.ask().x, np.tile(solver.best_x, (16, 1)))
    annealed = 0
    while not annealed or np.isfinite(solver.ask().upper_bound).all():
        trials = len(solver.ask().x)
        cost = np.inf if annealed else 1.0
        work = 1 if annealed else 11
        solver.tell(np.full(trials, cost))
        annealed += trials * work
    assert annealed == pytest.approx(250 * dimensions, abs=128)
    assert len(np.unique(solver.ask().x, axis=0)) == 48


def test_lshade_restarts_with_twice_the_evaluations():
    """4000 a dimension at first; every run starts with 18 random points a dimension."""
    solver = LshadeRestarts(2, 1)
    told = []
    while sum(told) < 8000 + 16000 + 36:
        told.append(len(solver.ask().x))
        solver.tell(bowl(solver.ask().x))
    starts = [n for n, size in enumerate(told) if size == 36 and (n == 0 or told[n - 1] == 4)]
    assert len(starts) == 3
    first, second = (sum(told[a:b]) for a, b in itertools.pairwise(starts))
    assert 8000 <= first < 8004
    assert 16000 <= second < 16004
    assert solver.cycles == len(told)


def test_lshade_shrinks_to_four_points_that_lie_deep():
    """18 points a dimension at first, 4 at the end, in a straight line between (Tanabe and Fukunaga 2014, eq. 10)."""
    solver = Lshade(4, np.random.default_rng(1), 6000)
    used = 0
    best = np.inf
    while not solver.over:
        asked = solver.ask()
        assert len(asked.x) == (max(4, round(72 - 68 * used / 6000)) if used else 72)
        assert np.isfinite(asked.upper_bound).all() == (used > 0)
        cost = bowl(asked.x)
        cost[cost >= asked.upper_bound] = np.inf  # all that an evaluator says of them
        solver.tell(cost)
        used = used + len(asked.x)
        best = min(best, cost.min())
        assert np.array_equal(bowl(solver.sources[asked.source]), np.minimum(cost, asked.upper_bound))
    assert used >= 6000
    assert best < 1e-6


def test_lshade_learns_what_paid():
    """Weighted Lehmer means over the trials that beat their points (eq. 7 to 9), by hand."""
    solver = Lshade(2, np.random.default_rng(2), 10000)
    solver.tell(np.ones(36))
    f, cr = solver._drawn
    cost = np.full(len(f), 2.0)
    cost[[3, 8]] = 0.5, 0.75  # gains 0.5 and 0.25
    solver.tell(cost)
    assert solver._f[0] == pytest.approx((2 * f[3] ** 2 + f[8] ** 2) / (2 * f[3] + f[8]))
    assert solver._cr[0] == pytest.approx((2 * cr[3] ** 2 + cr[8] ** 2) / (2 * cr[3] + cr[8]))
    assert solver._f[1:].tolist() == [0.5] * 5


def test_lshade_finds_what_hides_among_hills():
    """Rastrigin's function: 11^4 valleys, one of them the deepest."""

    def hills(x):
        y = 10.24 * (x - 0.4)
        return (y**2 - 10 * np.cos(2 * np.pi * y) + 10).sum(axis=1)

    solver = Lshade(4, np.random.default_rng(3), 20000)
    found = np.inf
    while not solver.over:
        cost = hills(solver.ask().x)
        found = min(found, cost.min())
        solver.tell(cost)
    assert found < 1e-6
