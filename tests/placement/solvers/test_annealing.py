"""The chains' steps one by one, against the rule of Metropolis and the rules of the rounds."""

import numpy as np
import pytest
from scipy.stats import kstest

from lidarcfg.placement.solvers import annealing
from lidarcfg.placement.solvers.annealing import LEARNING, MANY, ONE, OWN, Annealing, AnnealingRounds
from lidarcfg.placement.solvers.search import Coordinates

GROUPS = np.array([0, 0, 0, 2, 2, 7])
COORDINATES = Coordinates(GROUPS, np.array([1, 2, 3, 1, 3, 9]))  # the first two groups have two kinds in common
ALIKE = Coordinates(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]))
PAIR = Coordinates(np.array([0, 1]), np.array([0, 0]))


def sphere(x):
    return 1 + ((x - 0.3) ** 2).sum(axis=1)


def started(coordinates=COORDINATES, trials=10**9, seed=1, shape=MANY, start=None):
    run = Annealing(coordinates, np.random.default_rng(seed), trials, shape, start)
    run.tell(sphere(run.ask().x))
    return run


def test_chains_begin_at_random_points_and_go_there_whatever_they_cost():
    run = Annealing(COORDINATES, np.random.default_rng(2), 10**9)
    begin = run.ask()
    assert begin.x.shape == (64, 6)
    assert np.isinf(begin.to_beat).all()
    run.tell(np.where(np.arange(64) % 2, np.inf, 5.0))
    assert np.array_equal(run.sources, begin.x)
    asked = run.ask()
    assert np.isinf(asked.to_beat[asked.source % 2 == 1]).all()
    assert (asked.to_beat[asked.source % 2 == 0] > 5).all()


def test_a_trial_moves_coordinates_of_one_group():
    run = started()
    run.tell(np.full(64, np.inf))
    asked = run.ask()
    moved = asked.x != run.sources[asked.source]
    assert moved.any(axis=1).all()
    groups = [set(GROUPS[row].tolist()) for row in moved]
    assert {len(one) for one in groups} == {1}
    assert {number for one in groups for number in one} == {0, 2, 7}


@pytest.mark.parametrize(("taken", "trials"), [(64, 1), (33, 1), (24, 1), (16, 2), (5, 6), (4, 8), (1, 8), (0, 8)])
def test_the_fewer_trials_are_taken_the_more_of_them_a_chain_has_at_a_time(taken, trials):
    """So many that one in two chains takes one; up to 8."""
    run = started()
    run.tell(np.where(np.arange(64) < taken, 0.5, np.inf))
    assert run.ask().source.tolist() == [chain for chain in range(64) for _ in range(trials)]


def test_what_a_trial_has_to_beat_is_drawn_from_the_rule_of_metropolis():
    """One that costs r times as much is taken with probability r^(−1/T): Metropolis on the logarithm of the cost."""
    run = started()
    uphill = []
    for _ in range(50):
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
    run.tell(np.full(64, np.inf))
    before, asked = run.sources.copy(), run.ask()
    cost = np.full(512, np.inf)
    cost[17], cost[18] = asked.to_beat[17] * 0.999, 0.5  # both of chain 2
    cost[40] = asked.to_beat[40]  # of chain 5, and no better than what it had to beat
    run.tell(cost)
    assert np.array_equal(run.sources[2], asked.x[17])
    assert np.array_equal(np.delete(run.sources, 2, axis=0), np.delete(before, 2, axis=0))
    assert run.mean_cost == pytest.approx((sphere(before).sum() - sphere(before[2:3])[0] + cost[17]) / 64)


def test_half_of_the_other_steps_are_differences_of_two_chains_of_the_island(monkeypatch):
    """Islands on parallel lines: a difference of their chains goes along them, but for its jitter."""
    monkeypatch.setattr(annealing, "LEARNING", 0.0)
    run = Annealing(Coordinates(np.zeros(2, int), np.arange(2)), np.random.default_rng(4), 10**9)
    run.tell(np.ones(64))
    run.tell(np.full(64, np.inf))
    run.sources[:] = np.linspace(0.4, 0.6, 64)[:, None] + np.arange(64)[:, None] // 8 * (0.01, -0.01)
    off = []
    for _ in range(20):
        run.tell(np.full(len(run.ask().x), np.inf))
        step = run.ask().x - run.sources[run.ask().source]
        off.append(np.abs(step[:, 0] - step[:, 1]))
    assert (np.concatenate(off) < 1e-3).mean() == pytest.approx(0.5, abs=0.1)


