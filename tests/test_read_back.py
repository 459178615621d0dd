"""What is written as YAML is read back equal: studies by each of their writers, rigs, scenes, motions and records."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lidarcfg as library
from lidarcfg.capture.manifest import CaptureManifest, FileDigest
from lidarcfg.cli.templates import vehicles, write_template
from lidarcfg.config.document import Document, document, inline, yaml_text
from lidarcfg.config.kinds import kind_of
from lidarcfg.config.models import load, loads, whole_values
from lidarcfg.errors import ConfigError
from lidarcfg.report.search_log import fingerprint
from lidarcfg.search.combinations import combinations
from lidarcfg.search.sweep_plan import load_plan
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.study.file import StudyFile
from lidarcfg.study.study import with_solver
from lidarcfg.world.motion import Motion
from lidarcfg.world.scene_file import SceneFile
from tests.command_line import lidarcfg, without_drawing
from tests.studies import study_of
from tests.test_docs import PAGES, blocks, named_files

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
FOLDERS = ("data/*", "docs/examples", "tests/search/studies")
FILES = sorted(path for folder in FOLDERS for path in ROOT.glob(f"{folder}/*.yaml"))
STUDIES = [path for path in FILES if "\n---" not in path.read_text() and kind_of(document(path).value) == "study"]
PLANS = [path for path in FILES if "\n---" not in path.read_text() and kind_of(document(path).value) == "plan"]
RIGS = [path for path in FILES if path.parent.name == "rigs"]
SCENES = [path for path in FILES if path.parent.name == "scenes"]
SHOWN = [
    (page, text) for page in PAGES for _, text in blocks(page, "yaml") if re.search("^region:", text, re.MULTILINE)
]
RETURNS = """region: {min_m: [-6, -6, 0], max_m: [6, 6, 2], cuboid_m: [1, 1, 0.5]}
prices: {fan-4: 100, vlp-16: 900}
sensors:
  - name: roof
    choose: [vlp-16, none]
    count: 2
    min: {position_m: [-1, -1, 1.5], rpy_deg: [-20, -20, 0]}
    max: {position_m: [1, 1, 1.9], rpy_deg: [20, 20, 0]}
surroundings: near/wall.yaml
objective: {max_vsr: 1, detection: {child: 1, crate: 0.5}}
detection:
  - {name: child, mesh: near/child.ply, returns: 12, step_m: 4}
  - {name: crate, size_m: [0.5, 0.5, 0.5], returns: 5, on_ground: true, step_m: 4}
  - {name: box, size_m: [1, 1, 1]}
