"""Blind spots in a report, by posts around the vehicle; and the shadow: volumes, and contours from above."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from lidarcfg.geometry import Array
from lidarcfg.placement.blind_spots import AZIMUTHS, BlindSpots, Contour, Directions
from lidarcfg.placement.region import Region
from lidarcfg.placement.subspace import Subspaces
from lidarcfg.report.canvas import (
    EXCLUDED,
    LABELS_IN,
    WIDTH_IN,
    colour,
    dashes,
    drawing,
    extent,
    height_in,
    label,
    panels,
    panels_in,
    sensor_dots,
    thinned,
)
from lidarcfg.report.evidence import draw_body, draw_posts, finish_map
from lidarcfg.report.html import KeyFigure
from lidarcfg.report.table import Cell, Column, Table
from lidarcfg.requirements.post_visibility import STEP_M as POST_STEP_M
from lidarcfg.requirements.post_visibility import WIDTH_M, PostVisibility
from lidarcfg.sensors.rig import Rig
from lidarcfg.world.footprint import Footprint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

SIDES = {"ahead": 0, "left": 90, "behind": 180, "right": 270}  # azimuths in degrees
MAP = "magma_r"
MARGIN_M = 0.5  # shown around the largest contour
LEGEND_IN = 1.4  # beside the contours


def post_figure(posts: PostVisibility) -> KeyFigure:
    """The blind spot for a post in a summary."""
    value = "never seen at some azimuths"
    if np.isfinite(posts.first_seen_m[posts.known]).all():
        value = f"seen from {np.nanmax(posts.first_seen_m):.2f} m on"
    gap_m = float(np.nanmax(posts.longest_gap_m))
    beyond = f"longest gap beyond {gap_m:.2f} m" if gap_m else "no gap beyond"
    detail = f"from the body, at the worst azimuth, within {posts.limit_m:g} m; {beyond}"
    return KeyFigure(f"Blind spot, a post of {posts.height_m:g} m", value, detail)


def posts_table(found: Sequence[PostVisibility]) -> Table:
    """First seen, gaps, and seen without gaps to, by the height of a post."""
    rows = []
    for posts in found:
        first = np.where(posts.known, posts.first_seen_m, -1.0)
        worst = int(first.argmax())
        gap = np.where(posts.known, posts.longest_gap_m, -1.0)
        widest = int(gap.argmax())
        to = np.where(posts.known, posts.seen_to_m, np.inf)
        least = int(to.argmin())
        azimuth = posts.azimuth_deg
        rows.append(
            [
                Cell(posts.height_m, f"{posts.height_m:g} m"),
                _at(first[worst], azimuth[worst]),
                _at(gap[widest], azimuth[widest]) if gap[widest] else "none",
                posts.gap_share,
                _at(to[least], azimuth[least]),
            ]
        )
    columns = [
        Column("post"),
        Column("first seen", ".2f", "m"),
        Column("longest gap", ".2f", "m"),
        Column("gaps' share", ".2%"),
        Column("seen without gaps to", ".2f", "m"),
    ]
    count = int(found[0].places.counts.sum())
    where = (
        f"within {found[0].limit_m:g} m of the body: {count:,} places, {POST_STEP_M:g} m apart on {AZIMUTHS} azimuths"
    )
    return Table(f"Blind spots: where a post {WIDTH_M:g} m wide is seen in the worst phase, {where}", columns, rows)


def _at(value: float, azimuth_deg: float) -> Cell:
    text = f"never at {azimuth_deg:.0f}°" if np.isinf(value) else f"{value:.2f} at {azimuth_deg:.0f}°"
    return Cell(float(value), text)


def draw_posts_by_height(body: Footprint, rig: Rig, found: Sequence[PostVisibility]) -> Markup:
    """Where posts of each height are seen around the body."""
    points = np.concatenate([posts.places.places[posts.places.counts][:, :2] for posts in found])
    low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    width, height = high - low
    columns = min(len(found), 3)

    def draw(figure: "Figure") -> None:
        figure.set_layout_engine("compressed")
        grid = panels(figure, len(found), columns)
        for posts, axes in zip(found, grid, strict=True):
            draw_posts(axes, posts, legend=False)
            draw_body(axes, body)
            sensor_dots(axes, rig, "top", 3)
            finish_map(axes, low, high)
            axes.set_title(f"a post of {posts.height_m:g} m")
            axes.label_outer()

    each = float(np.clip((WIDTH_IN - LABELS_IN) / columns * height / width, 1.5, 4.5))
    return drawing("posts", panels_in(each, -(-len(found) // columns)), "where posts are seen around the vehicle", draw)


def volumes_table(blind: BlindSpots) -> Table:
    """The volume by the number of LiDARs that see it."""
    total = float(blind.seen_by_m3.sum())
    rows = [[n, volume, volume / total] for n, volume in enumerate(blind.seen_by_m3.tolist())]
    columns = [Column("LiDARs", ",.0f"), Column("volume", ",.2f", "m³"), Column("part", ".2%")]
    return Table("The region's volume by the number of LiDARs that see it", columns, rows)


def contours_table(blind: BlindSpots) -> Table:
    """How far the shadow reaches at each height."""
    rows = [
        [
            Cell(contour.directions.height_m, f"{contour.directions.height_m:g} m"),
            Cell(
                contour.largest_m,
                f"{_distance(contour, int(contour.largest_at_deg)).text} at {contour.largest_at_deg:.0f}°",
            ),
            *(_distance(contour, azimuth) for azimuth in SIDES.values()),
            contour.area_m2,
        ]
        for contour in blind.contours
    ]
    distances = [Column(side, ".2f", "m") for side in ("largest", *SIDES)]
    columns = [Column("above the ground"), *distances, Column("area", ".2f", "m²")]
    return Table("Shadow: how far from the body something may stay hidden, whatever the beams", columns, rows)


def _distance(contour: Contour, azimuth: int) -> Cell:
    """The distance at an azimuth in degrees; where it ends at the region's edge, at least that."""
    distance = float(contour.distance_m[azimuth])
    if np.isnan(distance):
        return Cell(None, "–")
    return Cell(distance, f"{'≥ ' if contour.reaches_edge[azimuth] else ''}{distance:.2f}")


