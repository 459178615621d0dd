"""Detection rates against plain loops, a sum by hand, and sampling at random as the paper does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.errors import ConfigError
from lidarcfg.placement.detection import DetectionObject, count_places, detection_rate
from lidarcfg.placement.region import Region
from lidarcfg.placement.subspace import lidar, segment
from tests import naive

REGION = Region.from_boxes((0, 0, 0), (6, 4, 2), (0.5, 0.5, 0.25), (((2, 1, 0), (3, 2, 1)),))
SPACES = segment(
    REGION,
    [
        lidar((2.6, 1.3, 1.1), (0.1, 0.2, 0.0), np.sin(np.radians([-20, -7, 3, 15]))),
        lidar((3.4, 2.2, 0.9), (-0.2, 0.4, 0.0), np.sin(np.radians([-20, -7, 3, 15]))),
    ],
)


def item(size, threshold=1, on_ground=False):
    return DetectionObject(name="o", size_m=size, threshold=threshold, on_ground=on_ground)


@settings(max_examples=50, deadline=None)
@given(st.tuples(st.floats(0.1, 3), st.floats(0.1, 2), st.floats(0.1, 2)), st.integers(0, 6), st.booleans())
def test_the_kernel_equals_its_twin(size, threshold, on_ground):
    whole = [int(np.ceil(s / e - 1e-9)) for s, e in zip(size, (0.5, 0.5, 0.25), strict=True)]
    expected = naive.detection(SPACES.label.tolist(), whole, threshold, on_ground)
    assert count_places(SPACES, item(size, threshold, on_ground)) == expected


def test_by_hand():
    """A plane halfway up 4 layers: of the 3 heights of a 2-layer box, the middle one touches both halves."""
    region = Region.from_boxes((0, 0, 0), (3, 1, 4), (1, 1, 1))
    halves = segment(region, [lidar((1.5, 0.5, 2.0), (0, 0, 0), np.array([0.0]))])
    assert count_places(halves, item((1.0, 1.0, 2.0))) == (3, 9)
    assert detection_rate(halves, item((1.0, 1.0, 2.0), on_ground=True)) == 0.0
    assert detection_rate(halves, item((1.0, 1.0, 2.0), threshold=0)) == 1.0
    assert detection_rate(halves, item((1.0, 1.0, 2.0), threshold=2)) == 0.0


def test_the_papers_sampling_agrees():
    """ODR = T / M over M places at random (paper, section II-C), within four standard errors."""
    rng = np.random.default_rng(3)
    rate = detection_rate(SPACES, item((1.0, 1.0, 0.5), threshold=2))
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
        detection_rate(SPACES, item((1.0, 1.0, 3.0)))
    with pytest.raises(ConfigError, match="o: finds no free place in the region"):
        detection_rate(SPACES, item((6.0, 4.0, 2.0)))
