"""A rig beside a result: in every table, with differences that are recomputed from result.json."""

import json

import pytest

from lidarcfg.report.table import Cell, Column, Table, with_baseline
from tests.command_line import lidarcfg
from tests.report.test_report import read

STUDY = """
region:
  min_m: [0, 0, 0]
  max_m: [12, 8, 4]
  cuboid_m: [1, 0.5, 0.25]
sensors:
  - elevation_deg: [-20, -10, 0, 10, 20]
    count: 2
    min: {position_m: [5, 3, 2.2], rpy_deg: [-5, 0, 0]}
    max: {position_m: [7, 5, 2.6], rpy_deg: [5, 0, 0]}
detection:
  - {name: person, size_m: [0.6, 0.5, 1.7], on_ground: true}
  - {name: ball, size_m: [0.2, 0.2, 0.2], samples: 64}
vehicle:
  boxes: [{name: box, center_m: [6, 4, 0.7], size_m: [2, 1.5, 1.4]}]
objective: {max_vsr: 1}
solver: {method: abc, bees: 10, evaluations: 40, seed: 1}
"""
RIG = """name: by hand
sensors:
  - {name: left, elevation_deg: [-15, 0, 15], position_m: [6, 4.5, 2], rpy_deg: [0, 0, 0]}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "s.yaml").write_text(STUDY)
    (tmp_path / "hand.yaml").write_text(RIG)
    return tmp_path


@pytest.mark.slow
def test_beside_a_search_and_an_evaluation(folder):
    done = lidarcfg("optimize", "s.yaml", "--baseline", "hand.yaml", "-o", "out", cwd=folder)
    result, alone = (
        json.loads(text)
        for text in (
            (folder / "out/result.json").read_text(),
            lidarcfg("evaluate", "s.yaml", "hand.yaml", "--json", cwd=folder).stdout,
        )
    )
    base = result["baseline"]
    assert (base["file"], base["rig"]) == ("hand.yaml", alone["rig"])
    assert {key: base[key] for key in ("max_vsr_m", "worst", "detection", "seen_by_m3", "robustness")} == {
        key: alone[key] for key in ("max_vsr_m", "worst", "detection", "seen_by_m3", "robustness")
    }
    page = read((folder / "out/report.html").read_text())
    ours, theirs = result["worst"][0], base["worst"][0]
    for key in ("vsr_m", "volume_m3", "surface_m2"):
        digits = 4 if key == "vsr_m" else 2
        less = round(ours[key], digits) - round(theirs[key], digits)
        assert f"{less:+z,.{digits}f}" in page.words
    rate = result["detection"]["person"]
    other = base["detection"]["person"]
    assert f"person {rate:.4f} {result['detection_places']['person']:,} places, " in page.words
    assert f"baseline {other:.4f} {base['detection_places']['person']:,} places, " in page.words
    assert f"difference {round(rate, 4) - round(other, 4):+z.4f}" in page.words
    assert "the rig in hand.yaml" in page.words
    assert page.words.count("below each row, the baseline's") == 7  # all but that of a LiDAR lost: it has one
    assert f"{base['max_vsr_m']:.6f} m" in page.words
    assert f"the baseline: {base['max_vsr_m']:.6f} m" in page.words
    assert f"the baseline: {result['midpoint_max_vsr_m']:.6f} m" not in page.words  # it is the study's, of no rig
    assert f"{base['max_vsr_m']:.6f}" in done.stdout
    again = lidarcfg("evaluate", "s.yaml", "out/rig.yaml", "--baseline", "hand.yaml", "--json", cwd=folder)
    values = json.loads(again.stdout)
    assert (values["max_vsr_m"], values["baseline"]["max_vsr_m"]) == (result["max_vsr_m"], base["max_vsr_m"])
    assert values["baseline"]["extrapolated"] is not None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "none.yaml: no such file or directory"),
        (STUDY, "this is a study; a rig belongs here"),
        (RIG.replace("4.5, 2]", "4.5, 1]"), "left"),
        (RIG.replace("position_m", "positions_m"), "positions_m: unknown key"),
    ],
)
def test_a_baseline_that_does_not_fit(folder, text, said):
    """It is refused before the search, in one line."""
    if text:
        (folder / "none.yaml").write_text(text)
    words = ("optimize", "s.yaml", "--baseline", "none.yaml", "-o", "out", "--seconds", "600")
    done = lidarcfg(*words, code=2, cwd=folder)
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (folder / "out/rig.yaml").exists()


def test_differences_are_of_what_is_printed():
    """0.30004 is 0.3000 and 0.24996 is 0.2500; 1199.6 is 1,200; a number that is in no words is none."""
    rate, count, part = Column("rate", ".4f"), Column("count", ",.0f"), Column("part", ".1%")
    assert rate.difference(0.30004, 0.24996) == "+0.0500"
    assert rate.difference(Cell(3.1, "≥ 3.1000 at 20°"), Cell(2.0, "2.0000 at 5°")) == "+1.1000"
    assert count.difference(1199.6, 1300) == "-100"
    assert part.difference(0.1254, 0.0996) == "+2.5%"
    assert rate.difference(0.5, 0.5) == rate.difference(0.49999, 0.5) == "+0.0000"
    assert rate.difference(Cell(0.51, form=".2f"), Cell(0.5, form=".2f")) == "+0.01"
    for pair in ((None, 1.0), (float("inf"), 1.0), ((-15, 15), (-10, 10)), ("exact", 0.1)):
        assert rate.difference(*pair) == ""
    assert Column("what it is").difference(1, 2) == ""


COLUMNS = [Column(""), Column("a", "g"), Column("b")]


def test_sensors_of_one_name_belong_together():
    """Whatever their numbers; of the others the first with the first."""

    def table(*rows):
        return Table("t", COLUMNS[:2], [[Cell(name, f"{n} {name}"), value] for n, name, value in rows])

    own = table((1, "roof", 4), (2, "left", 3), (3, "rear", 2))
    more = table((1, "top", 9), (2, "rear", 8), (3, "front", 7), (4, "side", 6))
    assert with_baseline(own, more).texts == [
        ["1 roof", "4"], ["baseline: 1 top", "9"], ["difference", "-5"],
        ["2 left", "3"], ["baseline: 3 front", "7"], ["difference", "-4"],
        ["3 rear", "2"], ["baseline", "8"], ["difference", "-6"],
        ["baseline: 4 side", "6"],
    ]  # fmt: skip


def test_rows_that_only_one_of_them_has():
    own = Table("t", COLUMNS, [["x", 1, "p"]])
    more = Table("t", COLUMNS, [["y", 3, "q"], ["z", 4, "r"]])
    assert with_baseline(own, more).texts == [
        ["x", "1", "p"], ["baseline: y", "3", "q"], ["difference", "-2", ""], ["baseline: z", "4", "r"],
    ]  # fmt: skip
    assert with_baseline(own, None) is own
