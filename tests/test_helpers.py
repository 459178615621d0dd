"""Processes that compile beside a command: when they start, what they compile, and that they end with it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import pytest

from lidarcfg import helpers
from lidarcfg.commands import interrupts, rehearsals
from lidarcfg.compiling import clock, compiling, stopwatch
from lidarcfg.loop_cache import LoopCache

ROOT = Path(__file__).parents[1]
COMMAND = """
import time
from lidarcfg.helpers import Helper
print(Helper("search").process.pid, flush=True)
time.sleep(600)
"""
SIGNATURES = """
import sys
from numba.core.caching import NullCache
from lidarcfg import load_rig, load_study
from lidarcfg.commands import rehearsals
from lidarcfg.placement.details import details
from lidarcfg.placement.evaluation import evaluate
from lidarcfg.placement.rows import look

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("lidarcfg.")]
    loops = {loop for module in modules for loop in vars(module).values() if hasattr(loop, "py_func")}
    return {f"{loop.__module__}.{loop.__name__}": len(loop.signatures) for loop in loops if loop.signatures}

look._cache = NullCache()  # so that it asks for its parts
rehearsals.lines()
rehearsals.lines()
rehearsals.search()
rehearsals.evaluation()
before = compiled()
study, rig = load_study("data/studies/sedan.yaml"), load_rig("data/rigs/roof.yaml")
details(study, rig, evaluate(study, rig))
after = compiled()
print(len(before), [name for name in before if after[name] > before[name]])
print(*sorted(after.keys() - before.keys()))
"""

PARTS = """
import sys
from numba.core.caching import NullCache
from lidarcfg.commands import rehearsals
from lidarcfg.cli import main
from lidarcfg.simulate.simulator_kernels import hit_bodies, trace_firings
from lidarcfg.simulate.aim_kernels import aimed, locate
from lidarcfg.world.tracer_kernels import trace
from lidarcfg.world.world_kernels import hit_dynamic, keep_normals

trace_firings._cache = NullCache()  # so that it asks for its parts
rehearsals.tracing()
parts = trace, hit_dynamic, keep_normals, hit_bodies, locate, aimed
before = [set(loop.overloads) for loop in parts]
sys.argv[1:] = [*"export data/rigs/roof.yaml --scene data/scenes/street.yaml --duration 0.01 --quiet -o".split(), sys.argv[1]]
try:
    main()
finally:
    after = [set(loop.overloads) for loop in parts]
    print(list(map(len, before)), before == after, len(trace_firings.overloads))
"""


def ended(pid, seconds=60.0):
    """Whether a process ends within that time."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_a_helper_starts_when_a_loop_is_missing(monkeypatch):
    started = []
    monkeypatch.setattr(helpers, "_start", lambda *what: started.append(what))
    monkeypatch.setattr(LoopCache, "on_missing", None)
    for processors, expected in ((1, []), (2, [(("evaluation",), ("lines", "search"))])):
        monkeypatch.setattr(helpers, "_processors", lambda processors=processors: processors)
        helpers.prepare("evaluation", meanwhile=("lines", "search"))
        assert started == []
        if LoopCache.on_missing:
            LoopCache.on_missing()
        assert started == expected


def test_rehearsals_compile_what_a_real_study_needs():
    """A rig of a study with a body, after the rehearsals: of the loops they used, none is compiled for other types.

    What is left is what a command needs to read such a study: the body's tree, and what of the region is inside it.
    """
    done = subprocess.run([sys.executable, "-c", SIGNATURES], cwd=ROOT, capture_output=True, text=True, check=True)
    counted, left = done.stdout.splitlines()
    count, again = counted.split(maxsplit=1)
    assert int(count) >= 15
    assert again == "[]"
    assert "try_out" not in left
    read = {"lidarcfg.world.bvh", "lidarcfg.world.solids"}
    assert {name.rpartition(".")[0] for name in left.split()} <= read


def test_a_rehearsal_compiles_the_parts_that_an_export_takes_in(tmp_path):
    """`trace_firings`, compiled after them, needs none of them for other types."""
    words = (sys.executable, "-c", PARTS, tmp_path / "c.pcap")
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[1, 1, 1, 1, 1, 1] True 1\n"


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_helper_ends_when_the_command_is_killed():
    command = subprocess.Popen([sys.executable, "-c", COMMAND], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    helper = int(command.stdout.readline())
    command.send_signal(signal.SIGKILL)
    command.communicate()
    assert ended(helper)


def test_where_a_budget_waits_for_a_helper_the_command_compiles_meanwhile(monkeypatch):
    """The helper is there for it as long as it takes; what only measures time waits for neither."""
    order = []
    helper = Mock()
    helper.process.wait = lambda: order.append("waited")
    monkeypatch.setattr(helpers, "Helper", lambda *names: order.append(names) or helper)
    monkeypatch.setattr(rehearsals, "search", lambda: order.append("rehearsed"))
    monkeypatch.setattr(compiling, "others", None)
    helpers._start(("subspaces", "evaluation"), ("search",))
    stopwatch()
    assert order == [("subspaces", "evaluation")]
    clock()
    clock()
    assert order[1:] == ["rehearsed", "waited"]


def test_budgets_wait_for_what_others_compile(monkeypatch):
    monkeypatch.setattr(compiling, "others", None)  # of an earlier test
    began, spent, counted = time.perf_counter(), compiling.seconds, compiling.compiled

    def others():
        with compiling.elsewhere():
            time.sleep(0.3)

    before = clock()
    monkeypatch.setattr(compiling, "others", others)
    after = clock()
    assert compiling.seconds - spent >= 0.3
    assert after - before <= time.perf_counter() - began - 0.3
    assert (compiling.compiled - counted, compiling.others) == (1, None)


def test_an_interrupt_does_not_wait_for_what_others_compile(monkeypatch):
    """Within numba it is raised only where numba does nothing but wait for another process."""
    monkeypatch.setattr(interrupts, "_within", lambda *_: True)
    monkeypatch.setattr(interrupts, "Timer", Mock())
    handle = interrupts.Interrupts().handle
    handle(signal.SIGINT, None)
    with pytest.raises(KeyboardInterrupt), compiling.elsewhere():
        handle(signal.SIGINT, None)
    handle = interrupts.Interrupts().handle
    compiling.begin(1)
    with compiling.elsewhere():
        handle(signal.SIGINT, None)
    compiling.end()