def learned(coordinates, monkeypatch):
    """Steps that take over coordinates: (chain, coordinate) of each, and of where it was in the island; and the trials.

    Every coordinate of every chain is another number, and Gaussian steps are tiny, so that this can be seen.
    """
    monkeypatch.setattr(annealing, "LEAST", 1e-12)
    monkeypatch.setattr(annealing, "MOST", 1e-12)
    run, steps, trials = Annealing(coordinates, np.random.default_rng(5), 10**9, (4, 4)), [], 0
    count = len(coordinates)
    run.tell(np.ones(16))
    run.sources[:] = np.random.default_rng(6).permutation(np.linspace(0.05, 0.95, 16 * count)).reshape(16, count)
    run.tell(np.full(16, np.inf))
    for _ in range(40):
        asked = run.ask()
        for x, chain in zip(asked.x, asked.source, strict=True):
            trials += 1
            first = chain - chain % 4
            near = [np.argwhere(np.abs(run.sources[first : first + 4] - value) < 1e-9) for value in x]
            moved = np.flatnonzero(np.abs(x - run.sources[chain]) > 1e-9)
            if moved.size and all(len(near[c]) for c in moved):
                steps.append([((chain, int(c)), (first + int(near[c][0, 0]), int(near[c][0, 1]))) for c in moved])
        run.tell(np.full(len(asked.x), np.inf))
    return steps, trials


