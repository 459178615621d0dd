"""init, validate and schema; what is warned about before a search, and files in the wrong place."""

import re
import subprocess
import sys
from pathlib import Path

import jsonschema
import numpy as np
import open3d as o3d
import pytest
import trimesh
from PIL import Image

from lidarcfg.cli.json_schemas import KINDS, schema
from lidarcfg.cli.templates import KINDS as TEMPLATES
from lidarcfg.cli.templates import vehicles, write_template
from lidarcfg.config.document import Document
from lidarcfg.config.kinds import kind_of
from lidarcfg.errors import ConfigError, SceneError
from lidarcfg.files import shipped
from lidarcfg.report.summaries import summary
from lidarcfg.search.combinations import combinations
from lidarcfg.sensors.rig import load_rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.study.checks import rig_warnings, study_warnings
from lidarcfg.study.loading import load_study
from lidarcfg.vsr.region import RegionFile, _sizes
from lidarcfg.world.meshes import read_mesh
from lidarcfg.world.scene import load_scene
from lidarcfg.world.vehicle import rig_vehicle
from tests.command_line import lidarcfg

ROOT = Path(__file__).parents[2]
FILES = sorted([*ROOT.glob("data/*/*.yaml"), *ROOT.glob("sensors/*.yaml")])


def values(path):
    """A file's values as JSON has them."""

    def plain(value):
        if isinstance(value, dict):
            return {key: plain(one) for key, one in value.items()}
        return [plain(one) for one in value] if isinstance(value, tuple) else value

    return plain(Document(path.read_text(), str(path), own=True).value)


@pytest.fixture(scope="module")
def validators():
    for kind in KINDS:
        jsonschema.Draft202012Validator.check_schema(schema(kind))
    return {kind: jsonschema.Draft202012Validator(schema(kind)) for kind in KINDS}


def kind_by_folder(path):
    if path.stem == "trend":
        return "plan"
    folders = {
        "studies": "study",
        "rigs": "rig",
        "scenes": "scene",
        "sensors": "sensor",
        "requirements": "requirements",
        "scenarios": "scenario",
    }
    return folders[path.parent.name]


@pytest.mark.slow
def test_every_file_that_comes_along_is_of_its_kind_and_keeps_its_schema(validators):
    assert len(FILES) > 40
    for path in FILES:
        kind = kind_by_folder(path)
        found = Document(path.read_text(), str(path), own=True).value
        assert kind_of(found) == kind, path
        validators[kind].validate(values(path))


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("data/studies/sedan.yaml", lambda v: v["region"].update(cuboids_m=[1, 1, 1])),
        ("data/studies/sedan.yaml", lambda v: v["sensors"][0].update(count=0)),
        ("data/studies/sedan.yaml", lambda v: v["region"].update(min_m=[0, 0])),
        ("data/rigs/roof.yaml", lambda v: v["sensors"][0].update(data_port=70000)),
        ("data/rigs/roof.yaml", lambda v: v["sensors"][0].update(velodyne={"pps": "odd"})),
        ("data/rigs/roof.yaml", lambda v: v["sensors"][0].update(nothing={})),
        ("data/rigs/roof.yaml", lambda v: v.update(vehicle={"boxes": [{"name": "body"}]})),
        ("sensors/os1-64.yaml", lambda v: v["ouster"].update(unknown=1)),
        ("data/scenes/street.yaml", lambda v: v["boxes"][0].update(reflectivity=300)),
    ],
)
def test_a_schema_finds_what_our_reader_refuses(validators, file, change):
    changed = values(ROOT / file)
    validators[kind_by_folder(ROOT / file)].validate(changed)
    change(changed)
    assert list(validators[kind_by_folder(ROOT / file)].iter_errors(changed))


