"""The chains' steps one by one, against the rule of Metropolis and the rules of the rounds."""

import numpy as np
import pytest
from scipy.stats import kstest

from lidarcfg.solvers import annealing
from lidarcfg.solvers.annealing import ACCEPT_WORK, LEARNING, OWN, Annealing, AnnealingRounds
from lidarcfg.solvers.search import Coordinates, of_objectives

GROUPS = np.array([0, 0, 0, 2, 2, 7])
COORDINATES = Coordinates(GROUPS, np.array([1, 2, 3, 1, 3, 9]))  # the first two groups have two kinds in common
ALIKE = Coordinates(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]))
PAIR = Coordinates(np.array([0, 1]), np.array([0, 0]))


def sphere(x):
    return 1 + ((x - 0.3) ** 2).sum(axis=1)


def started(coordinates=COORDINATES, work=10**9, seed=1, start=None):
    run = Annealing(coordinates, np.random.default_rng(seed), work, start)
    run.tell(of_objectives(sphere(run.ask().x)))
    return run


def test_chains_begin_at_random_points_and_go_there_whatever_they_cost():
    run = Annealing(COORDINATES, np.random.default_rng(2), 10**9)
    begin = run.ask()
    assert begin.x.shape == (16, 6)
    assert np.isinf(begin.upper_bound).all()
    run.tell(of_objectives(np.where(np.arange(16) % 2, np.inf, 5.0)))
    assert np.array_equal(run.sources, begin.x)
    asked = run.ask()
    assert np.isinf(asked.upper_bound[asked.source % 2 == 1]).all()
    assert (asked.upper_bound[asked.source % 2 == 0, 1] > 5).all()


def test_a_trial_moves_coordinates_of_one_group():
    run = started()
    run.tell(of_objectives(np.full(16, np.inf)))
    asked = run.ask()
    moved = asked.x != run.sources[asked.source]
    assert moved.any(axis=1).all()
    groups = [set(GROUPS[row].tolist()) for row in moved]
    assert {len(one) for one in groups} == {1}
    assert {number for one in groups for number in one} == {0, 2, 7}


@pytest.mark.parametrize(("taken", "trials"), [(16, 1), (9, 1), (6, 1), (4, 2), (3, 2), (2, 4), (1, 8), (0, 8)])
def test_the_fewer_trials_are_taken_the_more_of_them_a_chain_has_at_a_time(taken, trials):
    """So many that one in two chains takes one; up to 8."""
    run = started()
    run.tell(of_objectives(np.where(np.arange(16) < taken, 0.5, np.inf)))
    assert run.ask().source.tolist() == [chain for chain in range(16) for _ in range(trials)]


def test_what_a_trial_has_upper_bound_is_drawn_from_the_rule_of_metropolis():
    """One that costs r times as much is taken with probability r^(−1/T): Metropolis on the logarithm of the cost."""
    run = started()
    uphill = []
    for _ in range(50):
        asked = run.ask()
        uphill.append(np.log(asked.upper_bound[:, 1] / sphere(run.sources[asked.source])) / run.temperature)
        run.tell(of_objectives(np.full(len(asked.x), np.inf)))
    drawn = np.concatenate(uphill)
    assert kstest(drawn, "expon").pvalue > 1e-3
    ratio = 1 + run.temperature / 2
    taken = np.log(ratio) / run.temperature < drawn
    assert taken.mean() == pytest.approx(ratio ** (-1 / run.temperature), abs=0.02)


def test_a_chain_that_falls_short_goes_uphill_by_its_shortfall():
    """It takes what falls short by less than shortfall × exp(T × Exp(1)), whatever its objective; the others as before."""
    run = Annealing(COORDINATES, np.random.default_rng(1), 10**9)
    cost = of_objectives(np.full(16, 0.25))
    cost[8:] = 4.0, np.inf
    run.tell(cost)
    asked = run.ask()
    short = asked.source >= 8
    assert (asked.upper_bound[~short, 0] == 0).all()
    assert (asked.upper_bound[~short, 1] > 0.25).all()
    assert (asked.upper_bound[short, 0] > 4).all()
    told = np.tile([np.inf, np.inf], (len(asked.x), 1))
    told[short] = asked.upper_bound[short, 0, None] * [0.999, np.inf]
    told[~short] = 0.001, np.inf  # none of those that meet all takes what does not
    run.tell(told)
    assert np.array_equal(run.sources[8:], asked.x[short])
    assert not (run.sources[:8, None] == asked.x).all(axis=2).any()


