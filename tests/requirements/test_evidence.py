"""What shows a verdict: counts on the map, views, single failures and mounts that are off, beside the counts alone."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.report.evidence import draw_map
from lidarcfg.report.verdict import remarks, verdict_table
from lidarcfg.report.verification import margins_table
from lidarcfg.requirements.evidence import OFF_M, OFF_RAD, MountMargins
from lidarcfg.requirements.object_judge import CAP_MAX, ObjectJudge
from lidarcfg.requirements.post import PostJudge, PostRequirement
from lidarcfg.requirements.shadow import ShadowJudge
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.post_visibility import PostPlaces
from lidarcfg.returns.reach import reached
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.loading import load_study
from lidarcfg.world.footprint import Footprint
from tests.command_line import lidarcfg
from tests.requirements.cases import ALL, AROUND, BODY, random_rig, requirement
from tests.returns_cases import mount

pytestmark = pytest.mark.slow

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
THIRD = "  - {name: front, model: vlp-16, position_m: [1.05, 0, 0.4], rpy_deg: [0, 0, 0]}\n"
BLIND = """
requirements:
  - {name: post, post_height_m: 1, first_seen_at_most_m: 1.6, gap_at_most_m: 0.5, within_m: [0, 3], sector_deg: [20, 24], lost: LOST}
  - {name: shadow, shadow_at_most_m3: 2, height_m: [0, 1], within_m: [0, 2], lost: LOST}
"""
AHEAD = """
requirements:
  - {name: post ahead, post_height_m: 0.5, first_seen_at_most_m: 1, within_m: [0, 2], sector_deg: [-20, 20]}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evidence")
    (folder / "study.yaml").write_text(STUDY)
    (folder / "rig.yaml").write_text(RIG)
    return folder


def verification(study, mounts):
    """The verdict on a rig, with the evidence."""
    verifier = Verifier(study.requirements)
    return verifier.verification(mounts, verifier.verify(mounts))


@pytest.fixture(scope="module")
def found(files):
    study = load_study(files / "study.yaml")
    return study, verification(study, load_rig(files / "rig.yaml").mounts)


def test_counts_are_those_of_each_position_at_its_worst_heading():
    """Counted anew at every place, heading by heading."""
    item = requirement(headings_deg=(0, 45), returns=40)
    mounts = random_rig(np.random.default_rng(1))
    counts = ObjectJudge(item).counts(mounts)
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


def without(mounts, n):
    return tuple(mount for m, mount in enumerate(mounts) if m != n)


def moved(mounts, n, axis, way):
    """A rig one of whose mounts is off along x, y or z; or in roll, pitch or yaw, if it is upright and faces ahead."""
    position_m = list(mounts[n].position_m)
    rpy_rad = list(mounts[n].rpy_rad)
    if axis < 3:
        position_m[axis] += way * OFF_M
    else:
        assert not any(rpy_rad)
        rpy_rad[axis - 3] += way * OFF_RAD
    off = replace(mounts[n], position_m=tuple(position_m), rpy_rad=tuple(rpy_rad))
    return (*mounts[:n], off, *mounts[n + 1 :])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sensors": 2},
        {"at_least": 0.8},
        {"cluster_m": 0.3, "at_least": 0.8},
        {"cluster_m": 0.3, "sensors": 3},
        {"lost": 1},
    ],
    ids=str,
)
def test_margins_are_those_of_rigs_without_a_sensor_and_with_one_moved(changes):
    """Beside the counts, at the verdict's places, of rigs of which a sensor was taken, or moved."""
    item = requirement((2.2, 2.4), returns=30, **changes)
    mounts = random_rig(np.random.default_rng(2))
    judge = ObjectJudge(item)
    found = judge.margins(mounts)
    places = judge.refined(mounts).every.places

    def value(rig, lost=item.lost):
        """What the position that decides has, exact below the cap."""
        fresh = ObjectJudge(replace(item, lost=lost))
        measured = (
            fresh.reach.measured_at(places, rig, CAP_MAX) if item.at_least == 1 else fresh.reach.measured(rig, CAP_MAX)
        )
        least = {}
        for (x, y), count in zip(measured.places[:, :2].tolist(), measured.values.tolist(), strict=True):
            least[x, y] = min(least.get((x, y), count), count)
        best = sorted(least.values(), reverse=True)
        return min(best[math.ceil(item.at_least * len(best)) - 1], item.first_cap)

    reached_in_all = ObjectJudge(item).judge(mounts).reached
    assert min(found.whole, found.cap) == min(reached_in_all, found.cap) == value(mounts)
    for n in range(len(mounts)):
        assert min(found.without[n], found.cap) == value(without(mounts, n), 0)
    least = min(value(moved(mounts, 1, 2, way)) for way in (-1, 1))
    assert min(found.off[1, 2], found.cap) == pytest.approx(least, abs=2)  # at the lowest places only
    alone = judge.margins(mounts[:1]) if not item.lost else None
    assert alone is None or np.isnan(alone.without).all()