@pytest.mark.slow
@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_template_is_valid_with_and_without_what_is_optional(tmp_path, kind):
    (path,) = write_template(kind, tmp_path / "folder" / f"my-{kind}.yaml")
    assert (summary(path).kind, summary(path).warnings) == (kind, ())
    text = path.read_text()
    assert str(path) in text.splitlines()[0] + text.splitlines()[1]  # the command that takes it
    optional = re.sub(r"^#(?=\s*(- \{?)?[a-z])", "", text, flags=re.M)
    assert optional.count("\n#") <= 4  # what is left says what the file is
    (tmp_path / "folder/scene.yaml").write_text("name: wall\nground: {reflectivity: 10}\n")
    for name in ("tree.ply", "depot.ply"):
        (tmp_path / "folder" / name).write_bytes((ROOT / "data/scenes/meshes/tree.ply").read_bytes())
    Image.fromarray(np.eye(3, dtype=np.uint8)).save(tmp_path / "folder/land.png")
    block = trimesh.creation.box()
    block.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(name="glass"))
    block.export(tmp_path / "folder/block.glb")
    path.write_text(optional)
    assert summary(path).kind == kind
    assert len(values(path)) + str(values(path)).count(":") > len(Document(text, "").value) + text.count("#")


@pytest.mark.slow
@pytest.mark.parametrize("name", vehicles())
def test_what_is_optional_in_a_study_with_a_vehicle_is_valid_too(tmp_path, name):
    study, *_ = write_template("study", tmp_path / "study.yaml", name)
    (tmp_path / "scene.yaml").write_text("name: wall\nground: {reflectivity: 10}\n")
    study.write_text(re.sub(r"^#(?=\s*(- \{?)?[a-z])", "", study.read_text(), flags=re.M))
    loaded = load_study(study)
    assert {"choose", "on"} <= {key for group in loaded.file["sensors"] for key in group}
    assert {"robust", "zones", "prices", "constraints", "objective", "surroundings"} <= loaded.file.keys()
    kept = [one.study.space.violation(one.study.space.midpoint[None])[0] for one in combinations(loaded)]
    assert kept == [0.0] * 3  # a model, the other, none


@pytest.mark.slow
@pytest.mark.parametrize("name", vehicles())
def test_a_study_begins_with_a_vehicle_and_can_be_searched(tmp_path, name):
    study, body, *_ = write_template("study", tmp_path / "study.yaml", name)
    assert body.read_bytes() == (ROOT / "data/vehicles" / body.name).read_bytes()
    assert body.stem == name
    loaded = load_study(study)
    corners = [loaded.space.poses(np.full((1, loaded.space.dimensions), value)) for value in (0.0, 0.5, 1.0)]
    assert max(float(loaded.space.violation(poses)[0]) for poses in corners) == 0
    assert list(study_warnings(study, loaded)) == []
    assert (loaded.region.min_m < loaded.vehicle.scene.vertices_m.min(axis=0) + 1e-9).all()
    own, *_ = write_template("study", tmp_path / "deep/er/study.yaml", str(body))
    assert np.array_equal(load_study(own).space.upper, loaded.space.upper)


@pytest.mark.parametrize("model", ["vlp-16", "mid-360", "airy"])
def test_a_study_begins_with_a_box_and_a_model(tmp_path, model):
    """A robot of 0.8 m by 0.6 m by 0.4 m has a volume of 0.192 m³, on the ground; what is optional is valid, too."""
    (path,) = write_template("study", tmp_path / "study.yaml", "0.8x0.6x0.4", model=model)
    study = load_study(path)
    corners_m = study.vehicle.scene.vertices_m
    assert np.ptp(corners_m, axis=0).prod() == pytest.approx(0.192)
    assert corners_m.min(axis=0).tolist() == pytest.approx([-0.4, -0.3, 0])
    assert {slot.model for slot in study.slots} == {model}
    assert list(study_warnings(path, study)) == []
    (tmp_path / "scene.yaml").write_text("name: wall\nground: {reflectivity: 10}\n")
    path.write_text(re.sub(r"^#(?=\s*(- \{?)?[a-z])", "", path.read_text(), flags=re.M))
    assert len(load_study(path).requirements.items) > len(study.requirements.items)


def test_models_of_ones_own_and_what_is_no_box(tmp_path):
    (sensor,) = write_template("sensor", tmp_path / "mine.yaml")
    (path,) = write_template("study", tmp_path / "deep/study.yaml", "12x2.5x3", model=str(sensor))
    assert load_study(path).slots[0].sensor.name == "my_sensor"
    for box in ("0.8x0.6", "8x6x4x2", "800x600x400", "8x2x0"):
        with pytest.raises(ConfigError, match="no box; allowed: length, width and height"):
            write_template("study", tmp_path / "none.yaml", box)
    with pytest.raises(ConfigError, match="did you mean mid-360"):
        write_template("study", tmp_path / "none.yaml", model="mid360")
    with pytest.raises(ConfigError, match="not known how it fires"):
        write_template("study", tmp_path / "none.yaml", "truck", model="fan-4")
    assert not (tmp_path / "none.yaml").exists()