def test_the_first_trial_that_a_chain_takes_moves_it():
    run = started()
    run.tell(of_objectives(np.full(16, np.inf)))
    before = run.sources.copy()
    asked = run.ask()
    cost = np.full(128, np.inf)
    cost[17] = asked.upper_bound[17, 1] * 0.999
    cost[18] = 0.5  # both of chain 2
    cost[40] = asked.upper_bound[40, 1]  # of chain 5, and no better than what it had to beat
    run.tell(of_objectives(cost))
    assert np.array_equal(run.sources[2], asked.x[17])
    assert np.array_equal(np.delete(run.sources, 2, axis=0), np.delete(before, 2, axis=0))
    assert run.mean_cost == pytest.approx((sphere(before).sum() - sphere(before[2:3])[0] + cost[17]) / 16)


def test_half_of_the_other_steps_are_differences_of_two_chains(monkeypatch):
    """Chains on a line: a difference goes along it, but for its jitter."""
    monkeypatch.setattr(annealing, "LEARNING", (0.0, 0.0))
    run = Annealing(Coordinates(np.zeros(2, int), np.arange(2)), np.random.default_rng(4), 10**9)
    run.tell(of_objectives(np.ones(16)))
    run.tell(of_objectives(np.full(16, np.inf)))
    run.sources[:] = np.linspace(0.4, 0.6, 16)[:, None]
    off = []
    for _ in range(40):
        run.tell(of_objectives(np.full(len(run.ask().x), np.inf)))
        step = run.ask().x - run.sources[run.ask().source]
        off.append(np.abs(step[:, 0] - step[:, 1]))
    assert (np.concatenate(off) < 1e-3).mean() == pytest.approx(0.5, abs=0.1)


def learned(coordinates, monkeypatch):
    """Steps that take over coordinates: (chain, coordinate) of each, and of where it was; and the trials.

    Every coordinate of every chain is another number, and Gaussian steps are tiny, so that this can be seen.
    """
    monkeypatch.setattr(annealing, "STEP_LEAST", 1e-12)
    monkeypatch.setattr(annealing, "STEP_MOST", 1e-12)
    run = Annealing(coordinates, np.random.default_rng(5), 10**9)
    steps = []
    trials = 0
    count = len(coordinates)
    run.tell(of_objectives(np.ones(16)))
    run.sources[:] = np.random.default_rng(6).permutation(np.linspace(0.05, 0.95, 16 * count)).reshape(16, count)
    run.tell(of_objectives(np.full(16, np.inf)))
    for _ in range(40):
        asked = run.ask()
        for x, chain in zip(asked.x, asked.source, strict=True):
            trials += 1
            near = [np.argwhere(np.abs(run.sources - value) < 1e-9) for value in x]
            moved = np.flatnonzero(np.abs(x - run.sources[chain]) > 1e-9)
            if moved.size and all(len(near[c]) for c in moved):
                steps.append([((chain, int(c)), (int(near[c][0, 0]), int(near[c][0, 1]))) for c in moved])
        run.tell(of_objectives(np.full(len(asked.x), np.inf)))
    return steps, trials