def contours_view(axes: "Axes", region: Region, rig: Rig, contours: Sequence[Contour]) -> None:
    """The body's outline and the contours around it, from above."""
    around = contours[0].directions
    for i, contour in enumerate(contours):
        x, y = _ring(contour.directions, np.nan_to_num(contour.distance_m))
        name = f"{contour.directions.height_m:g} m"
        axes.fill(x, y, facecolor=colour(i), alpha=0.12)
        axes.plot(x, y, color=colour(i), lw=1.2, ls=dashes(i), label=name)
    if around.outline_m.any():
        axes.fill(*_ring(around, 0.0), facecolor=EXCLUDED, edgecolor="0.25", lw=0.8)
    sensor_dots(axes, rig, "top", 5)
    left, right, bottom, top = extent(region, "top")
    axes.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], color="0.6", lw=0.8, ls=":")
    axes.set_aspect("equal")
    axes.grid(True)
    axes.set(xlabel="x (m)", ylabel="y (m)")


def _ring(around: Directions, beyond_m: Array | float) -> tuple[Array, Array]:
    """A closed line (AZIMUTHS + 1,) around the reference point, at these distances beyond the outline."""
    angle = np.append(np.arange(AZIMUTHS), 0) * (2 * np.pi / AZIMUTHS)
    reach = around.outline_m + beyond_m
    reach = np.append(reach, reach[0])
    return around.center_m[0] + reach * np.cos(angle), around.center_m[1] + reach * np.sin(angle)


def window(contours: Sequence[Contour], rigs: Sequence[Rig]) -> tuple[Array, Array]:
    """The corners (2,) of a window around contours, body and sensors."""
    rings = [np.stack(_ring(c.directions, np.nan_to_num(c.distance_m)), axis=1) for c in contours]
    sensors = np.array([mount.position_m[:2] for rig in rigs for mount in rig.mounts])
    points = np.concatenate([*rings, sensors])
    low = points.min(axis=0)
    high = points.max(axis=0)
    return low - MARGIN_M, high + MARGIN_M


def draw_blind_spots(subspaces: Subspaces, rig: Rig, blind: BlindSpots) -> Markup:
    """The contours around the body, and a map of the hidden height at each position."""
    region = subspaces.region
    low, high = window(blind.contours, [rig])
    width, height = high - low
    size = region.max_m - region.min_m
    wide = WIDTH_IN - LABELS_IN - LEGEND_IN
    tall = float(np.clip(wide * height / width, 2.2, 5.5))
    flat = float(np.clip(wide * size[1] / size[0], 1.4, 3.5))

    def draw(figure: "Figure") -> None:
        heights = (tall + LABELS_IN, flat + LABELS_IN)
        (above,), (below,) = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)
        axes = above.subplots()
        contours_view(axes, region, rig, blind.contours)
        axes.set(
            xlim=(low[0], high[0]), ylim=(low[1], high[1]), title="contours of the shadow; gaps between beams aside"
        )
        axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), title="above the ground")
        _draw_heights(below, subspaces, rig)

    alt = (
        "the contours of the shadow around the vehicle from above, and a map of how much is hidden above each position"
    )
    return drawing("blind", height_in(tall, flat), alt, draw)


def _draw_heights(figure: "SubFigure", subspaces: Subspaces, rig: Rig) -> None:
    """A map of the unseen height: how much of each upright line of cuboids no LiDAR sees, in metres."""
    axes = figure.subplots()
    region = subspaces.region
    blind = (subspaces.seen_by == 0) & region.included
    metres = np.where(region.included.any(axis=2), blind.sum(axis=2) * region.cuboid_m[2], np.nan)
    around = extent(region, "top")
    look: dict[str, Any] = {"cmap": MAP, "vmin": 0, "vmax": max(float(np.nanmax(metres)), float(region.cuboid_m[2]))}
    image = axes.imshow(thinned(metres).T, extent=around, origin="lower", aspect="auto", **look)
    sensor_dots(axes, rig, "top", 4)
    axes.set(xlim=around[:2], ylim=around[2:], facecolor=(*EXCLUDED, 0.4), xlabel="x (m)", ylabel="y (m)")
    axes.set_title("unseen height (m)")
    figure.colorbar(image, label="m")


def compare_contours(region: Region, named: Sequence[tuple[str, Rig, BlindSpots]]) -> Markup:
    """The contours of each rig, on one scale."""
    low, high = window([c for _, _, blind in named for c in blind.contours], [rig for _, rig, _ in named])
    width, height = high - low

    def draw(figure: "Figure") -> None:
        figure.set_layout_engine("compressed")
        grid = panels(figure, len(named))
        for n, ((name, rig, blind), axes) in enumerate(zip(named, grid, strict=True)):
            contours_view(axes, region, rig, blind.contours)
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), title=label(name, 40))
            axes.label_outer()
            axes.set_ylabel("y (m)" if n % 2 == 0 else "")
        grid[0].legend(fontsize=7, title="above the ground", title_fontsize=7)

    wide = WIDTH_IN - LABELS_IN
    each = float(np.clip(wide / 2 * height / width, 1.5, 4.5))
    return drawing("blind", panels_in(each, -(-len(named) // 2)), "the contours of the shadow of each rig", draw)