def test_a_study_begins_with_a_robot_and_its_rig(tmp_path):
    """Its ground is where its wheels are, 0.1 m below base_link; its own LiDARs are a rig on the same body."""
    written = write_template("study", tmp_path / "my.yaml", "delivery-robot", (said := []).append)
    names = ["my.yaml", "delivery-robot.urdf", "delivery-robot-lid.stl", "my-rig.yaml"]
    assert [path.name for path in written] == names
    assert any("left out of the body, as LiDARs: vlp16, airy_front" in line for line in said)
    study = load_study(written[0])
    rig = load_rig(written[3])
    assert study.region.min_m[2] == -0.1
    assert [mount.model for mount in rig.mounts] == ["vlp-16", "airy"]
    own = rig_vehicle(rig)
    assert np.array_equal(own.scene.vertices_m, study.vehicle.scene.vertices_m)
    assert (own.warnings, study.vehicle.warnings) == ((), ())
    with pytest.raises(ConfigError, match=r"my-rig.yaml: exists already"):
        (tmp_path / "my.yaml").unlink()
        write_template("study", tmp_path / "my.yaml", "delivery-robot")


def test_a_study_of_an_open_body_is_valid(tmp_path):
    plate = trimesh.Trimesh([(0, 0, 0), (4, 0, 0), (0, 2, 0), (0, 0, 1)], [(0, 2, 1), (0, 1, 3)])
    plate.export(tmp_path / "plate.ply")
    (study,) = write_template("study", tmp_path / "study.yaml", str(tmp_path / "plate.ply"))
    assert load_study(study).vehicle.excluded == ()


@pytest.mark.slow
def test_a_mesh_in_millimetres_makes_the_study_of_the_mesh_in_metres(tmp_path):
    """As CAD has it; but for a comment and the scale, the text is the same."""
    body = o3d.io.read_triangle_mesh(str(ROOT / "data/vehicles/truck.ply"))
    o3d.io.write_triangle_mesh(str(tmp_path / "mm.ply"), body.scale(1000, np.zeros(3)))
    (study,) = write_template("study", tmp_path / "study.yaml", str(tmp_path / "mm.ply"))
    (usual,) = write_template("study", tmp_path / "usual.yaml", str(ROOT / "data/vehicles/truck.ply"))
    assert (
        "#     By its looks its file's unit is the millimetre: compare the drawing of the page (lidarcfg view)\n"
        in study.read_text()
    )
    own = load_study(study)
    known = load_study(usual)
    assert own.vehicle.warnings == ()
    assert np.array_equal(own.space.upper, known.space.upper)
    assert own.region.included.sum() == known.region.included.sum() == 47_630


def test_a_template_replaces_nothing(tmp_path):
    write_template("study", tmp_path / "study.yaml", "truck")
    with pytest.raises(ConfigError, match=r"study.yaml: exists already"):
        write_template("study", tmp_path / "study.yaml")
    (tmp_path / "truck.ply").write_text("mine")
    with pytest.raises(ConfigError, match=r"truck.ply: exists already"):
        write_template("study", tmp_path / "other.yaml", "truck")
    assert not (tmp_path / "other.yaml").exists()
    with pytest.raises(
        ConfigError,
        match=r"no vehicle is called 'truk'; allowed: bus, delivery-robot, sedan, shuttle, truck, a mesh file, a URDF, or length",
    ):
        write_template("study", tmp_path / "other.yaml", "truk")
    with pytest.raises(ConfigError, match=r"gone.ply: no such file"):
        write_template("study", tmp_path / "other.yaml", "gone.ply")


