"""Strict YAML: what is refused, and that the place named is the place meant."""

import itertools
import os
import re
import stat
import sys
from inspect import isabstract
from typing import Annotated, ClassVar

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import Field, ValidationError

from lidarcfg.capture.manifest import CaptureManifest
from lidarcfg.config.models import ERROR_MESSAGES, Model, Section, load, loads, nested_models
from lidarcfg.errors import MANY, ConfigError
from lidarcfg.files import replacing
from lidarcfg.requirements.file import RequirementsFile
from lidarcfg.sensors.faults import FaultsFile
from lidarcfg.sensors.rig import RigFile, load_rig
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.study.file import StudyFile
from lidarcfg.world.motion import Motion
from lidarcfg.world.scene_file import SceneFile
from tests.refusals import refused

GOOD = "name: a\nbeams:\n  elevation_deg: [-1, 1e-05]\n"


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        loads(text, Sensor, "f.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: a\nbeams: {elevation: [1, 2]}", "f.yaml:2:9: beams.elevation: unknown key without a unit; allowed: elevation_deg"),
        ("name: a\nbeam: {}", "f.yaml:2:1: beam: unknown key; did you mean beams? allowed: name, maker, desc"),
        ("name: a\nname: b\n", "f.yaml:2:1: name: repeated key; it was given on line 1"),
        ("name: a\nbeams: {elevation_deg: [1, 1]}", "f.yaml:2:28: beams.elevation_deg[1]: 1 is beam 0 already"),
        ("name: a\nbeams:\n  elevation_deg: [1, .nan]", "f.yaml:3:22: beams.elevation_deg[1]: .nan is not a finite number"),
        ("name: a\nbeams:\n  elevation_deg: [1, -.inf]", "f.yaml:3:22: beams.elevation_deg[1]: -.inf is not a finite number"),
        ("name: a\nbeams:\n  elevation_deg: [1, 1e999]", "f.yaml:3:22: beams.elevation_deg[1]: 1e999 is not a finite number"),
        ("name: a\nbeams:\n  elevation_deg: [90.1]", "f.yaml:3:19: beams.elevation_deg[0]: 90.1 is outside the allowed -90 to 90"),
        ("name: a\nbeams:\n  elevation_deg: []", "f.yaml:3:3: beams.elevation_deg: has 0 values; allowed: at least 1"),
        ("name: a\nbeams:\n  elevation_deg: [true]", "f.yaml:3:19: beams.elevation_deg[0]: true is not a number"),
        ("name: a\nbeams:\n  elevation_deg: ['1']", "f.yaml:3:19: beams.elevation_deg[0]: '1' is not a number"),
        ("name: 3\nbeams:\n  elevation_deg: [1]", "f.yaml:1:1: name: 3 is not a text"),
        ("name: a", "f.yaml:1:1: beams: missing"),
        ("", "f.yaml:1:1: the file is empty"),
        ("- 1", "f.yaml:1:1: a list of 1 is not a map of keys"),
        ("a: [", "f.yaml:1:5: not YAML: expected the node content, but found '<stream end>'"),
        ("a: 1\n---\nb: 1", "f.yaml:2:1: not YAML: but found another document"),
        ("a: !!python/object:os.system x", "f.yaml:1:1: a: tag"),
        ("3: a", "f.yaml:1:1: 3: is not a text; a key must be one"),
        ("name: a\nbeams: &b {elevation_deg: *b}", "f.yaml:2:12: beams.elevation_deg: an alias inside itself"),
        ("a: " + "[" * 3000, "f.yaml:"),
        ("a: \x07", "f.yaml:1:1: not YAML"),
        ("a: " + "9" * 5000, "f.yaml:1:1: a: '9999"),
        ("a: 0x" + "f" * 5000, "f.yaml:1:1: a: '0xff"),
        ("name: a\nbeams:\n  elevation_deg: [0x" + "f" * 390 + "]", "f.yaml:3:19: beams.elevation_deg[0]: "),
        ("a: 1e" + "9" * 5000, "f.yaml:1:1: a: '1e99"),
    ],
)  # fmt: skip
def test_refused(text, message):
    assert refusal(text).startswith(message)


def test_the_core_schema():
    sensor = loads(GOOD + "maker: on\ndescription: 'yes'\n", Sensor, "f.yaml")
    assert sensor.beams.elevation_deg == (-1.0, 1e-05)
    assert (sensor.maker, sensor.description) == ("on", "yes")


def test_json_is_yaml():
    assert loads('{"name": "a", "beams": {"elevation_deg": [0]}}', Sensor, "f.json").count == 1


