"""Names of neighbouring sensors in a picture: by the extents that matplotlib draws."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.figure import Figure

from lidarcfg.viewer.still import name_mounts

SIZE = 1.7
DOT_PX = (3 + 8 * SIZE) * 100 / 72


@pytest.mark.parametrize(
    "places",
    [
        [(900, 300), (904, 300), (930, 330)],
        [(900, 300), (900, 300), (900, 300), (900, 300)],
        [(5, 5), (10, 5), (1900, 5), (1910, 800)],
        [(900 + 30 * i, 300 + 5 * (i % 3)) for i in range(8)],
    ],
)
def test_no_name_covers_another_or_a_dot(places):
    figure = Figure(figsize=(19.2, 10.8), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 1920), ylim=(1080, 0))
    name_mounts(axes, np.array(places, float), [f"roof_{i}_left"[: 6 + 2 * i] for i in range(len(places))], SIZE)
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in axes.texts]
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    for x, y in places:
        for box in boxes:
            assert not (box.x0 < x < box.x1 and box.y0 < 1080 - y < box.y1)
    assert all(box.x0 >= -1 and box.x1 <= 1921 for box in boxes)
