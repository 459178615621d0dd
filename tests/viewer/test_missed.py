"""What is missed, on the page: as the measure counts it at the first of the fresh places, again after each move."""

import base64
import json
import math

import numpy as np
import pytest

from lidarcfg.returns.misses import FRESH
from lidarcfg.viewer.contents import load_contents
from lidarcfg.viewer.evaluation import with_poses
from lidarcfg.viewer.missed import PLACES
from lidarcfg.viewer.page import page_of, save_html
from tests.capture_fixtures import no_warning
from tests.viewer.driver import asked, in_browser, opened, poses_of, put, serving, settled
from tests.viewer.test_verdict import RIG

pytestmark = pytest.mark.slow

STUDY = """
region: {min_m: [-8, -5, 0], max_m: [8, 5, 3], cuboid_m: [1, 1, 0.5]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4], exclude: true}]}
sensors:
  - {model: vlp-16, count: 2, min: {position_m: [-1, -1, 1.5], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 1, 3], rpy_deg: [0, 0, 0]}}
objective: {misses: {objects: {child: 1, tyre: 3}, within_m: [0.2, 5]}}
"""

CELL_M = 0.25  # of a square around so small a body


@pytest.fixture
def missing(tmp_path):
    for name, text in (("study", STUDY), ("rig", RIG)):
        (tmp_path / f"{name}.yaml").write_text(text)
    return load_contents([tmp_path / "study.yaml", tmp_path / "rig.yaml"], None, None, np.eye(4), no_warning)


def shares(contents, poses):
    """The share of each object, counted anew at the first of the fresh places; and the places with how likely."""
    misses = contents.study.misses
    found = misses.found_at(misses.known(PLACES, FRESH), with_poses(contents.rigs[0], np.array(poses)).mounts)
    for one, fresh in zip(found.objects, misses.fresh.objects, strict=True):
        assert (one.places == fresh.places[:PLACES]).all()
    return found


def test_the_server_answers_as_the_measure_does(missing):
    """From what it kept, too; and each square has the colour of its share, by plain loops over the places."""
    poses = poses_of(missing.rigs[0])
    with serving(missing) as url:
        for by_m in (0.0, 1.3, 0.0):
            poses[0, 2] = 1.6 + by_m
            answer = json.loads(asked(url, "POST", "/misses", json.dumps({"poses": poses.tolist()}))[1])
            want = shares(missing, poses)
            assert [one["share"] for one in answer["objects"]] == [one.share for one in want.objects]
            assert answer["share"] == pytest.approx((want.objects[0].share + 3 * want.objects[1].share) / 4)
            assert answer["places"] == PLACES
        assert asked(url, "POST", "/misses", "{}")[0] == 400
    weight, missed = {}, {}
    for one, part in zip(want.objects, (1, 3), strict=True):
        for (x, y, *_), p in zip(one.places.tolist(), one.probability.tolist(), strict=True):
            cell = math.floor(x / CELL_M), math.floor(y / CELL_M)
            weight[cell] = weight.get(cell, 0) + part
            missed[cell] = missed.get(cell, 0) + part * p
    drawn = {}
    for square in answer["squares"]:
        mesh = square["mesh"]
        corners = np.frombuffer(base64.b64decode(mesh["vertices"]), "<f4").reshape(-1, 4, 3) + mesh["origin_m"]
        assert np.ptp(corners[..., :2], axis=1) == pytest.approx(CELL_M, abs=1e-6)
        for x, y in np.rint(corners[..., :2].min(axis=1) / CELL_M).astype(int).tolist():
            drawn[x, y] = square["colour"]
    assert drawn.keys() == {cell for cell, amount in missed.items() if amount > 0}
    assert 0 < len(drawn) < len(weight)
    for cell, colour in drawn.items():
        if missed[cell] == weight[cell]:
            assert colour == "#7f0000"
    order = sorted(drawn, key=lambda cell: missed[cell] / weight[cell])
    green = [int(drawn[cell][3:5], 16) for cell in order]
    assert green == sorted(green, reverse=True)  # the more is missed, the darker


@in_browser
def test_misses_follow_a_drag(chromium, missing):
    with serving(missing) as url:
        opened(chromium, url)
        poses = poses_of(missing.rigs[0])
        shown = "return Number(document.getElementById('misses').dataset.value)"
        assert chromium.execute_script(shown) == pytest.approx(shares(missing, poses).mean)
        before = chromium.execute_script(
            "return lidarcfg.missed.object.children.map((one) => one.material.emissive.getHexString())"
        )
        put(chromium, "#mount", 0, "change")
        put(chromium, "#pose-z", 2.9)
        settled(chromium)
        poses[0, 2] = 2.9
        assert chromium.execute_script(shown) == pytest.approx(shares(missing, poses).mean)
        assert shares(missing, poses).mean != shares(missing, poses_of(missing.rigs[0])).mean
        rows = chromium.execute_script("return document.getElementById('missed-objects').innerText.split('\\n')")
        assert [row.split("\t")[0] for row in rows] == ["child", "tyre"]
        assert before


@in_browser
def test_a_page_of_its_own_has_the_map(chromium, missing, tmp_path):
    """Computed once, and without a study's vehicle there is none."""
    page = page_of(missing)
    assert page.about["misses"]["share"] == pytest.approx(shares(missing, poses_of(missing.rigs[0])).mean)
    save_html(page, tmp_path / "page.html")
    opened(chromium, (tmp_path / "page.html").as_uri())
    count = chromium.execute_script("return lidarcfg.missed.object.children.length")
    assert count == len(page.about["misses"]["squares"]) > 0
    assert chromium.execute_script("return document.getElementById('missed').checked")
