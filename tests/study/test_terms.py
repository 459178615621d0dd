"""The table of terms: what is in it is read, explained, minimised and described, and nothing else knows of it."""

import json
import pickle
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from lidarcfg.cli.json_schemas import schema
from lidarcfg.search.optimize import optimize
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from lidarcfg.study.terms import TERMS
from tests.command_line import lidarcfg
from tests.study.toy_term import MeanHeight

STUDY = """region: {min_m: [-6, -6, 0], max_m: [6, 6, 4], cuboid_m: [2, 2, 1]}
sensors:
  - elevation_deg: [-15, -5, 5]
    count: 2
    min: {position_m: [-0.9, -0.4, 1.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [0.9, 0.4, 1.9], rpy_deg: [0, 0, 0]}
objective: {ITEM}
solver: {method: METHOD, BUDGET, seed: 1}
"""


@pytest.fixture
def toy(monkeypatch):
    """An entry in the table."""
    monkeypatch.setitem(TERMS, MeanHeight.key, MeanHeight)


@pytest.fixture
def write(tmp_path):
    def written(item, method="annealing", budget="evaluations: 300"):
        path = tmp_path / "study.yaml"
        path.write_text(STUDY.replace("ITEM", item).replace("METHOD", method).replace("BUDGET", budget))
        return path

    return written


def test_its_value_counts_by_its_weight(toy, write):
    """Sensors at 1.5 m and 1.8 m are 0.5 m and 0.8 m above 1 m, 0.65 m on average; above 1.6 m it is 0 and 0.2 m."""
    poses = np.array([[-0.5, 0, 1.5, 0, 0, 0], [0.5, 0, 1.8, 0, 0, 0]])
    assert objective_of(load_study(write("mean_height: {above_m: 1}")), poses) == pytest.approx(0.65)
    assert objective_of(load_study(write("mean_height: {above_m: 1.6}")), poses) == pytest.approx(0.1)
    study = load_study(write("mean_height: {above_m: 1, weight: 3}, max_vsr: 1"))
    vsr_m = evaluate(study, study.rig(poses)).max_vsr_m
    assert objective_of(study, poses) == pytest.approx((3 * 0.65 + vsr_m) / 4)
    assert study.file["objective"]["mean_height"] == {"above_m": 1.0, "weight": 3.0}
    assert pickle.loads(pickle.dumps(study)).objective == study.objective


@pytest.mark.slow
@pytest.mark.parametrize(("method", "budget"), [("annealing", "evaluations: 100"), ("abc", "cycles: 2")])
@pytest.mark.parametrize("item", ["mean_height: {}", "mean_height: {above_m: 1, weight: 3}, max_vsr: 1"])
def test_a_search_minimises_it_and_skipping_changes_nothing(toy, write, item, method, budget):
    study = load_study(write(item, method, budget))
    found, skipped = (optimize(study, threads=1, skip=skip) for skip in (False, True))
    assert (found.rig, found.objective) == (skipped.rig, skipped.objective)
    assert found.objective == objective_of(
        study, np.array([[*one.position_m, *one.rpy_rad] for one in found.rig.mounts])
    )


@pytest.mark.slow
def test_the_command_takes_and_describes_it(toy, write, tmp_path):
    """All stand as low as they may, at 1.5 m: 0.5 m above 1 m."""
    lidarcfg("optimize", write("mean_height: {above_m: 1}"), "-o", tmp_path / "out", "--quiet")
    assert [one.position_m[2] for one in load_rig(tmp_path / "out/rig.yaml").mounts] == pytest.approx(
        [1.5] * 2, abs=0.02
    )
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert result["objective"] == pytest.approx(0.5, abs=0.02)
    page = (tmp_path / "out/report.html").read_text()
    assert "1 × the mean height above 1 m" in page
    assert "not computed, as the objective does not need them" in page


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ("mean_height: 1", "7:13: objective.mean_height: 1 is not a map of keys"),
        ("mean_height: {above_m: -1}", "7:27: objective.mean_height.above_m: -1 is too small; allowed: at least 0"),
        ("mean_hight: {}", "7:13: objective.mean_hight: unknown key; did you mean mean_height? allowed: KEYS"),
        ("weather: 1", "7:13: objective.weather: unknown key; allowed: KEYS"),
    ],
)
def test_mistakes_are_told_where_they_are(toy, write, item, said):
    path = write(item)
    keys = ", ".join(TERMS)
    assert lidarcfg("validate", path, code=2).stderr == f"lidarcfg: {path}:{said.replace('KEYS', keys)}\n"


def test_what_a_term_refuses_is_told_where_it_is(toy, write):
    path = write("mean_height: {}")
    path.write_text(path.read_text() + "detection: [{name: post, size_m: [0.5, 0.5, 1], threshold: 1}]\n")
    said = f"{path}:7:13: objective.mean_height: does not go with objects"
    assert lidarcfg("validate", path, code=2).stderr == f"lidarcfg: {said}\n"


def test_the_schema_has_it(monkeypatch):
    """By another library; without the entry it has not."""
    values = {
        "region": {"min_m": [0, 0, 0], "max_m": [1, 1, 1], "cuboid_m": [1, 1, 1]},
        "sensors": [{}],
        "objective": {"mean_height": {"above_m": 1.0}},
    }
    assert not jsonschema.Draft202012Validator(schema("study")).is_valid(values)
    monkeypatch.setitem(TERMS, MeanHeight.key, MeanHeight)
    known = jsonschema.Draft202012Validator(schema("study"))
    assert known.is_valid(values)
    values["objective"]["mean_height"]["above_m"] = -1.0
    assert not known.is_valid(values)
    assert "the mean height of the sensors" in json.dumps(schema("study"))


def test_without_the_entry_it_is_unknown(write):
    path = write("mean_height: {}")
    assert "objective.mean_height: unknown key" in lidarcfg("validate", path, code=2).stderr


def test_each_term_is_in_the_table_by_its_own_key():
    assert [term.key for term in TERMS.values()] == list(TERMS)


def test_nobody_asks_of_which_term_a_file_speaks():
    """But for misses and max VSR, which are defaults, and of which searches and the evaluator know more."""
    asks = re.compile(
        r"isinstance\([^)]*\b(DetectionTerm|MissRate|InscribedRadius|BlindVolume|SeenByTwo)\b|objective\.(inscribed|blind|seen)"
    )
    files = [
        path
        for folder in ("study", "search", "report", "viewer", "cli")
        for path in Path(__file__).parents[2].joinpath("lidarcfg", folder).rglob("*.py")
        if path.parent.name != "terms"
    ]
    assert [(str(path), found[0]) for path in files for found in asks.finditer(path.read_text())] == []