solver: {evaluations: 220, seed: 3}
"""
TEXTS = st.text(st.characters(exclude_categories=["Cs"])) | st.from_regex(r"[-+.0-9eExo_~ ]{1,8}", fullmatch=True)
NUMBERS = st.integers() | st.floats(allow_nan=False, allow_infinity=False)
VALUES = st.recursive(
    TEXTS | NUMBERS | st.booleans(),
    lambda inner: st.lists(inner).map(tuple) | st.dictionaries(TEXTS, inner),
    max_leaves=10,
)


def with_files(folder):
    """A folder with what RETURNS names."""
    (folder / "near").mkdir(parents=True)
    (folder / "near/child.ply").write_bytes((ROOT / "data/objects/child.ply").read_bytes())
    box = "{name: wall, center_m: [5, 0, 1], size_m: [0.2, 2, 2], reflectivity: 9}"
    (folder / "near/wall.yaml").write_text(f"name: wall\nboxes: [{box}]\n")
    return folder


def rigs_are_equal(rig, other):
    return (rig.name, rig.mounts, rig.vehicle) == (other.name, other.mounts, other.vehicle)


def sensors_of(study):
    return [(slot.name, slot.sensor, slot.model, slot.range_m, slot.azimuth_fov_deg) for slot in study.slots]


def assert_read_back(study, folder):
    """Its file's text, in another folder, is the same study; so are the first and last combination."""
    chosen = [found.study for found in combinations(study)] if study.to_choose else []
    for one in [study, *chosen[:: max(len(chosen) - 1, 1)]]:
        path = folder / "elsewhere" / "study.yaml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(yaml_text(one.file))
        again = library.load_study(path)
        file = load(path, StudyFile)
        assert again.file == one.file
        assert fingerprint(again) == fingerprint(one)
        assert loads(yaml_text(whole_values(file, Path())), StudyFile, "again") == file
        for key in ("solver", "objective", "constraints", "robust", "detection"):
            assert getattr(again, key) == getattr(file, key)
        assert again.objective == one.objective
        assert again.robust == one.robust
        assert sensors_of(again) == sensors_of(one)
        for key in ("lower", "upper", "mirror"):
            np.testing.assert_array_equal(getattr(again.space, key), getattr(one.space, key))
        np.testing.assert_array_equal(again.region.included, one.region.included)
        assert len(again.detection_targets) == len(one.detection_targets)
        for sought, known in zip(again.detection_targets, one.detection_targets, strict=True):
            assert np.array_equal(sought.places, known.places)
            assert sought.item.model_copy(update={"mesh": known.item.mesh}) == known.item
        save_rig(one.rig(one.space.midpoint), path.with_name("rig.yaml"))
        assert rigs_are_equal(load_rig(path.with_name("rig.yaml")), one.rig(one.space.midpoint))


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_shipped_studies(path, tmp_path):
    study = library.load_study(path)
    assert_read_back(study, tmp_path)
    changed = with_solver(study, seconds=5, seed=2)
    assert loads(yaml_text(changed.file), StudyFile, "changed").solver == changed.solver


