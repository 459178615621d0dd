"""Rigs that are moved on the page: undone, mirrored, evaluated, and written back into the file that they came from."""

import difflib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.viewer.bodies import score
from lidarcfg.viewer.contents import load_contents
from lidarcfg.viewer.evaluation import with_poses
from lidarcfg.viewer.page import page_of
from lidarcfg.viewer.rig_source import RigSource
from lidarcfg.viewer.server import Server
from tests.capture_fixtures import no_warning
from tests.viewer.driver import (
    asked,
    click,
    different,
    in_browser,
    opened,
    picture,
    poses_of,
    put,
    serving,
    settled,
    shown_vsr,
    told,
)

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
STUDY = """
region: {min_m: [-8, -5, 0], max_m: [8, 5, 3], cuboid_m: [0.5, 0.5, 0.25]}
vehicle:
  boxes: [{name: cab, center_m: [0, 0, 0.75], size_m: [4, 2, 1.5], exclude: true}]
sensors:
  - {name: side, model: vlp-16, count: 2, mirror_y_m: 0.1, min: {position_m: [1, 1.2, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [2, 1.6, 1.4], rpy_deg: [20, 0, 90]}}
zones:
  - {name: ahead, min_m: [3, -2, 0], max_m: [8, 2, 2], weight: 2}
detection:
  - {name: child, size_m: [0.5, 0.5, 1], on_ground: true}
  - {name: post, size_m: [0.2, 0.2, 1], samples: 64}
"""
RIG = """# Two on the sides.
name: sides
sensors:
  - name: side_0         # the left one
    model: vlp-16
    position_m: [1.5, 1.4, 1.2]   # measured by hand
    rpy_deg:
      - 10               # outwards
      - 0
      - 45
  - {name: side_1, model: vlp-16, rpy_deg: [-10, 0, -45], position_m: [1.5, -1.2, 1.2], rpm: 600}
"""
OTHERS = {
    "radians in a flow": '# a\nname: r\nsensors: [{name: a, model: vlp-16, position_m: [1, 2, 3], rpy_rad: [0, 0.5, 0]}] # b\n',
    "no angles": "name: r\nsensors:\n- position_m: [1, 2, 3]\n  name: a\n  model: vlp-16\n",
    "no angles in a flow": "name: r\nsensors: [{name: a, position_m: [1, 2, 3], model: vlp-16}]\n",
    "JSON": '{"name": "r",\n "sensors": [{"name": "a", "model": "vlp-16", "position_m": [1, 2, 3]}]}',
    "Windows": "\ufeffname: r\r\nsensors:\r\n- position_m: [1, 2, 3]  # ä\r\n  name: a\r\n  model: vlp-16\r\n",
}  # fmt: skip


def source(path, text):
    path.write_bytes(text.encode())
    return RigSource.read(path), load_rig(path)


def test_only_numbers_change(tmp_path):
    """Bit for bit; comments, order and layout stay: three lines of the text differ, in their numbers."""
    found, rig = source(tmp_path / "rig.yaml", RIG)
    poses = poses_of(rig)
    poses[0, 1] = 1.4321
    poses[0, 3] = np.radians(12.5)
    poses[1, 2] = 1 / 3
    after = found.save(poses)
    assert (poses_of(load_rig(after.path)) == poses).all()
    lines = [line for line in difflib.ndiff(RIG.splitlines(), after.path.read_text().splitlines()) if line[0] in "+-"]
    assert [line for line in lines if line[0] == "+"] == [
        "+     position_m: [1.5, 1.4321, 1.2]   # measured by hand",
        "+       - 12.5               # outwards",
        "+   - {name: side_1, model: vlp-16, rpy_deg: [-10, 0, -45], position_m: [1.5, -1.2, 0.3333333333333333], rpm: 600}",
    ]
    assert len(lines) == 6
    assert (poses_of(load_rig(after.save(poses_of(rig)).path)) == poses_of(rig)).all()  # and back again
    rng = np.random.default_rng(1)
    for _ in range(20):  # any angle has degrees that are read as it
        poses[:, 3:] = rng.uniform(-7, 7, (2, 3))
        after = RigSource.read(found.path).save(poses)
        assert poses_of(load_rig(after.path)) == pytest.approx(poses, abs=1e-14)


