"""What `optimize` writes and prints of a study with sensors to choose, and what else reads such a study."""

import csv
import json
import re

import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.report.describe import price
from lidarcfg.report.front import draw_front, save_front_progress
from lidarcfg.report.search_log import load_log
from lidarcfg.search.front import front
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
from tests.command_line import lidarcfg, without_drawing

pytestmark = pytest.mark.slow

STUDY = """region: {min_m: [0, 0, 0], max_m: [8, 6, 3], cuboid_m: [1, 0.5, 0.5]}
prices: {fan-4: 100, fan-8: 250, fan-16: 900}
sensors:
  - name: roof
    choose: [fan-4, fan-8, none]
    count: 2
    min: {position_m: [3, 2, 1], rpy_deg: [-20, -20, 0]}
    max: {position_m: [5, 4, 2], rpy_deg: [20, 20, 0]}
objective: {max_vsr: 1, detection: {box: 0.5}}
detection: [{name: box, size_m: [1, 1, 1]}]
solver: {evaluations: 1500, seed: 3}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Of a search in the place of one that has left other points."""
    at = tmp_path_factory.mktemp("front")
    (at / "study.yaml").write_text(STUDY.replace("fan-4, fan-8, none", "fan-4, none"))
    for stale in ("points/gone/rig.yaml", "points/gone/study.yaml", "points/kept/notes.txt", "points/kept/rig.png"):
        (at / "out" / stale).parent.mkdir(parents=True, exist_ok=True)
        (at / "out" / stale).write_text("of another search")
    with without_drawing():
        done = lidarcfg("optimize", "study.yaml", "-o", "out", "--threads", "2", cwd=at)
    (at / "printed").write_text(done.stdout)
    (at / "warned").write_text(done.stderr)
    return at


def test_a_folder_for_each_point(folder):
    """Each result.json, and each rig evaluated anew in the whole study, says what front.json says."""
    said = json.loads((folder / "out/front.json").read_text())
    study = load_study(folder / "study.yaml")
    assert len(said["points"]) >= 2
    for point in said["points"]:
        there = folder / "out" / point["folder"]
        result = json.loads((there / "result.json").read_text())
        rig = load_rig(there / "rig.yaml")
        found = evaluate(study, rig)
        assert point["price"] == sum(study.file["prices"][mount.sensor.name] for mount in rig.mounts)
        assert point["objective"] == result["objective"]
        assert point["objective"] == pytest.approx((found.max_vsr_m + 0.5 * (1 - found.detection["box"].rate)) / 1.5)
        assert point["max_vsr_m"] == result["max_vsr_m"] == found.max_vsr_m
        assert point["detection"] == result["detection"]
        alone = load_study(there / "study.yaml")
        assert [slot.sensor for slot in alone.slots] == [mount.sensor for mount in rig.mounts]
        assert (there / "report.html").read_text().count("</svg>") >= 4
    left = {path.relative_to(folder / "out/points").as_posix() for path in (folder / "out/points").glob("*/*")}
    assert "kept/notes.txt" in left
    assert {path.split("/")[0] for path in left} == {"kept", *(point["name"] for point in said["points"])}


def test_the_numbers_of_the_search(folder):
    said = json.loads((folder / "out/front.json").read_text())
    rows = list(csv.DictReader((folder / "out/history.csv").read_text().splitlines()))
    last = {row["combination"]: int(row["own_evaluations"]) for row in rows}
    assert last == {one["name"]: one["evaluations"] for one in said["combinations"]}
    assert int(rows[-1]["evaluations"]) == sum(last.values()) == said["evaluations"] == 1500
    dominated = [one["evaluations"] for one in said["combinations"] if not one["on_front"]]
    assert said["dominated_evaluations"] == sum(dominated)
    assert [one["name"] for one in said["points"]] == [one["name"] for one in said["combinations"] if one["on_front"]]
    assert "lidarcfg: warning: study.yaml:2:34: prices.fan-16: is not used" in (folder / "warned").read_text()


