"""The solvers behind ask and tell: they minimise, repeat by their seed, and leave the world alone."""

import numpy as np
import pytest

from lidarcfg.placement.auto import Auto
from lidarcfg.placement.bee_colony import BeeColony
from lidarcfg.placement.cma_es import CmaEs
from lidarcfg.placement.differential_evolution import DifferentialEvolution

SOLVERS = {
    "abc": lambda dimensions, seed: BeeColony(dimensions, 20, 20 * dimensions, seed),
    "cmaes": CmaEs,
    "de": DifferentialEvolution,
    "auto": Auto,
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
def test_they_find_the_bottom_of_a_bowl(name):
    solver = SOLVERS[name](4, 1)
    x = run(solver, bowl, 8000)
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
    solver = Auto(3, 1)
    points = solver.ask().x
    assert len(points) == 200
    solver.tell(bowl(points))
    best = points[bowl(points).argmin()]
    assert np.abs(solver.ask().x - best).mean() < 0.15
    assert solver.best_cost == bowl(points).min()


def test_autos_later_runs_have_larger_populations():
    solver, sizes = Auto(2, 1), []
    while len(sizes) < 6:
        size = len(solver.ask().x)
        if size == 200:
            solver.tell(bowl(solver.ask().x))
            sizes.append(len(solver.ask().x))
        else:
            solver.tell(bowl(solver.ask().x))
    assert [size // sizes[0] for size in sizes] == [1, 1, 2, 2, 4, 4]