def test_sensors_whose_loss_breaks_it_are_those_without_which_it_fails():
    """Clusters at eight of ten positions, where that is met; beside verdicts on the rigs without each."""
    item = requirement((2.25, 2.3), returns=90, cluster_m=0.3, at_least=0.8)
    mounts = random_rig(np.random.default_rng(2))
    found = ObjectJudge(item).judge(mounts)
    passing = [n for n in range(3) if ObjectJudge(item).judge(without(mounts, n)).passed]
    assert found.passed
    assert 0 < len(passing) < 3
    assert found.breaking == tuple(mounts[n].name for n in range(3) if n not in passing)


def judged(item, mounts):
    """The verdict by a requirement of a post, or of the shadow."""
    judge = PostJudge(item) if isinstance(item, PostRequirement) else ShadowJudge(item)
    return judge.judge(mounts)


@pytest.mark.parametrize("lost", [0, 1])
def test_margins_of_posts_and_of_the_shadow_are_those_of_rigs_judged_anew(tmp_path, lost):
    """One limit at a time, without each sensor and with each coordinate of each mount off, either way."""
    (tmp_path / "study.yaml").write_text(STUDY[: STUDY.index("requirements:")] + BLIND.replace("LOST", f"{lost}"))
    (tmp_path / "rig.yaml").write_text(RIG + THIRD)
    mounts = load_rig(tmp_path / "rig.yaml").mounts
    post, shadow = load_study(tmp_path / "study.yaml").requirements.items
    for item in (post, shadow):
        found = judged(item, mounts)
        alone = [judged(replace(item, lost=0), without(mounts, n)) for n in range(3)]
        assert found.breaking == tuple(mounts[n].name for n in range(3) if not alone[n].passed)
    limits = [replace(post, gap_at_most_m=None), replace(post, first_seen_at_most_m=None), shadow]
    margins = [*PostJudge(post).margins(mounts), ShadowJudge(shadow).margins(mounts)]
    for item, found in zip(limits, margins, strict=True):
        assert found.whole == pytest.approx(judged(item, mounts).reached)
        for n in range(3):
            alone = judged(replace(item, lost=0), without(mounts, n))
            assert found.without[n] == pytest.approx(alone.reached)
            assert found.meets(alone.reached) == alone.passed
            for axis in range(6):
                worst = max(judged(item, moved(mounts, n, axis, way)).reached for way in (-1, 1))
                assert found.off[n, axis] == pytest.approx(worst)
    assert len({value for found in margins for value in found.off.ravel().tolist()}) > 4


def test_a_post_that_one_sensor_alone_sees_breaks_with_it(tmp_path):
    """On the terminal, in JSON, JUnit and HTML; the sensor ahead of the body alone sees posts there."""
    (tmp_path / "study.yaml").write_text(STUDY[: STUDY.index("requirements:")] + AHEAD)
    (tmp_path / "rig.yaml").write_text(RIG + THIRD)
    files = tmp_path / "study.yaml", tmp_path / "rig.yaml"
    done = lidarcfg("verify", *files, "-o", tmp_path / "out", "--junit", tmp_path / "verdict.xml")
    assert "post ahead: fails without any one of front" in done.stdout
    values = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert values["requirements"][0]["breaking"] == ["front"]
    assert "fails without any one of front" in (tmp_path / "verdict.xml").read_text()
    page = (tmp_path / "out" / "verdict.html").read_text()
    assert "The loss of any of these alone breaks it: front." in page
    assert "First seen at the worst azimuth, in metres: at most 1.00 demanded" in page


