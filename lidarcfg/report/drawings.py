"""The drawings of a report: search, worst subspaces, failures, detection and coverage; and a rig as a picture."""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lidarcfg.report.canvas import (
    BAR_IN,
    EXCLUDED,
    LABELS_IN,
    MARKERS,
    VIEWS,
    WIDTH_IN,
    colour,
    dashes,
    draw_bodies,
    draw_values,
    drawing,
    extent,
    fractions,
    hidden,
    label,
    lay_out,
    name_axes,
    number_places,
    outline,
    panels,
    panels_in,
    sensor_dots,
    shade,
    shade_excluded,
    thinned,
)
from lidarcfg.report.inputs import Coverage, DetectionMap
from lidarcfg.report.plots import new_figure, search_view
from lidarcfg.report.text import summarize, truncate
from lidarcfg.search.run import Placement
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation, Robustness
from lidarcfg.study.study import Study
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.detection import Rings
from lidarcfg.vsr.region import Region
from lidarcfg.world.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAP = "cividis"  # looks the same to colour-blind people
WORST = "#D55E00"
OBJECTS_MAX = 12  # that are drawn
AXIS = 0.12  # a sensor's axis, of the length of the vehicle
LEGEND_ROW = 0.12  # of the height of bars


def draw_history(study: Study, found: Placement) -> Markup:
    """Best and mean over the evaluations."""
    alt = "best and mean of the search over its evaluations"
    return drawing("history", 2.9, alt, lambda figure: search_view(figure.subplots(), study, found))


def _draw_worst(figure: "Figure", views: Sequence[tuple["Axes", str, Rig, Evaluation]], count: int) -> None:
    """The worst subspaces from a side each: outlined and numbered at their centroids, the first one filled."""
    for axes, view, rig, found in views:
        region = found.subspaces.region
        shade_excluded(axes, region, view)
        for rank, one in reversed(list(enumerate(found.extents[:count]))):
            mask = one.lines[hidden(view)] > 0
            if rank == 0:
                shade(axes, region, mask, view, WORST, 0.35)
            outline(axes, region, mask, view, color=_tint(rank), lw=1.4 if rank == 0 else 0.8)
        sensor_dots(axes, rig, view, 4)
        left, right, bottom, top = extent(region, view)
        axes.set(xlim=(left, right), ylim=(bottom, top))
    lay_out(figure)
    for axes, view, _, found in views:
        ranks = range(min(count, len(found.worst)))
        middles = np.array([[found.worst[rank].centroid_m[axis] for axis in VIEWS[view]] for rank in ranks])
        number_places(axes, middles, [str(rank + 1) for rank in ranks], [_tint(rank) for rank in ranks])


def _tint(rank: int) -> str:
    return WORST if rank == 0 else colour(rank % 5)  # the sixth colour is WORST


def _draw_zones(axes: "Axes", view: str, study: Study) -> None:
    """The study's zones as dashed boxes with their names."""
    across, up = VIEWS[view]
    for zone in study.zones:
        (left, bottom), (right, top) = (corner[[across, up]] for corner in zone.box_m)
        axes.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], "k--", lw=0.9)
        if view == "top":
            axes.text(left, top, f" {label(zone.name)}", ha="left", va="top", fontsize=7, clip_on=True)


def draw_worst(study: Study, rig: Rig, found: Evaluation) -> Markup:
    """The worst subspaces in the region from top, side and front, and the study's zones."""
    size = found.subspaces.region.max_m - found.subspaces.region.min_m

    def draw(figure: "Figure") -> None:
        grid = figure.add_gridspec(2, 2, width_ratios=fractions(size[0], size[1]), height_ratios=(1.9, 1))
        views = dict(zip(VIEWS, (grid[0, :], grid[1, 0], grid[1, 1]), strict=True))
        drawn = {view: figure.add_subplot(place) for view, place in views.items()}
        for view, axes in drawn.items():
            _draw_zones(axes, view, study)
            name_axes(axes, view, "" if view == "top" else " (height stretched)")
        _draw_worst(figure, [(axes, view, rig, found) for view, axes in drawn.items()], len(found.worst))

    alt = f"the {len(found.worst)} worst subspaces in the region, from top, side and front"
    return drawing("worst", 4.6, alt, draw)


