"""Where compiled loops are kept."""

import subprocess
import sys
from pathlib import Path

import lidarcfg

CODE = """
import os, sys
if sys.argv[1] == "unwritable":
    os.access = lambda path, mode: False
from lidarcfg.jit import njit
import numba

@njit(cache=True)
def doubled(x):
    return 2 * x

assert doubled(4) == 8
print(numba.config.CACHE_DIR)
for folder, _, files in os.walk(numba.config.CACHE_DIR or os.path.dirname(__file__)):
    print(*[name for name in files if name.startswith("loops.doubled")])
"""


def run(folder, kind, monkeypatch):
    script = folder / "loops.py"
    script.write_text(CODE)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(Path(lidarcfg.__file__).parents[1]))
    done = subprocess.run([sys.executable, script, kind], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_loops_are_kept_beside_their_module(tmp_path, monkeypatch):
    kept, *files = run(tmp_path, "writable", monkeypatch)
    assert kept == ""
    assert any("loops.doubled" in line for line in files)


def test_where_nothing_can_be_written_they_are_kept_for_the_run(tmp_path, monkeypatch):
    """In a folder that is gone when the process ends."""
    kept, *files = run(tmp_path, "unwritable", monkeypatch)
    assert "lidarcfg-" in kept
    assert any("loops.doubled" in line for line in files)
    assert not Path(kept).exists()
    assert not (tmp_path / "__pycache__").exists()
