"""Plans: which runs they ask for, what is wrong with them and where, and what tells one run from another."""

import shutil
from pathlib import Path

import pytest
import yaml

from lidarcfg.errors import ConfigError
from lidarcfg.search import sweep_plan as plans
from lidarcfg.search.sweep_plan import load_plan
from lidarcfg.study.loading import load_study

ROOT = Path(__file__).parents[2]
STUDY = """region: {min_m: [-4, -3, 0], max_m: [4, 3, 2], cuboid_m: [1, 0.5, 0.25]}
sensors:
  - model: fan-4
    min: {position_m: [-1, -1, 1.2], rpy_deg: [-20, -20, 0]}
    max: {position_m: [1, 1, 1.5], rpy_deg: [20, 20, 0]}
  - {name: b, elevation_deg: [-9, 0, 9], min: {position_m: [-1, 0, 1.2], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 0, 1.2], rpy_deg: [0, 0, 0]}}
solver: {method: abc, evaluations: 30, limit: 7}
detection: [{name: box, size_m: [1, 1, 1]}]
objective: {max_vsr: 1}
"""


@pytest.fixture
def asks(tmp_path):
    """The plan with this text, beside a study."""
    (tmp_path / "study.yaml").write_text(STUDY)

    def load(text):
        (tmp_path / "plan.yaml").write_text(text if "study:" in text else f"study: study.yaml\n{text}")
        return load_plan(tmp_path / "plan.yaml")

    return load


def test_a_grid_and_rows(asks):
    """By hand: rows of `together` are outermost, the last key changes first."""
    plan = asks("""
vary: {"sensors[0].count": [1, 3], solver.seed: [5, 6]}
together:
  - {"sensors[0].model": fan-16, "sensors[1].name": c}
  - {"sensors[0].model": fan-8, "sensors[1].name": d}
""")
    rows = [tuple(run.values.values()) for run in plan.runs]
    assert rows == [
        ("fan-16", "c", 1, 5), ("fan-16", "c", 1, 6), ("fan-16", "c", 3, 5), ("fan-16", "c", 3, 6),
        ("fan-8", "d", 1, 5), ("fan-8", "d", 1, 6), ("fan-8", "d", 3, 5), ("fan-8", "d", 3, 6),
    ]  # fmt: skip
    assert plan.varied == ("sensors[0].model", "sensors[1].name", "sensors[0].count", "solver.seed")
    assert [run.number for run in plan.runs] == list(range(1, 9))
    assert len({run.digest for run in plan.runs}) == 8


def test_each_study_is_that_of_a_file_with_the_value_in_it(asks, tmp_path):
    values = {
        "sensors[0].count": 2,
        "sensors[1].min.position_m[1]": -0.5,
        "solver.limit": None,
        "detection": None,
        "zones": None,
        "robust.lost": None,
        "solver.seed": 9,
        "vehicle": {"boxes": [{"name": "body", "center_m": [0, 0, 0.5], "size_m": [1, 1, 1]}]},
        "constraints.max_tilt_deg": 15.5,
    }
    (run,) = (plan := asks(yaml.safe_dump({"study": "study.yaml", "vary": {k: [v] for k, v in values.items()}}))).runs
    by_hand = yaml.safe_load(STUDY)
    by_hand["sensors"][0]["count"] = 2
    by_hand["sensors"][1]["min"]["position_m"][1] = -0.5
    del by_hand["solver"]["limit"], by_hand["detection"]
    by_hand["solver"]["seed"] = 9
    by_hand["vehicle"] = values["vehicle"]
    by_hand["constraints"] = {"max_tilt_deg": 15.5}
    (tmp_path / "by_hand.yaml").write_text(yaml.safe_dump(by_hand))
    expected = load_study(tmp_path / "by_hand.yaml")
    found = plan.studies.of(run.file)
    assert found.file == expected.file
    assert (found.space.lower == expected.space.lower).all()
    assert found.solver == expected.solver
    assert (found.visibility.obstacles.tree.shapes == expected.visibility.obstacles.tree.shapes).all()


def test_an_inline_study(asks):
    inline = "study:\n" + "".join(f"  {line}\n" for line in STUDY.splitlines()) + "vary: {solver.seed: [1, 2]}"
    one, other = asks(inline), asks("vary: {solver.seed: [1, 2]}")
    assert [run.file for run in one.runs] == [run.file for run in other.runs]
    assert (one.study, other.study) == ("", "study.yaml")