@pytest.mark.parametrize("text", OTHERS.values(), ids=OTHERS)
def test_any_layout(tmp_path, text):
    found, _ = source(tmp_path / "rig.yaml", text)
    poses = np.array([[1, -2.5, 3, 0.1, 0.2, -0.3]])
    found.save(poses)
    assert poses_of(load_rig(found.path)) == pytest.approx(poses, abs=1e-15)
    raw = found.path.read_bytes()
    assert raw.startswith(b"\xef\xbb\xbf") == text.startswith("\ufeff")
    assert (raw.count(b"\r\n") == raw.count(b"\n")) == ("\r\n" in text)
    assert all(part in raw.decode() for part in ("# a", "# b", "# ä") if part in text)


def test_examples_that_are_installed_are_not_written(tmp_path, monkeypatch):
    found, rig = source(tmp_path / "rig.yaml", RIG)
    monkeypatch.setattr("lidarcfg.__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(
        ConfigError, match=r"rig.yaml: comes with lidarcfg and is not changed; download the rig instead"
    ):
        found.save(poses_of(rig) + 0.01)
    assert found.path.read_text() == RIG


def test_files_that_are_not_written(tmp_path):
    """Changed meanwhile, gone, read-only, or with numbers that stand for others: one line says so, nothing is written."""
    found, rig = source(tmp_path / "rig.yaml", RIG)
    poses = poses_of(rig) + 0.01
    found.path.write_text(RIG + "# mine\n")
    with pytest.raises(
        ConfigError, match=r"rig.yaml: has changed on disk since it was opened; nothing is written; down"
    ):
        found.save(poses)
    assert found.path.read_text() == RIG + "# mine\n"
    found.path.unlink()
    with pytest.raises(ConfigError, match="has changed on disk"):
        found.save(poses)
    found, _ = source(tmp_path / "ro.yaml", RIG)
    found.path.chmod(0o444)
    with pytest.raises(PermissionError, match="is read-only; to have it replaced"):
        found.save(poses)
    assert found.path.read_text() == RIG
    anchored = RIG.replace("[1.5, 1.4, 1.2]", "&p [1.5, 1.4, 1.2]").replace("[1.5, -1.2, 1.2]", "*p")
    found, _ = source(tmp_path / "a.yaml", anchored)
    with pytest.raises(ConfigError, match=r"a.yaml:6: an anchor, which other keys refer to, is not changed; download"):
        found.save(poses)
    assert found.path.read_text() == anchored
    assert len(list(tmp_path.iterdir())) == 2  # and no leftovers


@pytest.fixture
def sides(tmp_path):
    """A study of a mirrored pair, and a rig of its own file."""
    (tmp_path / "sides.yaml").write_text(STUDY)
    (tmp_path / "rig.yaml").write_text(RIG)
    return load_contents([tmp_path / "sides.yaml", tmp_path / "rig.yaml"], None, None, np.eye(4), no_warning)


def test_what_is_no_file_any_more_is_not_written(tmp_path):
    """Links in a circle, and a file that has become ten gigabytes, which are not read."""
    found, rig = source(tmp_path / "rig.yaml", RIG)
    found.path.unlink()
    found.path.symlink_to("rig.yaml")
    with pytest.raises(ConfigError, match="has changed on disk"):
        found.save(poses_of(rig))
    found.path.unlink()
    with open(found.path, "wb") as file:
        file.truncate(10**10)
    with pytest.raises(ConfigError, match="has changed on disk"):
        found.save(poses_of(rig))
    assert found.path.stat().st_size == 10**10


@pytest.mark.parametrize("number", ['"1"', "true", "null", "[1]", "NaN", "1e999", "1e308"])
def test_what_is_no_number_is_not_saved(sides, number):
    with serving(sides) as url:
        token = json.loads(asked(url, "GET", "/about.json")[1])["token"]
        body = f'{{"poses": [[{number}, 1, 2, 0, 0, 0], [1, 2, 3, 0, 0, 0]]}}'
        status, text = asked(url, "POST", "/save", body, **{"X-Lidarcfg-Token": token})
        assert (status, text) == (400, b"poses: allowed are 2 of x, y, z, roll, pitch, yaw in metres and radians\n")
    assert sides.source.path.read_text() == RIG


