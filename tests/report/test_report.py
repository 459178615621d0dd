"""The report: read back by the standard library's parser, with names of any kind."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.report.comparison import contenders, save_comparison
from lidarcfg.report.describe import date, describe_constraints
from lidarcfg.report.drawings import least_detected
from lidarcfg.report.evaluation import bounds_table, mounts_table
from lidarcfg.report.inputs import report_inputs
from lidarcfg.report.plots import draw_convergence
from lidarcfg.report.printing import print_evaluation
from lidarcfg.report.results import save_evaluation, save_placement
from lidarcfg.report.rig_report import Commands
from lidarcfg.report.text import truncate
from lidarcfg.search.optimize import optimize
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from tests.chromium import LACKING, asked_for, browser, complaints
from tests.command_line import lidarcfg

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
NAMES = [
    "<script>alert('x')</script> & \"q\" $\\frac$",
    "歩行者 пешеход مشاة",
    "long-" * 40,
    "control\x01\x1b[31m\u202e",
]
STUDY = """
region:
  min_m: [0, 0, 0]
  max_m: [12, 8, 4]
  cuboid_m: [1, 0.5, 0.25]
  exclude:
    - {min_m: [4, 3, 0], max_m: [8, 5, 2]}
sensors:
  - elevation_deg: [-20, -10, 0, 10, 20]
    count: 2
    min: {position_m: [5, 3, 2.2], rpy_deg: [0, 0, 0]}
    max: {position_m: [7, 5, 3.0], rpy_deg: [30, 30, 0]}
solver: {method: abc, bees: 10, cycles: 4, seed: 1}
"""
SECTIONS = [
    "asked",
    "rig",
    "search",
    "worst",
    "robust",
    "blind",
    "detection",
    "coverage",
    "trust",
    "repeat",
]


VOID = {"meta", "br", "path", "use", "image", "rect", "circle", "line", "polygon", "polyline"}


class Page(HTMLParser):
    """What stands in a page; open and closed tags must match, ids be its own, and nothing be fetched."""

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.ids = []
        self.links = []
        self.tags = []
        self.text = []
        self.labels = []
        self.heads = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        if "id" in attributes:
            self.ids.append(attributes["id"])
        self.links += [value for key, value in attributes.items() if key in ("href", "xlink:href", "src")]
        self.links += re.findall(r"url\(([^)]*)\)", " ".join(str(value) for value in attributes.values()))
        if tag == "svg":
            self.labels.append((attributes.get("role"), attributes.get("aria-label")))
        if tag == "th":
            self.heads.append(attributes.get("scope"))
        assert not any(key.startswith("on") for key in attributes)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


def read(text):
    """The page, after what holds for every page."""
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    for link in page.links:
        assert link.startswith("data:image/png;base64,") or (link[0] == "#" and link[1:] in page.ids), link[:80]
    assert "http:" not in text
    assert "https:" not in text
    assert not {"script", "iframe", "object", "img", "link"} & set(page.tags)
    assert all(role == "img" and label for role, label in page.labels)
    assert set(page.heads) == {"col", "row"}
    assert len(text.encode()) < 2_000_000
    return page


def make(folder, study, **changes):
    path = folder / "s.yaml"
    path.write_text(study)
    return load_study(path)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    objects = "".join(
        f"  - {{name: {json.dumps(name)}, size_m: [1, 1, 1], on_ground: {str(bool(i % 2)).lower()}}}\n"
        for i, name in enumerate(NAMES)
    )
    drawn = "  - {name: drawn, size_m: [1, 0.6, 1], samples: 256}\n"
    return make(tmp_path_factory.mktemp("study"), STUDY + "detection:\n" + objects + drawn)


@pytest.fixture(scope="module")
def found(study):
    return optimize(study, threads=1)


@pytest.fixture(scope="module")
def runs(study, found, tmp_path_factory):
    """Two folders into which the same search was written."""
    folders = [tmp_path_factory.mktemp("run") for _ in range(2)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", "1767225600")
        for folder in folders:
            commands = Commands("lidarcfg <typed>", "lidarcfg again")
            shown = report_inputs(study, found.rig, found.evaluation, found.midpoint_max_vsr_m)
            save_placement(study, found, shown, folder, commands)
    return folders


def test_the_page_says_what_result_json_says(runs):
    page = read((runs[0] / "report.html").read_text())
    result = json.loads((runs[0] / "result.json").read_text())
    assert [link for link in page.links if link[1:] in SECTIONS] == [f"#{key}" for key in SECTIONS]
    bar = result["extrapolated"]
    said = [
        f"{result['max_vsr_m']:.6f} m",
        f"{result['midpoint_max_vsr_m']:.6f} m",
        f"{bar['max_vsr_m']:.6f} ± {bar['error_m']:.6f} m",
        f"the largest of {result['subspaces']:,} subspaces",
        f"{result['skipped']['full_evaluations']:,} of",
        "2026-01-01 00:00 UTC",
        "lidarcfg <typed>",
        "lidarcfg again",
        f"numpy {np.__version__}",
        "open3d",
    ]
    said += [f"{rate:.4f}" for rate in result["detection"].values()]
    said += [f"{worst['vsr_m']:.4f} {worst['volume_m3']:.2f}" for worst in result["worst"]]
    for words in said:
        assert words in page.words, words


def test_any_name_stands_as_it_is(runs):
    text = (runs[0] / "report.html").read_text()
    page = read(text)
    assert all(f"object: {truncate(name)}" in page.words for name in NAMES[:3])
    assert "control\\x01\\x1b[31m\\u202e" in page.words
    assert "<script" not in text
    assert not [c for c in text if not c.isprintable() and c != "\n"]


def test_the_same_run_gives_the_same_page(runs):
    assert (runs[0] / "report.html").read_bytes() == (runs[1] / "report.html").read_bytes()


VEHICLE = """
objective: {max_vsr: 1}
vehicle:
  boxes: [{name: cab, center_m: [6, 4, 0.75], size_m: [4, 2, 1.5], exclude: true}]
