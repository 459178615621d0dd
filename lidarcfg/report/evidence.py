"""The evidence for a verdict, drawn: maps around the vehicle's outline, and the worst place as each sensor sees it."""

import math
from collections.abc import Iterable, Sequence
from functools import singledispatch
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from markupsafe import Markup

from lidarcfg.geometry import Array
from lidarcfg.report.canvas import (
    BAR_IN,
    EXCLUDED,
    LABELS_IN,
    TITLE_IN,
    WIDTH_IN,
    colour,
    drawing,
    label,
    sensor_dots,
)
from lidarcfg.report.describe import counted
from lidarcfg.report.scenario import draw_scenario_on, scenario_rows
from lidarcfg.requirements.evidence import Evidence, SensorView
from lidarcfg.requirements.object_judge import PlaceCounts
from lidarcfg.requirements.shadow import HiddenColumns
from lidarcfg.requirements.verdict import RequirementVerdict
from lidarcfg.returns.beams import BeamOutcome
from lidarcfg.returns.places import StandZone
from lidarcfg.returns.post_visibility import STEP_M as POST_STEP_M
from lidarcfg.returns.post_visibility import PostVisibility
from lidarcfg.sensors.rig import Rig
from lidarcfg.world.footprint import Footprint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize
    from matplotlib.figure import Figure

SHORT = "#7F2704", "#FDD0A2"  # from no returns to almost enough
ENOUGH = "#C6DBEF", "#08306B"  # from enough to twice as many
SHADES = 128  # on either side of what is demanded
UNSEEN = "#B2182B"
GAP = "#F4A582"
SEEN = "#D1E5F0"
HEIGHTS = "magma_r"
WORST = "#000000"
ARROW = 0.06  # of the map's width
MARGIN_M = 0.4  # around what is drawn
MAP_IN = 1.8, 6.2  # least and greatest height of a map
COLUMNS = 4  # of sensors' views in a row
VIEW_IN = 1.6
STEEPEST_DEG = 80.0  # elevation of a silhouette's middle, whose proportions are true
FRAMES_IN = 2.3  # height of a row of plots over time
BEAMS = {  # as they are drawn: colour, size, mark, words
    BeamOutcome.PASSES: ("0.55", 5.0, ".", "passes"),
    BeamOutcome.RETURNS: ("#0072B2", 9.0, "o", "returns"),
    BeamOutcome.HIDDEN: ("#D55E00", 9.0, "x", "something stands before it"),
    BeamOutcome.UNSEEN: ("#CC79A7", 9.0, "+", "out of range or view"),
}


def draw_map(evidence: Evidence, rig: Rig, number: int) -> Markup | None:
    """A requirement's map around the vehicle; None if it has none. `number` tells it from others of the page."""
    seen = evidence.map
    if seen is None:
        return None
    low, high = _window(evidence, rig)
    width, height = high - low
    tall = float(np.clip((WIDTH_IN - LABELS_IN - BAR_IN) * height / width, *MAP_IN))

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        draw_mapped(seen, figure, axes)
        if evidence.zone:
            _draw_zone(axes, evidence.zone)
        draw_body(axes, evidence.body)
        sensor_dots(axes, rig, "top", 4)
        if evidence.verdict.worst:
            _mark_worst(axes, evidence.verdict, ARROW * float(width))
        finish_map(axes, low, high)

    name = label(evidence.verdict.name)
    return drawing(f"map-{number}", tall + LABELS_IN + TITLE_IN, f"{name}: map around the vehicle", draw)


def finish_map(axes: "Axes", low: Array, high: Array) -> None:
    """Limits and labels of a map in true proportions."""
    axes.set_aspect("equal")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)")


def _window(evidence: Evidence, rig: Rig) -> tuple[Array, Array]:
    """The lower and the upper corner (2,) of a map."""
    parts = [np.array([mount.position_m[:2] for mount in rig.mounts])]
    if evidence.body:
        parts += evidence.body.outlines_m
    if evidence.zone and evidence.zone.box_m is not None:
        parts.append(np.array(evidence.zone.box_m))
    if evidence.map:
        parts.append(evidence.map.at_m)
    if evidence.verdict.worst:
        parts.append(np.array([[evidence.verdict.worst.x_m, evidence.verdict.worst.y_m]]))
    points = np.concatenate(parts)
    return points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M


