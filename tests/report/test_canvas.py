"""Numbers in drawings: none over another, each as near to its place as may be."""

import base64
import re
from io import BytesIO
from itertools import combinations
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from lidarcfg.report.canvas import drawing, number_places, spread
from lidarcfg.report.drawings import draw_rig
from lidarcfg.report.mounts import draw_mounts
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study

ROOT = Path(__file__).parents[2]

BOX = {
    "region": {"min_m": [-8, -5, 0], "max_m": [8, 5, 3], "cuboid_m": [2, 2, 1]},
    "sensors": [
        {
            "model": "vlp-16",
            "min": {"position_m": [0, 0, 1.8], "rpy_deg": [0, 0, 0]},
            "max": {"position_m": [1, 0, 2], "rpy_deg": [0, 0, 0]},
        }
    ],
}
LOW = np.zeros(2)
HIGH = np.array([100.0, 60.0])


@pytest.mark.parametrize("seed", range(5))
def test_no_box_lies_over_another_and_none_leaves_the_frame(seed):
    """By plain comparisons of the boxes' edges."""
    draws = np.random.default_rng(seed)
    places = draws.uniform((40, 0), (60, 15), (14, 2))
    sizes = draws.uniform((5, 4), (9, 6), (14, 2))
    places[3] = places[4] = places[5]
    found = spread(places, sizes, LOW, HIGH)
    for (a, da), (b, db) in combinations(zip(found, sizes / 2, strict=True), 2):
        across, up = abs(a - b) - (da + db)
        assert across > -1e-6 or up > -1e-6
    assert (found - sizes / 2 > -1e-6).all()
    assert (found + sizes / 2 < HIGH + 1e-6).all()


def test_what_is_alone_stays_and_what_is_not_moves_as_little_as_it_may():
    """Two at one place: the second by its height, which is less than its width; at the edge by what is outside."""
    places = np.array([[50.0, 30.0], [50.0, 30.0], [20.0, 20.0], [0.0, 60.0]])
    found = spread(places, np.tile([8.0, 4.0], (4, 1)), LOW, HIGH)
    np.testing.assert_allclose(abs(found - places), [[0, 0], [0, 4], [0, 0], [4, 2]], atol=1e-9)


def test_where_nothing_is_free_they_stay():
    places = np.tile([[5.0, 5.0]], (3, 1))
    assert np.array_equal(spread(places, np.full((3, 2), 8.0), np.zeros(2), np.full(2, 10.0)), places)


def test_only_what_is_moved_has_a_line_to_its_place():
    def draw(figure):
        axes = figure.subplots()
        axes.set(xlim=(0, 10), ylim=(0, 10))
        number_places(axes, np.array([[5.0, 5], [5, 5], [2, 2]]), ["1", "2", "3"], ["#111111", "#222222", "#333333"])

    svg = drawing("x", 3.0, "three numbers", draw)
    assert [f"stroke: {code}" in svg for code in ("#111111", "#222222", "#333333")] == [False, True, False]


def test_the_drawing_of_a_rig_has_the_body_and_not_its_cuboids():
    """The outline of what is grey is the mesh's own, seen from the top, the side and the front, whole and not stretched."""
    study = load_study(ROOT / "data/studies/sedan.yaml")
    rig = load_rig(ROOT / "data/rigs/roof.yaml")
    figure = draw_rig(study, rig, evaluate(study, rig))
    vertices = study.vehicle.scene.mesh()[0]
    for axes, (across, up) in zip(figure.axes, ((0, 1), (0, 2), (1, 2)), strict=True):
        (body,) = (one for one in axes.collections if one.get_rasterized())
        drawn = np.concatenate([path.vertices for path in body.get_paths()])
        for axis, column in ((across, 0), (up, 1)):
            assert drawn[:, column].min() == pytest.approx(vertices[:, axis].min())
            assert drawn[:, column].max() == pytest.approx(vertices[:, axis].max())
            low, high = (axes.get_xlim, axes.get_ylim)[column]()
            assert low < vertices[:, axis].min() < vertices[:, axis].max() < high
        assert axes.get_aspect() == 1.0
        assert not axes.images  # no cuboids


def test_the_drawing_of_the_mounts_has_the_body_and_not_its_cuboids():
    """A box as the vehicle: what its three views embed as pictures is grey in its proportions of 4 to 2 to 1.5 m."""
    study = load_study(
        {**BOX, "vehicle": {"boxes": [{"name": "cab", "center_m": [0, 0, 0.75], "size_m": [4, 2, 1.5]}]}}
    )
    svg = str(draw_mounts(study, study.rig(study.space.midpoint)))
    shapes = []
    for text in re.findall(r"base64,([A-Za-z0-9+/=\s]+)", svg):
        alpha = matplotlib.image.imread(BytesIO(base64.b64decode(text)))[..., 3]
        high, wide = np.ptp(np.argwhere(alpha > 0.5), axis=0)
        shapes.append(wide / high)
    assert shapes == pytest.approx([4 / 2, 4 / 1.5, 2 / 1.5], rel=0.05)