def test_of_two_pages_one_saves_and_a_request_that_stops_is_refused(sides, monkeypatch):
    monkeypatch.setattr("lidarcfg.viewer.server._Handler.timeout", 0.2)
    with serving(sides) as one, serving(sides) as other:
        tokens = [json.loads(asked(url, "GET", "/about.json")[1])["token"] for url in (one, other)]
        bodies = [json.dumps({"poses": (poses_of(sides.rigs[0]) + step).tolist()}) for step in (0.01, 0.02)]
        assert asked(one, "POST", "/save", bodies[0], **{"X-Lidarcfg-Token": tokens[0]})[0] == 200
        status, text = asked(other, "POST", "/save", bodies[1], **{"X-Lidarcfg-Token": tokens[1]})
        assert (status, b"has changed on disk" in text) == (400, True)
        status, text = asked(one, "POST", "/save", bodies[0], **{"Content-Length": "9999"})
        assert (status, text) == (400, b"the request is not whole after 0.2 s\n")


def test_who_may_save(sides):
    """Only the page as it is served now; a foreign page knows no token, nor does one of an earlier server."""
    body = json.dumps({"poses": (poses_of(sides.rigs[0]) + 0.01).tolist()})
    with serving(sides) as url:
        token = json.loads(asked(url, "GET", "/about.json")[1])["token"]
        for headers in ({}, {"X-Lidarcfg-Token": "x" + token}, {"X-Lidarcfg-Token": "ü"}):
            status, text = asked(url, "POST", "/save", body, **headers)
            assert (status, text.decode()) == (
                400,
                "the request does not come from the page as it is served now; reload it\n",
            )
        foreign = {"X-Lidarcfg-Token": token, "Origin": "http://evil.example"}
        assert asked(url, "POST", "/save", body, **foreign)[0] == 403
        assert sides.source.path.read_text() == RIG
        sides.source.path.chmod(0o444)
        status, text = asked(url, "POST", "/save", body, **{"X-Lidarcfg-Token": token})
        assert (status, text.count(b"\n"), b"rig.yaml: is read-only" in text) == (400, 1, True)
        sides.source.path.chmod(0o644)
        assert asked(url, "POST", "/save", body, **{"X-Lidarcfg-Token": token})[0] == 200
        assert asked(url, "POST", "/save", body, **{"X-Lidarcfg-Token": token})[0] == 200  # it knows what it wrote
    with Server(
        load_contents([ROOT / "data/studies/sedan.yaml"], None, None, np.eye(4), no_warning), page_of(sides)
    ) as one:
        assert one.source is None  # the rig of a study has no file


