"""The drawing of mount surfaces: where sensors may sit on the vehicle, and where they do."""

from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.study import Study
from lidarcfg.placement.surfaces import Surface
from lidarcfg.report.canvas import LABELS_IN, WIDTH_IN, colour, drawing, height_in
from lidarcfg.sensors.rig import Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FITS = "#2a9d5c"
MARGIN_M = 0.15
HALO_PT = 2.5  # around numbers, which may lie on green
PIXELS = 500  # along the longer edge of the picture of a body
FROM_BEHIND = ("left", "rear")  # sides from which the horizontal axis points to the left


def draw_surfaces(study: Study, rig: Rig) -> Markup:
    """The vehicle from each side that sensors sit on, where their bases fit, and the bases of the rig."""
    alt = f"where sensors may sit on the vehicle, from {', '.join(_sides(study))}"
    height = height_in(*heights_in(study))
    return drawing("surfaces", height, alt, lambda figure: fill_figure(figure, study, rig))


def heights_in(study: Study) -> list[float]:
    """The heights of the sides' axes."""
    low, high = _frame(study)
    pairs = [seats[0][1].across for seats in _sides(study).values()]
    scale = (WIDTH_IN - LABELS_IN) / max(high[across] - low[across] for across, _ in pairs)
    return [scale * float(high[up] - low[up]) for _, up in pairs]


def fill_figure(figure: "Figure", study: Study, rig: Rig) -> None:
    """Draw them below each other."""
    sides = _sides(study)
    low, high = _frame(study)
    grid = figure.add_gridspec(len(sides), 1, height_ratios=heights_in(study))
    for row, (side, seats) in enumerate(sides.items()):
        axes = figure.add_subplot(grid[row, 0])
        _draw_side(axes, seats, rig, study, low, high)
        axes.set_title(f"from {'' if side == 'above' else 'the '}{side}")


def _sides(study: Study) -> dict[str, list[tuple[int, Surface]]]:
    """The numbers and surfaces of the slots that are on any, by side."""
    sides: dict[str, list[tuple[int, Surface]]] = {}
    for i, slot in enumerate(study.slots):
        if slot.surface:
            sides.setdefault(slot.surface.side, []).append((i, slot.surface))
    return sides


def _frame(study: Study) -> tuple[Array, Array]:
    """The corners (3,) of a box around the vehicle."""
    ((_, surface), *_), *_ = _sides(study).values()
    bodies = surface.tracer.scene.mesh()[0]
    return bodies.min(axis=0) - MARGIN_M, bodies.max(axis=0) + MARGIN_M


def _draw_side(axes: "Axes", seats: list[tuple[int, Surface]], rig: Rig, study: Study, low: Array, high: Array) -> None:
    """Draw the vehicle between low and high (3,) from the side of some slots, where they fit, and their bases."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patheffects import withStroke

    first = seats[0][1]
    shown = list(first.across)
    extent = (*(edge[shown[0]] for edge in (low, high)), *(edge[shown[1]] for edge in (low, high)))
    axes.imshow(_shades(first, low, high), extent=extent, origin="lower", aspect="equal", cmap="gray", vmin=0, vmax=1)
    names = [mount.name for mount in rig.mounts]
    for surface in dict.fromkeys(surface for _, surface in seats):
        cells = surface.patch.cells_m[..., shown]
        axes.add_collection(PolyCollection(list(cells), facecolor=FITS, edgecolor="none", alpha=0.6, rasterized=True))
        left, bottom = surface.low_m[shown]
        right, top = surface.high_m[shown]
        axes.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], "--", color="0.25", lw=0.7)
    for i, surface in seats:
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


def _shades(surface: Surface, low: Array, high: Array) -> NDArray[np.float64]:
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