@pytest.mark.slow
def test_errors_of_an_alias_bomb_end_soon():
    bomb = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10))
    assert "too many" in refusal(bomb)


@given(st.text(max_size=200))
@example("::")  # an unknown key, and none of those that must be there
def test_any_text_is_an_error_or_an_answer(text):
    """An error is one mistake a line."""
    try:
        answer = str(loads(text, Sensor, "f.yaml").count)
    except ConfigError as error:
        answer = str(error)
    assert all(line.startswith("f.yaml:") for line in answer.split("\n")) or int(answer) >= 1


def test_files_that_cannot_be_read(tmp_path):
    for path, message in ((tmp_path / "none.yaml", "no such file"), (tmp_path, "is a directory")):
        with pytest.raises(ConfigError, match=message):
            load(path, Sensor)
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"name: \xff\xfe")
    with pytest.raises(ConfigError, match=r"b.yaml:1:1: not text in UTF-8 \(byte 6\)"):
        load(binary, Sensor)


def test_replacing_leaves_the_old_file_until_the_new_is_whole(tmp_path):
    path = tmp_path / "f"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as file:
        file.write("new")
        raise RuntimeError
    assert path.read_text() == "old"
    with replacing(path) as file:
        file.write("new")
        assert path.read_text() == "old"
    assert [p.read_text() for p in tmp_path.iterdir()] == ["new"]


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # between opening and `with`, only the collector closes
def test_an_interrupt_at_any_line_leaves_nothing_half_made(tmp_path):
    code = replacing.__wrapped__.__code__

    def interrupted(lines):
        """Whether so many lines of `replacing` ran and then an interrupt came."""

        def on_line(frame, event, argument):
            nonlocal lines
            lines -= event == "line"
            if lines < 0:
                raise KeyboardInterrupt
            return on_line

        before = sys.gettrace()
        sys.settrace(lambda frame, event, argument: on_line if frame.f_code is code else None)
        try:
            with replacing(tmp_path / "f"):
                pass
        except KeyboardInterrupt:
            return True
        finally:
            sys.settrace(before)
        return False

    interrupts = 0
    while interrupted(interrupts):
        interrupts += 1
        assert [path.name for path in tmp_path.iterdir() if path.name != "f"] == []
    assert interrupts >= 5


def test_a_device_is_not_replaced():
    with pytest.raises(OSError, match="not a regular file"), replacing(os.devnull):
        pass
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_an_error_is_one_line_whatever_names_hold():
    """Found by tools/stress.py: a key with a line break stood in the place that an error names."""
    assert refusal(f'{GOOD}"a\\nb": 1\n').startswith("f.yaml:4:1: a\\nb: unknown key")


WRONG = [None, True, 0, -1, 2.5, 1e300, 10**400, "", "x y", "\ud800", (), (1,), ("a",) * 9, "x" * 201, {}, {"a": 1}]


def models_in(model):
    found = {model}
    for field in model.model_fields.values():
        for part in nested_models(field.annotation):
            found |= models_in(part)
    return found


def test_every_error_of_pydantic_has_a_sentence_of_ours():
    """Wrong values of each kind for every key of every file: pydantic's own words never show."""
    kinds = set()
    models = set().union(*map(models_in, (StudyFile, RigFile, SceneFile, Sensor, Motion)))
    for model, value in itertools.product(models, WRONG):
        for key in () if isabstract(model) else model.model_fields:
            try:
                model.model_validate({key: value})
            except ValidationError as error:
                kinds |= {item["type"] for item in error.errors()}
    assert kinds - ERROR_MESSAGES.keys() == {"fault", "extra_forbidden", "too_short", "too_long"}
    assert ERROR_MESSAGES.keys() <= kinds


class Inner(Model):
    renamed: ClassVar = {"hair_m": "tolerance_m", "pps": "velodyne.pps"}
    tolerance_m: float = 0.0


class Outer(Model):
    parts: Annotated[tuple[Inner, ...], Field(min_length=1)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("parts:\n  - {hair_m: 1}", "f.yaml:2:6: parts[0].hair_m: renamed; it is now tolerance_m"),
        ("parts:\n  - {}\n  - {pps: locked}", "f.yaml:3:6: parts[1].pps: renamed; it is now velodyne.pps"),
        ("hair_m: 1", "f.yaml:1:1: hair_m: unknown key; allowed: parts"),
    ],
)
def test_a_renamed_key_names_the_new_one(text, message):
    with pytest.raises(ConfigError) as caught:
        loads(text, Outer, "f.yaml")
    assert str(caught.value).startswith(message)


