"""The cache of compiled loops, among processes: by what numba's own events say that each of them compiled."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import lidarcfg

pytest.importorskip("fcntl")
FAR = """
from lidarcfg.jit import inner

@inner(kept=True)
def far(x):
    return 2 * x
"""
LOOPS = """
from far import far
from lidarcfg.jit import inner, njit, outer

@njit(cache=True)
def inside(x):
    return 2 * x

@njit(cache=True)
def outside(x):
    return inside(x) + 1

@njit(cache=True)
def other(x):
    return inside(x) - 1

@inner(kept=True)
def within(x):
    return 2 * x

@njit(cache=True)
def around(x):
    return within(x) + 1

@njit(cache=True)
def about(x):
    return within(x) - 1

@outer(kept=True)
def above(x):
    return far(x) + 1

@njit(cache=True)
def beyond(x):
    return above(x) - 1

@njit(cache=True)
def wrong(x):
    return x.no_such_attribute
"""
RUN = """
import sys, time
from numba.core import event
from numba.core.caching import FunctionCache

class Watch(event.Listener):
    def on_start(self, event):
        if event.data["dispatcher"] is not loops.wrong:
            print(event.data["dispatcher"].__name__, flush=True)
            time.sleep(float(sys.argv[1]))

    def on_end(self, event):
        pass

event.register("numba:compile", Watch())
usual = FunctionCache.save_overload

def save_slowly(cache, *what):
    time.sleep(float(sys.argv[1]))
    usual(cache, *what)

FunctionCache.save_overload = save_slowly
import loops
from lidarcfg import loop_cache
loop_cache.PATIENCE_S = float(sys.argv[2])
try:
    loops.wrong(1)
except Exception:  # numba's, of a loop that does not compile; the lock must be free all the same
    pass
for name in sys.argv[3:]:
    by_hand = {"outside": 7, "around": 7, "other": 5, "about": 5, "beyond": loops.far.py_func(3)}
    assert getattr(loops, name)(3) == by_hand[name]
"""


PAIR = """
from typing import NamedTuple

class Pair(NamedTuple):
    x: int
    y: int
"""
TOTAL = """
from lidarcfg.jit import njit

@njit(cache=True)
def total(pair):
    return pair.x + pair.y
"""


@pytest.fixture
def start(tmp_path, monkeypatch):
    """A function that starts a process which calls loops; compiling one takes so many seconds more, and saving it, too.

    patience: for how many seconds it waits for another.
    """
    (tmp_path / "far.py").write_text(FAR)
    (tmp_path / "loops.py").write_text(LOOPS)
    (tmp_path / "run.py").write_text(RUN)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(Path(lidarcfg.__file__).parents[1]))

    def run(seconds, *names, patience=100):
        words = (sys.executable, tmp_path / "run.py", str(seconds), str(patience), *names)
        return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)

    return run


WITHOUT = """
import sys
import loops

assert loops.outside(3) == 7
print("scipy.linalg" in sys.modules)
assert loops.other(3) == 5
print("scipy.linalg" in sys.modules)
"""


def done(process):
    """The loops that it compiled; it has failed to compile one before."""
    out = process.communicate(timeout=300)[0].split()
    assert process.returncode == 0
    return out


def test_each_loop_is_compiled_once(start):
    one, two = start(0.5, "outside", "other"), start(0.5, "other", "outside")
    assert sorted(done(one) + done(two)) == ["inside", "other", "outside"]
    assert done(start(0, "outside", "other")) == []


def test_an_inner_loop_that_is_kept_is_compiled_once_for_all_loops_and_processes(start):
    assert done(start(0, "around")) == ["around", "within"]
    assert done(start(0, "about")) == ["about"]
    assert done(start(0, "about", "around")) == []


def test_what_is_loaded_needs_nothing_that_compiles(start, tmp_path):
    """numba loads scipy's linear algebra with all else that it may need to compile."""
    done(start(0, "outside"))
    (tmp_path / "without.py").write_text(WITHOUT)
    said = subprocess.run([sys.executable, tmp_path / "without.py"], stdout=subprocess.PIPE, text=True, check=True)
    assert said.stdout.split() == ["False", "True"]


ASSEMBLY = """
import re, loops
loops.beyond(3)
for loop in loops.beyond, loops.above:
    code = loop.inspect_asm(loop.signatures[0])
    print(*(name for name in ("5loops6beyond", "5loops5above", "3far3far") if f"_ZN{name}" in code))
    print(*re.findall(r"^_ZN(5loops6beyond|5loops5above|3far3far)\\w+:", code, re.M))
"""