"""


def test_what_no_sensor_sees_is_said_and_drawn(tmp_path):
    """As result.json has them; the same in a comparison, which marks the rig that sees more."""
    study = make(tmp_path, STUDY.replace("sensors:", VEHICLE + "sensors:"))
    rigs = [study.rig(study.space.poses(np.full((1, study.space.dimensions), at))[0]) for at in (0.5, 0.0)]
    shown = [report_inputs(study, rig, evaluate(study, rig), cheap_cuboids=100) for rig in rigs]
    save_evaluation(study, rigs[0], shown[0], tmp_path / "o")
    page = read((tmp_path / "o/report.html").read_text())
    result = json.loads((tmp_path / "o/result.json").read_text())
    assert "the vehicle (cab)" in page.words
    total = sum(result["seen_by_m3"])
    assert result["shadow_volume_m3"] == result["seen_by_m3"][0] > 0
    for n, volume in enumerate(result["seen_by_m3"]):
        assert f"{n} {volume:,.2f} {volume / total:.2%}" in page.words
    assert "a map of how much is hidden above each position" in [label for _, label in page.labels]
    compared = contenders([(f"{n}", rig, one) for n, (rig, one) in enumerate(zip(rigs, shown, strict=True))])
    save_comparison(study, compared, tmp_path / "c", Commands("typed", "again"))
    page = read((tmp_path / "c/compare.html").read_text())
    values = json.loads((tmp_path / "c/compare.json").read_text())
    blind = [one["shadow_volume_m3"] for one in values["rigs"]]
    assert blind[0] != blind[1]
    assert values["best"]["shadow (m³)"] == ["AB"[blind.index(min(blind))]]
    assert f"shadow (m³) {blind[0]:.2f} {blind[1]:.2f}" in page.words


def test_an_evaluation_without_objects(tmp_path):
    bare = make(tmp_path, STUDY)
    rig = load_rig(ROOT / "data/rigs/roof.yaml")
    shown = report_inputs(bare, rig, evaluate(bare, rig))
    save_evaluation(bare, rig, shown, tmp_path / "o")
    page = read((tmp_path / "o/report.html").read_text())
    bar = shown.evaluation.extrapolated
    assert "names no objects" in page.words
    assert "No search was run" in page.words
    assert "written from Python" in page.words
    assert bar.cuboid_m == [0.25, 0.125, 0.0625]
    assert f"{bar.max_vsr_m:.6f} ± {bar.error_m:.6f} m" in page.words


def test_no_error_bar_where_it_would_cost_too_much(tmp_path, blank_pictures):
    bare = make(tmp_path, STUDY)
    rig = load_rig(ROOT / "data/rigs/roof.yaml")
    shown = report_inputs(bare, rig, evaluate(bare, rig), cheap_cuboids=100)
    save_evaluation(bare, rig, shown, tmp_path / "o")
    page = read((tmp_path / "o/report.html").read_text())
    assert shown.evaluation.extrapolated is None
    assert "was not extrapolated" in page.words
    assert "midpoint of the study's bounds" not in page.words


@pytest.mark.parametrize("text", ["noon", "1e9", "9" * 30])
def test_a_date_that_is_none(text, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", text)
    with pytest.raises(ConfigError, match=f"SOURCE_DATE_EPOCH: '{text}' is not a number of seconds"):
        date()


def test_rigs_that_break_the_constraints_do_not_flatten_the_rest(study, found):
    """They cost a million; a search that found one in the first swarm is drawn up to four times its best."""
    first = replace(found.history[0], mean=1e6)
    axes = draw_convergence(study, replace(found, history=(first, *found.history[1:]))).axes[0]
    assert axes.get_ylim() == (0, 4 * found.history[-1].best)
    most = max(found.midpoint_max_vsr_m, *(cycle.mean for cycle in found.history))
    assert draw_convergence(study, found).axes[0].get_ylim() == (0, pytest.approx(1.05 * most))


def test_the_command_line_writes_it(tmp_path, monkeypatch, blank_pictures):
    (tmp_path / "s.yaml").write_text(STUDY)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")

    def run(*words):
        done = lidarcfg(*words, cwd=tmp_path)
        assert done.stderr == ""
        return done.stdout

    assert run("optimize", "s.yaml", "-o", "a b", "--seconds", "0.2", "--quiet") == ""
    words = read((tmp_path / "a b/report.html").read_text()).words
    assert "lidarcfg optimize s.yaml -o 'a b' --seconds 0.2 --quiet" in words
    again = re.search(r"(lidarcfg optimize s.yaml -o 'a b' --solver abc --seed 1 --evaluations \d+)", words)
    rig = (tmp_path / "a b/rig.yaml").read_bytes()
    run(*again[1].replace("'a b'", "c").split()[1:], "--quiet")
    assert (tmp_path / "c/rig.yaml").read_bytes() == rig
    found = json.loads(run("evaluate", "s.yaml", "c/rig.yaml", "-o", "d", "--json"))
    written = json.loads((tmp_path / "d/result.json").read_text())
    assert found == written
    assert "lidarcfg evaluate s.yaml c/rig.yaml -o d --json" in read((tmp_path / "d/report.html").read_text()).words


@pytest.mark.skipif(bool(LACKING), reason=LACKING)
def test_in_a_browser(runs):
    """It fetches nothing, complains of nothing, scrolls down only, and its letters lie inside its drawings."""
    with browser(900, 700) as driver:
        driver.get((runs[0] / "report.html").as_uri())
        assert asked_for(driver) == [(runs[0] / "report.html").as_uri()]
        assert complaints(driver) == []
        assert driver.execute_script("return document.body.scrollWidth <= window.innerWidth")
        outside = """
            return [...document.querySelectorAll("figure svg")].flatMap(svg => {
                const box = svg.getBoundingClientRect();
                return [...svg.querySelectorAll("text")].map(text => [text.textContent, text.getBoundingClientRect()])
                    .filter(([_, t]) => t.left < box.left - 2 || t.right > box.right + 2
                                     || t.top < box.top - 2 || t.bottom > box.bottom + 2)
                    .map(([words]) => words);
            })"""
        assert driver.execute_script(outside) == []
        drawn = driver.execute_script("return document.querySelectorAll('figure svg').length")
        assert drawn == 7


def test_no_angle_is_minus_nothing(tmp_path, capsys):
    """The mirror image of an angle of 0 is -0, and a hair below 0 is 0 in two digits."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "name: r\nsensors: [{name: a, model: vlp-16, position_m: [-1e-6, 1, 2], rpy_deg: [-1, -0.001, -0.0]}]\n"
    )
    assert mounts_table(load_rig(rig)).texts[0][4:9] == ["0.000", "1.000", "2.000", "-1.00", "0.00"]
    study = make(tmp_path, STUDY)
    print_evaluation(study, load_rig(rig), evaluate(study, load_rig(rig)))
    assert " -0.00" not in capsys.readouterr().out


