"""Numbers that threads share: each is taken once, by whoever comes first; an exception ends them."""

from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import numpy as np
import pytest

from lidarcfg.futures import parallel_for


@pytest.mark.parametrize(
    ("threads", "numbers", "most"), [(1, 1000, 7), (2, 20_000, 100), (8, 20_000, 1), (8, 3, 5), (2, 0, 9)]
)
def test_each_number_is_taken_once(threads, numbers, most):
    times = np.zeros(numbers, np.int64)
    reported = []
    lock = Lock()

    def work(counter, some, workspace):
        taken = 0
        for _ in range(some):
            with lock:
                number = int(counter[0])
                counter[0] += 1
            if number >= numbers:
                break
            times[number] += 1
            taken += 1
        return taken

    with ThreadPoolExecutor(threads) as pool:
        taken = parallel_for(pool, [None] * threads, numbers, most, work, reported.append)
    assert (times == 1).all()
    assert sum(taken) == sum(reported) == numbers


def test_after_an_exception_no_numbers_are_taken():
    seen = []

    def work(counter, most, workspace):
        if workspace == 0:
            raise KeyboardInterrupt
        while counter[0] < 10**9:  # ends as soon as nothing is left
            pass
        seen.append(int(counter[0]))

    with ThreadPoolExecutor(2) as pool, pytest.raises(KeyboardInterrupt):
        parallel_for(pool, [0, 1], 10**9, 1, work)
    assert seen == [10**9]
