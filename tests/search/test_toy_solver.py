"""The table of solvers: what is in it is read, run, completed and in the schema, and nothing else knows of it.

The witness of what is found is a box of 4 × 4 × 4 m that a level beam at height z cuts in two. A part of height h has
16 h m³ and 32 + 16 h m², so VSR is h / (2 + h). Cuboids are 1 m high, and below if their centres are.
"""

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest

from lidarcfg.cli.json_schemas import schema
from lidarcfg.errors import ConfigError
from lidarcfg.search.optimize import optimize
from lidarcfg.sensors.rig import load_rig
from lidarcfg.solvers import GONE, SOLVERS, solver_of
from lidarcfg.solvers.solver import Solver
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
from tests.command_line import lidarcfg

STUDY = """region: {min_m: [0, 0, 0], max_m: [4, 4, 4], cuboid_m: [1, 1, 1]}
sensors:
  - elevation_deg: [0]
    min: {position_m: [2, 2, 0], rpy_deg: [0, 0, 0]}
    max: {position_m: [2, 2, 4], rpy_deg: [0, 0, 0]}
"""
TABLE = """import sys
from lidarcfg.solvers import SOLVERS
SOLVERS["ruler"] = "tests.search.toy_solver:RulerSolver"
from lidarcfg.cli.main import main
main()
"""


@pytest.fixture
def toy(monkeypatch):
    """An entry in the table."""
    monkeypatch.setitem(SOLVERS, "ruler", "tests.search.toy_solver:RulerSolver")


@pytest.fixture
def study(tmp_path):
    def write(keys):
        path = tmp_path / "study.yaml"
        path.write_text(STUDY + (f"solver: {{{keys}}}\n" if keys else ""))
        return path

    return write


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keys", "height_m", "max_vsr_m", "mean_m"),
    [
        ("", 2, 2 / 4, (4 / 6 + 3 / 5 + 2 / 4 + 3 / 5 + 4 / 6) / 5),  # at 0, 1, 2, 3, 4 m
        (", values: 4", 4 / 3, 3 / 5, (4 / 6 + 3 / 5 + 3 / 5 + 4 / 6) / 4),  # at 0, 4/3, 8/3, 4 m
    ],
)
def test_optimize_searches_by_it(toy, study, tmp_path, keys, height_m, max_vsr_m, mean_m):
    lidarcfg("optimize", study(f"method: ruler{keys}"), "-o", tmp_path / "out", "--quiet")
    (mount,) = load_rig(tmp_path / "out/rig.yaml").mounts
    assert mount.position_m == pytest.approx((2, 2, height_m), abs=1e-6)
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert result["objective"] == pytest.approx(max_vsr_m)
    values = 4 if keys else 5
    assert (result["solver"], result["evaluations"]) == ("ruler", values)
    assert result["study"]["solver"] == {"method": "ruler", "values": values, "cycles": 1, "seed": 1}
    with open(tmp_path / "out/history.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert [float(row[key]) for key in ("best", "mean")] == pytest.approx([max_vsr_m, mean_m], abs=1e-6)
    report = (tmp_path / "out/report.html").read_text()
    assert f"ruler, values {values}, seed 1, for 1 cycles" in report


@pytest.mark.slow
def test_the_command_line_has_it(study, tmp_path):
    """In a process of its own, as its choices are made when it starts."""

    def run(*words):
        return subprocess.run(
            [sys.executable, "-c", TABLE, *map(str, words)],
            capture_output=True,
            text=True,
            cwd=Path(__file__).parents[2],
        )

    assert "[auto|annealing|abc|ruler]" in run("optimize", "--help").stdout
    done = run("optimize", study("method: abc, bees: 9, seed: 3"), "--solver", "ruler", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert (result["objective"], result["evaluations"], result["seed"]) == (pytest.approx(0.5), 800 * 5, 3)


COMMON = "method, cycles, evaluations, seconds, seed"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("method: ruler, values: 1", ["6:25: solver.values: 1 is too small; allowed: at least 2"]),
        (
            "method: ruler, vales: 3",
            [f"6:25: solver.vales: unknown key; did you mean values? allowed: {COMMON}, values"],
        ),
        (
            "method: ruler, bees: 3, seed: none",
            [
                "6:25: solver.bees: does not go with ruler; it goes with abc",
                "6:34: solver.seed: 'none' is not a whole number",
            ],
        ),
        ("values: 3", ["6:10: solver.values: does not go with auto; it goes with ruler"]),
        (
            "method: rule, values: 3, seed: -1",
            [
                "6:10: solver.method: 'rule' is not allowed; allowed: auto, annealing, abc, ruler",
                "6:35: solver.seed: -1 is too small; allowed: at least 0",
            ],
        ),
        ("method: 5", ["6:10: solver.method: is not a text; allowed: auto, annealing, abc, ruler"]),
    ],
)
def test_mistakes_are_told_all_at_once_where_they_are(toy, study, keys, said):
    path = study(keys)
    told = lidarcfg("validate", path, code=2).stderr.splitlines()
    assert told == [f"lidarcfg: {path}:{one}" for one in said]