@pytest.mark.slow
def test_files_are_summed_up(tmp_path):
    done = lidarcfg("validate", "data/studies/sedan.yaml", "data/rigs/roof.yaml", cwd=ROOT)
    assert done.stdout.splitlines() == [
        "data/studies/sedan.yaml: study: 47,930 cuboids, 4 × vlp-16, 4 objects; auto searches 18 free coordinates for "
        "20,000 evaluations, to minimise misses: places where an object gets fewer than 3 returns",
        "data/rigs/roof.yaml: rig: 2 × vlp-16, no vehicle; can be exported",
    ]
    front = summary(ROOT / "data/studies/truck-prices.yaml").text
    assert " 17 combinations of sensors, 2 objects" in front
    (tmp_path / "odd.yaml").write_text("colour: red\n")
    (tmp_path / "arc.yaml").write_text("arc: {speed_m_s: 5, yaw_rate_deg_s: 10}\n")
    (tmp_path / "body.yaml").write_text("boxes: [{name: body, size_m: [4, 2, 1]}]\n")
    done = lidarcfg("validate", tmp_path / "odd.yaml", tmp_path / "arc.yaml", tmp_path / "body.yaml", code=2)
    assert re.search(
        r"odd.yaml: is not one of lidarcfg's files; allowed: capture manifest, faults, plan, requirements, rig, scenario, scene, sensor, study, ",
        done.stderr,
    )
    assert re.search(r"arc.yaml: trajectory: an arc\n.*body.yaml: vehicle: a vehicle of 1 body with 12", done.stdout)
    assert lidarcfg("init", "rig", "--vehicle", "truck", "-o", tmp_path / "r.yaml", code=2).stderr.startswith(
        "lidarcfg: --vehicle is for a study, not for a rig"
    )


def test_sensors_that_say_nothing_are_no_sensors_of_a_rig(tmp_path):
    """Without a sensor, a rig and a study without its region look alike; the error is at the key."""
    path = tmp_path / "rig.yaml"
    path.write_text("name: empty\nsensors: []\n")
    said = lidarcfg("validate", path, code=2).stderr
    assert said == f"lidarcfg: {path}:2:1: sensors: has 0 values; allowed: at least 1\n"
    path.write_text("sensors: [{model: vlp-16}]\n")
    assert f"{path}:1:11: sensors[0].position_m: missing" in lidarcfg("validate", path, code=2).stderr


def test_init_writes_the_study_and_the_body_or_neither(tmp_path):
    """On a disk that is full at 100,000 bytes; the body has more."""
    code = "import resource as r, signal as s; s.signal(s.SIGXFSZ, s.SIG_IGN); r.setrlimit(r.RLIMIT_FSIZE, (100_000,) * 2);"
    code += "from lidarcfg.cli.templates import write_template as w; from pathlib import Path;"
    code += f"w('study', Path({str(tmp_path / 'study.yaml')!r}), 'truck')"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "File too large" in ended.stderr
    assert (shipped("data") / "vehicles/truck.ply").stat().st_size > 100_000
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("read", "file", "what"),
    [
        (load_study, "data/rigs/roof.yaml", "2:1: this is a rig; a study belongs here"),
        (load_study, "data/scenes/street.yaml", "this is a scene; a study belongs here"),
        (load_rig, "data/studies/sedan.yaml", "this is a study; a rig belongs here"),
        (load_rig, "sensors/vlp-16.yaml", "this is a sensor; a rig belongs here"),
    ],
)
def test_a_file_in_the_place_of_another_is_named(read, file, what):
    with pytest.raises(ConfigError, match=re.escape(what)):
        read(ROOT / file)


STUDY = """\
region: {min_m: [-6, -6, 0], max_m: [6, 6, 4], cuboid_m: [1, 1, 1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 1], size_m: [4, 2, 2]}]}
sensors:
  - {model: vlp-16, min: {position_m: [0, 0, 2.5], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 1, 3], rpy_deg: [0, 0, 0]}}
  - {model: vlp-16, min: {position_m: [2.1, 0, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [3, 1, 1.5], rpy_deg: [9, 9, 0]}}
CONSTRAINTS
"""


