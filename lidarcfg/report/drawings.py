"""The drawings of a page, as SVG that stands in it: one style, colours told apart by colour-blind people."""

import io
import re
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.cones import rig_lidars
from lidarcfg.placement.coverage import beams_across
from lidarcfg.placement.detection import DetectionObject, Rings, counted_places
from lidarcfg.placement.metric import volume_m3
from lidarcfg.placement.optimize import Placement
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import Evaluation, Study
from lidarcfg.placement.subspace import Subspaces
from lidarcfg.report.markup import Html, escaped, shown
from lidarcfg.report.plots import COLOURS, history_top, new_figure
from lidarcfg.rig import Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 7.4
VIEWS = {"top": (0, 1), "side": (0, 2), "front": (1, 2)}  # what they show, across and up
MARKERS = "osD^vPX*"
MAP = "cividis"  # the same to all eyes
LEFT_OUT = (0.55, 0.57, 0.6)
WORST = "#D55E00"
PIXELS_MAX = 700  # of a map's side; larger ones are drawn by the mean of several cells
NAMES_MAX = 12  # beside the drawing; the table has them all
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


def drawing(name: str, height_in: float, alt: str, draw: Callable[["Figure"], None]) -> Html:
    """What `draw` draws, as SVG for a page; `name` sets its ids apart from other drawings'."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # whoever shows the page has more letters
        figure = new_figure(WIDTH_IN, height_in)
        draw(figure)
        file = io.StringIO()
        figure.savefig(file, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    svg = file.getvalue()
    svg = svg[svg.index("<svg") :]
    box = re.search(r'viewBox="[^"]*"', svg)
    assert box
    svg = re.sub(r"<svg[^>]*>", f'<svg {box[0]} role="img" aria-label="{escaped(alt)}">', svg, count=1)
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", svg)
    return Html(re.sub(r'(url\(|href=")#', rf"\g<1>#{name}-", svg))


def label(name: str, most: int = 28) -> str:
    """A name as it fits beside a line."""
    text = shown(name).replace("\n", " ")
    return text if len(text) <= most else text[: most - 1] + "…"


def colour(i: int) -> str:
    """Of the i-th of some things."""
    return COLOURS[i % len(COLOURS)]


def dashes(i: int) -> str:
    """Of the i-th of some lines, so that one shows below another."""
    return ("-", "--", "-.", ":")[i % 4]


def _hidden(across: int, up: int) -> int:
    return 3 - across - up


def _axes_of(figure: "Figure", across_m: float, up_m: float, depth_m: float) -> dict[str, "Axes"]:
    """Top above side, front beside it: their sizes as the extents of x, y and z are, but none too thin."""
    grid = figure.add_gridspec(2, 2, width_ratios=_shares(across_m, up_m), height_ratios=_shares(up_m, depth_m))
    return {
        "top": figure.add_subplot(grid[0, 0]),
        "side": figure.add_subplot(grid[1, 0]),
        "front": figure.add_subplot(grid[1, 1]),
    }


def _shares(one: float, other: float) -> tuple[float, float]:
    share = min(max(one / (one + other), 0.3), 0.75)
    return share, 1 - share


def _name_axes(axes: "Axes", view: str, note: str = "") -> None:
    across, up = VIEWS[view]
    axes.set(xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    axes.set_title(view + note)


def _extent(region: Region, across: int, up: int) -> tuple[float, float, float, float]:
    low, high = region.min_m, region.max_m
    return float(low[across]), float(high[across]), float(low[up]), float(high[up])


def _thinned(values: Array) -> Array:
    """A map (a, b, …) of at most PIXELS_MAX cells a side: means of blocks, NaN where all of a block is."""
    for axis in (0, 1):
        step = -(-values.shape[axis] // PIXELS_MAX)
        if step > 1:
            starts = np.arange(0, values.shape[axis], step)
            known = np.add.reduceat(~np.isnan(values), starts, axis=axis)
            total = np.add.reduceat(np.nan_to_num(values), starts, axis=axis)
            values = np.divide(total, known, out=np.full(total.shape, np.nan), where=known > 0)
    return values


def _shade(axes: "Axes", region: Region, mask: NDArray[np.bool_], across: int, up: int, rgb: Any, alpha: float) -> None:
    """Colour the cells of a mask (a, b)."""
    from matplotlib.colors import to_rgb

    share = _thinned(mask.astype(float))
    picture = np.zeros((share.shape[1], share.shape[0], 4))
    picture[..., :3] = to_rgb(rgb)
    picture[..., 3] = alpha * share.T
    axes.imshow(picture, extent=_extent(region, across, up), origin="lower", aspect="auto")


def _shade_left_out(axes: "Axes", region: Region, across: int, up: int) -> None:
    out = np.asarray((~region.included).any(axis=_hidden(across, up)))
    _shade(axes, region, out, across, up, LEFT_OUT, 0.4)


def _outline(axes: "Axes", region: Region, mask: NDArray[np.bool_], across: int, up: int, **style: Any) -> None:
    """The edges of a mask (a, b), along its cells."""
    from matplotlib.collections import LineCollection

    low, edge = region.min_m[[across, up]], region.cuboid_m[[across, up]]
    lines = []
    for turn in (0, 1):  # edges across the first axis, then across the second
        cells = mask if turn == 0 else mask.T
        walls = np.diff(np.pad(cells, ((1, 1), (0, 0))).astype(np.int8), axis=0) != 0
        ends = np.diff(np.pad(walls, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        for (i, first), (_, last) in zip(np.argwhere(ends == 1), np.argwhere(ends == -1), strict=True):
            line = np.array([[i, first], [i, last]], np.float64)
            lines.append(low + (line if turn == 0 else line[:, ::-1]) * edge)
    axes.add_collection(LineCollection(lines, rasterized=len(lines) > 4000, **style))


def _sensor_dots(axes: "Axes", rig: Rig, across: int, up: int, size: float = 5) -> None:
    for i, mount in enumerate(rig.mounts):
        at = mount.position_m
        axes.plot(
            at[across], at[up], MARKERS[i // len(COLOURS) % len(MARKERS)], color=colour(i), mec="w", mew=0.6, ms=size
        )


def draw_mounts(study: Study, rig: Rig) -> Html:
    """The sensors with their axes, from top, side and front, near the vehicle; the study's bounds dashed."""
    lidars = rig_lidars(rig)
    bounds = {
        slot.name: (low[:3], high[:3])
        for slot, low, high, mirror in zip(study.slots, study.lower, study.upper, study.mirror, strict=True)
        if np.isnan(mirror)
    }
    drawn = [np.stack(bounds[mount.name]) for mount in rig.mounts if mount.name in bounds]
    at = np.array([lidar.position_m for lidar in lidars])
    span = max(float(np.ptp(np.concatenate([at, *drawn]), axis=0).max()), 1.0)
    tips = at + 0.25 * span * np.array([lidar.axis for lidar in lidars])
    points = np.concatenate([at, tips, *drawn])
    low, high = points.min(axis=0) - 0.15 * span, points.max(axis=0) + 0.15 * span
    floor = float(study.region.min_m[2]) - 0.02 * span
    if 0 < low[2] - floor < 2 * span:
        low[2] = floor
    wider = np.maximum(0.6 * (high - low).max() - (high - low), 0.0) / 2  # none of the three is a sliver
    low, high = low - wider, high + wider
    size = high - low

    def draw(figure: "Figure") -> None:
        views = _axes_of(figure, size[0], size[1], size[2])
        for view, axes in views.items():
            across, up = VIEWS[view]
            _shade_left_out(axes, study.region, across, up)
            for i, (mount, here, there) in enumerate(zip(rig.mounts, at, tips, strict=True)):
                if mount.name in bounds:
                    least, most = bounds[mount.name]
                    x, y = [least[across], most[across]], [least[up], most[up]]
                    axes.plot([*x, *x[::-1], x[0]], [y[0], *y, y[1], y[0]], "--", color=colour(i), lw=0.8)
                start, end = here[[across, up]], there[[across, up]]
                arrow = {"arrowstyle": "-|>", "color": colour(i), "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
                axes.annotate("", end, start, arrowprops=arrow)
                length = float(np.hypot(*(end - start)))
                away = (start - end) / length if length > 0.02 * span else np.array([0.0, -1.0])
                offset = (11 * away[0], 11 * away[1])
                text = axes.annotate(str(i + 1), start, offset, textcoords="offset points", color=colour(i))
                text.set(weight="bold", ha="center", va="center")
            _sensor_dots(axes, rig, across, up, 7)
            axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]))
            axes.set_aspect("equal")
            axes.grid(True)
            _name_axes(axes, view)
        dots = views["top"].lines[-len(lidars) :][:NAMES_MAX]
        words = [f"{i} {label(mount.name)}" for i, mount in enumerate(rig.mounts[:NAMES_MAX], 1)]
        names = views["top"].legend(dots, words, loc="upper left", bbox_to_anchor=(1.03, 1.0))
        names.set_in_layout(False)  # the corner beside the front is free

    margins = 1.4  # inches, for what is written beside the axes
    scale = (WIDTH_IN - margins) / (size[0] + size[1])
    height = float(np.clip(margins + scale * (size[1] + size[2]), 3.0, 7.5))
    alt = f"{len(lidars)} sensors from top, side and front, with their axes and bounds"
    return drawing("mounts", height, alt, draw)


