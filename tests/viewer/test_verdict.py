"""The verdict on the page: that of `verify`, again after each move, and in a page that stands alone."""

import json
import math

import numpy as np
import pytest

from lidarcfg.requirements.verify import Verifier
from lidarcfg.viewer.contents import load_contents
from lidarcfg.viewer.evaluation import with_poses
from lidarcfg.viewer.page import page_of, save_html
from tests.capture_fixtures import no_warning
from tests.viewer.driver import asked, click, drag, in_browser, opened, poses_of, put, serving, settled

pytestmark = pytest.mark.slow

STUDY = """
region: {min_m: [-8, -5, 0], max_m: [8, 5, 3], cuboid_m: [1, 1, 0.5]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4], exclude: true}]}
sensors:
  - {model: vlp-16, count: 2, min: {position_m: [-1, -1, 1.5], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 1, 3], rpy_deg: [0, 0, 0]}}
prices: {vlp-16: 4000}
requirements:
  - {name: crates ahead, object: {size_m: [1, 1, 1]}, within_m: [2, 3], sector_deg: [-30, 30], headings_deg: [0], returns: 60}
  - {name: budget, price_at_most: 8000}
"""
RIG = """name: two
sensors:
  - {name: left, model: vlp-16, position_m: [0.8, 0.4, 1.6], rpy_deg: [0, 0, 0]}
  - {name: right, model: vlp-16, position_m: [0.8, -0.4, 1.6], rpy_deg: [0, 0, 0]}
"""


@pytest.fixture
def required(tmp_path):
    for name, text in (("study", STUDY), ("rig", RIG)):
        (tmp_path / f"{name}.yaml").write_text(text)
    paths = [tmp_path / "study.yaml", tmp_path / "rig.yaml"]
    return load_contents(paths, None, None, np.eye(4), no_warning)


def verdict_of(contents, poses):
    return Verifier(contents.study.requirements).verify(with_poses(contents.rigs[0], np.array(poses)).mounts)


def test_the_server_answers_as_verify_does(required):
    """From what it kept of the sensor that stays, too; what cannot be verified is the user's mistake."""
    poses = poses_of(required.rigs[0])
    with serving(required) as url:
        for by_m in (0.0, 1.3, 0.0):
            poses[0, 2] = 1.6 + by_m
            answer = json.loads(asked(url, "POST", "/verify", json.dumps({"poses": poses.tolist()}))[1])
            want = verdict_of(required, poses)
            assert answer["pass"] == want.passed
            assert [(one["name"], one["pass"]) for one in answer["requirements"]] == [
                (one.name, one.passed) for one in want.requirements
            ]
            assert f"{abs(want.requirements[0].margin):,.0f} returns" in answer["requirements"][0]["margin"]
        assert asked(url, "POST", "/verify", "{}")[0] == 400


@in_browser
def test_the_verdict_follows_a_drag(chromium, required):
    """Two sensors that are dragged up see the crates no longer with enough beams, and undoing it restores the verdict."""

    def shown():
        settled(chromium)
        found = verdict_of(required, chromium.execute_script("return lidarcfg.handles.poses"))
        text = chromium.find_element("id", "verdict").text
        rows = chromium.execute_script(
            "return [...document.querySelectorAll('#requirements tr')].map((r) => r.innerText)"
        )
        assert text == ("PASS" if found.passed else "FAIL")
        for row, one in zip(rows, found.requirements, strict=True):
            name, margin, word = row.split("\t")
            assert (name, word) == (one.name, "PASS" if one.passed else "FAIL")
            assert math.copysign(1, one.margin) == (-1 if margin.startswith("-") else 1)
        assert rows[1].startswith("budget\t+0\tPASS")
        return text

    with serving(required) as url:
        opened(chromium, url)
        assert shown() == "PASS"
        click(chromium, "#fit")
        for number in (0, 1):
            put(chromium, "#mount", number, "change")
            at = chromium.execute_script("return lidarcfg.handles.poses")[number][:3]
            drag(chromium, np.array(at), 2, 1.2)
        assert shown() == "FAIL"
        click(chromium, "#reset")
        assert shown() == "PASS"


@in_browser
def test_a_page_of_its_own_has_the_verdict(chromium, required, tmp_path):
    path = tmp_path / "page.html"
    save_html(page_of(required), path)
    opened(chromium, path.as_uri())
    assert chromium.find_element("id", "verdict").text == "PASS"
