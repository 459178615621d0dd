"""Long names: shortened where they are drawn or listed, whole in files."""

import json

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from lidarcfg.report.blind_spots import volumes_table
from lidarcfg.report.drawings import draw_rig
from lidarcfg.report.text import summarize, truncate
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from tests.command_line import lidarcfg

LONG = {kind: (kind * 60)[:190] + "-the-last" for kind in ("left", "right", "thing", "zone", "body", "rig")}


def folder_with(tmp_path):
    (tmp_path / "study.yaml").write_text(
        f"""
region: {{min_m: [-6, -6, 0], max_m: [6, 6, 2], cuboid_m: [1, 1, 0.5]}}
vehicle: {{boxes: [{{name: {LONG["body"]}, center_m: [0, 0, 0.5], size_m: [3, 2, 1]}}]}}
sensors:
  - {{model: vlp-16, count: 2, min: {{position_m: [-1, -1, 1.2], rpy_deg: [0, 0, 0]}}, max: {{position_m: [1, 1, 1.5], rpy_deg: [0, 0, 0]}}}}
zones: [{{name: {LONG["zone"]}, min_m: [0, 0, 0], max_m: [3, 3, 2], weight: 2}}]
detection: [{{name: {LONG["thing"]}, size_m: [1, 1, 1]}}]
"""
    )
    mounts = ", ".join(
        f"{{name: {LONG[name]}, model: vlp-16, position_m: [0, {y}, 1.4]}}" for name, y in (("left", 1), ("right", -1))
    )
    (tmp_path / "rig.yaml").write_text(f"name: {LONG['rig']}\nsensors: [{mounts}]\n")
    return tmp_path


def test_a_short_name_stays_and_a_long_one_keeps_its_ends():
    """By hand: 10 characters, of which one is …, three the end, six the start."""
    assert truncate("0123456789", 10) == "0123456789"
    assert truncate("0123456789A", 10) == "012345…89A"
    assert {len(truncate("x" * count, 40)) for count in range(41, 200)} == {40}
    assert truncate(LONG["left"] + "1") != truncate(LONG["left"] + "2")


@pytest.mark.slow
def test_a_drawing_holds_long_names(tmp_path):
    """By matplotlib's own measures; it warns, which is an error here, of axes for which texts leave no room."""
    folder = folder_with(tmp_path)
    study = load_study(folder / "study.yaml")
    rig = load_rig(folder / "rig.yaml")
    figure = draw_rig(study, rig, evaluate(study, rig))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    legend = figure.axes[0].get_legend()
    extents = [text.get_window_extent(canvas.get_renderer()) for text in (*figure.texts, *legend.get_texts())]
    assert len(extents) == 3
    assert all((one.p0 >= 0).all() and (one.p1 <= np.array(figure.bbox.size)).all() for one in extents)


@pytest.mark.slow
def test_tables_are_short_and_files_whole(tmp_path):
    folder = folder_with(tmp_path)
    found = lidarcfg("evaluate", "study.yaml", "rig.yaml", "-o", "out", cwd=folder)
    assert max(map(len, found.stdout.splitlines())) <= 110
    assert found.stdout.count("…") >= 4
    assert not any(name in found.stdout for name in LONG.values())
    values = json.loads((folder / "out/result.json").read_text())
    assert LONG["thing"] in values["detection"]
    assert [one["name"] for one in values["rig"]["sensors"]] == [LONG["left"], LONG["right"]]
    report = (folder / "out/report.html").read_text()
    assert all(truncate(LONG[name]) in report for name in ("thing", "zone", "left"))


def test_of_many_sensors_the_first_are_listed(tmp_path):
    """Twelve on one spot: each sees what the others see, so that all of the volume is in the last column."""
    folder = folder_with(tmp_path)
    mounts = ", ".join(f"{{name: s{i}, model: vlp-16, position_m: [0, 0, 1.4]}}" for i in range(12))
    (folder / "rig.yaml").write_text(f"name: many\nsensors: [{mounts}]\n")
    study = load_study(folder / "study.yaml")
    rig = load_rig(folder / "rig.yaml")
    found = evaluate(study, rig)
    texts = [text.get_text() for text in draw_rig(study, rig, found).axes[0].get_legend().get_texts()]
    assert texts == [*(f"s{i}" for i in range(8)), "and 4 more"]
    assert summarize(texts) == texts
    rows = volumes_table(found.seen_by_m3).texts
    assert [row[0] for row in rows] == ["0", "1", "2", "3", "4 or more"]
    assert rows[0][1] == f"{found.seen_by_m3[0]:.2f}"
    assert rows[4][1] == f"{found.seen_by_m3[12]:.2f}"