def lost_view(axes: "Axes", titled: Sequence[tuple[str, Robustness]]) -> None:
    """Bars of max VSR for the whole rig and with each LiDAR lost; one of each group for each title."""
    most = max(len(found.without) for _, found in titled)
    width = 0.8 / len(titled)
    names = [[left.lost or "" for left in found.without] for _, found in titled]
    alike = [dict.fromkeys(label(name, 14) for name in of if name) for of in zip_longest(*names, fillvalue="")]
    for i, (title, found) in enumerate(titled):
        values = [left.max_vsr_m for left in (found.whole, *found.without)]
        at = [n + (i - (len(titled) - 1) / 2) * width for n in range(len(values))]
        axes.bar(at, values, 0.92 * width, color=colour(i), label=label(title))
    axes.set_xticks(range(most + 1), ["whole rig", *("without\n" + " / ".join(of) for of in alike)])
    axes.set(xlim=(-0.6, most + 0.6), ylabel="max VSR (m)")
    axes.grid(True, axis="y")
    axes.set_axisbelow(True)
    if len(titled) > 1:
        axes.legend(ncols=2, loc="upper left")
        axes.set_ylim(0, axes.get_ylim()[1] * (1 + LEGEND_ROW * -(-len(titled) // 2)))  # above the bars


def draw_lost(titled: Sequence[tuple[str, Evaluation]]) -> Markup | None:
    """Max VSR with each LiDAR lost; None where no rig has two, or that is not known."""
    known = [(title, found.robustness) for title, found in titled if found.robustness]
    if not any(robust.without for _, robust in known):
        return None
    alt = "max VSR of the whole rig, and with each LiDAR lost"
    return drawing("lost", 2.8, alt, lambda figure: lost_view(figure.subplots(), known))


def draw_rings(titled: Sequence[tuple[str, Mapping[str, Rings]]]) -> Markup:
    """Detection rate by distance; a panel for each title, with a line for each name."""

    def draw(figure: "Figure") -> None:
        grid = panels(figure, len(titled), min(len(titled), 2))
        for n, ((title, lines), axes) in enumerate(zip(titled, grid, strict=True)):
            for i, (name, rings) in enumerate(lines.items()):
                distance = (rings.edges_m[:-1] + rings.edges_m[1:]) / 2
                rate = 100 * rings.rate
                style: dict[str, Any] = {"color": colour(i), "ls": dashes(i), "marker": MARKERS[i % len(MARKERS)]}
                axes.plot(distance, rate, ms=4, label=label(name), **style)
                axes.set(ylim=(-3, 103), xlim=(0, rings.edges_m[-1]))
            if title:
                axes.set_title(label(title))
            if n % 2 == 0:
                axes.set_ylabel("detection rate (%)")
            if n >= len(titled) - 2:
                axes.set_xlabel("distance (m)")
            axes.grid(True)
        grid[0].legend(fontsize=7.5)

    height = 0.6 + 2.3 * -(-len(titled) // 2)
    return drawing("rings", height, "detection rate by distance", draw)


def least_detected(found: Sequence[Evaluation]) -> list[str]:
    """The objects that are drawn, in their order: all, or the OBJECTS_MAX that some rig detects least."""
    names = list(found[0].detection)
    by_rate = sorted(names, key=lambda name: min(one.detection[name].rate for one in found))
    return sorted(by_rate[:OBJECTS_MAX], key=names.index)


def draw_places(region: Region, rig: Rig, places: Mapping[str, DetectionMap]) -> Markup:
    """Where each object is detected, from above."""
    size = region.max_m - region.min_m
    columns = min(len(places), 2)

    def draw(figure: "Figure") -> None:
        figure.set_layout_engine("compressed")
        grid = panels(figure, len(places), columns)
        for axes, (name, place) in zip(grid, places.items(), strict=True):
            rate = 100 * place.rate
            around = (place.low_m[0], place.high_m[0], place.low_m[1], place.high_m[1])
            aspect: Literal["equal", "auto"] = "equal" if 0.2 < size[0] / size[1] < 5 else "auto"
            image = axes.imshow(
                thinned(rate).T, extent=around, origin="lower", aspect=aspect, cmap=MAP, vmin=0, vmax=100
            )
            sensor_dots(axes, rig, "top", 3.5)
            _finish_map(axes, region, label(name))
        _name_outer(grid)
        figure.colorbar(image, ax=grid, label="detected (%)")

    wide = WIDTH_IN - LABELS_IN - BAR_IN
    each = float(np.clip(wide / columns * size[1] / size[0], 0.8, 4.0))
    height = panels_in(each, -(-len(places) // columns))
    return drawing("places", height, "where each object is detected, from above", draw)


def _finish_map(axes: "Axes", region: Region, title: str) -> None:
    left, right, bottom, top = extent(region, "top")
    axes.set(xlim=(left, right), ylim=(bottom, top), facecolor=(*EXCLUDED, 0.4))
    axes.set_title(title)


def _name_outer(grid: Sequence["Axes"]) -> None:
    """Label x below the last panels and y beside the left ones, in rows of two."""
    for n, axes in enumerate(grid):
        if n % 2 == 0:
            axes.set_ylabel("y (m)")
        if n >= len(grid) - 2:
            axes.set_xlabel("x (m)")


def draw_rig(study: Study, rig: Rig, found: Evaluation) -> "Figure":
    """The rig from top, side and front with the sensors' axes: on the vehicle, in true proportions; without one in the
    region, with what it excludes and the worst subspace."""
    from matplotlib.lines import Line2D

    figure = new_figure(11, 7)
    misses = f"misses {found.misses.mean:.2%}, " if found.misses else ""
    title = f"{truncate(rig.name)}: {misses}max VSR {found.max_vsr_m:.4f} m"
    if study.vehicle:
        _draw_on_vehicle(figure, study.vehicle, rig)
    else:
        _draw_in_region(figure, study.region, rig, found)
        title += "; the worst subspace orange, excluded grey"
    top = figure.axes[0]
    dots = top.lines[: len(rig.mounts)]
    named = summarize([label(mount.name) for mount in rig.mounts])
    rest = [Line2D([], [], ls="")] * (len(named) < len(dots))
    place = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0)} if study.vehicle else {"loc": "upper right"}
    legend = top.legend([*dots[: len(named) - len(rest)], *rest], named, **place)
    legend.set_in_layout(not study.vehicle)  # the corner beside the top is free
    figure.suptitle(title, parse_math=False)
    return figure


def _draw_on_vehicle(figure: "Figure", vehicle: Vehicle, rig: Rig) -> None:
    """The vehicle and the sensors, in true proportions."""
    at = np.array([mount.position_m for mount in rig.mounts])
    places = np.concatenate([vehicle.scene.mesh()[0], at])
    length = AXIS * float(np.ptp(places, axis=0).max())
    low = places.min(axis=0) - 1.3 * length
    high = places.max(axis=0) + 1.3 * length
    size = high - low
    grid = figure.add_gridspec(2, 2, width_ratios=(size[0], size[1]), height_ratios=(size[1], size[2]))
    for view, place in zip(VIEWS, (grid[0, 0], grid[1, 0], grid[1, 1]), strict=True):
        axes = figure.add_subplot(place)
        across, up = VIEWS[view]
        draw_bodies(axes, vehicle, view)
        _draw_axes(axes, view, rig, length)
        axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal")
        name_axes(axes, view)


def _draw_in_region(figure: "Figure", region: Region, rig: Rig, found: Evaluation) -> None:
    """The region's worst subspace and the sensors; heights are stretched."""
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 1))
    for view, place in zip(VIEWS, (grid[0, :], grid[1, 0], grid[1, 1]), strict=True):
        axes = figure.add_subplot(place)
        shade_excluded(axes, region, view)
        shade(axes, region, found.extents[0].lines[hidden(view)] > 0, view, WORST, 0.45)
        left, right, bottom, top = extent(region, view)
        _draw_axes(axes, view, rig, 0.12 * (top - bottom))
        axes.set(xlim=(left, right), ylim=(bottom, top))
        name_axes(axes, view, "" if view == "top" else " (height stretched)")


def _draw_axes(axes: "Axes", view: str, rig: Rig, length: float) -> None:
    """The sensors, each with its axis."""
    shown = list(VIEWS[view])
    for i, lidar in enumerate(rig_lidars(rig)):
        at = lidar.position_m[shown]
        tip = at + length * lidar.axis[shown]
        axes.plot(*at, "o", color=colour(i), ms=5, zorder=3)
        arrow = {"arrowstyle": "->", "color": colour(i), "lw": 1.5}
        axes.annotate("", (tip[0], tip[1]), (at[0], at[1]), arrowprops=arrow, zorder=3)


def coverage_view(axes: "Axes", view: str, region: Region, beams: NDArray[np.int64], most: float) -> Any:
    """Draw a map of beams (a, b), −1 where nothing counts; returns the image, for a colour bar."""
    values = np.where(beams < 0, np.nan, beams.astype(np.float64))
    return draw_values(axes, region, values, view, cmap=MAP, vmin=0, vmax=max(most, 1))


def all_beams(coverage: Coverage, view: str) -> NDArray[np.int64]:
    """(a, b) the beams of all sensors together; −1 where nothing counts."""
    beams = coverage.beams[hidden(view)]
    return np.where(beams[0] < 0, -1, beams.sum(axis=0))


def draw_coverage(region: Region, rig: Rig, coverage: Coverage) -> Markup:
    """Beams across each line of cuboids, from top, side and front; and from above how many sensors have one there."""
    upright = coverage.beams[2]
    sensors = np.where(upright[0] < 0, -1, (upright > 0).sum(axis=0))
    size = region.max_m - region.min_m
    levels = len(rig.mounts) + 1

    def draw(figure: "Figure") -> None:
        import matplotlib as mpl

        grid = figure.add_gridspec(3, 2, width_ratios=fractions(size[0], size[1]), height_ratios=(1.9, 1, 1.9))
        for view, place in zip(VIEWS, (grid[0, :], grid[1, 0], grid[1, 1]), strict=True):
            axes = figure.add_subplot(place)
            beams = all_beams(coverage, view)
            image = coverage_view(axes, view, region, beams, float(beams.max()))
            sensor_dots(axes, rig, view, 4)
            name_axes(axes, view, f": beams along {'xyz'[hidden(view)]}")
            figure.colorbar(image, label="beams")
        axes = figure.add_subplot(grid[2, :])
        image = coverage_view(axes, "top", region, sensors, levels - 1)
        image.set(cmap=mpl.colormaps[MAP].resampled(levels), clim=(-0.5, levels - 0.5))
        sensor_dots(axes, rig, "top", 4)
        name_axes(axes, "top", ": sensors with a beam along z")
        bar = figure.colorbar(image, label="sensors")
        bar.set_ticks([int(n) for n in np.unique(np.linspace(0, levels - 1, min(levels, 6)).round())])

    return drawing("coverage", 6.3, "maps of how many beams cross the region, from top, side and front", draw)


def compare_worst(key: str, named: Sequence[tuple[str, Rig, Evaluation]]) -> Markup:
    """The worst subspaces of each rig, a row per rig, from top and side; `key` names this drawing among several."""

    def draw(figure: "Figure") -> None:
        grid = figure.subplots(len(named), 2, sharex=True, sharey="col", squeeze=False)
        drawn = []
        for row, (name, rig, found) in zip(grid, named, strict=True):
            for view, axes in zip(("top", "side"), row, strict=True):
                name_axes(axes, view)
                axes.set_title(label(name, 40) if view == "top" else "")
                drawn.append((axes, view, rig, found))
        for axes in grid[:-1].ravel():
            axes.set_xlabel("")
        _draw_worst(figure, drawn, 5)

    return drawing(key, 0.5 + 1.7 * len(named), "the worst subspaces of each rig, from top and side", draw)


def compare_coverage(region: Region, named: Sequence[tuple[str, Rig, Coverage]]) -> Markup:
    """Beams across upright lines of cuboids, a map per rig, on one scale."""
    maps = [all_beams(coverage, "top") for _, _, coverage in named]
    most = max(float(beams.max()) for beams in maps)

    def draw(figure: "Figure") -> None:
        grid = panels(figure, len(named))
        for (name, rig, _), beams, axes in zip(named, maps, grid, strict=True):
            image = coverage_view(axes, "top", region, beams, most)
            sensor_dots(axes, rig, "top", 3.5)
            axes.set_title(label(name, 40))
        _name_outer(grid)
        figure.colorbar(image, ax=grid, label="beams")

    return drawing("coverage", 0.5 + 1.6 * -(-len(named) // 2), "beams across upright poles, for each rig", draw)
