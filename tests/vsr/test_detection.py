"""Detection rates against plain loops, a sum by hand, and sampling at random as the paper does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.core import vsr as core
from lidarcfg.errors import ConfigError
from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.detection import DetectionObject, detection
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from tests.naive import vsr as naive

REGION = Region.from_boxes((0, 0, 0), (6, 4, 2), (0.5, 0.5, 0.25), (((2, 1, 0), (3, 2, 1)),))
SPACES = segment(
    REGION,
    [
        lidar((2.6, 1.3, 1.1), (0.1, 0.2, 0.0), np.sin(np.radians([-20, -7, 3, 15]))),
        lidar((3.4, 2.2, 0.9), (-0.2, 0.4, 0.0), np.sin(np.radians([-20, -7, 3, 15]))),
    ],
)


def item(size, threshold=1, on_ground=False, samples=None):
    return DetectionObject(name="o", size_m=size, threshold=threshold, on_ground=on_ground, samples=samples)


@settings(max_examples=50, deadline=None)
@given(st.tuples(st.floats(0.1, 3), st.floats(0.1, 2), st.floats(0.1, 2)), st.integers(0, 6), st.booleans())
def test_the_kernel_equals_its_twin(size, threshold, on_ground):
    whole = [int(np.ceil(s / e - 1e-9)) for s, e in zip(size, (0.5, 0.5, 0.25), strict=True)]
    expected = naive.detection(SPACES.label.tolist(), whole, threshold, on_ground)
    found = detection(SPACES, item(size, threshold, on_ground)) if expected[1] else None
    assert expected[1] == 0 or (round(found.rate * found.places), found.places, found.half_width) == (*expected, 0.0)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 140)),
    st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 70)),
    st.integers(0, 3),
)
def test_high_columns(seed, shape, size, threshold):
    """More than 64 places above one another; blocks of one label, so that boxes lie in some."""
    if any(n > most for n, most in zip(size, shape, strict=True)):
        return
    blocks = np.random.default_rng(seed).integers(-1, 20, (-(-shape[0] // 2), -(-shape[1] // 2), 3))
    label = np.repeat(blocks.repeat(2, 0).repeat(2, 1), 60, axis=2)[: shape[0], : shape[1], : shape[2]].astype(np.int32)
    held = np.zeros(20, bool)
    detected, places = core.detected_positions(label, size, threshold, shape[2], 2**62, held)
    assert (detected.sum(), places.sum()) == naive.detection(label.tolist(), size, threshold, on_ground=False)
    boxes = np.lib.stride_tricks.sliding_window_view(label, size).reshape(-1, np.prod(size))
    assert set(np.flatnonzero(held)) == {box[0] for box in boxes if box[0] >= 0 and (box == box[0]).all()}


def test_by_hand():
    """A plane halfway up 4 layers: of the 3 heights of a 2-layer box, the middle one touches both halves."""
    region = Region.from_boxes((0, 0, 0), (3, 1, 4), (1, 1, 1))
    halves = segment(region, [lidar((1.5, 0.5, 2.0), (0, 0, 0), np.array([0.0]))])
    found = detection(halves, item((1.0, 1.0, 2.0)))
    assert (found.rate, found.places) == (3 / 9, 9)
    assert detection(halves, item((1.0, 1.0, 2.0), on_ground=True)).rate == 0.0
    assert detection(halves, item((1.0, 1.0, 2.0), threshold=0)).rate == 1.0
    assert detection(halves, item((1.0, 1.0, 2.0), threshold=2)).rate == 0.0


def test_the_papers_sampling_agrees():
    """ODR = T / M over M places at random (paper, section II-C), within four standard errors."""
    rng = np.random.default_rng(3)
    rate = detection(SPACES, item((1.0, 1.0, 0.5), threshold=2)).rate
    hits = []
    while len(hits) < 4000:
        i, j, k = rng.integers((12 - 1, 8 - 1, 8 - 1))
        touched = SPACES.label[i : i + 2, j : j + 2, k : k + 2]
        if touched.min() >= 0:
            hits.append(len(np.unique(touched)) > 2)
    assert 0.1 < rate < 0.9
    assert abs(np.mean(hits) - rate) < 4 * np.sqrt(rate * (1 - rate) / len(hits))


def test_objects_that_do_not_fit():
    with pytest.raises(ConfigError, match=r"o: size_m\[2\]: 3 is more than the region's 2 along z"):
        detection(SPACES, item((1.0, 1.0, 3.0)))
    with pytest.raises(ConfigError, match="o: has no free place in the region"):
        detection(SPACES, item((6.0, 4.0, 2.0)))


def touched_by_hand(box, size):
    """The labels of the cuboids in which a fine grid of the box's own points falls; None where one is left out."""
    x, y, z, heading = box
    along = np.linspace(-0.4999, 0.4999, 25)
    a, b, c = np.meshgrid(along * size[0], along * size[1], np.linspace(1e-6, 1 - 1e-6, 12) * size[2])
    px = x + a * np.cos(heading) - b * np.sin(heading)
    py = y + a * np.sin(heading) + b * np.cos(heading)
    cuboid = (px / 0.5).astype(int), (py / 0.5).astype(int), ((z + c) / 0.25).astype(int)
    labels = set(SPACES.label[cuboid].ravel().tolist())
    return None if -1 in labels else labels


def test_free_places_and_headings_against_plain_monte_carlo():
    size = (1.3, 0.6, 0.5)
    threshold = 3
    rng = np.random.default_rng(2)
    hits = []
    while len(hits) < 600:
        heading = rng.uniform(0, 2 * np.pi)
        c, s = abs(np.cos(heading)), abs(np.sin(heading))
        reach = np.array([size[0] * c + size[1] * s, size[0] * s + size[1] * c]) / 2
        x, y = rng.uniform(reach, np.array([6, 4]) - reach)
        labels = touched_by_hand((x, y, rng.uniform(0, 1.5), heading), size)
        if labels is not None:
            hits.append(len(labels) > threshold)
    plain = np.mean(hits)
    found = detection(SPACES, item(size, threshold, samples=2**14))
    assert 0.1 < plain < 0.9
    assert abs(found.rate - plain) < 4 * np.sqrt(plain * (1 - plain) / len(hits)) + 0.01  # its points miss thin corners
    assert 0 < found.half_width < 0.02


def test_the_confidence_interval_covers_the_truth():
    truth = detection(SPACES, item((0.8, 0.4, 0.4), 2, samples=2**19))
    few = detection(SPACES, item((0.8, 0.4, 0.4), 2, samples=2**10))
    assert truth.half_width < 0.1 * few.half_width
    assert abs(few.rate - truth.rate) < 2 * few.half_width


def test_a_box_at_right_angles_touches_what_it_covers():
    box = np.array([[1.25, 1.0, 0.25, 0.0], [1.25, 1.0, 0.25, np.pi / 2], [2.5, 1.5, 0.0, 0.3]])
    labels = np.arange(12 * 8 * 8, dtype=np.int32).reshape(12, 8, 8)
    for covered, boxes in ((1 * 2 * 2, box[:1]), (3 * 2 * 2, box[1:2])):
        size = (0.5, 1.0, 0.5)  # one cuboid wide and two deep, or turned and straddling
        assert core.detected_boxes(labels, np.zeros(3), np.array([0.5, 0.5, 0.25]), boxes, size, covered - 1) == (
            1,
            1,
        )
        assert core.detected_boxes(labels, np.zeros(3), np.array([0.5, 0.5, 0.25]), boxes, size, covered) == (0, 1)