@pytest.mark.parametrize("path", PLANS, ids=lambda path: path.stem)
def test_the_studies_of_plans(path, tmp_path):
    plan = load_plan(path)
    for run in plan.runs[:: max(len(plan.runs) // 3, 1)]:
        study = plan.studies.of(run.file)
        assert_read_back(study, tmp_path)
        assert loads(yaml_text(whole_values(run.file, plan.studies.path.parent)), StudyFile, "it") == load(
            tmp_path / "elsewhere/study.yaml", StudyFile
        )


@pytest.mark.parametrize("name", [None, *vehicles()])
def test_templates_of_studies(name, tmp_path):
    """With all that is optional; that without a vehicle also without."""
    path = write_template("study", tmp_path / "study.yaml", name)[0]
    if name is None:
        assert_read_back(library.load_study(path), tmp_path)
    (tmp_path / "scene.yaml").write_text("name: wall\nground: {reflectivity: 10}\n")
    path.write_text(re.sub(r"^#(?=\s*(- \{?)?[a-z])", "", path.read_text(), flags=re.M))
    assert_read_back(library.load_study(path), tmp_path)


@pytest.mark.parametrize(("page", "text"), SHOWN, ids=[page.stem for page, _ in SHOWN])
def test_studies_that_pages_show(page, text, tmp_path):
    """Beside the other files of the page, with the examples where the study says that they are."""
    folder = tmp_path / "data/mine"
    folder.mkdir(parents=True)
    (folder / "data").symlink_to(ROOT / "data")
    for name in ("objects", "scenes", "vehicles"):
        (tmp_path / "data" / name).symlink_to(ROOT / "data" / name)
    for name, other in named_files(page).items():
        (folder / name).write_text(other)
    assert_read_back(study_of(folder, text), tmp_path)


def test_an_example_named_from_a_folder_without_it(tmp_path, monkeypatch):
    """A scene, or a body, that comes with the package is found by its name there, and then from anywhere."""
    monkeypatch.chdir(tmp_path)
    text = RETURNS.replace("near/wall.yaml", "data/scenes/room.yaml").partition("objective")[0]
    body = "vehicle: {allow_inside: true, meshes: [{name: body, file: data/vehicles/sedan.ply}]}\n"
    Path("study.yaml").write_text(text + body)
    study = library.load_study("study.yaml")
    assert (
        study.vehicle.scene.vertices_m[:, 2].max()
        == library.load_vehicle("data/vehicles/sedan.ply").scene.vertices_m[:, 2].max()
    )
    assert study.file["surroundings"] == str(ROOT / "data/scenes/room.yaml")
    assert_read_back(study, tmp_path)


def test_nothing_is_said_of_an_object_that_it_may_not_say(tmp_path):
    """Of one with returns no threshold, and that it is on the ground; null is what is missing."""
    study = study_of(with_files(tmp_path / "it"), RETURNS)
    child, crate, box = study.file["detection"]
    assert child == {
        "name": "child", "mesh": str(tmp_path / "it/near/child.ply"), "returns": 12, "on_ground": True, "step_m": 4.0,
    }  # fmt: skip
    assert "threshold" not in crate
    assert box == {"name": "box", "size_m": [1.0, 1.0, 1.0], "threshold": 1, "on_ground": False}
    nulls = RETURNS.replace("size_m: [1, 1, 1]", "size_m: [1, 1, 1], threshold: null, returns: null")
    nulls += "robust: {angle_sigma_deg: 1, samples: null, quantile: null}\n"
    loaded = study_of(tmp_path / "it", nulls)
    assert loaded.file["detection"][2] == box
    assert loaded.file["robust"] == {"angle_sigma_deg": 1.0, "samples": 16, "quantile": 0.9}
    assert_read_back(loaded, tmp_path)


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """The folder of a search among sensors for objects that are detected by returns."""
    folder = with_files(tmp_path_factory.mktemp("returns") / "it")
    (folder / "study.yaml").write_text(RETURNS)
    with without_drawing():
        lidarcfg("optimize", "study.yaml", "-o", "out", "--threads", 2, cwd=folder)
    return folder


def complete_study(page):
    """The study that a page of HTML shows as a file."""
    (text,) = re.findall(r"The complete study, with defaults</summary>\s*<pre><code>(.*?)</code>", page, re.DOTALL)
    return html.unescape(text)


def test_the_points_of_a_front(searched, tmp_path, blank_pictures):
    """Each is a study, the same as in its report, in which its rig is what it was, and whose search goes on."""
    points = json.loads((searched / "out/front.json").read_text())["points"]
    assert points
    known = {one.name: one.study for one in combinations(library.load_study(searched / "study.yaml"))}
    for point in points[:: max(len(points) - 1, 1)]:  # the first and the last
        there = searched / "out" / point["folder"]
        study = library.load_study(there / "study.yaml")
        assert study.file == known[point["name"]].file
        shown = complete_study((there / "report.html").read_text())
        assert study_of(tmp_path, shown).file == study.file
        words = ("evaluate", there / "study.yaml", there / "rig.yaml")
        found = json.loads(lidarcfg(*words, "--json", cwd=tmp_path).stdout)
        assert (found["max_vsr_m"], found["detection"]) == (point["max_vsr_m"], point["detection"])
        lidarcfg(*words, "-o", "evaluated", "--quiet", cwd=tmp_path)
        shown = complete_study((tmp_path / "evaluated/report.html").read_text())
        assert study_of(tmp_path, shown).file == study.file
        before = len(np.load(there / "search.npz")["cost"])
        more = ("--evaluations", before + 200)
        lidarcfg("optimize", there / "study.yaml", "--resume", there, *more, "--threads", 2, cwd=tmp_path)
        assert len(np.load(there / "search.npz")["cost"]) > before


def test_the_study_of_a_front_and_of_a_comparison(searched, tmp_path):
    study = library.load_study(searched / "study.yaml")
    front = complete_study((searched / "out/front.html").read_text())
    rig = next((searched / "out/points").glob("*/rig.yaml"))
    lidarcfg("compare", rig, ROOT / "data/rigs/roof.yaml", "--study", "study.yaml", "-o", tmp_path, cwd=searched)
    for text in (front, complete_study((tmp_path / "compare.html").read_text())):
        again = study_of(tmp_path, text)
        assert again.file == study.file
        assert fingerprint(again) == fingerprint(study)


@pytest.mark.parametrize(
    ("choose", "length", "message"),
    [
        ("[vlp-16, none]", 199, r"sensors\[0\].name: makes a sensor's name of 201 characters; allowed: at most 200"),
        ("[vlp-16, fan-4]", 195, "a sensor of a combination has a name of 202 characters; allowed: at most 200"),
    ],
)
def test_names_too_long_for_a_rig_are_refused(choose, length, message, tmp_path):
    """A sensor's number or model is appended to its group's name."""
    text = RETURNS.replace("surroundings: near/wall.yaml\n", "").partition("objective")[0]
    text = text.replace("[vlp-16, none]", choose).replace("name: roof", f"name: {'r' * length}")
    with pytest.raises(ConfigError, match=message):
        combinations(study_of(tmp_path, text))


@settings(max_examples=50, deadline=None)
@given(st.dictionaries(TEXTS, VALUES, min_size=1))
def test_values(values):
    assert Document(yaml_text(values), "it").value == values
    assert Document(yaml_text(values, blocks=True), "it").value == values


@given(TEXTS)
def test_a_text_in_a_line(text):
    assert Document(f"a: {{b: {inline(text)}, c: [{inline(text)}]}}  # comment", "it").value == {
        "a": {"b": text, "c": (text,)}
    }


def test_what_is_there_twice_is_written_twice():
    item = {"min_m": [1, 2, 3]}
    assert yaml_text({"a": [item, item]}) == "a:\n- min_m: [1, 2, 3]\n- min_m: [1, 2, 3]\n"


@pytest.mark.parametrize("name", ["a, b.ply", "it's.ply", "{x}.ply", "a # b: c.ply", "é.ply"])
def test_a_template_names_any_mesh(name, tmp_path):
    (tmp_path / name).write_bytes((ROOT / "data/vehicles/truck.ply").read_bytes())
    (path,) = write_template("study", tmp_path / "study.yaml", str(tmp_path / name))
    assert library.load_study(path).file["vehicle"]["meshes"][0]["file"] == str(tmp_path / name)


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
@pytest.mark.parametrize("name", [None, "1e3", "0o17", "a\x85b", "é: #1"])
def test_rigs(path, name, tmp_path):
    text = path.read_text()
    (tmp_path / "named.yaml").write_text(re.sub("^name:.*$", lambda _: f"name: {json.dumps(name)}", text, flags=re.M))
    rig = load_rig(tmp_path / "named.yaml" if name else path)
    assert name in (None, rig.name)
    save_rig(rig, tmp_path / "deep/er/again.yaml")
    assert rigs_are_equal(load_rig(tmp_path / "deep/er/again.yaml"), rig)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_scenes(path):
    file = load(path, SceneFile).model_copy(update={"name": "1e3"})
    assert loads(yaml_text(file.model_dump(mode="json", exclude_none=True)), SceneFile, "again") == file
    whole = loads(yaml_text(whole_values(file, path.parent)), SceneFile, "again")
    assert all(Path(item.file).is_file() for item in (*whole.meshes, *whole.height_fields, *whole.models))


@pytest.mark.parametrize(
    "text",
    [
        "arc: {speed_m_s: 1e-9, yaw_rate_deg_s: 3}",
        "velocity_m_s: [1, 2, 0]",
        "poses: [{time_s: 0, position_m: [0, 0, 1]}, {time_s: 1, position_m: [1, 0, 1], rpy_deg: [0, 0, 9]}]",
    ],
)
def test_motions(text):
    file = loads(text, Motion, "it")
    assert loads(yaml_text(file.model_dump(mode="json", exclude_none=True)), Motion, "again") == file


@pytest.mark.parametrize("name", ["1e3", "0o17", "é, b"])
def test_records(name):
    part = FileDigest(file=name, sha256="1" * 64)
    file = CaptureManifest.model_validate(
        {"rig": part.model_dump(), "at": "1e3", "start": "2026-01-01", "duration_s": 1}
    )
    assert loads(yaml_text(file.model_dump(mode="json", exclude_none=True)), CaptureManifest, "again") == file