def test_the_page_and_the_table(folder):
    """Both name every point with its price; every link of the page leads somewhere."""
    said = json.loads((folder / "out/front.json").read_text())
    page = (folder / "out/front.html").read_text()
    printed = (folder / "printed").read_text()
    for link in re.findall(r'<a href="([^#"]+)"', page):
        assert (folder / "out" / link).is_file()
    for point in said["points"]:
        assert page.count(f'href="{point["folder"]}/report.html"') == 1
        cost = f"{point['price']:,g}"
        objective = point["objective"]
        assert re.search(rf"^ +{cost} +{objective:.6f} .*{point['sensors']}", printed, re.MULTILINE)
        assert f"{objective:.6f}" in page
    assert page.count("<svg") == 1
    assert (folder / "out/front.png").read_bytes().startswith(b"\x89PNG")


def test_other_commands_take_the_study(folder):
    rig = folder / "out" / json.loads((folder / "out/front.json").read_text())["points"][0]["folder"] / "rig.yaml"
    said = json.loads(lidarcfg("evaluate", "study.yaml", rig, "--json", cwd=folder).stdout)
    both = json.loads(lidarcfg("compare", rig, rig, "--study", "study.yaml", "--json", cwd=folder).stdout)
    assert said["max_vsr_m"] == both["rigs"][0]["max_vsr_m"]
    lidarcfg("evaluate", "study.yaml", rig, "-o", "evaluated", "--quiet", cwd=folder)
    assert "midpoint of the study's bounds" not in (folder / "evaluated/report.html").read_text()


def test_a_log_is_resumed_and_that_of_another_search_refused(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    study = load_study(tmp_path / "study.yaml")
    found = front(with_solver(study, evaluations=1100), threads=2)
    save_front_progress(study, found.log, tmp_path)
    resumed = front(study, threads=2, log=load_log(study, tmp_path))
    whole = front(study, threads=2)
    assert [one.evaluations for one in resumed.candidates] == [one.evaluations for one in whole.candidates]
    rigs = [[point.placement.rig for point in each.points] for each in (resumed, whole)]
    assert rigs[0] == rigs[1]
    with pytest.raises(ConfigError, match=r"search.npz: is of another search; study, solver and seed must be the same"):
        load_log(with_solver(study, seed=4), tmp_path)
    lidarcfg("optimize", "study.yaml", "--resume", "nowhere", code=2, cwd=tmp_path)


def test_the_cheapest_are_tried_first(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    search = front(with_solver(load_study(tmp_path / "study.yaml"), evaluations=300), threads=2)
    figure = draw_front(load_study(tmp_path / "study.yaml"), search)
    figure.draw_without_rendering()
    legend = next(axes.get_legend() for axes in figure.axes if axes.get_legend())
    assert not any(legend.get_window_extent().overlaps(axes.get_window_extent()) for axes in figure.axes)
    assert [one.combination.price for one in search.candidates if one.evaluations] == [100, 200]
    assert len(search.candidates) == 5
    plain = STUDY.replace("objective: {max_vsr: 1, detection: {box: 0.5}}\n", "")
    zones = "zones: [{name: near, min_m: [0, 0, 0], max_m: [4, 6, 3]}]\n"
    lost = "robust: {position_sigma_m: 0.1}\n"
    for text, named in ((plain, "max VSR (m)"), *((t, "objective") for t in (plain + zones, plain + lost, STUDY))):
        (tmp_path / "study.yaml").write_text(text)
        axes = draw_front(load_study(tmp_path / "study.yaml"), search).axes
        assert [one.get_ylabel() for one in axes if one.get_ylabel()] == [named]


@pytest.mark.parametrize(
    ("value", "said"),
    [(1234567.0, "1,234,567"), (0.1 + 0.2, "0.3"), (9999.99, "9,999.99"), (4e12, "4,000,000,000,000")],
)
def test_prices_have_all_their_figures(value, said):
    """A rig's price in yen has seven figures; what dozens of cents add up to has no rounding errors."""
    assert price(value) == said