def test_the_schema_has_it(monkeypatch):
    """By another library; without the entry it has not."""
    values = {"region": {"min_m": [0, 0, 0], "max_m": [1, 1, 1], "cuboid_m": [1, 1, 1]}, "sensors": [{}]}
    values["solver"] = {"method": "ruler", "values": 3}
    assert not jsonschema.Draft202012Validator(schema("study")).is_valid(values)
    monkeypatch.setitem(SOLVERS, "ruler", "tests.search.toy_solver:RulerSolver")
    known = jsonschema.Draft202012Validator(schema("study"))
    assert known.is_valid(values)
    for wrong in ({"method": "ruler", "values": 1}, {"values": 3}, {"method": "ruler", "bees": 3}, {"method": "rule"}):
        assert not known.is_valid(values | {"solver": wrong})
    for right in ({}, {"seed": 3}, {"method": "abc", "bees": 3}, {"method": "auto", "cycles": 3}):
        assert known.is_valid(values | {"solver": right})
    assert "Evenly spaced values" in json.dumps(schema("study"))


def test_a_key_of_another_method_may_be_null(toy, study):
    """As where a plan varies the method of a study."""
    assert load_study(study("method: ruler, bees: null")).solver.own_keys == {"values": 5}


def test_another_method_keeps_what_all_have(toy, study):
    loaded = load_study(study("method: abc, bees: 9, cycles: 7, seed: 3"))
    changed = with_solver(loaded, method="ruler", values=4, seed=None)
    assert changed.solver.model_dump(exclude_none=True) == {"method": "ruler", "values": 4, "cycles": 7, "seed": 3}
    assert changed.file["solver"] == {"method": "ruler", "values": 4, "cycles": 7, "seed": 3}
    assert with_solver(changed, evaluations=20).solver.cycles is None
    assert optimize(changed).evaluations == 7 * 4
    with pytest.raises(ConfigError, match=r"solver\.bees: does not go with ruler; it goes with abc"):
        with_solver(changed, bees=3)
    with pytest.raises(ConfigError, match=r"solver\.seed: -1 is too small"):
        with_solver(changed, seed=-1)


@pytest.mark.parametrize("method", GONE)
def test_of_a_method_that_is_gone_it_is_said_what_to_use(study, method):
    path = study(f"method: {method}")
    said = f"{method!r} is gone; use auto"
    assert lidarcfg("validate", path, code=2).stderr.startswith(f"lidarcfg: {path}:6:10: solver.method: {said}")
    assert said in lidarcfg("optimize", path, "--solver", method, code=2).stderr


def test_each_solver_is_in_the_table_by_its_method():
    for method in SOLVERS:
        assert solver_of(method).model_validate({"method": method}).method == method
    named = [name for name in SOLVERS if not solver_of(name).model_fields["method"].is_required()]
    assert named == ["auto"]
    assert solver_of("auto")().method == load_study("data/studies/sedan.yaml").solver.method


def test_nobody_asks_for_a_solver_by_its_name():
    """But the table."""
    names = "|".join(name for name in SOLVERS if name != "auto")  # which Matplotlib says, too
    asks = re.compile(rf"method\W{{1,4}}(==|!=|in)\s*[\"'(]|[\"']({names})[\"']")
    folder = Path(__file__).parents[2] / "lidarcfg"
    files = [path for one in ("study", "search", "report", "cli") for path in folder.joinpath(one).rglob("*.py")]
    assert [(str(path), found[0]) for path in files for found in asks.finditer(path.read_text())] == []
    assert {name for name in vars(Solver) if name in SOLVERS} == set()
