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
    seen, told = [], 0
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
    x = run(solver, bowl, 40_000 if name == "annealing" else 8000)  # a round of annealing ends cold
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


def test_auto_is_cma_es_and_four_rounds_of_annealing_in_turns():
    solver = Auto(pairs(2), 1)
    for turn in (1, 2):  # 1000 evaluations a dimension, and 10,000 a round; twice as many in the second turn
        sizes = []
        while (size := len(solver.ask().x)) != (32, 64)[
            turn - 1
        ]:  # where chains that refine, or those of a round, begin
            sizes.append(size)
            solver.tell(bowl(solver.ask().x))
        first = sizes.index(6)  # the usual population of two dimensions, which is doubled again and again
        assert sizes[:first] == [200] + [30] * (first - 1)
        assert sizes[first:] == sorted(sizes[first:])
        runs = sorted(set(sizes[first:]))
        assert runs == [6 * 2**n for n in range(len(runs))]
        assert sum(sizes) - runs[-1] * sizes.count(runs[-1]) < 2000 * turn <= sum(sizes)
        best, many, annealed = solver.best_x, 0, 0
        if turn == 1:
            assert np.array_equal(solver.ask().x, np.tile(best, (32, 1)))
        while (size := len(solver.ask().x)) != 200:
            many += size == 64 and np.isinf(solver.ask().to_beat).all()
            annealed += size
            solver.tell(bowl(solver.ask().x))
        assert many == 2  # of the four rounds
        assert 4 * 20000 * turn * 0.98 < annealed < (4 * 28000 * turn + 8000) * 1.02  # refining takes 8000


def test_lshade_restarts_with_twice_the_evaluations():
    """4000 a dimension at first; every run starts with 18 random points a dimension."""
    solver, told = LshadeRestarts(2, 1), []
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
    used, best = 0, np.inf
    while not solver.over:
        asked = solver.ask()
        assert len(asked.x) == (max(4, round(72 - 68 * used / 6000)) if used else 72)
        assert np.isfinite(asked.to_beat).all() == (used > 0)
        cost = bowl(asked.x)
        cost[cost >= asked.to_beat] = np.inf  # all that an evaluator says of them
        solver.tell(cost)
        used, best = used + len(asked.x), min(best, cost.min())
        assert np.array_equal(bowl(solver.sources[asked.source]), np.minimum(cost, asked.to_beat))
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
