"""What shows a verdict: counts on the map, views, single failures and mounts that are off, beside the counts alone."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.placement.study import load_study
from lidarcfg.requirements.evidence import OFF_M, OFF_RAD, verification
from lidarcfg.requirements.objects import ObjectJudge, reached
from lidarcfg.requirements.sensors import lowest_at
from lidarcfg.requirements.verify import Verifier
from lidarcfg.sensors.rig import load_rig
from tests.command_line import lidarcfg
from tests.requirements.cases import ALL, AROUND, random_rig, requirement

STUDY = """
region: {min_m: [-10, -10, 0], max_m: [10, 10, 4], cuboid_m: [1, 1, 1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4], exclude: true}]}
sensors:
  - {model: vlp-16, count: 2, min: {position_m: [0, -1, 1.5], rpy_deg: [0, 0, 0]}, max: {position_m: [0, 1, 2], rpy_deg: [0, 0, 0]}}
prices: {vlp-16: 4000}
requirements:
  - {name: crates <ahead>, object: {size_m: [0.5, 0.5, 0.5]}, within_m: [2, 3], sector_deg: [-30, 30], headings_deg: [0, 30], returns: 10}
  - {name: moving off, post_height_m: 0.5, first_seen_at_most_m: 1, within_m: [0, 3]}
  - {name: little shadow, shadow_at_most_m3: 2, height_m: [0, 1]}
  - {name: budget, price_at_most: 8000}
"""
RIG = """name: two
sensors:
  - {name: left, model: vlp-16, position_m: [0, 0.5, 1.6], rpy_deg: [0, 0, 0]}
  - {name: right, model: vlp-16, position_m: [0, -0.5, 1.6], rpy_deg: [0, 0, 0]}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evidence")
    (folder / "study.yaml").write_text(STUDY)
    (folder / "rig.yaml").write_text(RIG)
    return folder


@pytest.fixture(scope="module")
def found(files):
    study = load_study(files / "study.yaml")
    return study, verification(Verifier(study.requirements), load_rig(files / "rig.yaml").mounts)


def test_counts_are_those_of_each_position_at_its_worst_heading():
    """Counted anew at every place, heading by heading."""
    item = requirement(headings_deg=(0, 45), returns=40)
    mounts = random_rig(np.random.default_rng(1))
    counts = ObjectJudge(item, AROUND).counts(mounts)
    places = item.stand.base
    alone = reached(lowest_at(places, item.target, mounts, AROUND, ALL, 4).counts, 0, None)
    least = {}
    for (x, y), value in zip(places[:, :2].tolist(), alone.tolist(), strict=True):
        least[x, y] = min(least.get((x, y), value), value)
    shown = {(x, y): value for (x, y), value in zip(counts.at_m.tolist(), counts.values.tolist(), strict=True)}
    assert {at: min(value, counts.cap) for at, value in shown.items()} == {
        at: min(value, counts.cap) for at, value in least.items()
    }
    assert (np.diff(counts.side_m) <= 0).all()


def test_views_have_the_counts_of_the_verdict(found):
    """The returns that the sensors' pictures show add up to what is reached, each in its worst phase."""
    _, shown = found
    one = shown.evidence[0]
    assert [view.name for view in one.views] == ["left", "right"]
    assert sum(view.beams.returns for view in one.views) == one.verdict.reached
    post = shown.evidence[1]
    assert not any(view.beams.returns for view in post.views)  # as it is never seen within 3 m
    assert post.verdict.reached == np.inf


def test_margins_are_those_of_rigs_without_a_sensor_and_with_one_moved():
    item = requirement(returns=30)
    mounts = random_rig(np.random.default_rng(2))
    judge = ObjectJudge(item, AROUND)
    found = judge.margins(mounts, OFF_M, OFF_RAD)
    for n in range(len(mounts)):
        left = [mount for m, mount in enumerate(mounts) if m != n]
        alone = int(ObjectJudge(item, AROUND).measured(left, judge.first_cap).values.min())
        assert min(int(found.without[n]), judge.first_cap) == min(alone, judge.first_cap)
    least = []
    for way in (-1, 1):
        x, y, z = mounts[1].position_m
        moved = (mounts[0], replace(mounts[1], position_m=(x, y, z + way * OFF_M)), mounts[2])
        least.append(int(ObjectJudge(item, AROUND).measured(moved, judge.first_cap).values.min()))
    assert found.off[1, 2] >= min(least)  # at the lowest places only
    assert found.whole == int(judge.measured(mounts, judge.first_cap).values.min())


def test_hidden_heights_add_up_to_the_shadow(found):
    _, shown = found
    hidden = shown.evidence[2].hidden
    volume_m3 = float(hidden.height_m.sum()) * hidden.side_m**2
    assert volume_m3 == pytest.approx(shown.verdict.requirements[2].reached)
    assert not shown.evidence[3].has_map


def test_the_report_begins_with_the_verdict(files, found):
    """As verdict.json has it; a map for each requirement but the price, and views of the worst places."""
    out = files / "out"
    lidarcfg("verify", files / "study.yaml", files / "rig.yaml", "-o", out, code=0 if found[1].verdict.passed else 3)
    page = (out / "verdict.html").read_text()
    values = json.loads((out / "verdict.json").read_text())
    assert values["pass"] == found[1].verdict.passed
    body = page[page.index("<body") :]
    assert body.index('class="verdict') < body.index("<nav") < body.index("Requirement by requirement")
    assert "crates &lt;ahead&gt;" in page
    assert "<ahead>" not in page
    assert page.count("map around the vehicle") == 3
    assert page.count("the worst place as each sensor sees it") == 2
    for one in values["requirements"]:
        assert ("PASS" if one["pass"] else "FAIL") + ": " + one["name"].replace("<", "&lt;").replace(
            ">", "&gt;"
        ) in page


def test_an_evaluation_begins_with_the_verdict(files, blank_pictures):
    out = files / "evaluated"
    lidarcfg("evaluate", files / "study.yaml", files / "rig.yaml", "-o", out)
    page = (out / "report.html").read_text()
    assert page.index('class="verdict') < page.index('class="summary"')
    result = json.loads((out / "result.json").read_text())
    assert [one["name"] for one in result["verdict"]["requirements"]][3] == "budget"
    posts = {one["post_height_m"]: one for one in result["blind_spots"]}
    assert list(posts) == [0.25, 0.5, 1.0]
    # 1 m ahead the body's edge lies 11.3° below the sensors: the beams at 11° are the lowest that pass it
    assert posts[0.5]["first_seen_m"][0] == pytest.approx(1.1 / np.tan(np.radians(11)) - 1, abs=0.12)
    assert posts[1.0]["first_seen_m"][0] == pytest.approx(0.6 / np.tan(np.radians(11)) - 1, abs=0.12)
