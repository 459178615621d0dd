"""Turns that threads share: each is taken once, by whoever comes first; an exception ends them."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from lidarcfg.jit import outer
from lidarcfg.placement.turns import share, take


@outer()
def count(turns, most, times):
    taken = 0
    for _ in range(most):
        turn = take(turns)
        if turn >= times.size:
            break
        times[turn] += 1
        taken += 1
    return taken


@pytest.mark.parametrize(
    ("threads", "turns", "most"), [(1, 1000, 7), (2, 100_000, 100), (8, 100_000, 1), (8, 3, 5), (2, 0, 9)]
)
def test_each_turn_is_taken_once(threads, turns, most):
    times, told = np.zeros(turns, np.int64), []

    def work(shared, some, room):
        return count(shared, some, room)

    with ThreadPoolExecutor(threads) as pool:
        taken = share(pool, [times] * threads, turns, most, work, told.append)
    assert (times == 1).all()
    assert sum(taken) == sum(told) == turns


def test_after_an_exception_no_turns_are_taken():
    seen = []

    def work(turns, most, room):
        if room == 0:
            raise KeyboardInterrupt
        while turns[0] < 10**9:  # ends as soon as nothing is left
            pass
        seen.append(int(turns[0]))

    with ThreadPoolExecutor(2) as pool, pytest.raises(KeyboardInterrupt):
        share(pool, [0, 1], 10**9, 1, work)
    assert seen == [10**9]
