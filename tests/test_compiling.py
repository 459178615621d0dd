"""Compiling: what numba says of it, in no budget, and shown."""

import json
import os
import pty
import re
import select
import subprocess
import sys

import pytest

from lidarcfg import compiling as module
from lidarcfg.compiling import Compiling, clock
from lidarcfg.jit import inner, njit

STUDY = """\
region: {min_m: [-2, -2, 0], max_m: [2, 2, 2], cuboid_m: [1, 1, 1]}
sensors:
  - {model: vlp-16, min: {position_m: [-1, -1, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 1, 1], rpy_deg: [0, 0, 0]}}
solver: {method: abc, bees: 4}
"""
SLOW = """
import sys
import time

from numba.core import event
from numba.core.caching import NullCache

from lidarcfg.cli import main
from lidarcfg.placement.evaluator_kernels import remember

remember._cache = NullCache()


class Slow(event.Listener):
    def on_start(self, event):
        time.sleep(4 * (event.data["dispatcher"] is remember))

    def on_end(self, event):
        pass


event.register("numba:compile", Slow())
main()
"""


def test_numbas_own_record_of_the_time():
    """numba keeps the seconds of each compiled function in its metadata: as `clock` has it, within its own."""
    before = module.compiling.seconds, module.compiling.compiled, clock()

    @njit()
    def squares(x):
        return sum([i * x for i in range(3)])

    assert squares(2) == 6
    own = squares.get_metadata()[squares.signatures[0]]["timers"]["compiler_lock"]
    spent, counted = module.compiling.seconds - before[0], module.compiling.compiled - before[1]
    assert counted >= 1
    assert module.compiling.depth == 0
    assert 0.5 * own < spent <= own
    assert squares(2) == 6
    assert module.compiling.compiled - before[1] == counted


def test_the_clock_stands_while_something_is_compiled(monkeypatch):
    """By a clock that is moved by hand: 10 s before, 5 s of compiling with 2 s within them, 1 s after."""
    now, one = [0.0], Compiling()
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(module, "compiling", one)
    times = []
    for seconds, change in (
        (10, lambda: one.begin(3)), (1, lambda: one.begin(1)), (2, one.end), (2, one.end), (1, lambda: None),
    ):  # fmt: skip
        now[0] += seconds
        change()
        times.append(clock())
    assert times == [10, 10, 10, 10, 11]
    assert (one.seconds, one.compiled, one.expected) == (5.0, 2, 2)  # the third was not needed


def test_the_count_never_passes_what_is_expected():
    """Two loops are expected for the first one, and three are compiled; a helper expects ten more, and has one."""
    one, counts = Compiling(), []
    one.on_change = lambda: counts.append((one.compiled, one.expected))
    one.begin(2)
    one.begin(1)
    one.end()
    one.count(10, 1)
    one.begin(1)
    one.end()
    one.end()
    assert counts == [(0, 2), (0, 2), (1, 2), (2, 12), (2, 12), (3, 13), (4, 13)]


def test_an_inner_loop_is_part_of_others():
    @inner()
    def twice(x):
        return 2 * x

    @njit()
    def four_times(x):
        return twice(twice(x))

    assert four_times(3) == 12
    assert four_times(0.5) == 2.0
    with pytest.raises(TypeError, match=r"twice can be called by compiled loops only"):
        twice(3)


def test_without_what_numba_has_inside_loops_are_as_right(monkeypatch):
    monkeypatch.setattr("lidarcfg.jit.link_late", lambda: False)

    @inner()
    def twice(x):
        return 2 * x

    assert (twice(3), twice.targetoptions.get("no_cpython_wrapper")) == (6, None)


def on_a_terminal(words, environment):
    """What a command prints to a terminal of 120 columns."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(words, stdin=theirs, stdout=theirs, stderr=theirs, env=environment, close_fds=True)
    os.close(theirs)
    text = b""
    while select.select([ours], [], [], 600)[0]:
        try:
            text += os.read(ours, 65536)
        except OSError:  # its end was closed
            break
    os.close(ours)
    assert process.wait() == 0, text.decode()
    return text.decode()


def test_a_first_search_shows_what_it_compiles_and_does_not_count_it(tmp_path):
    """Compiling one of its loops takes 4 s here, twice the budget; the search has all of that all the same."""
    (tmp_path / "s.yaml").write_text(STUDY)
    (tmp_path / "slow.py").write_text(SLOW)
    words = (tmp_path / "slow.py", "optimize", tmp_path / "s.yaml", "-o", tmp_path / "out", "--seconds", "2")
    text = on_a_terminal((sys.executable, *words), os.environ | {"COLUMNS": "120", "TERM": "xterm"})
    assert "reading" in text
    shown = [tuple(map(int, counts)) for counts in re.findall(r"compiling, once: (\d+) of about (\d+)", text)]
    assert shown
    assert all(0 < at <= expected for at, expected in shown)
    rows = (tmp_path / "out/history.csv").read_text().split()
    assert len(rows) > 10
    assert json.loads((tmp_path / "out/result.json").read_text())["evaluations"] > 10