def test_a_section_is_checked_by_its_owner(tmp_path):
    """With file, line and column as the rest of the file; made in Python, by its key alone."""

    class Part(Model):
        size_m: float

    (tmp_path / "a.yaml").write_text("name: x\npart:\n  size_m: wide\n")
    values = {"size_m": "wide"}
    for path, where in ((str(tmp_path / "a.yaml"), f"{tmp_path}/a.yaml:3:3: "), ("", "")):
        with pytest.raises(ConfigError) as error:
            Section(values, path, ("part",)).checked(Part)
        assert str(error.value).startswith(f"{where}part.size_m: 'wide'")
    assert Section({"size_m": 2.0}, "", ("part",)).checked(Part).size_m == 2


SEVERAL = """\
name: r
sensors:
  - {name: left, model: vlp-16, position_m: [0.3, 0.5], rpm: -2, colour: red, pos: 1}
  - {name: right, model: vlp-16, position_m: [0.3, a, 1.9], realism: 3}
  - {model: vlp-16, position: [0.3, 1, 1.9]}
"""


def test_all_errors_of_a_file_are_told_at_once(tmp_path):
    """By the places of a text in which each mistake was made by hand; a missing key that a misspelled one means is not."""
    with pytest.raises(ConfigError) as caught:
        loads(SEVERAL, RigFile, "r.yaml")
    lines = str(caught.value).split("\n")
    told = [re.match(r"r.yaml:(\d+):\d+: sensors\[(\d)\]\.([a-z_]+)", line).groups() for line in lines]
    assert sorted(told) == [
        ("3", "0", "colour"),
        ("3", "0", "pos"),
        ("3", "0", "position_m"),
        ("3", "0", "rpm"),
        ("4", "1", "position_m"),
        ("4", "1", "realism"),
        ("5", "2", "name"),
        ("5", "2", "position"),
    ]
    assert len(caught.value.others) == 7


def test_of_very_many_errors_the_number_is_told():
    with pytest.raises(ConfigError) as caught:
        loads("name: r\nsensors: [" + "{}, " * 40 + "]\n", RigFile, "r.yaml")
    lines = str(caught.value).split("\n")
    assert len(lines) == MANY + 1
    assert lines[-1] == f"and {80 - MANY} more mistakes"


def test_errors_that_no_model_finds_are_told_at_once_too(tmp_path):
    path = tmp_path / "r.yaml"
    mounts = ["a, model: vlp17", "b, model: vlp-16, rpm: 5000", "c, model: zebra"]
    path.write_text("name: r\nsensors:\n" + "".join(f"  - {{name: {one}, position_m: [0, 0, 2]}}\n" for one in mounts))
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    lines = str(caught.value).split("\n")
    assert [line.split(": ")[1] for line in lines] == ["sensors[0].model", "sensors[1].rpm", "sensors[2].model"]
    assert "'vlp17'; did you mean" in lines[0]
    assert "allowed: 300 to 1200" not in lines[1]
    assert all("helios" not in line for line in lines)  # the catalogue is listed when asked for


def test_errors_of_a_file_within_another_are_one_line(tmp_path):
    (tmp_path / "s.yaml").write_text("name: s\nbeams: 3\nmaker: 4\n")
    (tmp_path / "r.yaml").write_text("name: r\nsensors:\n  - {name: a, model: s.yaml, position_m: [0, 0, 2]}\n")
    with pytest.raises(ConfigError, match=r"beams: 3 is not a map of keys; .*maker: 4 is not a text") as caught:
        load_rig(tmp_path / "r.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("model", "text", "said"),
    [
        (RigFile, "faults: []\n", "f.yaml:1:1: this is a file of faults; a rig belongs here"),
        (RequirementsFile, "sensors: [{position_m: 1}]\n", "this is a rig; a file of requirements belongs here"),
        (FaultsFile, "requirements: []\n", "this is a file of requirements; a file of faults belongs here"),
        (RigFile, "name: ''\nsensors: [{name: a}]\n", "name: '' is too short; allowed: at least 1 character"),
        (SceneFile, f"name: {'x' * 300}\n", f"name: '{'x' * 60}'… is too long; allowed: at most 200 characters"),
        (SceneFile, "name: a\nheight_fields: [{heights_m: [[1, 2]]}]\n", "heights_m: has 1 value; allowed: at least 2"),
        (SceneFile, "name: a\nmeshes: [{name: b, file: 3}]\n", "file: 3 is no mesh; allowed: the name of a file, or"),
        (CaptureManifest, "vehicle: {file: a, sha256: b, c: 1}\n", "unknown key; allowed: file, sha256"),
    ],
)
def test_errors_are_english(model, text, said):
    """Sentences read aloud; the last one was a traceback, as the key may be one of several models."""
    with refused(said):
        loads(text, model, "f.yaml")