def study(tmp_path, *changes, constraints=""):
    text = STUDY.replace("CONSTRAINTS", constraints)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "study.yaml"
    path.write_text(text)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ([("[0, 0, 2.5]", "[0, 0, 1.8]")], r":4:5: sensors\[0\]: 16% of the places within its bounds are inside"),
        (
            [("rpy_deg: [9, 9, 0]", "rpy_rad: [9, 9, 0]")],
            r":5:\d+: sensors\[1\].max.rpy_rad: \[9.0, 9.0, 0.0\] is m",
        ),
        ([("[9, 9, 0]", "[0.262, 0, 0]")], r":5:\d+: sensors\[1\].max.rpy_deg: 0.262 looks like 15° in radians"),
        ([("[9, 9, 0]", "[0, 0, 3.1416]")], r"3.1416 looks like 180° in radians, which go to rpy_rad"),
        ([("[9, 9, 0]", "[9, 0.5236, 0]")], r"0.5236 looks like 30° in radians, beside others that are degrees"),
        (
            [("[9, 9, 0]", "[0, 0, 9]"), ("[1, 1, 3], rpy_deg: [0, 0, 0]", "[1, 1, 3], rpy_deg: [0, 0, 1.57]")],
            r"1.57 l",
        ),
        (
            [("[2.1, 0, 1]", "[2.1, 0, -0.5]")],
            r":5:\d+: sensors\[1\].min.position_m\[2\]: this bound is 0.5 m below the g",
        ),
        (
            [("[3, 1, 1.5]", "[3, 1, 1500]")],
            r":5:\d+: sensors\[1\].max.position_m: this bound is 1,498 m from the vehicle's body; positions are in me",
        ),
    ],
)
def test_what_looks_wrong_is_a_warning(tmp_path, changes, what):
    path = study(tmp_path)
    assert list(study_warnings(path, load_study(path))) == []
    path = study(tmp_path, *changes)
    (line,) = study_warnings(path, load_study(path))
    assert re.search(what, line), line
    assert line.startswith(f"{path}:")