BAD = [
    ("vary: {'sensors[0].cuont': [1]}", ":2:29: vary.sensors[0].cuont[0]: unknown key; did you mean count?"),
    ("vary: {solvr.seed: [1]}", ":2:21: vary.solvr.seed[0]: solvr: unknown key; did you mean solver?"),
    ("vary: {'sensor[0].count': [1]}", ":2:8: vary.sensor[0].count: the study has no list before [0]"),
    ("vary: {'sensors[2].count': [1]}", ":2:8: vary.sensors[2].count: the study's list has no [2]; it ends with [1]"),
    ("vary: {solver.method.x: [1]}", ":2:8: vary.solver.method.x: what is before x is not a map of keys"),
    ("vary: {a..b: [1]}", ":2:8: vary.a..b: is not the path of a key, such as sensors[0].count"),
    ("vary: {solver.seed: []}", ":2:8: vary.solver.seed: has no values"),
    ("vary: {solver.seed: 3}", ":2:8: vary.solver.seed: 3 is not a list"),
    ("vary: {solver.seed: [1, 2, 1]}", ":2:28: vary.solver.seed[2]: 1 is there already"),
    ("vary: {'region.cuboid_m[0]': [1, 1.0]}", ":2:34: vary.region.cuboid_m[0][1]: 1.0 is there already"),
    ("vary: {solver.seed: [1, x]}", ":2:25: vary.solver.seed[1]: 'x' is not a whole number"),
    ("vary: {'sensors[0].count': [0]}", ":2:29: vary.sensors[0].count[0]: 0 is too small; allowed: at least 1"),
    ("vary: {'sensors[0].model': [fan-5]}", ":2:29: vary.sensors[0].model[0]: no sensor is called 'fan-5'"),
    ("vary: {surroundings: [no.yaml]}", ":2:23: vary.surroundings[0]: "),
    (
        "vary: {region.cuboid_m: [[1, 1, 1], [1, 0.5, 0.3]]}",
        ":2:46: vary.region.cuboid_m[1][2]: 0.3 does not divide",
    ),
    ("vary: {solver.seed: [1], solver: [{seed: 2}]}", ":2:8: vary.solver.seed: is a part of solver, which also varies"),
    ("vary: {solver.seed: [1]}\ntogether: [{solver.seed: 2}]", ":2:8: vary.solver.seed: is also in together"),
    ("together: [{solver.seed: 2}, {solver.limit: 2}]", ":2:30: together[1]: other keys than in the first row"),
    ("together: [{solver.seed: 2}, {solver.seed: 2}]", ':2:30: together[1]: {"solver.seed": 2} is there already'),
    ("vary: {}", ":1:1: missing; give vary or together"),
    ("varied: {}", ":2:1: varied: unknown key; did you mean vary?"),
    ("study: 5\nvary: {solver.seed: [1]}", ":1:1: study: is neither the name of a study's file nor a study"),
    ("study: none.yaml\nvary: {solver.seed: [1]}", ":1:1: study: "),
    (f"vary: {{{', '.join(f'k{i}: {list(range(10))}' for i in range(9))}}}", "asks for 1,000,000,000 runs; allowed"),
]


@pytest.mark.parametrize(("text", "what"), BAD, ids=[text[:40] for text, _ in BAD])
def test_what_is_wrong_is_said_at_its_place_in_the_plan(asks, tmp_path, text, what):
    with pytest.raises(ConfigError) as error:
        asks(text)
    assert what in str(error.value).removeprefix(str(tmp_path / "plan.yaml"))
    assert "\n" not in str(error.value)


def test_what_only_a_value_makes_wrong_is_said_with_it(asks, tmp_path):
    """A value that is right by itself, and wrong beside another key of the study."""
    with pytest.raises(ConfigError) as error:
        asks("vary: {solver.seed: [1, 2], 'sensors[0].min.position_m[0]': [-1, 3]}")
    place = f"{tmp_path}/study.yaml:5:5: sensors[0].max: its x is below min's"
    assert str(error.value).startswith(place)
    assert str(error.value).endswith("(with solver.seed: 1, sensors[0].min.position_m[0]: 3)")
    still = "{position_m: [0, 0, 1], rpy_deg: [0, 0, 0]}"
    with pytest.raises(ConfigError, match=r"plan.yaml:2:18: vary.sensors\[0\]: nothing is free to move"):
        asks(f"vary: {{sensors: [[{{model: fan-4, min: {still}, max: {still}}}]]}}")


@pytest.mark.slow
def test_a_run_is_another_once_anything_that_it_depends_on_is(asks, tmp_path, monkeypatch):
    """The study, the content of a file that it names, the versions; not how it is written."""
    text = "vary: {solver.seed: [1]}\nstudy: with_body.yaml"
    shutil.copy(ROOT / "data/vehicles/sedan.ply", tmp_path / "body.ply")
    body = "vehicle: {allow_inside: true, meshes: [{name: body, file: body.ply, position_m: [0, 0, -1]}]}\n"
    (tmp_path / "with_body.yaml").write_text(STUDY + body)
    first = asks(text).runs[0].digest
    (tmp_path / "with_body.yaml").write_text("# a remark\n" + body + STUDY)
    assert asks(text).runs[0].digest == first
    (tmp_path / "with_body.yaml").write_text(STUDY.replace("1.5]", "1.6]") + body)
    assert asks(text).runs[0].digest != first
    (tmp_path / "with_body.yaml").write_text(STUDY + body)
    shutil.copy(ROOT / "data/vehicles/shuttle.ply", tmp_path / "body.ply")
    assert asks(text).runs[0].digest != first
    shutil.copy(ROOT / "data/vehicles/sedan.ply", tmp_path / "body.ply")
    assert asks(text).runs[0].digest == first
    monkeypatch.setattr(plans, "versions", lambda: {"lidarcfg": "9.9"})
    assert asks(text).runs[0].digest != first
