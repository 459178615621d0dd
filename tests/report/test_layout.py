"""Labels that were never measured, by matplotlib's own measures: none leaves the figure or lies over another."""

from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from lidarcfg.report.canvas import STYLE, WIDTH_IN
from lidarcfg.report.layout import ABOVE, BESIDE, LEFT, color_bar, place_labels, spaces

RANGES = [(0, 1), (-10, 10), (-1000, 1000), (0, 2.5e-3), (-10_000, 10_000), (0.18, 0.19), (0, 4)]


@pytest.fixture(params=[{}, STYLE], ids=["default", "report"])
def style(request):
    with mpl.rc_context(request.param):
        yield


def extents(figure):
    """By axes: the extents of its axis labels, and of all labels of its ticks with its title."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    for axes in figure.axes:
        both = axes.xaxis, axes.yaxis
        yield [axis.label.get_window_extent(renderer) for axis in both if axis.label.get_text()]
        ends = [sorted(axis.get_view_interval()) for axis in both]
        ticks = [
            tick
            for axis, (low, high) in zip(both, ends, strict=True)
            for tick in axis.get_major_ticks()
            if low <= tick.get_loc() <= high
        ]
        texts = [
            *(text for tick in ticks for text in (tick.label1, tick.label2) if text.get_visible()),
            axes.title,
            axes._left_title,
        ]
        yield [text.get_window_extent(renderer) for text in texts if text.get_text()]


@pytest.mark.parametrize("limits", RANGES)
def test_labels_stay_in_the_figure_and_apart(style, limits):
    figure = Figure(figsize=(WIDTH_IN, 4))
    grid = figure.add_gridspec(2, 2, **spaces(figure, (3, 1), (1, 1), right=BESIDE, across=BESIDE + LEFT, above=ABOVE))
    for place in (grid[0, :], grid[1, 0], grid[1, 1]):
        axes = figure.add_subplot(place)
        axes.set(xlim=(0, 10), ylim=limits, xlabel="across (m)", ylabel="up (m)", title="a title")
    image = axes.imshow(np.array([[0, 60]]), aspect="auto", extent=(0, 10, *limits))
    color_bar(figure, image, [axes], "beams")
    place_labels(figure)
    boxes = [list(some) for some in extents(figure)]
    width, height = figure.bbox.size
    for box in (box for some in boxes for box in some):
        assert (box.p0 > -1).all()
        assert (box.p1 < (width + 1, height + 1)).all()
    labels, others = [box for some in boxes[::2] for box in some], [box for some in boxes[1::2] for box in some]
    assert len(labels) == 7
    assert len(others) > 20
    assert not any(one.overlaps(other) for one, other in combinations(labels, 2))
    assert not any(label.overlaps(other) for label in labels for other in others)


def test_spaces_are_as_wide_as_they_say(style):
    """Without long labels: the axes' edges in ems from the figure's, by hand."""
    figure = Figure(figsize=(6, 5))
    grid = figure.add_gridspec(2, 2, **spaces(figure, (1, 3), (2, 1), right=3, above=4, across=7, down=6))
    em = mpl.rcParams["font.size"] / 72
    boxes = [figure.add_subplot(grid[row, column]).get_position() for row in (0, 1) for column in (0, 1)]
    assert np.isclose(
        [6 * boxes[0].x0, 6 * (1 - boxes[1].x1), 5 * (1 - boxes[0].y1)], np.array([LEFT, 3, 4]) * em
    ).all()
    assert np.isclose(6 * (boxes[1].x0 - boxes[0].x1), 7 * em)
    assert np.isclose(5 * (boxes[0].y0 - boxes[2].y1), 6 * em)
    assert np.isclose(boxes[1].width, 3 * boxes[0].width)
    assert np.isclose(boxes[0].height, 2 * boxes[2].height)
