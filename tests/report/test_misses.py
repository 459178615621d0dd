"""What a report, the terminal and a comparison say of misses, and the map; by hand, and from result.json."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.report.misses import SeenBy, colours, draw_misses, misses_lines, misses_table, rigs_seen
from lidarcfg.returns.missed_map import missed_map
from lidarcfg.returns.misses import MissesFound, ObjectMisses
from lidarcfg.study.evaluation import evaluate
from tests.command_line import lidarcfg
from tests.report.test_report import read
from tests.studies import study_of

pytestmark = pytest.mark.slow

STUDY = """
region: {min_m: [-4, -3, 0], max_m: [4, 3, 2], cuboid_m: [1, 1, 0.5]}
sensors:
  - model: vlp-16
    min: {position_m: [-1, -1, 1.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [1, 1, 2], rpy_deg: [0, 0, 0]}
vehicle:
  boxes: [{name: box, center_m: [0, 0, 0.5], size_m: [2, 1, 1]}]
objective: {misses: {objects: {child: 2, tyre: 1}, within_m: [0.1, 4]}}
solver: {method: annealing, evaluations: 40, seed: 2}
"""
LOW = "{name: low, sensors: [{name: a, model: vlp-16, position_m: [0, 0, 1.2]}]}"


def found(*objects):
    """Misses of objects (name, weight, [(x, y, probability), …])."""
    made = []
    for name, weight, places in objects:
        x, y, probability = np.array(places, np.float64).T
        at = np.stack([x, y, np.zeros_like(x), np.zeros_like(x)], axis=1)
        made.append(ObjectMisses(name, weight, at, probability))
    return MissesFound(tuple(made), 3, (0.1, 20.0))


def test_cells_are_means_by_hand():
    """Places of three cells, on the edge of a cell in the upper one; of weights 3 and 1."""
    misses = found(
        ("a", 3.0, [(0.2, 0.2, 1.0), (0.8, 0.9, 0.5), (-0.5, 0.5, 0.0)]),
        ("b", 1.0, [(0.5, 0.5, 0.0), (1.0, 1.5, 1.0), (1.9, 1.1, 0.5)]),
    )
    cells = missed_map(misses)
    assert (cells.low_m.tolist(), cells.high_m.tolist()) == ([-1.0, 0.0], [2.0, 2.0])
    expected = [[0.0, math.nan], [(3 * 1 + 3 * 0.5 + 0) / 7, math.nan], [math.nan, (1 + 0.5) / 2]]
    np.testing.assert_allclose(cells.share, expected, atol=1e-15)


def test_cells_near_a_robot_are_small():
    """Two places 0.5 m apart: within 20 m they share a square metre, within 10 m they do not; by hand."""
    far = found(("a", 1.0, [(0.1, 0.1, 1.0), (0.6, 0.1, 0.0)]))
    assert missed_map(far).share.tolist() == [[0.5]]
    near = missed_map(replace(far, within_m=(0.1, 10.0)))
    assert (near.side_m, near.low_m.tolist()) == (0.25, [0.0, 0.0])
    np.testing.assert_array_equal(near.share, [[1.0], [math.nan], [0.0]])


def test_cells_sum_up_to_the_mean(tmp_path):
    """By plain loops over the places of a real rig: each cell, and from all of them the mean again."""
    study = study_of(tmp_path, STUDY)
    misses = study.misses.found(study.rig(study.space.midpoint).mounts)
    cells = missed_map(misses, 0.5)
    weight, missed = {}, {}
    for one, part in zip(misses.objects, (2 / 3, 1 / 3), strict=True):
        for (x, y, *_), p in zip(one.places.tolist(), one.probability.tolist(), strict=True):
            cell = math.floor(x / 0.5), math.floor(y / 0.5)
            weight[cell] = weight.get(cell, 0.0) + part
            missed[cell] = missed.get(cell, 0.0) + part * p
    first = np.rint(cells.low_m / 0.5).astype(int)
    for (i, j), share in np.ndenumerate(cells.share):
        cell = (int(first[0]) + i, int(first[1]) + j)
        assert (cell in weight) == (not math.isnan(share))
        if cell in weight:
            assert share == pytest.approx(missed[cell] / weight[cell], abs=1e-12)
    assert sum(missed.values()) / sum(weight.values()) == pytest.approx(misses.mean, abs=1e-12)
    assert 0 < misses.mean < 1


def test_colours_at_the_stops_and_between():
    """By the square root of the share: a quarter of the way at 1/16, half of it at 1/4; read off the stops by hand."""
    assert [tuple(one) for one in colours(np.array([0.0, 1 / 16, 1 / 4, 1.0])).tolist()] == [
        (0xE8, 0xEE, 0xF2),
        (0xFD, 0xD4, 0x9E),
        (0xFC, 0x8D, 0x59),
        (0x7F, 0x00, 0x00),
    ]
    half = [(0xE8 + 0xFD) / 2, (0xEE + 0xD4) / 2, (0xF2 + 0x9E) / 2]
    assert np.abs(colours(np.array([1 / 64]))[0] - half).max() <= 0.5


@pytest.mark.parametrize(
    ("own", "other", "said"),
    [  # 100 places; the difference is by pairs, its error that of 100 differences of 0 or 1
        (10, 40, "This rig misses 10.00 %, 75 % fewer than the baseline (40.00 %); the difference is 30.00 ± 9.03 "),
        (40, 10, "This rig misses 40.00 %, 300 % more than the baseline (10.00 %); the difference is 30.00 ± 9.03 "),
        (10, 11, "This rig misses 10.00 %, no better or worse than the baseline (11.00 %) as far as these places tell"),
        (1, 100, "This rig misses 1.00 %, 99.0 % fewer than the baseline (100.00 %)"),
        (0, 40, "This rig misses 0.00 %, 100 % fewer than the baseline (40.00 %)"),
        (40, 0, "This rig misses 40.00 %, more than the baseline (0.00 %)"),
    ],
)
def test_the_sentence_by_hand(tmp_path, own, other, said):
    """30 of 100 differ: the variance of a difference is 0.3 · 0.7 · 100 / 99, and 1.96 · √(that / 100) = 0.0903."""
    study = study_of(tmp_path, STUDY)
    rigs = [
        SeenBy(title, study.rig(pose), found(("a", 1.0, [(n, 0, n < missed) for n in range(100)])))
        for title, pose, missed in (("this rig", study.space.lower, own), ("baseline", study.space.upper, other))
    ]
    (line,) = misses_lines(study, rigs)
    assert line.startswith(said)


def test_the_same_rig_is_said_to_be_the_same(tmp_path):
    study = study_of(tmp_path, STUDY)
    misses = found(("a", 1.0, [(n, 0, n < 10) for n in range(100)]))
    rigs = [SeenBy(title, study.rig(study.space.midpoint), misses) for title in ("this rig", "best plain rig")]
    assert misses_lines(study, rigs) == ["This rig is the best plain rig. It misses 10.00 %."]
    texts = misses_table(rigs).texts
    assert texts[-1][:2] == ["mean", texts[0][1]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a search and its files."""
    path = tmp_path_factory.mktemp("misses")
    (path / "s.yaml").write_text(STUDY)
    (path / "low.yaml").write_text(LOW)
    (path / "out.txt").write_text(
        lidarcfg("optimize", "s.yaml", "-o", "out", "--baseline", "low.yaml", cwd=path).stdout
    )
    return path


def cell(one):
    low, high = one["interval_95"]
    return f"{100 * one['share']:.2f} % ({100 * low:.2f} … {100 * high:.2f})"


def test_the_report_begins_with_what_is_missed(folder):
    """Each number of the table and the first tile are those of result.json."""
    result = json.loads((folder / "out/result.json").read_text())
    page = read((folder / "out/report.html").read_text())
    told = result["believed"]
    columns = [
        result["misses"],
        told["best_plain"]["misses"],
        result["baseline"]["misses"],
        told["midpoint"]["misses"],
    ]
    head = "misses this rig best plain rig baseline middle of the bounds"
    rows = [f"{name} × {w} " for name, w in (("child", 2), ("tyre", 1))]
    for number, row in enumerate(rows):
        assert row + " ".join(cell(one["objects"][number]) for one in columns) in page.words
    mean = "weighted mean " + " ".join(cell(one) for one in columns)
    assert page.words.index(head) < page.words.index(mean) < page.words.index("The task study")
    assert page.words.index("Misses") < page.words.index("Max VSR")
    assert (
        f"Misses {100 * result['misses']['share']:.2f} % places where an object gets fewer than 3 returns" in page.words
    )
    assert any(label.startswith("what is missed where, from above: this rig") for _, label in page.labels)
    believed = f"{100 * told['objective']:.2f} % of i"
    assert f"The search believed {believed}" in page.words
    assert f"from the {told['places_per_object']:,} places of each object" in page.words


def test_the_terminal_says_the_same(folder):
    out = (folder / "out.txt").read_text()
    result = json.loads((folder / "out/result.json").read_text())
    told = result["believed"]
    shown = [line.split("  ") for line in out.splitlines() if line.strip().startswith("weighted mean")]
    cells = [part.strip() for part in shown[0] if part.strip()][1:]
    assert cells == [cell(one) for one in (result["misses"], told["best_plain"]["misses"], told["midpoint"]["misses"])]
    assert out.index("weighted mean") < out.index("max VSR")
    compared = next(line for line in out.splitlines() if line.strip().startswith("misses of tyre"))
    for one in (result, result["baseline"]):
        assert f"{100 * one['misses']['objects'][1]['share']:.2f} %" in compared


def test_an_evaluation_beside_the_midpoint(folder):
    """What stands beside a rig without search or baseline is the midpoint; counted here once more."""
    study = study_of(folder, STUDY)
    rig = study.rig(study.space.lower)
    rigs = rigs_seen(study, rig, evaluate(study, rig))
    assert [one.title for one in rigs] == ["this rig", "middle of the bounds"]
    assert rigs[1].misses.mean == study.misses.found(study.rig((study.space.lower + study.space.upper) / 2).mounts).mean
    svg = draw_misses(study.body, rigs)
    for one in rigs:
        assert f"{one.title}: misses {100 * one.misses.mean:.2f} %" in svg


def test_a_sweep_has_a_column(folder):
    (folder / "p.yaml").write_text("study: s.yaml\nvary: {solver.seed: [1]}\n")
    lidarcfg("sweep", "p.yaml", "-o", "sweep", cwd=folder)
    with (folder / "sweep/table.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert float(row["misses"]) == pytest.approx(float(row["cost"]), rel=1e-12)  # which is misses at fresh places


def test_nothing_without_a_vehicle(folder):
    """Neither rows nor a section, and max VSR is what is minimised."""
    lines = [line for line in STUDY.splitlines() if not line.startswith(("vehicle", "  boxes", "objective"))]
    study = study_of(folder, "\n".join(lines))
    rig = study.rig(study.space.midpoint)
    assert rigs_seen(study, rig, evaluate(study, rig)) == ()
    assert study.is_max_vsr