def draw_history(study: Study, found: Placement) -> Html:
    """Best and mean over the evaluations."""

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        evaluations = [cycle.evaluations for cycle in found.history]
        dot = "o" if len(evaluations) < 3 else ""
        axes.plot(evaluations, [cycle.mean for cycle in found.history], marker=dot, color=COLOURS[5], label="mean")
        axes.plot(evaluations, [cycle.best for cycle in found.history], marker=dot, color=COLOURS[0], label="best")
        if study.objective.is_max_vsr:
            axes.axhline(found.middle_max_vsr_m, color="0.4", ls=":", lw=1, label="middle of the bounds")
        value = "max VSR (m)" if study.objective.is_max_vsr else "objective (weighted mean)"
        axes.set(xlabel="evaluations", ylabel=value, ylim=(0, history_top(study, found)))
        axes.grid(True)
        axes.legend(loc="best")

    return drawing("history", 2.9, "best and mean of the search over its evaluations", draw)


def _region_axes(figure: "Figure", region: Region) -> dict[str, "Axes"]:
    """Top over the whole width, side and front below it."""
    size = region.max_m - region.min_m
    grid = figure.add_gridspec(2, 2, width_ratios=_shares(size[0], size[1]), height_ratios=(1.9, 1))
    places = (grid[0, :], grid[1, 0], grid[1, 1])
    return {view: figure.add_subplot(place) for view, place in zip(VIEWS, places, strict=True)}


