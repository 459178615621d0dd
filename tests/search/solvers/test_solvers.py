"""The solvers behind ask and tell: they minimise, repeat by their seed, and leave the world alone."""

import numpy as np
import pytest

from lidarcfg.solvers import SOLVERS, solver_of
from lidarcfg.solvers.auto import Auto
from lidarcfg.solvers.cma_es import CmaEs, ranked
from lidarcfg.solvers.search import Coordinates, cost_of, is_below, least, of_objectives, order


def pairs(dimensions):
    """Groups of two coordinates, the first of which mean the same, and the second."""
    number = np.arange(dimensions)
    return Coordinates(number // 2, number % 2)


def begun(name, dimensions, seed):
    """A search by a solver of the table."""
    keys = {"method": name, "seed": seed} | ({"bees": 20} if name == "abc" else {})
    return solver_of(name).model_validate(keys).begin(pairs(dimensions))


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
        solver.tell(of_objectives(cost))
        told += len(cost)
    return np.concatenate(seen)


def test_costs_compare_as_pairs():
    """As Python's tuples do."""
    rng = np.random.default_rng(1)
    cost = np.where(rng.random((60, 2)) < 0.3, np.inf, rng.integers(3, size=(60, 2)))
    rows = [tuple(row) for row in cost.tolist()]
    assert order(cost).tolist() == sorted(range(60), key=lambda i: rows[i])
    assert least(cost) == rows.index(min(rows))
    assert is_below(cost[:30], cost[30:]).tolist() == [a < b for a, b in zip(rows[:30], rows[30:], strict=True)]
    assert [cost_of(row) for row in cost] == rows
    found = [row if row[0] == 0 and row[1] < np.inf else (row[0] or np.inf, np.inf) for row in rows]
    number = ranked(np.array(found))
    assert sorted(range(60), key=lambda i: found[i]) == sorted(range(60), key=lambda i: number[i])


def walled(x):
    """A bowl beyond a wall: what is left of 0.6 falls short by its distance, whatever lies there."""
    shortfall = np.maximum(0.6 - x[:, 0], 0.0)
    return np.stack([shortfall, np.where(shortfall > 0, np.inf, bowl(x))], axis=1)


@pytest.mark.parametrize("name", SOLVERS)
def test_they_first_end_the_shortfall_then_find_the_bottom(name):
    """The bowl's is at (0.3, 0.4), the best that does not fall short at (0.6, 0.4): 0.09 above."""
    solver = begun(name, 2, 1)
    told = 0
    while told < 20_000:
        x = solver.ask().x
        solver.tell(walled(x))
        told += len(x)
    assert solver.best_cost.shortfall == 0
    assert solver.best_cost.objective == pytest.approx(0.09, abs=0.002)
    assert solver.best_x == pytest.approx([0.6, 0.4], abs=0.01)


@pytest.mark.parametrize("name", SOLVERS)
def test_one_dimension_is_enough(name):
    solver = begun(name, 1, 1)
    x = run(solver, bowl, 2000)
    assert x.shape[1] == len(solver.best_x) == 1
    assert solver.best_x == pytest.approx([0.3], abs=0.01)


@pytest.mark.parametrize("name", SOLVERS)
def test_they_find_the_bottom_of_a_bowl(name):
    solver = begun(name, 4, 1)
    x = run(solver, bowl, 60_000 if name == "annealing" else 9000)  # a round of annealing ends cold
    assert solver.best_cost < (0, 1e-3)
    assert solver.best_x == pytest.approx([0.3, 0.4, 0.5, 0.6], abs=0.05)
    assert solver.best_cost == (0, bowl(x).min())
    assert np.array_equal(solver.best_x, x[bowl(x).argmin()])
    assert solver.cycles > 0
    assert np.isfinite(solver.mean_cost)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_seed_gives_the_same_run(name):
    runs = [run(begun(name, 3, seed), bowl, 4500) for seed in (5, 5, 6)]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0][:100], runs[2][:100])


@pytest.mark.parametrize("name", SOLVERS)
def test_numpys_own_generator_is_left_alone(name):
    np.random.seed(3)  # noqa: NPY002  # the very thing that must not be touched
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    run(begun(name, 3, 1), bowl, 500)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


@pytest.mark.parametrize("name", SOLVERS)
def test_a_flat_objective_ends_no_search(name):
    assert len(run(begun(name, 2, 1), lambda x: np.zeros(len(x)), 5000)) >= 5000


def test_cma_es_ends_where_it_has_converged():
    """From a corner, at the bottom of the bowl; and at once where all costs are equal."""
    run = CmaEs(np.zeros(2), 1, 0.25, 6)
    told = 0
    while not run.over:
        x = run.ask().x
        assert len(x) == 6
        run.tell(of_objectives(bowl(x)))
        told += 1
    assert run.best_x == pytest.approx([0.3, 0.4], abs=1e-4)
    flat = CmaEs(np.full(2, 0.5), 1, 0.25, 6)
    while not flat.over:
        flat.tell(of_objectives(np.zeros(6)))
        told -= 1
    assert told > 0


def test_auto_walks_from_the_best_of_its_points():
    solver = Auto(Coordinates(np.zeros(3, int), np.arange(3)), 1)
    points = solver.ask().x
    assert len(points) == 200
    solver.tell(of_objectives(bowl(points)))
    best = points[bowl(points).argmin()]
    assert np.abs(solver.ask().x - best).mean() < 0.15
    assert solver.best_cost == (0, bowl(points).min())


@pytest.mark.parametrize("flat", [True, False])  # CMA-ES gives up where all costs are equal
def test_auto_is_one_run_of_cma_es_and_rounds_of_annealing(flat):
    """200 evaluations a dimension of CMA-ES at most. Its best is refined, then rounds begin at random points."""
    solver = Auto(pairs(8), 1)
    dimensions = 8
    solver.tell(of_objectives(bowl(solver.ask().x)))
    spent = 0
    while len(solver.ask().x) == 30:
        asked = solver.ask().x
        solver.tell(of_objectives(np.zeros(30) if flat else np.cos(1e6 * asked).sum(axis=1)))
        spent += 30
    assert spent < 200 * dimensions if flat else 0 <= spent - 200 * dimensions < 30
    assert np.array_equal(solver.ask().x, np.tile(solver.best_x, (16, 1)))
    annealed = 0
    while not annealed or np.isfinite(solver.ask().upper_bound).all():
        trials = len(solver.ask().x)
        cost = np.inf if annealed else 1.0
        work = 1 if annealed else 11
        solver.tell(of_objectives(np.full(trials, cost)))
        annealed += trials * work
    assert annealed == pytest.approx(250 * dimensions, abs=128)
    assert len(np.unique(solver.ask().x, axis=0)) == 48