def test_a_rig_s_angles_too(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(
        "name: one\nsensors:\n  - {name: a, model: vlp-16, position_m: [0, 0, 1], rpy_deg: [0, 0, 1.5708]}\n"
    )
    assert list(rig_warnings(path)) == [
        f"{path}:3:53: sensors[0].rpy_deg: 1.5708 looks like 90° in radians, which go to rpy_rad"
    ]
    path.write_text(
        "name: two\nsensors:\n  - {name: a, model: vlp-16, position_m: [0, 0, 1], rpy_deg: [0, 0, 1.57]}\n"
        "  - {name: b, model: vlp-16, position_m: [1, 0, 1], rpy_deg: [0, 1.25, 180]}\n"
    )
    assert list(rig_warnings(path)) == [
        f"{path}:3:53: sensors[0].rpy_deg: 1.57 looks like 90° in radians, which go to rpy_rad"
    ]
    path.write_text(path.read_text().replace("180", "3"))  # now 1.57 may be degrees as the others
    assert list(rig_warnings(path)) == []
    assert list(rig_warnings(ROOT / "data/rigs/roof.yaml")) == []


def test_a_rig_s_sensors_below_the_ground_or_far_away(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(
        "name: two\nsensors:\n  - {name: a, model: vlp-16, position_m: [0, 0, -0.2]}\n"
        "  - {name: b, model: vlp-16, position_m: [0, 0, 1900]}\n  - {name: c, model: vlp-16, position_m: [0, 0, 40]}\n"
    )
    assert list(rig_warnings(path)) == [
        f"{path}:3:49: sensors[0].position_m[2]: a is 0.2 m below the ground, which is at z = 0",
        f"{path}:4:30: sensors[1].position_m: b is 1,900 m from the origin of the vehicle frame; "
        "positions are in metres, in the vehicle frame",
    ]


@pytest.mark.slow
def test_a_rig_in_millimetres_is_told_where_it_is_evaluated_or_exported(tmp_path):
    """A roof 2 m high, and a sensor at 2,800 mm: 2,798 m above it."""
    rig = tmp_path / "rig.yaml"
    body = "vehicle: {boxes: [{name: body, center_m: [0, 0, 1], size_m: [4, 2, 2]}]}\n"
    rig.write_text(f"name: r\n{body}sensors:\n  - {{name: roof, model: vlp-16, position_m: [0, 0, 2800]}}\n")
    said = "roof is 2,798 m from the vehicle's body; positions are in metres, in the vehicle frame"
    path = study(tmp_path)
    scene = ROOT / "data/scenes/room.yaml"
    capture = tmp_path / "a.pcap"
    for words in (
        ("evaluate", path, rig, "--json"),
        ("export", rig, "--scene", scene, "--duration", 0.02, "-o", capture),
    ):
        assert f"{rig}:4:33: sensors[0].position_m: {said}" in lidarcfg(*words).stderr, words
    path = study(tmp_path, ("[0, 0, 2.5]", "[0, 0, 2500]"), ("[1, 1, 3]", "[1, 1, 3000]"))
    low, high = study_warnings(path, load_study(path))
    assert "sensors[0].min.position_m: this bound is 2,498 m from the vehicle's body" in low
    assert "sensors[0].max.position_m: this bound is 2,998 m from the vehicle's body" in high


def test_a_sensor_inside_the_body_that_its_rig_names_is_an_error_at_its_line(tmp_path):
    """It could not be exported: half the height of a box above its middle is its top."""
    path = tmp_path / "rig.yaml"
    text = "name: one\nvehicle: {boxes: [{name: body, center_m: [0, 0, 1], size_m: [4, 2, 1]}]}\nsensors:\n"
    path.write_text(text + "  - {name: a, model: vlp-16, position_m: [0, 0, 1.501]}\n")
    assert summary(path).text == "1 × vlp-16, a vehicle of 1 body with 12 triangles; can be exported"
    path.write_text(text + "  - {name: a, model: vlp-16, position_m: [0, 0, 1.499]}\n")
    scene = ROOT / "data/scenes/street.yaml"
    for words in (("validate", path), ("export", path, "--scene", scene, "--duration", 1, "-o", tmp_path / "a.pcap")):
        line = lidarcfg(*words, code=2).stderr
        assert line.startswith(f"lidarcfg: {path}:4:5: sensors[0]: a is inside the vehicle's 'body'; move it"), line


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "more", "said", "code"),
    [
        ("fan-4", "", "cannot be exported: no range of a", 2),
        ("fan-4", ", range_m: [1, 50]", "a exported as points: no packets", 0),
        ("pandar64", "", "a exported as points: no packets", 0),
    ],
)
def test_a_sensor_without_packets_is_exported_if_its_range_is_known(tmp_path, model, more, said, code):
    """As validate says, export does; so does the catalogue's list."""
    (tmp_path / "rig.yaml").write_text(
        f"name: r\nsensors: [{{name: a, model: {model}, position_m: [0, 0, 2]{more}}}]\n"
    )
    assert summary(tmp_path / "rig.yaml").text.endswith(f"; {said}")
    scene = ROOT / "data/scenes/room.yaml"
    words = (
        "export",
        tmp_path / "rig.yaml",
        "--scene",
        scene,
        "--duration",
        0.002,
        "-o",
        tmp_path / "a.ply",
        "--quiet",
    )
    lidarcfg(*words, code=code)
    listed = next(line for line in lidarcfg("sensors", "list").stdout.splitlines() if line.split()[:1] == [model])
    assert ("as points" in listed) == (model == "pandar64")


@pytest.mark.parametrize(
    ("changes", "constraints", "what"),
    [
        ([("[2.1, 0, 1], rpy_deg: [0, 0, 0]", "[2.1, 0, 1], rpy_deg: [5, 3, 0]")], "{max_tilt_deg: 5}", r"6:15: constraints.max_tilt_deg: 5 is impossible: sensors\[1\] tilts by 5.829 or more"),
        ([], "{min_distance_m: 3.9}", r"constraints.min_distance_m: 3.9 is impossible: sensors\[0\] and sensors\[1\] are at most 3.742 m apart"),
        ([("model: vlp-16", "count: 2, mirror_y_m: 0, model: vlp-16")], "{min_distance_m: 2.4}", r"two of sensors\[0\] are at most 2.291 m apart"),
    ],
)  # fmt: skip
def test_constraints_that_nothing_keeps_are_refused_before_the_search(tmp_path, changes, constraints, what):
    load_study(study(tmp_path, *changes))
    with pytest.raises(ConfigError, match=what):
        load_study(study(tmp_path, *changes, constraints=f"constraints: {constraints}"))