def worst_view(axes: "Axes", view: str, rig: Rig, found: Evaluation, numbers: Sequence[int]) -> None:
    """The worst subspaces, the first of them filled, outlined and numbered where they are, seen from one side."""
    region, (across, up) = found.subspaces.region, VIEWS[view]
    hidden = _hidden(across, up)
    _shade_left_out(axes, region, across, up)
    for rank in reversed(range(len(numbers))):
        mask = np.asarray((found.subspaces.label == numbers[rank]).any(axis=hidden))
        if rank == 0:
            _shade(axes, region, mask, across, up, WORST, 0.35)
        tint = WORST if rank == 0 else colour(rank % 5)  # the sixth colour is the worst's
        _outline(axes, region, mask, across, up, color=tint, lw=1.4 if rank == 0 else 0.8)
    for rank in reversed(range(len(numbers))):
        middle = found.worst[rank].centroid_m
        axes.text(
            middle[across],
            middle[up],
            str(rank + 1),
            ha="center",
            va="center",
            fontsize=7,
            weight="bold",
            color=WORST if rank == 0 else colour(rank % 5),
            bbox={"boxstyle": "round,pad=0.15", "fc": "w", "ec": "none", "alpha": 0.8},
        )
    _sensor_dots(axes, rig, across, up, 4)
    left, right, bottom, top = _extent(region, across, up)
    axes.set(xlim=(left, right), ylim=(bottom, top))


