"""What a combination of sensors takes over from the rig of another, worked out by hand; and the search from there."""

import numpy as np
import pytest

from lidarcfg.search.combinations import combinations
from lidarcfg.search.transfer import TRANSFERRED_MAX, Example, transferred
from lidarcfg.solvers.cma_es import WarmStart
from lidarcfg.solvers.search import of_objectives
from lidarcfg.study.loading import load_study

STUDY = """region: {min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 0.5, 0.25]}
prices: {vlp-16: 1, fan-4: 2}
sensors:
  - {name: a, choose: [vlp-16, fan-4, none], count: 2, min: {position_m: [5, 3, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [7, 5, 1], rpy_deg: [0, 0, 0]}}
  - {name: b, choose: [fan-4, none], count: 2, mirror_y_m: 4, min: {position_m: [1, 1, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [2, 1, 1], rpy_deg: [0, 0, 0]}}
"""


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    path = tmp_path_factory.mktemp("transfer") / "study.yaml"
    path.write_text(STUDY)
    return {one.name: one for one in combinations(load_study(path))}


@pytest.mark.parametrize(
    ("of", "x", "to", "expected"),
    [  # x, y of each of the group a; x of the first of a pair of b
        ("a-1xvlp-16-1xfan-4", [0.1, 0.2, 0.3, 0.4], "a-1xvlp-16-1xfan-4", [[0.1, 0.2, 0.3, 0.4]]),
        ("a-1xvlp-16-1xfan-4", [0.1, 0.2, 0.3, 0.4], "a-1xfan-4", [[0.3, 0.4]]),
        ("a-1xvlp-16", [0.1, 0.2], "a-1xfan-4", [[0.1, 0.2]]),
        ("a-2xvlp-16", [0.1, 0.2, 0.3, 0.4], "a-2xfan-4", [[0.1, 0.2, 0.3, 0.4], [0.3, 0.4, 0.1, 0.2]]),
        ("a-1xvlp-16_b-2xfan-4", [0.1, 0.2, 0.7], "a-1xvlp-16", [[0.1, 0.2]]),
        ("a-2xvlp-16", [0.1, 0.2, 0.3, 0.4], "a-2xfan-4_b-2xfan-4", []),  # two models and a pair
        ("a-1xvlp-16", [0.1, 0.2], "a-1xfan-4_b-2xfan-4", [[0.1, 0.2]]),  # and a pair that is drawn
    ],
)
def test_poses_that_are_taken_over(of, x, to, expected, named):
    found = transferred(named[to], [Example(named[of], np.array(x), 0.5)], np.random.default_rng(1))
    assert found.shape[1] == named[to].study.space.free.sum()
    assert bool(len(found)) == bool(expected)
    for row in found:
        assert row[: len(x)].tolist() in expected


def test_a_new_sensor_stands_anywhere_and_the_best_come_first(named):
    one, two = named["a-1xvlp-16-1xfan-4"], named["a-1xvlp-16"]
    examples = [Example(two, np.array([v, v]), v) for v in (0.4, 0.1, 0.3)]
    found = transferred(one, examples, np.random.default_rng(1))
    assert found[:, :2].tolist() == [[v, v] for v in (0.1, 0.3, 0.4) for _ in range(4)]
    assert len(np.unique(found[:, 2:])) == 24
    assert found.min() >= 0
    assert found.max() <= 1
    many = transferred(one, examples * 9, np.random.default_rng(1))
    assert len(many) == TRANSFERRED_MAX


def test_the_search_goes_on_from_the_best_start():
    """A narrow bowl far from the middle, found within it."""
    target = np.array([0.93, 0.07, 0.5])
    first = np.array([[0.5, 0.5, 0.5], [0.9, 0.1, 0.45], [0.1, 0.9, 0.1]])
    search = WarmStart(first, 3)
    asked = 0
    while not search.over and asked < 3000:
        x = search.ask().x
        asked += len(x)
        search.tell(of_objectives(((x - target) ** 2).sum(axis=1)))
    assert search.over
    assert search.best_x == pytest.approx(target, abs=1e-4)
    assert asked < 1500