def test_no_constraints_that_random_poses_keep_are_refused(tmp_path):
    """Bounds at random: the least tilt among many poses within them is never below what is taken for the least."""
    rng = np.random.default_rng(1)
    for _ in range(30):
        low = rng.uniform(-400, 400, 2)
        high = low + rng.uniform(0, 300, 2)
        roll, pitch = np.radians(rng.uniform(low, high, (2000, 2))).T
        least = float(np.degrees(np.arccos(np.cos(roll) * np.cos(pitch))).min())
        changes = [
            ("[2.1, 0, 1], rpy_deg: [0, 0, 0]", f"[2.1, 0, 1], rpy_deg: [{low[0]}, {low[1]}, 0]"),
            ("[9, 9, 0]", f"[{high[0]}, {high[1]}, 0]"),
        ]
        load_study(study(tmp_path, *changes, constraints=f"constraints: {{max_tilt_deg: {least}}}"))
        if least > 12:
            with pytest.raises(ConfigError, match="max_tilt_deg"):
                load_study(study(tmp_path, *changes, constraints=f"constraints: {{max_tilt_deg: {least - 12}}}"))


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("vlp32c", "vlp-32c"),
        ("VLP-16", "vlp-16"),
        ("OS1_64", "os1-64"),
        ("xt32", "pandar-xt32 or xt32m2x|xt32m2x or pandar-xt32"),
        ("os1-6", "os1-64.*"),
    ],
)
def test_a_sensor_s_name_spelled_otherwise_is_understood_but_not_taken(name, meant):
    with pytest.raises(ConfigError, match=rf"no sensor is called '{name}'; did you mean ({meant})\?"):
        load_sensor(name)
    with pytest.raises(ConfigError, match=r"no sensor is called 'zebra'; allowed: a name that lidarcfg sensors lists"):
        load_sensor("zebra")


@pytest.mark.parametrize(
    ("length", "edge", "sizes"), [(60, 0.7, [0.6, 0.75]), (20, 0.3, [0.25, 0.4]), (4, 9, [4]), (4, 0.3, [0.25, 0.4])]
)
def test_cuboid_sizes_that_are_proposed_are_round_and_divide(length, edge, sizes):
    assert np.allclose(_sizes(length, edge), sizes)
    for size in _sizes(length, edge):
        RegionFile(min_m=(0.0, 0.0, 0.0), max_m=(float(length), 1.0, 1.0), cuboid_m=(size, 1.0, 1.0))


def test_maps_that_are_no_meshes_are_refused_by_name(tmp_path):
    for name in ("bus.step", "bus.blend"):
        (tmp_path / name).write_text("x")
        with pytest.raises(SceneError, match=rf"{name}: a .*; export (a mesh of it, .*STL|the mesh as .*STL)"):
            read_mesh(tmp_path / name)
    for name, what in (("town.xodr", "OpenDRIVE map has lanes"), ("scan.pcd", "point cloud has no surfaces")):
        (tmp_path / name).write_text("x")
        with pytest.raises(SceneError, match=f"{name}: an? .*{what}"[:40]):
            read_mesh(tmp_path / name)
        with pytest.raises(ConfigError, match=f"{name}: .*, no YAML; .* under (meshes|surfels)"):
            load_scene(tmp_path / name)
        with pytest.raises(ConfigError, match=f"{name}: .*, no YAML; "):
            summary(tmp_path / name)
    (tmp_path / "points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 1 1\n"
    )
    with pytest.raises(
        SceneError, match=r"points.ply: no triangles that Open3D can read; a point cloud has no surfaces"
    ):
        read_mesh(tmp_path / "points.ply")


