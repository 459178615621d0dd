"""The drawings of a rig's mounts: poses, axes and bounds; and where on the vehicle's surfaces sensors may sit."""

from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.report.canvas import (
    LABELS_IN,
    VIEWS,
    WIDTH_IN,
    colour,
    draw_bodies,
    drawing,
    fractions,
    height_in,
    label,
    lay_out,
    name_axes,
    number_places,
    sensor_dots,
    shade_excluded,
)
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.study import Study
from lidarcfg.study.surfaces import Surface
from lidarcfg.vsr.cones import rig_lidars

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMES_MAX = 12  # in a legend; the table has them all
BESIDE_PT = 11  # from a sensor to its number
FITS = "#2a9d5c"
MARGIN_M = 0.15
HALO_PT = 2.5  # around numbers, which may lie on green
PIXELS = 500  # along the longer edge of the picture of a body
FROM_BEHIND = ("left", "rear")  # sides from which the horizontal axis points to the left
MOUNTS_CAPTION = (
    "The sensors by number. Arrows: their axes, towards the sensor's top. Dashed: the study's bounds. Grey: the "
    "vehicle, or without one what is excluded from the region."
)
Bounds = dict[str, tuple[Array, Array]]  # by sensor: least and greatest position


def draw_mounts(study: Study, rig: Rig) -> Markup:
    """The sensors with their axes from top, side and front; the study's bounds dashed."""
    space = study.space
    bounds: Bounds = {
        slot.name: (low[:3], high[:3])
        for slot, low, high, mirror in zip(study.slots, space.lower, space.upper, space.mirror, strict=True)
        if np.isnan(mirror)
    }
    lidars = rig_lidars(rig)
    at = np.array([lidar.position_m for lidar in lidars])
    drawn = [np.stack(bounds[mount.name]) for mount in rig.mounts if mount.name in bounds]
    span = max(float(np.ptp(np.concatenate([at, *drawn]), axis=0).max()), 1.0)
    tips = at + 0.25 * span * np.array([lidar.axis for lidar in lidars])
    bodies = [study.vehicle.scene.mesh()[0]] if study.vehicle else []
    low, high = _frame(np.concatenate([at, tips, *drawn, *bodies]), span, float(study.region.min_m[2]))
    size = high - low

    def draw(figure: "Figure") -> None:
        widths = fractions(size[0], size[1])
        heights = fractions(size[1], size[2])
        grid = figure.add_gridspec(2, 2, width_ratios=widths, height_ratios=heights)
        views = dict(zip(VIEWS, (grid[0, 0], grid[1, 0], grid[1, 1]), strict=True))
        drawn = {view: figure.add_subplot(place) for view, place in views.items()}
        for view, axes in drawn.items():
            across, up = VIEWS[view]
            if study.vehicle:
                draw_bodies(axes, study.vehicle, view)
            else:
                shade_excluded(axes, study.region, view)
            axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal")
            for i, mount in enumerate(rig.mounts):
                _draw_mount(axes, view, i, bounds.get(mount.name), at[i], tips[i])
            sensor_dots(axes, rig, view, 7)
            axes.grid(True)
            name_axes(axes, view)
        top = drawn["top"]
        names = [f"{i} {label(mount.name)}" for i, mount in enumerate(rig.mounts[:NAMES_MAX], 1)]
        legend = top.legend(top.lines[-len(lidars) :][:NAMES_MAX], names, loc="upper left", bbox_to_anchor=(1.03, 1.0))
        legend.set_in_layout(False)  # the corner beside the front is free
        lay_out(figure)
        for view, axes in drawn.items():
            beside = [_beside(axes, view, *ends) for ends in zip(at, tips, strict=True)]
            ranks = range(len(beside))
            number_places(axes, np.array(beside), [str(i + 1) for i in ranks], [colour(i) for i in ranks])

    scale = (WIDTH_IN - 2 * LABELS_IN) / (size[0] + size[1])
    height = float(np.clip(height_in(scale * size[1], scale * size[2]), 3.0, 7.5))
    return drawing("mounts", height, f"{len(lidars)} sensors from top, side and front, with axes and bounds", draw)


def _frame(points: Array, span: float, floor_m: float) -> tuple[Array, Array]:
    """A box around points (n, 3): down to the floor if that is near, and nowhere a sliver."""
    low = points.min(axis=0) - 0.15 * span
    high = points.max(axis=0) + 0.15 * span
    floor = floor_m - 0.02 * span
    if 0 < low[2] - floor < 2 * span:
        low[2] = floor
    wider = np.maximum(0.6 * (high - low).max() - (high - low), 0.0) / 2
    return low - wider, high + wider