@singledispatch
def draw_mapped(seen: object, figure: "Figure", axes: "Axes") -> None:
    """What a map shows, by its type."""
    raise TypeError(type(seen).__name__)


@singledispatch
def caption_of(seen: object) -> str:
    """A sentence on what a map shows, by its type."""
    raise TypeError(type(seen).__name__)


def _returns_colours(demanded: int) -> "tuple[Colormap, Normalize]":
    """One scale of colours below what is demanded, another from there on."""
    from matplotlib.colors import LinearSegmentedColormap, ListedColormap, TwoSlopeNorm

    both = [LinearSegmentedColormap.from_list("part", ends)(np.linspace(0, 1, SHADES)) for ends in (SHORT, ENOUGH)]
    # counts are whole: what is demanded has the first of the colours of enough
    return ListedColormap(np.concatenate(both)), TwoSlopeNorm(demanded - 0.5, 0, 2 * demanded)


@caption_of.register(PlaceCounts)
def _(counts: PlaceCounts) -> str:
    positions = counted(len(counts.at_m), "position")
    return f"The returns at the {positions} of the base grid, each at its worst heading; dashed, the zone's edge."


@draw_mapped.register(PlaceCounts)
def _(counts: PlaceCounts, figure: "Figure", axes: "Axes") -> None:
    """A square for each position, as large as the grid's spacing there."""
    from matplotlib.collections import PolyCollection

    colours, scale = _returns_colours(counts.demanded)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    squares = counts.at_m[:, None] + corners * counts.side_m[:, None, None]
    drawn = PolyCollection(
        list(squares), array=np.minimum(counts.values, 2 * counts.demanded), cmap=colours, norm=scale, rasterized=True
    )
    drawn.set_linewidth(0.2)
    drawn.set_edgecolor("face")
    axes.add_collection(drawn)
    bar = figure.colorbar(drawn, ax=axes, shrink=0.9, label="returns, at the worst heading and phase")
    ticks = sorted({0, counts.demanded // 2, counts.demanded, round(1.5 * counts.demanded), 2 * counts.demanded})
    bar.set_ticks(
        ticks, labels=[f"{n}{' demanded' * (n == counts.demanded)}{' or more' * (n == ticks[-1])}" for n in ticks]
    )


@caption_of.register(PostVisibility)
def _(posts: PostVisibility) -> str:
    return f"Where a post 0.1 m wide and {posts.height_m:g} m high is seen in the worst phase, along each azimuth."


@draw_mapped.register(PostVisibility)
def _(posts: PostVisibility, figure: "Figure", axes: "Axes") -> None:
    draw_posts(axes, posts)


def draw_posts(axes: "Axes", posts: PostVisibility, legend: bool = True) -> None:
    """Where a post is seen, azimuth by azimuth: not yet, seen, or lost again."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    names = "not seen yet", "seen", "gap"
    colours = dict(zip(names, (UNSEEN, SEEN, GAP), strict=True))
    wedges = _wedges(posts)
    for name, kind in zip(names, (0, 1, 2), strict=True):
        some = [corners for corners, one in wedges if one == kind]
        axes.add_collection(PolyCollection(some, facecolor=colours[name], edgecolor=colours[name], lw=0.2))
    if legend:
        shown = [Patch(color=code, label=name) for name, code in colours.items()]
        axes.legend(handles=shown, loc="upper left", bbox_to_anchor=(1.01, 1.0))


def _wedges(posts: PostVisibility) -> list[tuple[Array, int]]:
    """Corners (4, 2) of stretches along each azimuth, and what they are: 0 not seen yet, 1 seen, 2 a gap."""
    kind = np.where(posts.gaps, 2, posts.seen.astype(np.int64))
    kind[~posts.places.counts] = -1
    half_rad = math.pi / len(kind)
    reach_m = posts.places.from_middle_m
    out = []
    for n, azimuth in enumerate(np.radians(posts.azimuth_deg)):
        middle_m = posts.places.places[n, 0, :2] - reach_m[n, 0] * np.array([math.cos(azimuth), math.sin(azimuth)])
        ends = [0, *(np.flatnonzero(np.diff(kind[n])) + 1).tolist(), kind.shape[1]]
        sides = [np.array([math.cos(azimuth + turn), math.sin(azimuth + turn)]) for turn in (-half_rad, half_rad)]
        for first, end in pairwise(ends):
            if kind[n, first] >= 0:
                near, far = reach_m[n, first] - POST_STEP_M / 2, reach_m[n, end - 1] + POST_STEP_M / 2
                corners = [near * sides[0], far * sides[0], far * sides[1], near * sides[1]]
                out.append((middle_m + np.array(corners), int(kind[n, first])))
    return out


@caption_of.register(HiddenColumns)
def _(hidden: HiddenColumns) -> str:
    return "The height above each point that the bodies hide from all sensors."


@draw_mapped.register(HiddenColumns)
def _(hidden: HiddenColumns, figure: "Figure", axes: "Axes") -> None:
    """The hidden height above each point."""
    low = hidden.at_m.min(axis=0)
    cell = np.rint((hidden.at_m - low) / hidden.side_m).astype(int)
    picture = np.full(cell.max(axis=0) + 1, np.nan)
    picture[cell[:, 0], cell[:, 1]] = hidden.height_m
    left, bottom = low - hidden.side_m / 2
    right, top = low + (cell.max(axis=0) + 0.5) * hidden.side_m
    most = max(float(hidden.height_m.max()), hidden.side_m)
    image = axes.imshow(picture.T, extent=(left, right, bottom, top), origin="lower", cmap=HEIGHTS, vmin=0, vmax=most)
    figure.colorbar(image, ax=axes, shrink=0.9, label="height in shadow (m)")


def draw_body(axes: "Axes", body: Footprint | None) -> None:
    """The vehicle's outline from above."""
    for outline in body.outlines_m if body else ():
        axes.fill(*outline.T, facecolor=(*EXCLUDED, 0.9), edgecolor="0.2", lw=0.9, zorder=1.5)


def _draw_zone(axes: "Axes", zone: StandZone) -> None:
    """The zone's edges."""
    if zone.box_m is not None:
        (left, bottom), (right, top) = zone.box_m
        axes.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], "k--", lw=0.8)
        return
    if zone.body is None or zone.within_m is None:
        return
    for distance_m in zone.within_m:
        if distance_m > 0:
            for ring in _outlines(zone.body.shape.buffer(distance_m)):
                axes.plot(*ring.T, "k--", lw=0.8)
    if zone.sector_rad is not None and zone.sector_rad[1] - zone.sector_rad[0] < 2 * math.pi:
        low, high = zone.body.bounds_m
        reach = float(np.linalg.norm(high - low)) / 2 + zone.within_m[1]
        for angle in zone.sector_rad:
            end = zone.body.middle_m + reach * np.array([math.cos(angle), math.sin(angle)])
            axes.plot(*np.array([zone.body.middle_m, end]).T, "k:", lw=0.8)