def test_a_study_with_a_simplified_mesh(tmp_path):
    """In millimetres, 1 km away: what init says of it is what the sphere says, by hand; the study is accepted."""
    ball = trimesh.creation.icosphere(4, 1500.0)
    ball.apply_translation((1e6, 0, 1500))
    ball.export(tmp_path / "ball.ply")
    out = tmp_path / "out/study.yaml"
    asked = "init", "study", "--vehicle", tmp_path / "ball.ply", "--triangles", 500, "-o", out
    said = lidarcfg(*asked).stdout
    found = re.search(r"5,120 triangles are now 500, at most ([\d.]+) mm from their surface", said)
    fewer = trimesh.load(tmp_path / "out/ball-500.ply")
    away = abs(np.linalg.norm(fewer.triangles_center - (1e6, 0, 1500), axis=1) - 1500).max()
    assert float(found[1]) == pytest.approx(away, rel=0.3)
    assert values(out)["vehicle"]["meshes"][0]["file"] == "ball-500.ply"
    assert values(out)["vehicle"]["meshes"][0]["position_m"] == pytest.approx([-1000, 0, 0], abs=0.1)
    assert load_study(out).vehicle.warnings == ()
    assert "study.yaml: exists already" in lidarcfg(*asked, code=2).stderr
    for wrong in (("--vehicle", "truck", "--triangles", 500), ("--triangles", 500)):
        assert "--triangles is for a mesh file" in lidarcfg("init", "study", *wrong, "-o", "x.yaml", code=2).stderr


def test_a_study_of_an_open_mesh_can_be_used(tmp_path):
    """What init writes is accepted: nothing is inside of a mesh with a hole, and so nothing is excluded."""
    mesh = trimesh.creation.box((4, 2, 1.5))
    trimesh.Trimesh(mesh.vertices, mesh.faces[1:]).export(tmp_path / "body.ply")
    (study,) = write_template("study", tmp_path / "study.yaml", str(tmp_path / "body.ply"))
    (message,) = load_study(study).vehicle.warnings
    assert "is not closed" in message
    assert load_study(study).vehicle.excluded == ()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.stl", b"ply\nformat", "a.stl: it begins like a .ply file; name it a.ply"),
        ("a.obj", b"glTF\x02\0\0\0", "a.obj: it begins like a .glb file; name it a.glb"),
        ("a.fbx", b"Kaydara", "a.fbx: a format that is not read; export the mesh as glTF"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n1 0 0\n3 0 1 2\n", "'body' has no triangle with three different"),
    ],
)
def test_a_mesh_that_is_none(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    (tmp_path / "v.yaml").write_text(f"meshes: [{{name: body, file: {name}}}]\nallow_inside: false\n")
    with pytest.raises(ConfigError, match=re.escape(said)):
        summary(tmp_path / "v.yaml")


def test_a_mesh_that_is_far_away(tmp_path):
    """As a map has it: validate says where it stands, and init writes that."""
    mesh = trimesh.creation.box((4, 2, 1.5))
    mesh.apply_translation((1000, -2000, 30.75))
    mesh.export(tmp_path / "body.stl")
    (tmp_path / "v.yaml").write_text("meshes: [{name: body, file: body.stl, position_m: [1, 0, 0]}]\n")
    (message,) = summary(tmp_path / "v.yaml").warnings
    assert "to stand there, set position_m: [-1000, 2000, -30]" in message
    (study,) = write_template("study", tmp_path / "study.yaml", str(tmp_path / "body.stl"))
    assert values(study)["vehicle"]["meshes"][0]["position_m"] == [-1000, 2000, -30]
    assert summary(study).warnings == ()


def test_a_study_around_a_robot_is_of_what_is_near_it(tmp_path):
    """A box of 0.8 × 0.6 × 0.4 m, 0.05 m above the ground: by hand, what its region and its sensors' bounds should be."""
    trimesh.creation.box((0.8, 0.6, 0.4), trimesh.transformations.translation_matrix((0, 0, 0.25))).export(
        tmp_path / "robot.stl"
    )
    (path,) = write_template("study", tmp_path / "study.yaml", str(tmp_path / "robot.stl"))
    study = load_study(path)
    assert (study.region.min_m.tolist(), study.region.max_m.tolist()) == ([-8, -8, 0], [8, 8, 2])
    assert study.region.included.sum() < 41_000  # as cheap as a car's
    front = next(number for number, slot in enumerate(study.slots) if slot.name == "front")
    heights = [study.space.poses(np.full((1, study.space.dimensions), end))[0, front, 2] for end in (0.0, 1.0)]
    np.testing.assert_allclose(heights, [0.05 + 0.16, 0.05 + 0.32])  # in its front, not above it
    assert study.misses.within_m == (0.1, 5.0)
    assert values(path)["requirements"][0]["within_m"] == [0.5, 3]
    assert list(study_warnings(path, study)) == []
