"""Threads that take turns: who is alone is alone, whoever comes and goes, and an error lets the others on."""

import time
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest

from lidarcfg.world.turns import Turns


class Watched:
    """Threads of `turns`, who write down who is here."""

    def __init__(self):
        self.turns, self.here, self.seen = Turns(), [], []

    def work(self, number):
        with self.turns.together():
            for _ in range(5):
                self.note("together", number)
                with self.turns.alone():
                    self.note("alone", number)
                self.note("together", number)

    def note(self, how, number):
        self.here.append((how, number))
        time.sleep(1e-4)
        self.seen.append(list(self.here))
        self.here.remove((how, number))


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_who_is_alone_is_alone(threads):
    watched = Watched()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(watched.work, range(4 * threads)))
    alone = [here for here in watched.seen if any(how == "alone" for how, _ in here)]
    assert len(alone) == 5 * 4 * threads
    assert all(len(here) == 1 for here in alone)
    if threads > 1:
        assert any(len(here) > 1 for here in watched.seen)


def test_alone_from_outside():
    """As a caster is used by itself: nobody to wait for."""
    turns, seen = Turns(), []
    for _ in range(2):
        with turns.alone():
            seen.append("alone")
    with turns.together():
        seen.append("together")
    assert seen == ["alone", "alone", "together"]


def test_an_error_lets_the_others_on():
    turns, both = Turns(), Barrier(2)

    def fail():
        with turns.together():
            both.wait()
            with turns.alone():
                raise ValueError("of its own")

    def go_on():
        with turns.together():
            both.wait()
            with turns.alone():
                return "alone"

    with ThreadPoolExecutor(2) as pool:
        failed, other = pool.submit(fail), pool.submit(go_on)
        assert other.result(timeout=10) == "alone"
        with pytest.raises(ValueError, match="of its own"):
            failed.result(timeout=10)
    with turns.alone():
        pass
