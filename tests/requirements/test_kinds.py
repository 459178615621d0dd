"""The table of kinds: what is in it is read, explained, judged, searched and drawn, and nothing else knows of it."""

import json
import math
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from lidarcfg.cli.json_schemas import schema
from lidarcfg.requirements.file import KINDS
from lidarcfg.sensors.rig import load_rig
from tests.command_line import lidarcfg
from tests.requirements.toy_kind import ApartKind

STUDY = """region: {min_m: [-6, -6, 0], max_m: [6, 6, 4], cuboid_m: [2, 2, 1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4]}]}
sensors:
  - model: vlp-16
    name: roof
    count: COUNT
    min: {position_m: [-0.9, -0.4, 1.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [0.9, 0.4, 1.9], rpy_deg: [0, 0, 0]}
requirements:
  - {name: cables, ITEM}
  - {name: crate, object: {size_m: [0.5, 0.5, 1]}, within_m: [3, 3.2], sector_deg: [-20, 20], headings_deg: [0], returns: 5}
solver: {method: annealing, evaluations: 200, seed: 1}
"""
RIG = """name: two
sensors:
  - {name: left, model: vlp-16, position_m: [0.3, 0.4, 1.6]}
  - {name: right, model: vlp-16, position_m: [0, 0, 1.6]}
"""


@pytest.fixture
def toy(monkeypatch):
    """An entry in the table."""
    monkeypatch.setitem(KINDS, ApartKind.key, ApartKind)


@pytest.fixture
def files(tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)

    def write(item, count=2):
        path = tmp_path / "study.yaml"
        path.write_text(STUDY.replace("ITEM", item).replace("COUNT", str(count)))
        return path

    return write


@pytest.mark.slow
@pytest.mark.parametrize(("least_m", "said"), [(0.5, "PASS"), (0.6, "FAIL")])
def test_verify_judges_by_it(toy, files, tmp_path, least_m, said):
    """The sensors of the rig are 0.3 m and 0.4 m apart along two axes: 0.5 m."""
    words = "verify", files(f"apart_at_least_m: {least_m}"), tmp_path / "rig.yaml", "-o", tmp_path / "out"
    done = lidarcfg(*words, code=0 if said == "PASS" else 3)
    (row,) = (line for line in done.stdout.splitlines() if "cables" in line)
    margin = f"{'+' if said == 'PASS' else '-'}{abs(0.5 - least_m):.2f} m"
    assert re.split(r"\s{2,}", row.strip())[:5] == ["cables", said, f"≥ {least_m:.2f} m", "0.50 m", margin]
    one = json.loads((tmp_path / "out/verdict.json").read_text())["requirements"][0]
    assert (one["kind"], one["pass"], one["worst"]) == ("apart_at_least_m", said == "PASS", {"x_m": 0.15, "y_m": 0.2})
    assert one["shortfall"] == pytest.approx(max(1 - 0.5 / least_m, 0))
    page = (tmp_path / "out/verdict.html").read_text()
    assert f"{said}: cables" in page
    assert page.count("map around the vehicle") == 1  # the crate's


@pytest.mark.slow
@pytest.mark.parametrize(("least_m", "meets"), [(1.5, True), (2.5, False)])
def test_optimize_searches_for_it(toy, files, tmp_path, least_m, meets):
    """The corners of the sensors' bounds are √(1.8² + 0.8² + 0.4²) = 2.01 m apart."""
    study = files(f"apart_at_least_m: {least_m}")
    lidarcfg("optimize", study, "-o", tmp_path / "out", "--quiet", code=0 if meets else 3)
    one, other = (np.array(mount.position_m) for mount in load_rig(tmp_path / "out/rig.yaml").mounts)
    apart_m = math.dist(one, other)
    assert apart_m >= 1.5
    assert (apart_m >= least_m) == meets
    result = json.loads((tmp_path / "out/result.json").read_text())["verdict"]["requirements"]
    assert result[0]["reached"] == pytest.approx(apart_m)
    assert result[0]["pass"] == meets


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ("apart_at_least_m: 0", ["10:20: requirements[0].apart_at_least_m: 0 is too small; allowed: above 0"]),
        (
            "apart_at_least_m: wide, within_m: [0, 1]",
            [
                "10:20: requirements[0].apart_at_least_m: 'wide' is not a number",
                "10:44: requirements[0].within_m: does not go with apart_at_least_m; it goes with object or "
                "post_height_m or shadow_at_most_m3",
            ],
        ),
        (
            "apart_at_last_m: 1",
            [
                "10:20: requirements[0].apart_at_last_m: unknown key; did you mean apart_at_least_m? allowed: name, "
                "apart_at_least_m"
            ],
        ),
        (
            "apart_at_least_m: 1, sensors_at_most: 2",
            [
                "10:20: requirements[0].apart_at_least_m: conflicts with sensors_at_most; make it a requirement of its own"
            ],
        ),
        (
            "lost: 1",
            ["10:5: requirements[0]: asks for nothing; give one of " + ", ".join([*KINDS, "apart_at_least_m"])],
        ),
    ],
)
def test_mistakes_are_told_all_at_once_where_they_are(toy, files, item, said):
    path = files(item)
    told = lidarcfg("validate", path, code=2).stderr.splitlines()
    assert told == [f"lidarcfg: {path}:{one}" for one in said]


def test_what_a_kind_refuses_is_told_where_it_is(toy, files):
    path = files("apart_at_least_m: 1", count=1)
    said = f"{path}:10:20: requirements[0].apart_at_least_m: needs two sensors, and the study has one"
    assert lidarcfg("validate", path, code=2).stderr == f"lidarcfg: {said}\n"


@pytest.mark.parametrize("file", ["study", "requirements"])
def test_the_schema_has_it(monkeypatch, file):
    """By another library; without the entry it has not."""
    values = {"requirements": [{"name": "cables", "apart_at_least_m": 1.0}]}
    if file == "study":
        values |= {"region": {"min_m": [0, 0, 0], "max_m": [1, 1, 1], "cuboid_m": [1, 1, 1]}, "sensors": [{}]}
    assert not jsonschema.Draft202012Validator(schema(file)).is_valid(values)
    monkeypatch.setitem(KINDS, ApartKind.key, ApartKind)
    known = jsonschema.Draft202012Validator(schema(file))
    assert known.is_valid(values)
    values["requirements"][0]["apart_at_least_m"] = 0
    assert not known.is_valid(values)
    assert "No two sensors are nearer to each other" in json.dumps(schema(file))


def test_each_kind_is_in_the_table_by_its_own_key():
    for key, kind in KINDS.items():
        assert kind.key == key
        assert key in kind.model_fields
        assert [other for other, one in KINDS.items() if key in one.model_fields] == [key]


def test_nobody_asks_of_which_kind_a_requirement_is():
    """Neither by its type nor by its key."""
    names = "|".join(kind.__name__.removesuffix("Kind") for kind in KINDS.values())
    asks = re.compile(rf"isinstance\([^)]*\b({names})(Kind|Requirement|Judge)\b|case ({names})|\.key ==|\.kind ==")
    folders = ("requirements", "study", "search", "report", "viewer")
    files = [
        path for folder in folders for path in Path(__file__).parents[2].joinpath("lidarcfg", folder).rglob("*.py")
    ]
    assert files
    assert [(str(path), found[0]) for path in files for found in asks.finditer(path.read_text())] == []
