"""What a notebook shows is what the report has, escaped; and no object prints pages of arrays."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import lidarcfg
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.report.notebook import html
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns.misses import MissesFound, ObjectMisses
from lidarcfg.search.run import Believed, Compared
from tests.documents import ROOT

STUDY = {
    "region": {"min_m": [-10, -10, 0], "max_m": [10, 10, 2], "cuboid_m": [1, 1, 0.5]},
    "sensors": [
        {
            "name": "roof",
            "model": "vlp-16",
            "min": {"position_m": [0, 0, 1.7], "rpy_deg": [0, 0, 0]},
            "max": {"position_m": [0.5, 0, 2], "rpy_deg": [0, 0, 0]},
        }
    ],
    "prices": {"vlp-16": 4000},
    "requirements": [{"name": "cost", "price_at_most": 5000}],
    "objective": {"max_vsr": 1},
    "solver": {"evaluations": 40},
}
RIG = {"name": "hand <i>", "sensors": [{"name": "roof", "model": "vlp-16", "position_m": [0, 0, 1.8]}]}


FAR = {"position_m": [0, 0, 3], "rpy_deg": [0, 0, 0]}


def misses(share):
    """Of a dog at a hundred places, at a part of which it is missed."""
    at = np.column_stack([np.linspace(-5, 5, 100), np.linspace(5, -5, 100), np.zeros((100, 2))])
    return MissesFound((ObjectMisses("dog", 1.0, at, np.full(100, share)),), 3, (0.1, 20.0))


class Cells(HTMLParser):
    """The texts of all cells, and the tags."""

    def __init__(self, text):
        super().__init__()
        self.texts, self.tags = [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        if tag in ("td", "th"):
            self.texts.append("")

    def handle_data(self, data):
        if self.texts:
            self.texts[-1] += data.strip()


@pytest.fixture(scope="module")
def study():
    return lidarcfg.load_study(STUDY)


@pytest.fixture(scope="module")
def rig():
    return lidarcfg.load_rig(RIG)


@pytest.fixture(scope="module")
def found(study, rig):
    return lidarcfg.evaluate(study, rig)


def test_a_verdict_is_that_of_an_evaluation(study, rig, found):
    verdict = lidarcfg.verify(STUDY, RIG)
    assert verdict == found.verdict == Verifier(study.requirements).verify(rig.mounts)
    (one,) = verdict.requirements
    shown = Cells(verdict._repr_html_())
    assert (one.demanded, one.reached, one.passed) == (5000, 4000, True)
    assert shown.texts[shown.texts.index("PASS") + 1 :][:3] == ["≤ 5,000", "4,000", "+1,000"]


def test_progress_ends_and_what_cannot_be_judged_is_refused():
    told = []
    lidarcfg.verify(STUDY, RIG, lambda fraction, name: told.append((fraction, name)))
    assert told[0] == (0.0, "cost")
    assert told[-1][0] <= 1.0
    with pytest.raises(ConfigError, match=r"study 'study': has no requirements; give some under requirements"):
        lidarcfg.verify({key: value for key, value in STUDY.items() if key != "requirements"}, RIG)
    body = {"boxes": [{"name": "body", "center_m": [0, 0, 0.9], "size_m": [4, 2, 1.8001]}]}
    with pytest.raises(ConfigError, match="roof is inside the vehicle's 'body'"):
        lidarcfg.verify({**STUDY, "vehicle": body, "sensors": [{**STUDY["sensors"][0], "max": FAR, "min": FAR}]}, RIG)


@pytest.mark.slow
def test_results_are_tables_and_maps(study, rig, found):
    missed = misses(0.25)
    for shown in (missed, replace(found, misses=missed)):
        cells = Cells(html(shown))
        assert "svg" in cells.tags
        assert cells.texts[cells.texts.index("dog") + 1].startswith("25.00 % (")
    assert "PASS" in Cells(html(found)).texts
    assert f"max VSR {found.max_vsr_m:.4f} m" in html(replace(found, verdict=None))
    assert "1 roof" in Cells(rig._repr_html_()).texts
    assert "roof" in Cells(study._repr_html_()).texts
    with pytest.raises(TypeError, match="a dict is not shown"):
        html({})


def test_a_search_shows_its_rig_beside_the_best_plain_one(study, rig):
    found = lidarcfg.optimize(study)
    assert "1 roof" in Cells(found._repr_html_()).texts
    plain = Compared(rig, 0.5, misses(0.5))
    told = Believed(0.2, 100, plain, misses(0.75))
    evaluation = replace(found.evaluation, misses=misses(0.25))
    cells = Cells(html(replace(found, evaluation=evaluation, believed=told)))
    assert cells.texts[cells.texts.index("this rig") + 1] == "best plain rig"
    assert [text[:7] for text in cells.texts[cells.texts.index("dog") + 1 :][:2]] == ["25.00 %", "50.00 %"]


def test_rigs_side_by_side_are_their_evaluations(study, rig, found):
    other = rig.moved("roof", (0.0, 0.0, 2.0))
    both = lidarcfg.compare(study, [RIG, other])
    assert list(both.evaluations) == ["A", "B"]
    assert np.array_equal(both.evaluations["A"].vsr_m, found.vsr_m)
    assert [one["name"] for one in both.to_dict()["rigs"]] == ["hand <i>"] * 2
    shown = both._repr_html_()
    assert "hand &lt;i&gt;" in shown
    assert "<i>" not in shown
    with pytest.raises(ConfigError, match=r"1 rig to compare; allowed: 2 to 10"):
        lidarcfg.compare(study, [rig])


def test_what_python_prints_fits_a_line(study, rig):
    scene = lidarcfg.load_scene(ROOT / "data/scenes/street.yaml")
    cloud = lidarcfg.PointCloud.none(("roof",))
    for one in (study, rig, rig.mounts[0], rig.mounts[0].sensor, scene, cloud):
        assert len(repr(one)) < 100
        assert len(str(one)) < 100
    assert repr(rig.mounts[0]) == "<Mount roof: vlp-16 at (0, 0, 1.8) m, rpy (0, 0, 0)°>"
    assert repr(cloud) == "<PointCloud: 0 points of roof>"


@pytest.mark.slow
def test_a_view_is_a_page_and_a_picture(tmp_path, rig):
    shown = lidarcfg.view(rig, "data/scenes/street.yaml")
    shown.save(tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert '"name": "roof"' in page
    assert shown._repr_html_().startswith('<iframe srcdoc="&lt;!')
    shown.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(LidarcfgError, match=r"a.txt: is no page and no picture; allowed: .html, .png"):
        shown.save(tmp_path / "a.txt")
    with pytest.raises(LidarcfgError, match="there is nothing to show"):
        lidarcfg.view()._repr_html_()
