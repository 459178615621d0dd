"""The canvas of a report's drawings: SVG in one style, views of the region, numbers that do not overlap."""

import io
import re
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.report.plots import COLOURS, new_figure
from lidarcfg.report.text import DRAWN, printable, truncate
from lidarcfg.sensors.rig import Rig
from lidarcfg.vsr.region import Region
from lidarcfg.world.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 7.4
VIEWS = {"top": (0, 1), "side": (0, 2), "front": (1, 2)}  # the axes they show, across and up
MARKERS = "osD^vPX*"
NUMBER_PT = 7  # the size of numbers in a drawing
REACH = 8  # how many half sizes from its place a number may be written
EXCLUDED = (0.55, 0.57, 0.6)
PIXELS_MAX = 700  # a side of a map; larger ones are drawn as means of several cells
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Arial", "sans-serif"],
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.edgecolor": "#57606a",
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#d5d9de",
    "grid.linewidth": 0.6,
    "xtick.color": "#57606a",
    "ytick.color": "#57606a",
    "xtick.labelcolor": "#1b1f24",
    "ytick.labelcolor": "#1b1f24",
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "text.parse_math": False,
    "image.composite_image": False,
    "image.interpolation": "none",
    "svg.fonttype": "none",
    "svg.hashsalt": "lidarcfg",
}
LABELS_IN = 0.65  # beside axes or below them: ticks, their labels, and what they count; also their title
TITLE_IN = 0.3
BAR_IN = 0.9  # a colour bar with its labels


def drawing(name: str, height_in: float, alt: str, draw: Callable[["Figure"], None]) -> Markup:
    """What `draw` draws, as SVG inside HTML; `name` keeps its ids apart from those of other drawings."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s)Glyph .* missing")  # the browser has more fonts
        figure = new_figure(WIDTH_IN, height_in)
        draw(figure)
        file = io.StringIO()
        canvas: Any = FigureCanvasSVG(figure)  # matplotlib has no types here
        canvas.print_svg(file, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    # matplotlib names groups by counters that all drawings share, equal images alike, and ticks only as it draws them
    svg = file.getvalue()
    svg = svg[svg.index("<svg") :]
    box = re.search(r'viewBox="[^"]*"', svg)
    assert box
    svg = re.sub(r"<svg[^>]*>", f'<svg {box[0]} role="img" aria-label="{escape(alt)}">', svg, count=1)
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", svg)
    return Markup(re.sub(r'(url\(|href=")#', rf"\g<1>#{name}-", svg))  # matplotlib escapes the texts


def height_in(*rows: float) -> float:
    """The height of a drawing with rows of axes of these heights."""
    return sum(rows) + LABELS_IN * len(rows)


def panels_in(row: float, rows: int) -> float:
    """The height of a drawing with rows of `panels` of this height."""
    return (row + TITLE_IN) * rows + LABELS_IN - TITLE_IN


def lay_out(figure: "Figure") -> None:
    """Give the axes their final places; what is drawn from then on does not move them."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def label(name: str, most: int = DRAWN) -> str:
    """A name, shortened to fit beside a line."""
    return truncate(printable(name).replace("\n", " "), most)


def colour(i: int) -> str:
    """The colour of the i-th item."""
    return COLOURS[i % len(COLOURS)]


def dashes(i: int) -> str:
    """The dashes of the i-th line, so that lines on top of each other both show."""
    return ("-", "--", "-.", ":")[i % 4]


def hidden(view: str) -> int:
    """The axis along which a view looks."""
    return 3 - sum(VIEWS[view])


def fractions(one: float, other: float) -> tuple[float, float]:
    """The fractions that two extents take of a width; neither is too small."""
    part = min(max(one / (one + other), 0.3), 0.75)
    return part, 1 - part