def _outlines(shape: Any) -> Iterable[Array]:
    return (shapely.get_coordinates(part.exterior) for part in shapely.get_parts(shape))


def _mark_worst(axes: "Axes", one: RequirementVerdict, arrow_m: float) -> None:
    """A ring at the worst place, with an arrow along the object's heading."""
    assert one.worst
    at = one.worst.x_m, one.worst.y_m
    if one.worst.heading_deg is not None:
        angle = math.radians(one.worst.heading_deg)
        end = at[0] + arrow_m * math.cos(angle), at[1] + arrow_m * math.sin(angle)
        axes.annotate("", end, at, arrowprops={"arrowstyle": "-|>", "color": WORST, "lw": 1.4}, zorder=4)
    axes.plot(*at, "o", mfc="none", mec="w", mew=3.2, ms=9, zorder=4)
    axes.plot(*at, "o", mfc="none", mec=WORST, mew=1.6, ms=9, zorder=4)


def draw_views(evidence: Evidence, number: int) -> Markup | None:
    """The worst place as each sensor sees it; None where there is nothing to see."""
    views = evidence.views
    if not views:
        return None
    columns = min(len(views), COLUMNS)
    rows = -(-len(views) // columns)

    def draw(figure: "Figure") -> None:
        grid = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
        for n, (axes, view) in enumerate(zip(grid, views, strict=False)):
            _draw_view(axes, view, n)
            if n % columns == 0:
                axes.set_ylabel("elevation (°)")
            if n >= len(views) - columns:
                axes.set_xlabel("azimuth (°)")
        for axes in grid[len(views) :]:
            axes.set_visible(False)
        _legend(figure, views)

    height = rows * (VIEW_IN + TITLE_IN + 0.35) + LABELS_IN
    name = label(evidence.verdict.name)
    return drawing(f"views-{number}", height, f"{name}: the worst place as each sensor sees it", draw)


def _draw_view(axes: "Axes", view: SensorView, number: int) -> None:
    """The object's silhouette, and the beams around it, as seen from the sensor: left is left."""
    from matplotlib.collections import PolyCollection

    beams = view.beams
    triangles = np.degrees(beams.triangles_rad)
    silhouette = PolyCollection(
        list(triangles), facecolor="0.86", edgecolor="0.86", lw=0.4, rasterized=len(triangles) > 500
    )
    axes.add_collection(silhouette)
    low, high = (extreme(axis=(0, 1)) for extreme in (triangles.min, triangles.max))
    size = high - low
    margin = np.maximum(0.2 * size, 2.0)
    margin[0] = max(margin[0], (0.6 * size[1] - size[0]) / 2)  # nowhere a sliver
    at = np.degrees(beams.at_rad)
    for outcome, (code, size, mark, _) in BEAMS.items():
        some = beams.outcome == outcome
        rasterized = int(some.sum()) > 400
        style: dict[str, Any] = {"lw": 0.9} if mark in "x+" else {"lw": 0}
        axes.scatter(at[some, 0], at[some, 1], s=size, c=code, marker=mark, rasterized=rasterized, **style)
    axes.set(xlim=(high[0] + margin[0], low[0] - margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))
    axes.set_aspect(1 / math.cos(math.radians(min(abs(low[1] + high[1]) / 2, STEEPEST_DEG))))  # a degree of azimuth
    gone = ", lost" if view.lost else ""
    axes.set_title(f"{label(view.name, 18)}: {beams.returns}{gone}", color=colour(number), fontsize=8)
    axes.tick_params(labelsize=7)


def _legend(figure: "Figure", views: Sequence[SensorView]) -> None:
    """The legend of the beams' marks that are drawn."""
    from matplotlib.lines import Line2D

    drawn = {BeamOutcome(int(code)) for view in views for code in np.unique(view.beams.outcome)}
    shown = [
        Line2D([], [], color=code, marker=mark, ls="", ms=math.sqrt(size) + 1, label=words)
        for outcome, (code, size, mark, words) in BEAMS.items()
        if outcome in drawn
    ]
    if shown:
        figure.legend(handles=shown, loc="outside lower center", ncols=len(shown), fontsize=7.5)


def draw_frames(evidence: Evidence, number: int) -> Markup | None:
    """A requirement's returns over time; None if it has none."""
    found = evidence.frames
    if found is None:
        return None
    name = label(evidence.verdict.name)
    height = FRAMES_IN * scenario_rows(found) + LABELS_IN
    return drawing(
        f"frames-{number}", height, f"{name}: returns in each frame", lambda figure: draw_scenario_on(figure, found)
    )


def map_caption(evidence: Evidence) -> str:
    """What a map shows, in words; none without a map."""
    if evidence.map is None:
        return ""
    one = evidence.verdict
    ring = " The ring is the worst place" if one.worst else ""
    if ring and one.worst and one.worst.heading_deg is not None:
        ring += ", the arrow the object's heading there"
    return f"{caption_of(evidence.map)}{ring}{'.' if ring else ''}"