def _draw_mount(axes: "Axes", view: str, i: int, bounds: tuple[Array, Array] | None, at: Array, tip: Array) -> None:
    """Draw the i-th sensor's bounds and its axis from `at` to `tip`."""
    across, up = VIEWS[view]
    if bounds:
        (left, right), (bottom, top) = ((bounds[0][axis], bounds[1][axis]) for axis in (across, up))
        axes.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], "--", color=colour(i), lw=0.8)
    start = at[[across, up]]
    end = tip[[across, up]]
    arrow = {"arrowstyle": "-|>", "color": colour(i), "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=arrow)


def _beside(axes: "Axes", view: str, at: Array, tip: Array) -> Array:
    """(2,) where the number of a sensor at `at` belongs: behind its axis, or below it if that points at the viewer."""
    across, up = VIEWS[view]
    start = at[[across, up]]
    end = tip[[across, up]]
    length = float(np.hypot(*(end - start)))
    away = (start - end) / length if length > 0.08 * float(np.linalg.norm(tip - at)) else np.array([0.0, -1.0])
    beside = axes.transData.transform(start) + BESIDE_PT * axes.figure.dpi / 72 * away
    place: Array = axes.transData.inverted().transform(beside)
    return place


def draw_surfaces(study: Study, rig: Rig) -> Markup:
    """The vehicle from each side that sensors sit on, where their bases fit, and the bases of the rig."""
    alt = f"where sensors may sit on the vehicle, from {', '.join(_sides(study))}"
    height = height_in(*_side_heights_in(study))
    return drawing("surfaces", height, alt, lambda figure: _draw_sides(figure, study, rig))


def _side_heights_in(study: Study) -> list[float]:
    """The heights of the sides' axes."""
    low, high = _vehicle_box(study)
    pairs = [slots[0][1].across for slots in _sides(study).values()]
    scale = (WIDTH_IN - LABELS_IN) / max(high[across] - low[across] for across, _ in pairs)
    return [scale * float(high[up] - low[up]) for _, up in pairs]


def _draw_sides(figure: "Figure", study: Study, rig: Rig) -> None:
    """Draw them below each other."""
    sides = _sides(study)
    low, high = _vehicle_box(study)
    grid = figure.add_gridspec(len(sides), 1, height_ratios=_side_heights_in(study))
    for row, (side, slots) in enumerate(sides.items()):
        axes = figure.add_subplot(grid[row, 0])
        _draw_side(axes, slots, rig, study, low, high)
        axes.set_title(f"from {'' if side == 'above' else 'the '}{side}")


def _sides(study: Study) -> dict[str, list[tuple[int, Surface]]]:
    """The numbers and surfaces of the slots that are on any, by side."""
    sides: dict[str, list[tuple[int, Surface]]] = {}
    for i, slot in enumerate(study.slots):
        if slot.surface:
            sides.setdefault(slot.surface.side, []).append((i, slot.surface))
    return sides


def _vehicle_box(study: Study) -> tuple[Array, Array]:
    """The corners (3,) of a box around the vehicle."""
    ((_, surface), *_), *_ = _sides(study).values()
    bodies = surface.tracer.scene.mesh()[0]
    return bodies.min(axis=0) - MARGIN_M, bodies.max(axis=0) + MARGIN_M


def _draw_side(axes: "Axes", slots: list[tuple[int, Surface]], rig: Rig, study: Study, low: Array, high: Array) -> None:
    """Draw the vehicle between low and high (3,) from the side of some slots, where they fit, and their bases."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patheffects import withStroke

    first = slots[0][1]
    shown = list(first.across)
    extent = (*(edge[shown[0]] for edge in (low, high)), *(edge[shown[1]] for edge in (low, high)))
    axes.imshow(_shading(first, low, high), extent=extent, origin="lower", aspect="equal", cmap="gray", vmin=0, vmax=1)
    names = [mount.name for mount in rig.mounts]
    for surface in dict.fromkeys(surface for _, surface in slots):
        cells = surface.patch.cells_m[..., shown]
        axes.add_collection(PolyCollection(list(cells), facecolor=FITS, edgecolor="none", alpha=0.6, rasterized=True))
        left, bottom = surface.low_m[shown]
        right, top = surface.high_m[shown]
        axes.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], "--", color="0.25", lw=0.7)
    for i, surface in slots:
        if study.slots[i].name not in names:
            continue
        number = names.index(study.slots[i].name)
        mount = rig.mounts[number]
        pose = np.array([[*mount.position_m, *mount.rpy_rad]])
        rim = surface.rims_m(pose)[0][:, shown]
        axes.fill(*rim.T, facecolor=colour(number), edgecolor="w", lw=0.8)
        x, y = surface.bases_m(pose)[0, shown]
        text = axes.annotate(str(number + 1), (x, y), (9, 7), textcoords="offset points")
        text.set(
            color=colour(number),
            weight="bold",
            ha="center",
            va="center",
            path_effects=[withStroke(linewidth=HALO_PT, foreground="w")],
        )
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel=f"{'xyz'[shown[0]]} (m)", ylabel=f"{'xyz'[shown[1]]} (m)")
    if first.side in FROM_BEHIND:
        axes.invert_xaxis()


def _shading(surface: Surface, low: Array, high: Array) -> NDArray[np.float64]:
    """(rows, columns) the shade of the vehicle from a surface's side: bright where it faces it, NaN beside it."""
    a, b = surface.across
    pixel = max(high[a] - low[a], high[b] - low[b]) / PIXELS
    lines = [np.arange(low[axis] + pixel / 2, high[axis], pixel) for axis in (a, b)]
    points = np.zeros((len(lines[1]), len(lines[0]), 3))
    points[..., a] = lines[0][None]
    points[..., b] = lines[1][:, None]
    facing = surface.seen(points.reshape(-1, 3)).normal[:, surface.axis]
    bright: Array = np.where(facing == 0.0, np.nan, 0.45 + 0.5 * abs(facing)).reshape(points.shape[:2])
    return bright