def test_a_group_takes_over_coordinates_from_another_one_of_its_chain_or_of_a_second(monkeypatch):
    steps, trials = learned(ALIKE, monkeypatch)
    own = 0
    for step in steps:
        assert {to[1] // 2 for to, _ in step} in ({0}, {1})
        assert all(taken[1] == (to[1] + 2) % 4 for to, taken in step)
        assert len({taken[0] for _, taken in step}) == 1
        own += all(to[0] == taken[0] for to, taken in step)
    assert len(steps) / trials == pytest.approx(LEARNING[0], abs=0.03)
    assert own / len(steps) == pytest.approx(OWN, abs=0.04)
    assert np.mean([len(step) for step in steps]) == pytest.approx((2 * 0.36 + 2 * 0.24 + 0.16 * 2), abs=0.05)


@pytest.mark.parametrize("progress", [0.5, 0.999])
def test_the_colder_it_is_the_fewer_steps_take_over_coordinates(monkeypatch, progress):
    monkeypatch.setattr(Annealing, "progress", progress)
    steps, trials = learned(ALIKE, monkeypatch)
    assert len(steps) / trials == pytest.approx(0.6 - 0.5 * progress, abs=0.03)


def test_what_means_the_same_nowhere_else_is_taken_over_from_a_second_chain(monkeypatch):
    steps, _ = learned(COORDINATES, monkeypatch)
    seen = {(to[1], taken[1]) for step in steps for to, taken in step}
    assert seen == {(0, 3), (2, 4), (3, 0), (4, 2)} | {(c, c) for c in range(6)}
    assert all(to[0] != taken[0] for step in steps for to, taken in step if to[1] == taken[1])


@pytest.mark.parametrize("populations", [1, 3])
def test_the_worst_chains_of_a_population_go_on_from_where_its_best_are(populations):
    run = Annealing(COORDINATES, np.random.default_rng(3), 10**6, populations=populations)
    begin = run.ask().x
    run.tell(of_objectives(1.0 + np.arange(16 * populations)))
    while np.array_equal(run.sources, begin):
        run.tell(of_objectives(np.full(len(run.ask().x), np.inf)))
    for now, before in zip(np.split(run.sources, populations), np.split(begin, populations), strict=True):
        assert np.array_equal(now[:14], before[:14])
        assert np.array_equal(now[14:], before[:2])


def test_populations_do_not_learn_from_each_other(monkeypatch):
    """All chains of one are in one place, and Gaussian steps are tiny: nothing that it learns leads away from there."""
    monkeypatch.setattr(annealing, "STEP_LEAST", 1e-12)
    monkeypatch.setattr(annealing, "STEP_MOST", 1e-12)
    run = Annealing(ALIKE, np.random.default_rng(5), 10**9, populations=3)
    run.tell(of_objectives(np.ones(48)))
    run.sources[:] = np.repeat([0.2, 0.5, 0.8], 16)[:, None]
    run.tell(of_objectives(np.full(48, np.inf)))
    for _ in range(20):
        asked = run.ask()
        assert set(asked.source) == set(range(48))
        assert np.abs(asked.x - run.sources[asked.source]).max() < 1e-3  # ten times JITTER
        run.tell(of_objectives(np.full(len(asked.x), np.inf)))


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_only_the_best_population_ends_a_round(smoothing):
    """From seven tenths on: the one with the best chain, by costs without smoothing, which here say the opposite."""
    run = Annealing(PAIR, np.random.default_rng(1), 16_000, None, smoothing, 3)
    best = 2 if smoothing else 1
    seen = []
    while not run.over:
        asked = run.ask()
        before = run.sources.copy()
        alone = len(run.sources) == 16
        population = np.full(len(asked.x), best) if alone else asked.source // 16
        ranks = np.array([3.0, 1.0, 2.0] if asked.smoothing or not smoothing else [2.0, 3.0, 1.0])
        start = np.isinf(asked.upper_bound[:, 1]).all()
        run.tell(of_objectives(np.where(start, ranks[population], np.inf)))
        seen.append((run.progress, len(run.sources)))
        if len(run.sources) < len(before):
            assert np.array_equal(run.sources, before[16 * best : 16 * best + 16])
    assert {chains for progress, chains in seen if progress < 0.7} == {48}
    assert {chains for progress, chains in seen if progress >= 0.72} == {16}


@pytest.mark.parametrize(("start", "hot"), [(None, 0.03), (np.full((1, 6), 0.5), 0.004)])
def test_it_cools_evenly_by_a_chain_s_work_to_half_a_thousandth(start, hot):
    """A trial is 1, and 10 more if it is taken."""
    run = Annealing(COORDINATES, np.random.default_rng(1), 100_000, start)
    log_t = []
    work = []
    taken = np.random.default_rng(1)  # now many, now few, so that chains have more or fewer trials at a time
    while not run.over:
        asked = run.ask()
        log_t.append(np.log(run.temperature))
        cost = np.where(taken.random(len(asked.x)) < taken.random(), 0.5, np.inf)
        work.append((len(asked.x) + 10 * np.isfinite(cost).sum()) / len(np.unique(asked.source)))
        run.tell(of_objectives(cost))
    log_t.append(np.log(run.temperature))
    step = np.diff(log_t) / work
    assert len(set(work)) > 3
    assert np.exp(log_t[0]) == pytest.approx(hot)
    assert np.exp(log_t[-1]) == pytest.approx(0.0005)
    assert step[:-1] == pytest.approx(np.full(len(step) - 1, step[0]))
    assert step[0] <= step[-1] <= 0  # the last work may be more than is left


def test_a_run_from_a_point_has_all_of_its_chains_there():
    start = np.linspace(0.1, 0.9, 6)[None]
    run = Annealing(COORDINATES, np.random.default_rng(3), 50_000, start)
    assert np.array_equal(run.ask().x, np.tile(start, (16, 1)))


def works(solver, rounds, ends):
    """The work of each run until so many rounds have begun, and how many had begun; `ends`: the best of each round."""
    runs = []
    while solver.rounds < rounds:
        asked = solver.ask()
        if np.isinf(asked.upper_bound[:, 1]).all():
            runs.append([solver.rounds, 0])
        cost = np.full(len(asked.x), np.inf)
        if not runs[-1][1]:
            cost[:] = 10.0
            cost[3] = ends[solver.rounds - 1]
        runs[-1][1] += len(asked.x) + ACCEPT_WORK * np.isfinite(cost).sum()
        solver.tell(of_objectives(cost))
    return runs


@pytest.mark.slow
def test_rounds_become_longer_and_the_best_end_so_far_is_refined(monkeypatch):
    """1,000 a dimension, 21,000, half as much again and so on, and a quarter of it for refining.

    Each of three populations does seven tenths of it, and one the rest: 2.4 times as much.
    """
    monkeypatch.setattr(annealing, "SMOOTHING", 0.0)  # else they ask at times for something else
    solver = AnnealingRounds(PAIR, 1)
    runs = works(solver, 6, (5.0, 6.0, 4.0, 4.5, 3.0))  # the first, the third and the fifth are the best so far
    assert [number for number, _ in runs] == [1, 1, 2, 3, 3, 4, 5, 5]
    expected = [4800, 500, 100_800, 151_200, 15_750, 226_800, 340_200, 35_437.5]
    for (_, work), wanted in zip(runs, expected, strict=True):
        assert wanted <= work < wanted + 8 * 48  # as many trials at a time
    assert solver.best_cost == (0, 3)


def test_a_given_point_is_refined_before_the_first_round():
    start = np.array([[0.25, 0.75]])
    solver = AnnealingRounds(PAIR, 1, start)
    assert np.array_equal(solver.ask().x, np.tile(start, (16, 1)))
    runs = works(solver, 2, (5.0, 6.0))
    assert [number for number, _ in runs] == [0, 1, 1]
    for (_, work), wanted in zip(runs, (500, 4800, 500), strict=True):
        assert wanted <= work < wanted + 8 * 48


def test_with_smoothing_it_asks_at_times_what_its_chains_cost_without():
    """20 times, the last of them at the end; what it is told then moves no chain."""
    run = Annealing(PAIR, np.random.default_rng(1), 16_000, smoothing=0.1)
    asked_without = []
    while not run.over:
        asked = run.ask()
        if asked.smoothing:
            assert asked.smoothing == 0.1
            run.tell(of_objectives(1.5 * sphere(asked.x)))
            continue
        asked_without.append(run.progress)
        before = run.sources.copy()
        mean = run.mean_cost
        assert np.array_equal(asked.x, before)
        assert np.isinf(asked.upper_bound[:, 1]).all()
        run.tell(of_objectives(sphere(asked.x)))
        assert np.array_equal(run.sources, before)
        assert run.mean_cost == mean
    assert asked_without[-1] == 1.0
    assert asked_without == pytest.approx(np.arange(1, 21) / 20, abs=0.02)


def test_rounds_but_the_first_smooth_and_the_best_cost_that_counts_is_refined(monkeypatch):
    """Smoothed costs, which are less here, are not what a round is judged by."""
    monkeypatch.setattr(annealing, "SECOND_WORK", 2_000)
    solver = AnnealingRounds(PAIR, 1)
    ends = []
    while solver.rounds < 2:
        assert solver.ask().smoothing == 0.0
        solver.tell(of_objectives(2 * sphere(solver.ask().x)))
    while len(np.unique(solver.ask().x, axis=0)) > 1:
        asked = solver.ask()
        assert asked.smoothing in (0.0, annealing.SMOOTHING)
        cost = sphere(asked.x) * (1.0 if asked.smoothing else 1.5)
        if not asked.smoothing:
            best = int(np.argmin(cost))
            ends.append((cost[best], asked.x[best]))
        solver.tell(of_objectives(cost))
    refined = solver.ask()
    assert (solver.rounds, refined.smoothing) == (2, 0.0)
    assert np.array_equal(refined.x[0], min(ends, key=lambda end: end[0])[1])


def test_it_climbs_out_of_basins():
    """Rastrigin's function: 11^4 valleys, one of them the deepest, at 1."""
    run = Annealing(Coordinates(np.arange(4), np.arange(4)), np.random.default_rng(3), 40000)
    found = np.inf
    while not run.over:
        y = 10.24 * (run.ask().x - 0.4)
        cost = 1 + (y**2 - 10 * np.cos(2 * np.pi * y) + 10).sum(axis=1)
        found = min(found, cost.min())
        run.tell(of_objectives(cost))
    assert found < 1.01
