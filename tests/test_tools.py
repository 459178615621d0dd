"""Tools find what they import; the table of searches by hand; the meshes in data/ are what their scripts make."""

import ast
import importlib
from pathlib import Path

import numpy as np
import pytest

from tests.naive.rays import first_triangle

ROOT = Path(__file__).parents[1]


def test_triangles_by_hand():
    """Through the inside, an edge, a corner, beside it, and away from it."""
    vertices = np.array([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
    triangles = np.array([[0, 1, 2]])
    origins = np.array([[1.0, 1, 0], [2, 2, 0], [0, 0, 0], [2.1, 2, 0], [1, 1, 6]])
    ranges, which = first_triangle(vertices, triangles, origins, np.tile([0.0, 0, 1], (5, 1)))
    assert ranges.tolist() == [5, 5, 5, np.inf, np.inf]
    assert which.tolist() == [0, 0, 0, -1, -1]


def test_searches_against_the_best_known(tool):
    """Medians, worst and what is kept, by hand: 1.005 and 1.05 times the best known; 1.02 times."""
    bench = tool("bench_search")
    known = {name: {"max_vsr_m": 2.0} for name in bench.STUDIES}
    values = {"1x4": (2.0, 2.01, 2.01, 2.02, 2.1), "2x8": (2.04,) * 5, "3x8": (2.0,)}
    runs = [
        {"study": study, "method": "auto", "max_vsr_m": value, "evaluations": 1000 * n}
        for study, found in values.items()
        for n, value in enumerate(found, 1)
    ]
    lines = bench.compared(runs, ["auto"], known)
    assert lines[2:5] == [
        "| 1 × 4 | 2.0000 | 2.0000 2.0100 2.1000 | +0.5% +5.0% | 5 | 3,000 |",
        "| 2 × 8 | 2.0000 | 2.0400 2.0400 2.0400 | +2.0% +2.0% | 5 | 3,000 |",
        "| 3 × 8 | 2.0000 | 2.0000 2.0000 2.0000 | +0.0% +0.0% | 1 | 1,000 |",  # counts for no target
    ]
    assert lines[-1] == (
        "`auto`: the median within 1% and the worst within 4% on 0 of 2 studies; the median on 1, the worst on 1."
    )


def test_a_better_rig_takes_the_place_of_the_best_known(tool, tmp_path, monkeypatch):
    bench = tool("bench_search")
    monkeypatch.setattr(bench, "KNOWN", tmp_path / "known.json")
    monkeypatch.setattr(bench, "RUNS", tmp_path / "out/runs.jsonl")
    monkeypatch.setattr(bench, "STUDIES", ["1x4"])
    bench.KNOWN.write_text('{"1x4": {"max_vsr_m": 0.7, "found_by": "hand", "searched_s": 0.0, "poses": []}}')
    before = bench.search("1x4", "auto", 1000, 0.2, 1)
    assert 0.6 < before["max_vsr_m"] < 0.7
    for run in (before, {**before, "max_vsr_m": 0.8, "seed": 1001}, {**before, "max_vsr_m": 0.5, "seed": 2}):
        bench.record(run)
        known = bench.json.loads(bench.KNOWN.read_text())["1x4"]
        assert known["max_vsr_m"] == min(before["max_vsr_m"], run["max_vsr_m"])
    assert known["searched_s"] == 0.4  # those with seeds from 1000 on
    assert "seed 2, " in known["found_by"]
    assert [run["seed"] for run in bench.finished()] == [1000, 1001, 2]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["objects", "vehicles"])
def test_the_meshes_in_data_are_what_a_script_makes(tool, tmp_path, name):
    tool(f"make_{name}").main(tmp_path)
    made, kept = (
        {path.name: path.read_bytes() for path in folder.iterdir()} for folder in (tmp_path, ROOT / "data" / name)
    )
    assert made == {name: kept[name] for name in made}
    assert {path for path in kept if path.endswith(".ply")} <= made.keys()  # a robot's URDF and its lid are by hand


@pytest.mark.parametrize("path", sorted((ROOT / "tools").glob("*.py")), ids=lambda path: path.name)
def test_tools_ask_for_what_the_package_has(path):
    """No test runs the benchmarks: at least every name that they import is there."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lidarcfg"):
            module = importlib.import_module(node.module)
            for name in node.names:
                assert hasattr(module, name.name) or importlib.import_module(f"{node.module}.{name.name}"), name.name