@in_browser
def test_a_moved_pair_is_undone_and_saved(chromium, sides):
    """The partner is the mirror image; VSR and rates are evaluate's; each step is undone and redone; asked, then saved."""
    from selenium.webdriver import Keys

    rates = "return [...document.querySelectorAll('#rates tr')].map((row) => row.innerText)"
    poses = "return lidarcfg.handles.poses"

    def agrees(study=sides.study):
        settled(chromium)
        now = with_poses(sides.rigs[0], np.array(chromium.execute_script(poses)))
        found = evaluate(study, now)
        child = found.detection["child"]
        post = found.detection["post"]
        assert shown_vsr(chromium) == found.max_vsr_m
        shown = [text.split("\t") for text in chromium.execute_script(rates)]
        assert [name for name, _ in shown] == ["child", "post"]
        assert float(shown[0][1].split()[0]) == pytest.approx(100 * child.rate, abs=0.0051)
        assert [float(shown[1][1].split()[i]) for i in (0, 2)] == pytest.approx(
            [100 * post.rate, 100 * post.half_width], abs=0.0051
        )
        zone = chromium.find_element("id", "zone-vsr").text.splitlines()[0]
        assert zone == f"ahead: max VSR {found.zones[0].max_vsr_m:.4f} m"
        return np.array(chromium.execute_script(poses))

    with serving(sides) as url:
        opened(chromium, url)
        states = [agrees()]
        put(chromium, "#mount", 0, "change")
        for key, value in (("y", 1.6), ("roll", -25), ("yaw", 80), ("z", 1.1), ("z", 1.15)):
            put(chromium, f"#pose-{key}", value)
        states.append(agrees())
        one, two = states[1]
        assert two == pytest.approx([one[0], 0.2 - one[1], one[2], -one[3], one[4], -one[5]], abs=1e-15)
        click(chromium, "#transparent")
        assert (agrees(replace(sides.study, visibility=sides.study.visibility.transparent())) == states[1]).all()
        click(chromium, "#transparent")
        assert (one[1], one[2], one[3]) == (1.6, 1.15, pytest.approx(np.radians(-25)))
        assert "mirror" not in chromium.find_element("id", "violations").text
        put(chromium, "#mount", 1, "change")
        put(chromium, "#pose-x", 1.1)
        assert agrees()[0, 0] == 1.1  # and the other way round
        click(chromium, "#mirror")
        put(chromium, "#pose-x", 1.3)
        states.append(agrees())
        assert states[2][:, 0].tolist() == [1.1, 1.3]
        body = chromium.find_element("tag name", "body")
        for _ in range(6):  # x twice is one step, z twice is one
            body.send_keys(Keys.CONTROL, "z")
        assert (agrees() == states[0]).all()
        body.send_keys(Keys.CONTROL, "z")
        assert (agrees() == states[0]).all()  # nothing is left to undo
        for _ in range(5):
            click(chromium, "#redo")
        assert (agrees() == states[2]).all()
        click(chromium, "#reset")
        assert (agrees() == states[0]).all()
        click(chromium, "#undo")
        assert (agrees() == states[2]).all()

        click(chromium, "#save")
        assert str(sides.source.path) in chromium.find_element("id", "ask").text
        click(chromium, "#ask-no")
        assert sides.source.path.read_text() == RIG
        click(chromium, "#save")
        click(chromium, "#ask-yes")
        told(chromium, f"saved {sides.source.path}")
        assert (poses_of(load_rig(sides.source.path)) == states[2]).all()
        assert "# measured by hand" in sides.source.path.read_text()
        sides.source.path.write_text(RIG)
        click(chromium, "#save")
        click(chromium, "#ask-yes")
        told(chromium, "has changed on disk since it was opened")


LEANING = """name: leaning
sensors:
- {{name: left, model: vlp-16, position_m: [0, 0.5, 1.9], rpy_deg: [-5, {0}, 0]}}
- {{name: right, model: vlp-16, position_m: [0, -0.5, 1.9], rpy_deg: [5, {0}, 0]}}
"""
IN_VIEW = """
const [places] = arguments;
const { camera } = lidarcfg.stage;
return places.map((at) => lidarcfg.stage.orbit.target.clone().set(...at).project(camera).toArray());
"""


SIDES = "(({left, top, right, bottom}) => [left, top, right, bottom])(l.getBoundingClientRect())"


def seen(driver, places):
    """How far from the middle of the picture the outermost of the places is: 1 at its edge."""
    settled(driver)
    at = np.array(driver.execute_script(IN_VIEW, np.asarray(places).tolist()))
    return abs(at[:, :2]).max()


@in_browser
@pytest.mark.parametrize("name", ["sedan", "truck"])
def test_the_opening_view_shows_vehicle_and_worst_subspaces_whole(chromium, name):
    """All of their vertices are in the picture, from each side, and reach near to an edge."""
    contents = load_contents([ROOT / f"data/studies/{name}.yaml"], None, None, np.eye(4), no_warning)
    places = [contents.study.vehicle.scene.mesh()[0]]
    places += [body.faces_m.reshape(-1, 3) for body in score(contents.study, contents.rigs[0], 3).worst]
    with serving(contents, worst=3) as url:
        opened(chromium, url)
        for look in ("", "#look-top", "#look-front", "#look-side"):
            if look:
                click(chromium, look)
            assert 0.8 < seen(chromium, np.concatenate(places)) < 0.95
        put(chromium, "#worst", 1)
        click(chromium, "#region")
        click(chromium, "#bounds")
        click(chromium, "#missed")
        chromium.find_element("tag name", "body").send_keys("f")
        assert 0.8 < seen(chromium, np.concatenate(places[:2])) < 0.95


