"""The plot of a front: price against objective, with the rigs from above."""

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from lidarcfg.geometry import Array
from lidarcfg.placement.front import Front, Point
from lidarcfg.placement.study import Study
from lidarcfg.report.canvas import EXCLUDED, MARKERS, STYLE, WIDTH_IN, colour, drawing, shade_excluded
from lidarcfg.report.names import DRAWN, truncate
from lidarcfg.report.plots import CUT_OFF, new_figure
from lidarcfg.report.words import price

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PICTURES_MAX = 8  # of rigs, in a row
PICTURE_IN = WIDTH_IN / PICTURES_MAX
PLOT_IN = 3.4
MARGIN = 0.12  # around a rig, as a fraction of its extent
GREY = "0.6"
LEGEND_COLUMNS = 5


def front_svg(study: Study, found: Front) -> Markup:
    """The plot as SVG."""
    alt = f"price against objective of {len(found.candidates)} combinations; {len(found.points)} are on the front"
    return drawing("front", _height_in(study, found), alt, lambda figure: _draw(figure, study, found))


def draw_front(study: Study, found: Front) -> "Figure":
    """The plot as a figure of its own."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = new_figure(WIDTH_IN, _height_in(study, found))
        _draw(figure, study, found)
    return figure


def _height_in(study: Study, found: Front) -> float:
    low, high = _extent(study, found)
    return PLOT_IN + _tall(low, high) * PICTURE_IN + 0.3


def _tall(low: Array, high: Array) -> float:
    """The height of a picture as a fraction of its width."""
    return float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.3, 2.0))


def _draw(figure: "Figure", study: Study, found: Front) -> None:
    from matplotlib.patches import ConnectionPatch

    low, high = _extent(study, found)
    grid = figure.add_gridspec(2, PICTURES_MAX, height_ratios=(_tall(low, high) * PICTURE_IN, PLOT_IN))
    plot = figure.add_subplot(grid[1, :])
    _draw_plot(plot, study, found)
    models = _models(found)
    shown = _shown(found)
    first = (PICTURES_MAX - len(shown)) // 2
    for place, point in enumerate(shown, first):
        axes = figure.add_subplot(grid[0, place])
        _draw_rig(axes, study, point, models)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[], aspect="equal")
        axes.set_title(price(point.combination.price), fontsize=7, loc="center")
        for spine in axes.spines.values():
            spine.set(visible=True, color="0.85")
        at = (point.combination.price, point.placement.objective)
        line = ConnectionPatch((0.5, 0.0), at, "axes fraction", "data", axesA=axes, axesB=plot)
        line.set(color=GREY, lw=0.6, zorder=1)
        line.set_in_layout(False)
        figure.add_artist(line)
    _name_models(plot, models)


def _draw_plot(axes: "Axes", study: Study, found: Front) -> None:
    prices = [point.combination.price for point in found.points]
    best = [point.placement.objective for point in found.points]
    top = CUT_OFF * max(best) or None
    others = [(one.combination.price, one.objective) for one in found.candidates if not one.on_front]
    shown = np.array([pair for pair in others if pair[1] <= (top or np.inf)] or np.empty((0, 2)))
    axes.plot(shown[:, 0], shown[:, 1], "o", color=GREY, ms=4, label="dominated")
    right = max([*prices, *shown[:, 0].tolist()]) * 1.05
    axes.plot([*prices, right], [*best, best[-1]], drawstyle="steps-post", color=colour(0), zorder=2)
    axes.plot(prices, best, "o", color=colour(0), ms=6, label="front", zorder=3)
    value = "max VSR (m)" if study.is_max_vsr else "objective"
    axes.set(xlabel="price", ylabel=value, xlim=(0, right), ylim=(0, None))
    axes.xaxis.set_major_formatter("{x:,.0f}" if right > 10 else "{x:g}")
    axes.grid(True)


def _shown(found: Front) -> list[Point]:
    """The points that have a picture: the first, the last, and some between."""
    count = min(len(found.points), PICTURES_MAX)
    return [found.points[i] for i in np.linspace(0, len(found.points) - 1, count).round().astype(int)]


def _models(found: Front) -> list[str]:
    """The models on the front, the most frequent first."""
    counts = Counter(mount.sensor.name for point in found.points for mount in point.placement.rig.mounts)
    return [name for name, _ in counts.most_common()]


def _name_models(axes: "Axes", models: list[str]) -> None:
    """The legend of the plot, and of the pictures."""
    handles, names = axes.get_legend_handles_labels()
    for i, name in enumerate(models):
        handles += axes.plot([], [], _marker(i), color=colour(i + 1), mec="w", mew=0.4, ms=6)
        names.append(truncate(name, DRAWN))
    axes.legend(handles, names, loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=LEGEND_COLUMNS)  # below


def _marker(model: int) -> str:
    return MARKERS[model % len(MARKERS)]


def _extent(study: Study, found: Front) -> tuple[Array, Array]:
    """The corners of all pictures: the extent of the vehicle and the sensors."""
    at = [mount.position_m[:2] for point in found.points for mount in point.placement.rig.mounts]
    points = np.array([*at, *_outline(study)])
    low = points.min(axis=0)
    high = points.max(axis=0)
    size = max(float((high - low).max()), 0.5)
    more = np.maximum(0.5 * size - (high - low), 0.0) / 2 + MARGIN * size
    return low - more, high + more


def _outline(study: Study) -> Array:
    """(n, 2) the outline of the vehicle from above; nothing without one."""
    if not study.vehicle:
        return np.empty((0, 2))
    angle = np.radians(np.arange(len(study.outline_m)) * 360.0 / len(study.outline_m))
    outline: Array = study.reference_m + study.outline_m[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return outline


def _draw_rig(axes: "Axes", study: Study, point: Point, models: list[str]) -> None:
    outline = _outline(study)
    if len(outline):
        axes.fill(outline[:, 0], outline[:, 1], color=EXCLUDED, alpha=0.35, lw=0)
    elif not study.region.included.all():
        shade_excluded(axes, study.region, "top")
    for mount in point.placement.rig.mounts:
        model = models.index(mount.sensor.name)
        x, y, _ = mount.position_m
        axes.plot([x], [y], _marker(model), color=colour(model + 1), mec="w", mew=0.4, ms=4.5)