def worst_numbers(found: Evaluation) -> list[int]:
    """The labels of `found.worst`."""
    return [int(n) for n in np.argsort(-found.vsr_m, kind="stable")[: len(found.worst)]]


def draw_worst(rig: Rig, found: Evaluation) -> Html:
    """The worst subspaces in the region from top, side and front."""

    def draw(figure: "Figure") -> None:
        for view, axes in _region_axes(figure, found.subspaces.region).items():
            worst_view(axes, view, rig, found, worst_numbers(found))
            _name_axes(axes, view, "" if view == "top" else " (height stretched)")

    alt = f"the {len(found.worst)} worst subspaces in the region, from top, side and front"
    return drawing("worst", 4.6, alt, draw)


def draw_distribution(named: Sequence[tuple[str, Evaluation]]) -> Html:
    """How many subspaces have which VSR, and what share of the region's volume they hold."""
    most = max(found.max_vsr_m for _, found in named)
    least = min(float(found.vsr_m.min()) for _, found in named)
    edges = np.geomspace(least * 0.999, max(most, least * 1.2) * 1.001, 41)

    def draw(figure: "Figure") -> None:
        from matplotlib.ticker import LogLocator, NullFormatter

        counts, shares = figure.subplots(2, 1, sharex=True)
        for i, (name, found) in enumerate(named):
            volume = volume_m3(found.subspaces)
            style: dict[str, Any] = {"color": colour(i), "label": label(name)}
            style |= {"alpha": 0.75} if len(named) == 1 else {"histtype": "step", "lw": 1.5, "ls": dashes(i)}
            counts.hist(found.vsr_m, edges, **style)
            shares.hist(found.vsr_m, edges, weights=100 * volume / volume.sum(), **style)
            for axes in (counts, shares):
                for worst in found.worst:
                    axes.axvline(worst.vsr_m, 0, 0.06, color=WORST if len(named) == 1 else colour(i), lw=1)
        counts.set(xscale="log", yscale="log", ylabel="subspaces")
        shares.set(ylabel="share of volume (%)", xlabel="VSR of a subspace (m)")
        for axis in (counts.yaxis, shares.xaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        shares.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        if len(named) > 1:
            counts.legend(ncols=2)
        for axes in (counts, shares):
            axes.grid(True)

    return drawing(
        "distribution", 3.9, "histograms of VSR: number of subspaces, and share of the region's volume", draw
    )


def draw_rings(panels: Sequence[tuple[str, Sequence[tuple[str, Rings]]]]) -> Html:
    """Detection rate against distance; a panel for each title, with a line for each name."""
    rows = -(-len(panels) // 2) if len(panels) > 1 else 1

    def draw(figure: "Figure") -> None:
        grid = figure.subplots(rows, min(len(panels), 2), sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat[len(panels) :]:
            axes.set_visible(False)
        for n, ((title, lines), axes) in enumerate(zip(panels, grid.flat, strict=False)):
            for i, (name, rings) in enumerate(lines):
                middle, rate = (rings.edges_m[:-1] + rings.edges_m[1:]) / 2, 100 * rings.rate
                style: dict[str, Any] = {"color": colour(i), "ls": dashes(i), "marker": MARKERS[i % len(MARKERS)]}
                axes.plot(middle, rate, ms=4, label=label(name), **style)
            axes.set(ylim=(-3, 103), xlim=(0, lines[0][1].edges_m[-1]))
            if title:
                axes.set_title(label(title))
            if n % 2 == 0:
                axes.set_ylabel("detection rate (%)")
            if n >= len(panels) - 2:
                axes.set_xlabel("distance from the vehicle (m)")
                axes.tick_params(labelbottom=True)
            axes.grid(True)
            if n == 0:
                axes.legend(fontsize=7.5)

    return drawing("rings", 0.6 + 2.3 * rows, "detection rate against distance from the vehicle", draw)


def draw_blind_spots(subspaces: Subspaces, rig: Rig, objects: Sequence[DetectionObject]) -> Html:
    """Where each object is detected, from above."""
    region, rows = subspaces.region, -(-len(objects) // 2)
    size = region.max_m - region.min_m

    def draw(figure: "Figure") -> None:
        grid = figure.subplots(rows, 2 if len(objects) > 1 else 1, squeeze=False, sharex=True, sharey=True)
        for axes in grid.flat[len(objects) :]:
            axes.set_visible(False)
        for n, (item, axes) in enumerate(zip(objects, grid.flat, strict=False)):
            detected, places = counted_places(subspaces, item)
            rate = 100 * np.divide(detected, places, out=np.full(places.shape, np.nan), where=places > 0)
            first = region.min_m[:2] + (np.array(region.shape[:2]) - rate.shape) / 2 * region.cuboid_m[:2]
            last = first + rate.shape * region.cuboid_m[:2]  # so that a cell stands where the object's middle does
            image = axes.imshow(
                _thinned(rate).T,
                extent=(first[0], last[0], first[1], last[1]),
                origin="lower",
                aspect="equal" if 0.2 < size[0] / size[1] < 5 else "auto",
                cmap=MAP,
                vmin=0,
                vmax=100,
            )
            _sensor_dots(axes, rig, 0, 1, 3.5)
            left, right, bottom, top = _extent(region, 0, 1)
            axes.set(xlim=(left, right), ylim=(bottom, top), facecolor=(*LEFT_OUT, 0.4))
            axes.set_title(label(item.name))
            if n % 2 == 0:
                axes.set_ylabel("y (m)")
            if n >= len(objects) - 2:
                axes.set_xlabel("x (m)")
                axes.tick_params(labelbottom=True)
        figure.colorbar(image, ax=grid, label="detected (%)", shrink=0.9, fraction=0.03)

    columns = 2 if len(objects) > 1 else 1
    each = float(np.clip(0.85 * WIDTH_IN / columns * size[1] / size[0], 0.8, 4.0))
    return drawing("blind", 0.4 + rows * (each + 0.45), "where each object is detected, from above", draw)


def coverage_view(axes: "Axes", view: str, region: Region, beams: NDArray[np.int64], most: float) -> Any:
    """A map of beams (a, b), −1 where nothing counts; the image, for a colour bar."""
    across, up = VIEWS[view]
    values = _thinned(np.where(beams < 0, np.nan, beams.astype(np.float64)))
    extent = _extent(region, across, up)
    image = axes.imshow(values.T, extent=extent, origin="lower", aspect="auto", cmap=MAP, vmin=0, vmax=max(most, 1))
    axes.set(xlim=extent[:2], ylim=extent[2:], facecolor=(*LEFT_OUT, 0.4), autoscale_on=False)
    return image


def total(beams: NDArray[np.int64]) -> NDArray[np.int64]:
    """(a, b) of all LiDARs together from (lidars, a, b); −1 stays."""
    return np.where(beams[0] < 0, -1, beams.sum(axis=0))


def draw_coverage(subspaces: Subspaces, rig: Rig) -> Html:
    """Beams across each line of cuboids, from top, side and front; and from above how many sensors have one there."""
    region = subspaces.region
    beams = {view: beams_across(subspaces, _hidden(*VIEWS[view])) for view in VIEWS}
    sensors = np.where(beams["top"][0] < 0, -1, (beams["top"] > 0).sum(axis=0))
    size = region.max_m - region.min_m

    def draw(figure: "Figure") -> None:
        import matplotlib as mpl

        grid = figure.add_gridspec(3, 2, width_ratios=_shares(size[0], size[1]), height_ratios=[1.9, 1, 1.9])
        top, side, front = (figure.add_subplot(part) for part in (grid[0, :], grid[1, 0], grid[1, 1]))
        count = figure.add_subplot(grid[2, :])
        for view, axes in (("top", top), ("side", side), ("front", front)):
            sums = total(beams[view])
            image = coverage_view(axes, view, region, sums, float(sums.max()))
            _sensor_dots(axes, rig, *VIEWS[view], 4)
            _name_axes(
                axes, view, ": beams along z" if view == "top" else f": beams along {'y' if view == 'side' else 'x'}"
            )
            figure.colorbar(image, ax=axes, label="beams", pad=0.01)
        levels = len(rig.mounts) + 1
        image = coverage_view(count, "top", region, sensors, levels - 1)
        image.set(cmap=mpl.colormaps[MAP].resampled(levels), clim=(-0.5, levels - 0.5))
        _sensor_dots(count, rig, 0, 1, 4)
        _name_axes(count, "top", ": sensors with a beam along z")
        bar = figure.colorbar(image, ax=count, label="sensors", pad=0.01)
        bar.set_ticks([int(n) for n in np.unique(np.linspace(0, levels - 1, min(levels, 6)).round())])

    return drawing("coverage", 6.3, "maps of how many beams cross the region, from top, side and front", draw)


def compare_worst(key: str, named: Sequence[tuple[str, Rig, Evaluation]]) -> Html:
    """The worst subspaces of each rig, a row a rig: from top and side; `key` sets this drawing apart from others."""

    def draw(figure: "Figure") -> None:
        grid = figure.subplots(len(named), 2, sharex=True, sharey="col", squeeze=False)
        for n, (row, (name, rig, found)) in enumerate(zip(grid, named, strict=True), 1):
            for view, axes in zip(("top", "side"), row, strict=True):
                worst_view(axes, view, rig, found, worst_numbers(found)[:5])
                _name_axes(axes, view)
                axes.set_title(label(name, 40) if view == "top" else "")
                if n < len(named):
                    axes.set_xlabel("")

    return drawing(key, 0.5 + 1.7 * len(named), "the worst subspaces of each rig, from top and side", draw)


def compare_coverage(named: Sequence[tuple[str, Rig, Evaluation]]) -> Html:
    """Beams across upright lines of cuboids, a map a rig, on one scale."""
    maps = [total(beams_across(found.subspaces, 2)) for _, _, found in named]
    most = max(float(beams.max()) for beams in maps)
    region, rows = named[0][2].subspaces.region, -(-len(named) // 2)

    def draw(figure: "Figure") -> None:
        grid = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat[len(named) :]:
            axes.set_visible(False)
        for n, ((name, rig, _), beams, axes) in enumerate(zip(named, maps, grid.flat, strict=False)):
            image = coverage_view(axes, "top", region, beams, most)
            _sensor_dots(axes, rig, 0, 1, 3.5)
            axes.set_title(label(name, 40))
            if n % 2 == 0:
                axes.set_ylabel("y (m)")
            if n >= len(named) - 2:
                axes.set_xlabel("x (m)")
                axes.tick_params(labelbottom=True)
        figure.colorbar(image, ax=grid, label="beams", fraction=0.03)

    return drawing("coverage", 0.5 + 1.6 * rows, "beams across upright poles, by place, for each rig", draw)