def test_what_is_never_seen_is_nothing_but_a_gap():
    """A rig that looks over all posts misses a limit of gaps alone, too."""
    posts = PostPlaces.around(Footprint.of(BODY), 0.0, (0.0, 2.0))
    item = PostRequirement("post", posts, 0.3, None, 0.3, AROUND)
    high = (mount("vlp-16", (0.0, 0.0, 3.0), (0, 0, 0)),)
    judge = PostJudge(item)
    found = judge.judge(high)
    assert not found.passed
    assert np.isinf(found.reached)
    assert found.shortfall == 1
    assert np.isinf(judge.margins(high)[0].off).all()


def test_hidden_heights_add_up_to_the_shadow(found):
    _, shown = found
    hidden = shown.evidence[2].map
    volume_m3 = float(hidden.height_m.sum()) * hidden.side_m**2
    assert volume_m3 == pytest.approx(shown.verdict.requirements[2].reached)
    assert shown.evidence[3].map is None


def test_the_verdict_says_how_far_apart_posts_and_points_are(found):
    """Measured between them: posts along azimuths, which spread; points of the shadow. None is refined."""
    study, shown = found
    _, posts, shadow, _ = study.requirements.items
    texts = [one.sampling.text for one in shown.verdict.requirements[1:3]]
    at = posts.posts.places[:, :2, :2]
    step_m = np.linalg.norm(at[:, 1] - at[:, 0], axis=1)
    turns_deg = np.degrees(np.diff(np.arctan2(*(at[:, 1] - at[:, 0]).T[::-1]))) % 360
    apart = f"{step_m.mean():.3g} m apart along azimuths {turns_deg.mean():.3g}° apart"
    assert texts[0].endswith(
        f" places, {apart}, and in the middle of narrow shadows; nothing is known of what lies between"
    )
    x = np.unique(shadow.points_m[:, 0].round(6))
    assert texts[1].endswith(f" places, {np.diff(x).min():.3g} m apart; nothing is known of what lies between")


def test_the_map_shows_the_whole_box(files):
    """The axes' limits, of a box that reaches farther than the object's middle may."""
    drawn = []
    zone = "region: {min_m: [3, -2, 0], max_m: [8.5, 2, 2]}"
    text = STUDY.replace("within_m: [2, 3], sector_deg: [-30, 30]", zone)
    (files / "box.yaml").write_text(text)
    study = load_study(files / "box.yaml")
    rig = load_rig(files / "rig.yaml")
    shown = verification(study, rig.mounts)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lidarcfg.report.evidence.finish_map", lambda axes, low, high: drawn.append((low, high)))
        draw_map(shown.evidence[0], rig, 0)
    ((low, high),) = drawn
    assert low[1] < -2
    assert (high > (8.5, 2)).all()


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


def test_a_verdicts_table_has_a_column_of_losses_only_if_there_are_any():
    held = RequirementVerdict("a", "object", True, "returns", 1, 2, False, 0.0, phases=(0, 3), breaking=("left",))
    assert verdict_table(Verdict((held,))).columns[-1].head == "phases there"
    both = verdict_table(Verdict((held, replace(held, passed=False, lost=("left", "right")))))
    assert both.columns[-1].head == "sensors lost there"
    assert [row[-1] for row in both.texts] == ["", "left, right"]
    assert remarks(Verdict((held,))) == ["a: fails without any one of left"]


def test_a_table_of_margins_marks_what_misses_and_what_was_counted_no_further(files):
    """The cells of a sensor without which 5 of 10 are left; a lone sensor has no loss to tell of."""
    rig = load_rig(files / "rig.yaml")
    found = MountMargins("Returns", "returns", 10, False, 25, np.array([5.0, np.nan]), np.full((2, 6), 12.0), cap=20)
    table = margins_table(found, rig)
    assert [row[1:3] for row in table.texts] == [["5", "12"], ["–", "12"]]
    assert [row[1].mark == "fail" for row in table.cells] == [True, False]
    assert "at least 10 demanded, ≥ 20 with all mounts in place" in table.caption
