"""The bees' phases one by one, against the paper's algorithm 2 and Karaboga's rules."""

import numpy as np
import pytest
from scipy.stats import chisquare

from lidarcfg.solvers.bee_colony import BeeColony
from lidarcfg.solvers.search import Cost, of_objectives


def sphere(x):
    return ((x - 0.3) ** 2).sum(axis=1)


def started(dimensions=4, bees=10, limit=10**9, seed=1):
    colony = BeeColony(dimensions, bees, limit, seed)
    colony.tell(of_objectives(sphere(colony.ask().x)))
    return colony


def test_the_phases_come_in_turn():
    colony = BeeColony(3, 5, 10**9, 1)
    phases = []
    for _ in range(5):
        phases.append((colony.ask().phase, colony.cycles))
        colony.tell(of_objectives(sphere(colony.ask().x)))
    assert phases == [("first", 0), ("employed", 0), ("onlooker", 0), ("employed", 1), ("onlooker", 1)]


def test_asking_twice_asks_the_same():
    colony = started()
    assert np.array_equal(colony.ask().x, colony.ask().x)


def test_first_sources_fill_the_unit_cube_and_start_with_their_costs():
    colony = BeeColony(2, 2000, 5, 3)
    x = colony.ask().x.copy()
    assert x.min() >= 0
    assert x.max() <= 1
    assert x.mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.03)
    colony.tell(of_objectives(sphere(x)))
    assert np.array_equal(colony.cost, of_objectives(sphere(x)))
    assert colony.best_cost == (0, sphere(x).min())


def test_each_employed_bee_moves_one_coordinate_of_its_own_source_between_it_and_another():
    colony = started(bees=40)
    trials = colony.ask()
    assert trials.source.tolist() == list(range(40))
    assert np.array_equal(trials.upper_bound, colony.cost)
    moved = trials.x != colony.x
    assert moved.sum(axis=1).max() == 1
    for row, along in np.argwhere(moved):
        step = abs(trials.x[row, along] - colony.x[row, along])
        others = np.delete(colony.x[:, along], row)
        assert step <= abs(colony.x[row, along] - others).max() + 1e-15


def test_trials_are_clipped_to_the_bounds():
    colony = started(bees=50, seed=5)
    seen = []
    for _ in range(20):
        seen.append(colony.ask().x)
        colony.tell(of_objectives(sphere(seen[-1])))
    x = np.concatenate(seen)
    assert x.min() == 0.0
    assert x.max() == 1.0


def test_greedy_selection_and_counters():
    colony = started(bees=4)
    before_x = colony.x.copy()
    before = colony.cost[:, 1].copy()
    trials = colony.ask()
    told = np.array([before[0] - 0.01, before[1], before[2] + 1, np.inf])
    colony.tell(of_objectives(told))
    assert np.array_equal(colony.x[0], trials.x[0])
    assert np.array_equal(colony.x[1:], before_x[1:])  # an equal cost is no improvement
    assert colony.cost[:, 1].tolist() == [told[0], *before[1:]]
    assert colony.failures.tolist() == [0, 1, 1, 1]


def test_a_success_sets_the_counter_back():
    colony = started(bees=3)
    colony.tell(of_objectives(np.full(3, np.inf)))
    sources = colony.ask().source
    colony.tell(of_objectives(np.where(sources == sources[0], -1.0, np.inf) - np.arange(3) * (sources == sources[0])))
    assert colony.failures[sources[0]] == 0


def test_onlookers_are_drawn_by_fitness():
    colony = BeeColony(2, 4, 10**9, 7)
    colony.tell(of_objectives(np.array([0.0, 1.0, 3.0, 9.0])))  # fit = 1 / (1 + cost) = 1, 1/2, 1/4, 1/10
    drawn = np.bincount(colony.choose(100_000), minlength=4)
    fit = np.array([1, 0.5, 0.25, 0.1])
    assert chisquare(drawn, 100_000 * fit / fit.sum()).pvalue > 1e-3


def test_the_onlooker_phase_uses_the_roulette():
    colony = BeeColony(2, 500, 10**9, 7)
    colony.tell(of_objectives(np.where(np.arange(500) < 10, 0.0, 1e6)))
    colony.tell(of_objectives(np.full(500, np.inf)))
    trials = colony.ask()
    assert trials.phase == "onlooker"
    assert np.isin(trials.source, range(10)).mean() > 0.99


def test_trials_of_a_phase_are_told_in_order():
    colony = started(bees=2, seed=2)
    colony.tell(of_objectives(np.full(2, np.inf)))
    while len(set(colony.ask().source.tolist())) > 1:  # until both onlookers choose the same source
        colony.tell(of_objectives(np.full(2, np.inf)))
    trials = colony.ask()
    source = colony.ask().source[0]
    colony.tell(of_objectives(np.array([-1.0, -0.5])))  # the second beats the source as drawn, not as it stands
    assert colony.cost[source, 1] == -1.0
    assert np.array_equal(colony.x[source], trials.x[0])
    assert colony.failures[source] == 1


def test_scouts_replace_exactly_the_exhausted_sources():
    colony = started(bees=6, limit=2)
    colony.best_cost = Cost(0.0, -1.0)  # so that a scout's luck does not hide that the best is kept apart
    colony.tell(of_objectives(np.where(np.arange(6) == 3, -0.5, np.inf)))
    onlookers = np.bincount(
        colony.ask().source, minlength=6
    )  # all fail; before, all employed bees but that of source 3
    exhausted = np.flatnonzero((np.arange(6) != 3) + onlookers >= 2)
    colony.tell(of_objectives(np.full(6, np.inf)))
    trials = colony.ask()
    assert trials.phase == "scout"
    assert 0 < len(exhausted) < 6
    assert trials.source.tolist() == exhausted.tolist()
    assert trials.upper_bound.tolist() == [[np.inf, np.inf]] * len(exhausted)
    x = colony.x.copy()
    cost = colony.cost.copy()
    colony.tell(of_objectives(np.full(len(exhausted), 7.0)))  # worse than before, and taken all the same
    kept = np.setdiff1d(range(6), exhausted)
    assert np.array_equal(colony.x[exhausted], trials.x)
    assert (colony.cost[exhausted] == (0.0, 7.0)).all()
    assert (colony.failures[exhausted] == 0).all()
    assert np.array_equal(colony.x[kept], x[kept])
    assert np.array_equal(colony.cost[kept], cost[kept])
    assert colony.best_cost == (0, -1)
    assert colony.cycles == 1


def test_it_finds_the_minimum_of_a_bowl():
    colony = BeeColony(5, 30, 150, 1)
    for _ in range(300):
        colony.tell(of_objectives(sphere(colony.ask().x)))
    assert colony.best_cost < (0, 1e-6)
    assert colony.best_x == pytest.approx([0.3] * 5, abs=1e-2)
    assert sphere(colony.best_x[None])[0] == colony.best_cost.objective