def test_loops_call_the_machine_code_of_kept_ones(start, tmp_path):
    """By the assembly that numba prints: it has the names of those that are called next, and no code of theirs."""
    words = (sys.executable, "-c", ASSEMBLY)
    out = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert out.splitlines() == ["5loops6beyond 5loops5above", "5loops6beyond", "5loops5above 3far3far", "5loops5above"]


def test_loops_are_compiled_again_where_a_kept_one_that_they_call_has_changed(start, tmp_path):
    assert done(start(0, "beyond", "around")) == ["beyond", "above", "far", "around", "within"]
    (tmp_path / "far.py").write_text(FAR.replace("2 * x", "5 * x"))
    assert "far" in done(start(0, "beyond", "around"))
    assert done(start(0, "beyond", "around")) == []


OTHERS = """
import numba

@numba.njit(cache=True)
def inside(x):
    return 3 * x

@numba.njit(cache=True)
def outside(x):
    return inside(x) - x
"""


def test_loops_of_others_are_kept_for_processes_without_ours(tmp_path, monkeypatch):
    """A user's own, compiled beside ours, is loaded by numba alone; and ours loads what numba alone has kept."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(Path(lidarcfg.__file__).parents[1]))
    (tmp_path / "others.py").write_text(OTHERS)
    ours = "from lidarcfg.linking import link_late; assert link_late();"
    call = "import others; print(others.outside(2), sum(others.outside.stats.cache_hits.values()))"
    for first, second in ((ours, ""), ("", ours)):
        for before, hits in ((first, 0), (second, 1)):
            words = (sys.executable, "-c", before + call)
            out = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
            assert out.split() == ["4", str(hits)]
        for file in (tmp_path / "__pycache__").glob("others.*.nb?"):
            file.unlink()


NEAR = """
import numpy as np
from lidarcfg.jit import inner

FACTOR = 2
TABLE = np.array([0, 1])

@inner()
def nearest(x):
    return FACTOR * x * TABLE[1]

@inner()
def near(x):
    return nearest(x) if x in (1, 2, 3) else 0
"""
USE = """
from near import near
from lidarcfg.jit import njit

@njit(cache=True)
def use(x):
    return near(x)

print(use(3), sum(use.stats.cache_hits.values()))
"""


@pytest.mark.parametrize(
    ("change", "to", "result"),
    [("FACTOR = 2", "FACTOR = 5", 15), ("* x", "- x", -1), ("[0, 1]", "[0, 3]", 18), ("(1, 2, 3)", "(1, 2)", 0)],
)
def test_loops_are_compiled_again_where_what_they_take_in_has_changed(tmp_path, monkeypatch, change, to, result):
    """In another file: numba alone would say 6 to the end."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(Path(lidarcfg.__file__).parents[1]))
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    (tmp_path / "use.py").write_text(USE)

    def said():
        words = (sys.executable, tmp_path / "use.py")
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()

    (tmp_path / "near.py").write_text(NEAR)
    assert [said(), said()] == [["6", "0"], ["6", "1"]]
    assert change in NEAR
    (tmp_path / "near.py").write_text(NEAR.replace(change, to))
    assert [said(), said()] == [[str(result), "0"], [str(result), "1"]]


@pytest.mark.parametrize(("stop", "patience"), [(signal.SIGKILL, 100), (signal.SIGSTOP, 2)])
def test_what_a_stopped_process_was_compiling_is_compiled_by_the_next(start, stop, patience):
    one = start(600, "outside")
    assert one.stdout.readline() == "outside\n"
    two = start(0, "outside", patience=patience)
    time.sleep(1.5)
    one.send_signal(stop)
    assert done(two) == ["outside", "inside"]
    one.kill()
    one.communicate()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_without_a_file_for_locks_each_compiles(start, tmp_path):
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__/lidarcfg-loops.lock").touch(mode=0o000)
    assert sorted(done(start(0, "outside"))) == ["inside", "outside"]


def test_a_loop_is_compiled_again_where_a_type_of_an_argument_is_elsewhere(tmp_path, monkeypatch):
    """As in a new version that was installed over an old one: the old one's cache stays, and names the type's old module."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(Path(lidarcfg.__file__).parents[1]))
    (tmp_path / "loops.py").write_text(TOTAL)
    counts = []
    for module in ("before", "after", "after"):
        (tmp_path / f"{module}.py").write_text(PAIR)
        code = f"from {module} import Pair; from loops import total; print(total(Pair(2, 3)), sum(total.stats.cache_hits.values()))"
        words = (sys.executable, "-B", "-c", code)
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
        counts.append(done.stdout.split())
        (tmp_path / "before.py").unlink(missing_ok=True)
    assert counts == [["5", "0"], ["5", "0"], ["5", "1"]]