NEAREST = """
const [places, aways] = arguments;
const stage = lidarcfg.stage, at = (xyz) => stage.orbit.target.clone().set(...xyz);
const eyes = aways.map((away) => stage.framing(places.map(at), at(away).negate())[0]);
return [stage.camera.position, ...eyes].map((eye) => eye.toArray());
"""


@in_browser
@pytest.mark.parametrize("lean_deg", [5, -5])
def test_the_opening_view_is_from_where_the_vehicle_is_nearest(chromium, tmp_path, lean_deg):
    """Nearer than from the corners around; the worst subspace is ahead of sensors that lean ahead, behind those that lean back."""
    (tmp_path / "rig.yaml").write_text(LEANING.format(lean_deg))
    contents = load_contents(
        [ROOT / "data/studies/sedan.yaml", tmp_path / "rig.yaml"], None, None, np.eye(4), no_warning
    )
    worst = [body.faces_m.reshape(-1, 3) for body in score(contents.study, contents.rigs[0], 1).worst]
    places = np.concatenate([contents.study.vehicle.scene.mesh()[0], *worst])
    assert worst[0][:, 0].mean() * lean_deg > 0
    aways = [[np.cos(at), np.sin(at), 0.57] for at in np.radians([45, 135, 225, 315])]
    with serving(contents, worst=1) as url:
        opened(chromium, url)
        eyes = np.array(chromium.execute_script(NEAREST, places.tolist(), np.array(aways).tolist()))
        far = np.linalg.norm(eyes, axis=1)
        assert far[0] < 1.001 * far[1:].min() < 0.8 * far[1:].max()
        assert eyes[0, 0] * lean_deg < 0


BEHIND = """
const { stage } = lidarcfg, at = (...xyz) => stage.orbit.target.clone().set(...xyz);
stage.place(at(-20, 0, 12), at(0, 0, 0));
"""


@in_browser
def test_guides_zones_and_keys(chromium, sides):
    """Each key of the panel is on the page of the documentation; grid, rings and zones are drawn, with their names."""
    with serving(sides) as url:
        opened(chromium, url)
        chromium.execute_script(BEHIND)
        body = chromium.find_element("tag name", "body")
        labels = (
            "return [...document.querySelectorAll('#labels span')].filter((l) => !l.hidden).map((l) => l.textContent)"
        )
        assert "ahead × 2" in chromium.execute_script(labels)
        before = picture(chromium)
        for key, box in (("g", "#grid"), ("c", "#rings")):
            body.send_keys(key)
            assert different(picture(chromium), before) > 300, box
            if key == "c":
                assert {"5 m", "10 m"} <= set(chromium.execute_script(labels))
                low, high = np.split(
                    np.array(chromium.execute_script(labels.replace("l.textContent", SIDES))), 2, axis=1
                )
                apart = (low[:, None] >= high).any(axis=2) | (low >= high[:, None]).any(axis=2)
                assert len(low) > 6
                assert apart.sum() == len(low) * (len(low) - 1)  # no label lies over another
                assert low.min() >= 0
            body.send_keys(key)
            assert different(picture(chromium), before) < 100, box
        click(chromium, "#zones")
        assert different(picture(chromium), before) > 100
        assert "ahead × 2" not in chromium.execute_script(labels)
        body.send_keys("?")
        panel = chromium.find_element("id", "help")
        assert panel.is_displayed()
        rows = "return [...document.querySelectorAll('#help tr')].map((row) => [...row.children].map((cell) => cell.textContent))"
        listed = chromium.execute_script(rows)
        text = (ROOT / "docs/view.md").read_text()
        assert len(listed) > 15
        assert [row for row in listed if f"| {row[0]} | {row[1]} |" not in text] == []
        body.send_keys("?")
        assert not panel.is_displayed()