def test_a_group_takes_over_coordinates_from_another_one_of_its_chain_or_of_a_second(monkeypatch):
    steps, trials = learned(ALIKE, monkeypatch)
    own = 0
    for step in steps:
        assert {to[1] // 2 for to, _ in step} in ({0}, {1})
        assert all(taken[1] == (to[1] + 2) % 4 for to, taken in step)
        assert len({taken[0] for _, taken in step}) == 1
        own += all(to[0] == taken[0] for to, taken in step)
    assert len(steps) / trials == pytest.approx(LEARNING, abs=0.03)
    assert own / len(steps) == pytest.approx(OWN, abs=0.04)
    assert np.mean([len(step) for step in steps]) == pytest.approx((2 * 0.36 + 2 * 0.24 + 0.16 * 2), abs=0.05)


def test_what_means_the_same_nowhere_else_is_taken_over_from_a_second_chain(monkeypatch):
    steps, _ = learned(COORDINATES, monkeypatch)
    seen = {(to[1], taken[1]) for step in steps for to, taken in step}
    assert seen == {(0, 3), (2, 4), (3, 0), (4, 2)} | {(c, c) for c in range(6)}
    assert all(to[0] != taken[0] for step in steps for to, taken in step if to[1] == taken[1])


def test_the_worst_chains_of_an_island_go_on_from_where_its_best_is():
    run = Annealing(COORDINATES, np.random.default_rng(3), 10**6)
    begin = run.ask().x
    run.tell(1.0 + np.arange(64))
    while np.array_equal(run.sources, begin):
        run.tell(np.full(len(run.ask().x), np.inf))
    for island in range(8):
        assert np.array_equal(run.sources[8 * island : 8 * island + 7], begin[8 * island : 8 * island + 7])
        assert np.array_equal(run.sources[8 * island + 7], begin[8 * island])


def test_the_worse_half_of_the_islands_is_given_up_three_times():
    """By their best chains, which cost 1 … 8; after 30, 38 and 46 % of a chain's trials."""
    run, left, trials = Annealing(COORDINATES, np.random.default_rng(3), 200_000), [], 0
    island = np.arange(64) // 8 * 3 % 8  # so that the order of costs is not that of the islands
    run.tell(np.where(np.arange(64) % 8 == 5, 1.0 + island, 90.0 - island))  # by the mean the order is another
    while not run.over:
        asked = run.ask()
        left.append(sorted(set(island[asked.source].tolist())))
        trials += len(asked.x)
        run.tell(np.full(len(asked.x), np.inf))
    assert trials == pytest.approx(200_000, rel=0.005)
    expected = [list(range(8)), [0, 1, 2, 3], [0, 1], [0]]
    assert [one for n, one in enumerate(left) if n == 0 or left[n - 1] != one] == expected
    fraction = [left.count(one) / len(left) for one in expected]
    assert fraction == pytest.approx([0.3, 0.08, 0.08, 0.54], abs=0.01)


@pytest.mark.parametrize("shape", [MANY, ONE])
@pytest.mark.parametrize(("start", "hot"), [(None, 0.04), (np.full(6, 0.5), 0.004)])
def test_it_cools_evenly_by_a_chain_s_trials_to_half_a_thousandth(shape, start, hot):
    run, log_t, tries = started(trials=20_000, shape=shape, start=start), [], []
    taken = np.random.default_rng(1)  # now many, now few, so that chains have more or fewer trials at a time
    while not run.over:
        asked = run.ask()
        log_t.append(np.log(run.temperature))
        tries.append(len(asked.x) / len(np.unique(asked.source)))
        run.tell(np.where(taken.random(len(asked.x)) < taken.random(), 0.5, np.inf))
    log_t.append(np.log(run.temperature))
    step = np.diff(log_t) / tries
    assert len(set(tries)) > 3
    assert np.exp(log_t[0] - step[0]) == pytest.approx(hot)  # the points where chains begin count as one trial each
    assert np.exp(log_t[-1]) == pytest.approx(0.0005)
    assert step[:-1] == pytest.approx(np.full(len(step) - 1, step[0]))
    assert step[0] <= step[-1] <= 0  # the last trials may be more than are left


def test_a_run_from_a_point_has_all_of_its_chains_there():
    start = np.linspace(0.1, 0.9, 6)
    run = Annealing(COORDINATES, np.random.default_rng(3), 50_000, ONE, start)
    assert np.array_equal(run.ask().x, np.tile(start, (32, 1)))
    run.tell(np.ones(32))
    trials = 0
    while not run.over:
        trials += len(run.ask().x)
        run.tell(np.full(len(run.ask().x), np.inf))
    assert trials == pytest.approx(50_000, rel=0.005)


def test_four_rounds_are_of_one_length_and_the_best_end_so_far_is_refined():
    """10,000 trials a dimension, refining 4000; in the fifth twice as many. Every other round has one island of 32."""
    solver, runs = AnnealingRounds(PAIR, 1), []
    ends = (5.0, 6.0, 4.0, 4.5, 3.0)  # the first, the third and the fifth are the best so far
    while solver.rounds < 5:
        asked = solver.ask()
        if np.isinf(asked.to_beat).all():
            runs.append([len(asked.x), 0])
        runs[-1][1] += len(asked.x)
        cost = np.full(len(asked.x), 10.0)
        cost[3] = ends[solver.rounds]
        solver.tell(cost)
    assert [first for first, _ in runs] == [64, 32, 32, 64, 32, 32, 64, 32]
    expected = [20000, 8000, 20000, 20000, 8000, 20000, 40000, 16000]
    assert [trials for _, trials in runs] == pytest.approx(expected, rel=0.03)
    assert solver.best_cost == 3.0


def test_a_given_point_is_refined_before_the_first_round():
    start = np.array([0.25, 0.75])
    solver, runs = AnnealingRounds(PAIR, 1, start), []
    assert np.array_equal(solver.ask().x, np.tile(start, (32, 1)))
    while solver.rounds < 1:
        asked = solver.ask()
        if np.isinf(asked.to_beat).all():
            runs.append([len(asked.x), 0])
        runs[-1][1] += len(asked.x)
        solver.tell(sphere(asked.x))
    assert [first for first, _ in runs] == [32, 64, 32]
    assert [trials for _, trials in runs] == pytest.approx([8000, 20000, 8000], rel=0.02)


def test_it_climbs_out_of_basins():
    """Rastrigin's function: 11^4 valleys, one of them the deepest, at 1."""
    run, found = Annealing(Coordinates(np.arange(4), np.arange(4)), np.random.default_rng(3), 40000), np.inf
    while not run.over:
        y = 10.24 * (run.ask().x - 0.4)
        cost = 1 + (y**2 - 10 * np.cos(2 * np.pi * y) + 10).sum(axis=1)
        found = min(found, cost.min())
        run.tell(cost)
    assert found < 1.01