def name_axes(axes: "Axes", view: str, more: str = "") -> None:
    """Label the axes and name the view."""
    across, up = VIEWS[view]
    axes.set(xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    axes.set_title(view + more)


def extent(region: Region, view: str) -> tuple[float, float, float, float]:
    """Left, right, bottom, top."""
    across, up = VIEWS[view]
    low = region.min_m
    high = region.max_m
    return float(low[across]), float(high[across]), float(low[up]), float(high[up])


def thinned(values: Array) -> Array:
    """A map (a, b) of at most PIXELS_MAX cells a side: means of blocks, NaN where all of a block is."""
    for axis in (0, 1):
        step = -(-values.shape[axis] // PIXELS_MAX)
        if step > 1:
            starts = np.arange(0, values.shape[axis], step)
            known = np.add.reduceat(~np.isnan(values), starts, axis=axis)
            total = np.add.reduceat(np.nan_to_num(values), starts, axis=axis)
            values = np.divide(total, known, out=np.full(total.shape, np.nan), where=known > 0)
    return values


def draw_values(axes: "Axes", region: Region, values: Array, view: str, **look: Any) -> Any:
    """Draw a map of values (a, b), NaN where nothing counts; returns the image, for a colour bar."""
    around = extent(region, view)
    image = axes.imshow(thinned(values).T, extent=around, origin="lower", aspect="auto", **look)
    axes.set(xlim=around[:2], ylim=around[2:], facecolor=(*EXCLUDED, 0.4), autoscale_on=False)
    return image


def shade(axes: "Axes", region: Region, mask: NDArray[np.bool_], view: str, rgb: Any, alpha: float) -> None:
    """Colour the cells of a mask (a, b)."""
    from matplotlib.colors import to_rgb

    part = thinned(mask.astype(float))
    picture = np.zeros((part.shape[1], part.shape[0], 4))
    picture[..., :3] = to_rgb(rgb)
    picture[..., 3] = alpha * part.T
    axes.imshow(picture, extent=extent(region, view), origin="lower", aspect="auto")


def shade_excluded(axes: "Axes", region: Region, view: str) -> None:
    """Shade what is excluded from the region."""
    shade(axes, region, region.excluded_lines[hidden(view)], view, EXCLUDED, 0.4)


def draw_bodies(axes: "Axes", vehicle: Vehicle, view: str) -> None:
    """Draw the vehicle's bodies, grey, as far as their own outline reaches."""
    from matplotlib.collections import PolyCollection

    vertices, triangles = vehicle.scene.mesh()
    seen = vertices[triangles][:, :, list(VIEWS[view])]
    axes.add_collection(PolyCollection(list(seen), facecolors="0.75", edgecolors="0.75", lw=0.3, rasterized=True))


def outline(axes: "Axes", region: Region, mask: NDArray[np.bool_], view: str, **style: Any) -> None:
    """Draw the edges of a mask (a, b), along its cells."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    shown = list(VIEWS[view])
    low = region.min_m[shown]
    edge = region.cuboid_m[shown]
    lines = np.empty((0, 2, 2))
    for swapped in (False, True):  # edges across the first axis, then across the second
        cells = mask.T if swapped else mask
        walls = np.diff(np.pad(cells, ((1, 1), (0, 0))).astype(np.int8), axis=0) != 0
        ends = np.diff(np.pad(walls, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        found = np.stack([np.argwhere(ends == 1), np.argwhere(ends == -1)], axis=1)
        lines = np.concatenate([lines, low + (found[..., ::-1] if swapped else found) * edge])
    if len(lines):
        path = Path(lines.reshape(-1, 2), np.tile([Path.MOVETO, Path.LINETO], len(lines)))
        axes.add_artist(PathPatch(path, fill=False, rasterized=len(lines) > 4000, **style))  # limits are set


def spread(places: Array, sizes: Array, low: Array, high: Array) -> Array:
    """(n, 2) the middles of boxes of `sizes` (n, 2) that lie within `low` to `high`, none over an earlier one.

    Each is as near to its place (n, 2) as steps of half its size allow; it stays there where nothing is free.
    """
    steps = np.stack(np.meshgrid(*2 * [np.arange(-REACH, REACH + 1)]), axis=-1).reshape(-1, 2) / 2
    found = np.empty((0, 2))
    for place, size in zip(places, sizes, strict=True):
        tried = np.clip(place, low + size / 2, high - size / 2) + steps * size
        inside = ((tried >= low + size / 2 - 1e-9) & (tried <= high - size / 2 + 1e-9)).all(axis=1)
        apart = np.abs(tried[:, None] - found) >= (size + sizes[: len(found)]) / 2 - 1e-9
        far = np.where(inside & apart.any(axis=2).all(axis=1), np.linalg.norm(tried - place, axis=1), np.inf)
        best = int(np.argmin(far))
        found = np.concatenate([found, tried[best : best + 1] if far[best] < np.inf else place[None]])
    return found


def number_places(axes: "Axes", places: Array, texts: Sequence[str], colours: Sequence[str]) -> None:
    """Write a short text at each place (n, 2) of axes that are laid out; beside it, with a line, in a crowd."""
    per_point = axes.figure.dpi / 72
    sizes = per_point * np.array([(NUMBER_PT * (0.75 * len(text) + 0.3), 1.35 * NUMBER_PT) for text in texts])
    wanted = axes.transData.transform(places)
    moved = spread(wanted, sizes, *axes.bbox.get_points()) - wanted
    found = np.where(moved == 0.0, places, axes.transData.inverted().transform(wanted + moved))
    box = {"boxstyle": "round,pad=0.15", "fc": "w", "ec": "none", "alpha": 0.8}
    for place, at, text, code in reversed([*zip(places.tolist(), found.tolist(), texts, colours, strict=True)]):
        line = {"arrowstyle": "-", "color": code, "lw": 0.6, "shrinkA": 0, "shrinkB": 0} if place != at else None
        drawn = axes.annotate(text, place, at, ha="center", va="center", color=code, bbox=box, arrowprops=line)
        drawn.set(fontsize=NUMBER_PT, weight="bold")


def sensor_dots(axes: "Axes", rig: Rig, view: str, size: float) -> None:
    """Mark the sensors."""
    across, up = VIEWS[view]
    for i, mount in enumerate(rig.mounts):
        at = mount.position_m
        marker = MARKERS[i // len(COLOURS) % len(MARKERS)]
        axes.plot(at[across], at[up], marker, color=colour(i), mec="w", mew=0.6, ms=size)


def panels(figure: "Figure", count: int, columns: int = 2) -> list["Axes"]:
    """Axes in rows of two that share their scales; y is labelled on the left, x at the bottom."""
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, sharex=True, sharey=True).ravel().tolist()
    for axes in grid[count:]:
        axes.set_visible(False)
    for axes in grid[max(count - columns, 0) : count]:
        axes.tick_params(labelbottom=True)
    return list(grid[:count])
