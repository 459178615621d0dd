"""The report: read back by the standard library's parser; maps and rings against plain loops; names of any kind."""

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from lidarcfg import report
from lidarcfg.errors import ConfigError
from lidarcfg.placement.cones import lidar
from lidarcfg.placement.coverage import beams_across, coverage
from lidarcfg.placement.detection import DetectionObject, detection, detection_by_distance
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import evaluate, load_study
from lidarcfg.placement.subspace import segment
from lidarcfg.report.document import date, ring_edges_m, vehicle_m
from lidarcfg.rig import load_rig
from tests.chromium import LACKING, asked_for, browser, complaints
from tests.naive import placement as naive

ROOT = Path(__file__).parents[2]
ELEVATION_DEG = [-20, -7, 3, 15]
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
SECTIONS = ["asked", "rig", "search", "worst", "sizes", "detection", "coverage", "trust", "skipped", "repeat"]


VOID = {"meta", "br", "path", "use", "image", "rect", "circle", "line", "polygon", "polyline"}


class Page(HTMLParser):
    """What stands in a page; open and closed tags must match, ids be its own, and nothing be fetched."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.tags, self.text = [], [], [], [], []
        self.captions, self.labels, self.heads = 0, [], []
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
            report.save_placement(study, found, folder, report.Commands("lidarcfg <typed>", "lidarcfg again"))
    return folders


def test_the_page_says_what_result_json_says(runs):
    page, result = read((runs[0] / "report.html").read_text()), json.loads((runs[0] / "result.json").read_text())
    assert [link for link in page.links if link[1:] in SECTIONS] == [f"#{key}" for key in SECTIONS]
    bar = result["analytic"]
    said = [
        f"{result['max_vsr_m']:.6f} m",
        f"{result['middle_max_vsr_m']:.6f} m",
        f"{bar['max_vsr_m']:.6f} ± {bar['error_m']:.6f} m",
        f"the largest of {result['subspaces']:,} subspaces",
        f"{result['skipped']['full_evaluations']:,} of",
        f"{result['skipped']['cuboids']:,} of",
        "2026-01-01 00:00 UTC",
        "lidarcfg <typed>",
        "lidarcfg again",
        f"numpy {np.__version__}",
        "numba ",
        "open3d",
    ]
    said += [f"{rate:.2%}" for rate in result["detection"].values()]
    said += [f"{worst['vsr_m']:.4f} {worst['volume_m3']:.2f}" for worst in result["worst"]]
    for words in said:
        assert words in page.words, words


def test_any_name_stands_as_it_is(runs):
    text = (runs[0] / "report.html").read_text()
    page = read(text)
    assert all(f"object: {name}" in page.words for name in NAMES[:3])
    assert "control\\x01\\x1b[31m\\u202e" in page.words
    assert "<script" not in text
    assert not [c for c in text if not c.isprintable() and c != "\n"]


def test_the_same_run_gives_the_same_page(runs):
    assert (runs[0] / "report.html").read_bytes() == (runs[1] / "report.html").read_bytes()


def test_an_evaluation_without_objects(tmp_path):
    bare = make(tmp_path, STUDY)
    rig = load_rig(ROOT / "data/rigs/roof.yaml")
    saved = report.save_evaluation(bare, rig, evaluate(bare, rig), tmp_path / "o")
    page = read((tmp_path / "o/report.html").read_text())
    assert "names no objects" in page.words
    assert "No search was run" in page.words
    assert "Nothing: the rig was evaluated once, in full." in page.words
    assert "written from Python" in page.words
    assert saved.analytic.cuboid_m == [0.5, 0.25, 0.125]
    assert f"{saved.analytic.max_vsr_m:.4f} ± {saved.analytic.error_m:.4f} m" in page.words


def test_no_error_bar_where_it_would_cost_too_much(tmp_path, monkeypatch):
    bare = make(tmp_path, STUDY)
    rig = load_rig(ROOT / "data/rigs/roof.yaml")
    for module in (report.results, report.document):
        monkeypatch.setattr(module, "CHEAP_CUBOIDS", 100)
    saved = report.save_evaluation(bare, rig, evaluate(bare, rig), tmp_path / "o")
    page = read((tmp_path / "o/report.html").read_text())
    assert saved.analytic is None
    assert "not computed" in page.words
    assert "its error bar were not computed" in page.words


@pytest.mark.parametrize("text", ["noon", "1e9", "9" * 30])
def test_a_date_that_is_none(text, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", text)
    with pytest.raises(ConfigError, match=f"SOURCE_DATE_EPOCH: '{text}' is not a number of seconds"):
        date()


def test_rigs_that_break_the_constraints_do_not_flatten_the_rest(study, found):
    """They cost a million; a search that found one in the first swarm is drawn up to four times its best."""
    first = replace(found.history[0], mean=1e6)
    axes = report.draw_convergence(study, replace(found, history=(first, *found.history[1:]))).axes[0]
    assert axes.get_ylim() == (0, 4 * found.history[-1].best)
    most = max(found.middle_max_vsr_m, *(cycle.mean for cycle in found.history))
    assert report.draw_convergence(study, found).axes[0].get_ylim() == (0, pytest.approx(1.05 * most))


REGION = Region.from_boxes((0, 0, 0), (6, 4, 2), (0.5, 0.5, 0.25), (((2, 1, 0), (3, 2, 2)), ((4, 0, 0), (5, 1, 1))))
POSES = [((2.6, 1.3, 1.1), (0.1, 0.2, 0.0)), ((3.4, 2.2, 0.9), (-0.2, 0.4, 0.0))]
SPACES = segment(REGION, [lidar(at, rpy, np.sin(np.radians(ELEVATION_DEG))) for at, rpy in POSES])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_beams_across_lines_against_plain_loops(axis):
    found = beams_across(SPACES, axis)
    others = [a for a in range(3) if a != axis]
    centres = REGION.centres()
    empty = 0
    for a in range(REGION.shape[others[0]]):
        for b in range(REGION.shape[others[1]]):
            digits = []
            for n in range(REGION.shape[axis]):
                index = [0, 0, 0]
                index[others[0]], index[others[1]], index[axis] = a, b, n
                if REGION.included[tuple(index)]:
                    point = [float(centres[k][index[k]]) for k in range(3)]
                    digits.append([naive.digit(point, at, rpy, ELEVATION_DEG) for at, rpy in POSES])
            empty += not digits
            for m in range(len(POSES)):
                crossed = 0
                for beam in range(1, len(ELEVATION_DEG) + 1):  # a digit of `beam` or more: this cone is below
                    sides = {digit[m] >= beam for digit in digits}
                    crossed += len(sides) == 2
                assert found[m, a, b] == (crossed if digits else -1)
    assert empty == (4 if axis == 2 else 0)


def test_coverage_by_hand():
    """One level beam through the middle of a box: every upright pole is crossed, one beside a wall of it is not."""
    region = Region.from_boxes((0, 0, 0), (4, 1, 2), (1, 1, 0.5), (((0, 0, 1), (1, 1, 2)),))
    spaces = segment(region, [lidar((2, 0.5, 1.0), (0, 0, 0), np.array([0.0]))])
    found = coverage(spaces)
    assert beams_across(spaces, 2).tolist() == [[[0], [1], [1], [1]]]
    assert (found.median_beams, found.by_none, found.by_one_sensor) == (1.0, 0.25, 0.75)


@pytest.mark.parametrize(("size", "threshold", "on_ground"), [((1.2, 0.5, 0.4), 2, True), ((0.5, 1.0, 0.6), 3, False)])
def test_rings_against_plain_loops(size, threshold, on_ground):
    item = DetectionObject(name="o", size_m=size, threshold=threshold, on_ground=on_ground)
    middle, edges = np.array([2.9, 1.7]), np.array([0.0, 1.0, 1.5, 3.0, 9.0])
    cells = [math.ceil(s / e - 1e-9) for s, e in zip(size, (0.5, 0.5, 0.25), strict=True)]
    detected, places = [0] * 4, [0] * 4
    nx, ny, nz = REGION.shape
    for i in range(nx - cells[0] + 1):
        for j in range(ny - cells[1] + 1):
            x, y = (i + cells[0] / 2) * 0.5, (j + cells[1] / 2) * 0.5
            away = math.dist((x, y), middle)
            ring = max(n for n in range(4) if edges[n] <= away)
            for k in range(1 if on_ground else nz - cells[2] + 1):
                touched = {
                    int(SPACES.label[a, b, c])
                    for a in range(i, i + cells[0])
                    for b in range(j, j + cells[1])
                    for c in range(k, k + cells[2])
                }
                if -1 not in touched:
                    places[ring] += 1
                    detected[ring] += len(touched) > threshold
    found = detection_by_distance(SPACES, item, middle, edges)
    assert (found.detected.tolist(), found.places.tolist()) == (detected, places)
    whole = detection(SPACES, item)
    assert found.places.sum() == whole.places
    assert found.detected.sum() == pytest.approx(whole.rate * whole.places)
    assert 0 < found.detected.sum() < found.places.sum()


def test_rings_of_places_drawn():
    """All rings together are what `detection` counts; a ring that holds no place has no rate; beyond is left out."""
    item = DetectionObject(name="o", size_m=(0.8, 0.4, 0.4), threshold=2, samples=2**12)
    middle = np.array([3.0, 2.0])
    found = detection_by_distance(SPACES, item, middle, np.array([0.0, 1.0, 2.0, 9.0, 10.0]))
    whole = detection(SPACES, item)
    assert found.places.sum() == whole.places
    assert found.detected.sum() / found.places.sum() == pytest.approx(whole.rate, abs=whole.half_width)
    assert np.isnan(found.rate[3])
    inner = detection_by_distance(SPACES, item, middle, np.array([0.0, 1.0, 2.0]))
    assert inner.places.tolist() == found.places[:2].tolist()


@pytest.mark.parametrize("size_m", [0.3, 1.0, 7.7, 36.06, 59.99, 60.0, 60.01, 1e7])
def test_few_rings_hold_the_whole_region(size_m):
    region = Region.from_boxes((-size_m, 0, 0), (size_m / 2, size_m, 1), (size_m / 2, size_m, 1))
    middle = np.array([size_m / 4, size_m / 3])
    edges = ring_edges_m(region, middle)
    assert 2 <= len(edges) - 1 <= 12
    assert edges[0] == 0
    assert edges[-1] > math.hypot(1.25 * size_m, 2 / 3 * size_m) >= edges[-2] - 1e-9
    assert f"{edges[1]:.0e}"[0] in "125"


def test_where_the_vehicle_stands():
    assert vehicle_m(load_study(ROOT / "data/studies/liu2018-2x16.yaml")).tolist() == [29.5, 10.0]
    assert vehicle_m(load_study(ROOT / "data/studies/sedan.yaml")).tolist() == [0.0, 0.0]


def test_the_command_line_writes_it(tmp_path):
    (tmp_path / "s.yaml").write_text(STUDY)
    environment = os.environ | {"SOURCE_DATE_EPOCH": "1767225600"}

    def run(*words):
        call = [sys.executable, "-m", "lidarcfg", *words]
        done = subprocess.run(call, capture_output=True, text=True, cwd=tmp_path, env=environment)
        assert (done.returncode, done.stderr) == (0, "")
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