def test_mount_surfaces_are_said_and_drawn(tmp_path):
    """Which coordinate follows from the body, and a panel for each side that sensors are on."""
    mounts = """
  - name: top
    elevation_deg: [-10, 0, 10]
    on: {body: cab, from: above, within: {min_m: [4.5, 3.2, 1], max_m: [7.5, 4.8, 2]}, base_radius_m: 0.05}
  - name: side
    elevation_deg: [-10, 0, 10]
    count: 2
    mirror_y_m: 4
    on: {body: cab, from: left, within: {min_m: [5, 4, 0.2], max_m: [7, 6, 1.2]}, base_radius_m: 0.05, upright: false}
    yaw_deg: [0, 20]
"""
    text = STUDY.replace("sensors:", VEHICLE + "sensors:" + mounts)
    study = make(tmp_path, text)
    rig = study.rig(study.space.midpoint)
    save_evaluation(study, rig, report_inputs(study, rig, evaluate(study, rig), cheap_cuboids=100), tmp_path / "o")
    page = read((tmp_path / "o/report.html").read_text())
    assert "where sensors may sit on the vehicle, from above, left, right" in [label for _, label in page.labels]
    assert "Green: the middle of a base may be here, to half its radius." in page.words
    rows = {row[0]: row[2:] for row in bounds_table(study).texts}
    assert rows["top"] == ["4.5 … 7.5", "3.2 … 4.8", "on cab, from above", "0", "0", "0"]
    assert rows["side_0"] == ["5 … 7", "on cab, from left", "0.2 … 1.2", "normal", "normal", "0 … 20"]
    assert rows["side_1"][0] == "image in y = 4 m"
    assert "bases wholly on their surfaces" in describe_constraints(study)


def test_of_very_many_objects_those_are_drawn_that_are_detected_least(tmp_path, blank_pictures):
    """Twenty boxes, larger ones later: what is smaller is detected less. The table has all of them."""
    objects = [
        f"  - {{name: box{n:02}, size_m: [0.5, 0.5, {0.2 * n + 0.2:.1f}], on_ground: true}}\n" for n in range(20)
    ]
    study = make(tmp_path, STUDY + "detection:\n" + "".join(objects[::-1]))
    rig = study.rig(study.space.lower)
    found = evaluate(study, rig)
    rates = [found.detection[f"box{n:02}"].rate for n in range(20)]
    assert rates == sorted(rates)
    shown = least_detected([found])
    assert len(shown) == 12
    assert max(found.detection[name].rate for name in shown) <= rates[12]
    save_evaluation(study, rig, report_inputs(study, rig, found), tmp_path)
    text = (tmp_path / "report.html").read_text()
    assert "Only the 12 objects that are detected least are drawn" in text
    assert all(f"box{n:02}" in text for n in range(20))
