"""The chains' steps one by one, against the rule of Metropolis."""

import numpy as np
import pytest
from scipy.stats import kstest

from lidarcfg.placement.solvers.annealing import Annealing, AnnealingRestarts

GROUPS = np.array([0, 0, 0, 2, 2, 7])


def sphere(x):
    return 1 + ((x - 0.3) ** 2).sum(axis=1)


def started(groups=GROUPS, trials=10**9, seed=1):
    run = Annealing(groups, np.random.default_rng(seed), trials)
    run.tell(sphere(run.ask().x))
    return run


def test_chains_begin_at_random_points_and_go_there_whatever_they_cost():
    run = Annealing(GROUPS, np.random.default_rng(2), 10**9)
    begin = run.ask()
    assert np.isinf(begin.to_beat).all()
    run.tell(np.where(np.arange(32) % 2, np.inf, 5.0))
    assert np.array_equal(run.sources, begin.x)
    beat = run.ask().to_beat.reshape(32, 4)
    assert np.isinf(beat[1::2]).all()
    assert (beat[::2] > 5).all()


def test_a_trial_moves_coordinates_of_one_group():
    run = started()
    asked = run.ask()
    assert asked.source.tolist() == [chain for chain in range(32) for _ in range(4)]
    moved = asked.x != run.sources[asked.source]
    assert moved.any(axis=1).all()
    groups = [set(GROUPS[row].tolist()) for row in moved]
    assert {len(one) for one in groups} == {1}
    assert {number for one in groups for number in one} == {0, 2, 7}


def test_what_a_trial_has_to_beat_is_drawn_from_the_rule_of_metropolis():
    """One that costs r times as much is taken with probability r^(−1/T): Metropolis on the logarithm of the cost."""
    run = started()
    uphill = []
    for _ in range(100):
        asked = run.ask()
        uphill.append(np.log(asked.to_beat / sphere(run.sources[asked.source])) / run.temperature)
        run.tell(np.full(len(asked.x), np.inf))
    drawn = np.concatenate(uphill)
    assert kstest(drawn, "expon").pvalue > 1e-3
    ratio = 1 + run.temperature / 2
    taken = np.log(ratio) / run.temperature < drawn
    assert taken.mean() == pytest.approx(ratio ** (-1 / run.temperature), abs=0.02)


def test_the_first_trial_that_a_chain_takes_moves_it():
    run = started()
    before, asked = run.sources.copy(), run.ask()
    cost = np.full(128, np.inf)
    cost[9], cost[10] = asked.to_beat[9] * 0.999, 0.5  # both of chain 2
    cost[20] = asked.to_beat[20]  # of chain 5, and no better than what it had to beat
    run.tell(cost)
    assert np.array_equal(run.sources[2], asked.x[9])
    assert np.array_equal(np.delete(run.sources, 2, axis=0), np.delete(before, 2, axis=0))
    assert run.mean_cost == pytest.approx((sphere(before).sum() - sphere(before[2:3])[0] + cost[9]) / 32)


def test_half_of_the_steps_are_differences_of_two_chains():
    """All chains on a line: a difference stays on it, but for its jitter; a Gaussian step does not."""
    line = np.linspace(0.4, 0.6, 32)[:, None] * np.ones(2)
    run = Annealing(np.zeros(2, int), np.random.default_rng(4), 10**9, line)
    assert np.array_equal(run.ask().x, line)
    run.tell(np.ones(32))
    off = []
    for _ in range(20):
        step = run.ask().x - run.sources[run.ask().source]
        off.append(np.abs(step[:, 0] - step[:, 1]))
        run.tell(np.full(128, np.inf))
    assert (np.concatenate(off) < 1e-3).mean() == pytest.approx(0.5, abs=0.1)


def test_the_worst_chains_go_on_from_where_the_best_are():
    run = Annealing(GROUPS, np.random.default_rng(3), 32 + 128 * 19)
    begin = run.ask().x
    run.tell(1.0 + np.arange(32))
    while np.array_equal(run.sources, begin):
        run.tell(np.full(len(run.ask().x), np.inf))
    assert np.array_equal(run.sources[:29], begin[:29])
    assert {tuple(row) for row in run.sources[29:]} == {tuple(row) for row in begin[:3]}
    assert run.mean_cost == pytest.approx((np.arange(1, 30).sum() + 1 + 2 + 3) / 32)


def test_it_cools_evenly_from_three_hundredths_to_half_a_thousandth():
    run, log_t = started(trials=32 + 128 * 100), []
    while not run.over:
        log_t.append(np.log(run.temperature))
        run.tell(np.full(128, np.inf))
    log_t.append(np.log(run.temperature))
    assert len(log_t) == 101
    assert np.exp(log_t[0]) == pytest.approx(0.03, rel=0.02)
    assert np.exp(log_t[-1]) == pytest.approx(0.0005)
    assert np.diff(log_t) == pytest.approx(np.full(100, log_t[1] - log_t[0]))


def test_restarts_take_twice_as_long():
    solver, sizes = AnnealingRestarts(np.array([0, 1]), 1), []
    while sum(size == 32 for size in sizes) < 3:
        sizes.append(len(solver.ask().x))
        solver.tell(sphere(solver.ask().x))
    first, second = np.diff(np.flatnonzero(np.array(sizes) == 32))
    assert 8000 <= 32 + 128 * (first - 1) < 8000 + 128  # 4000 a dimension
    assert 16000 <= 32 + 128 * (second - 1) < 16000 + 128
    assert solver.cycles == len(sizes)


def test_it_climbs_out_of_basins():
    """Rastrigin's function: 11^4 valleys, one of them the deepest, at 1."""
    run, found = Annealing(np.arange(4), np.random.default_rng(3), 40000), np.inf
    while not run.over:
        y = 10.24 * (run.ask().x - 0.4)
        cost = 1 + (y**2 - 10 * np.cos(2 * np.pi * y) + 10).sum(axis=1)
        found = min(found, cost.min())
        run.tell(cost)
    assert found < 1.01
