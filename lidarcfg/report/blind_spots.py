"""Blind spots in a report, by posts around the vehicle; and what no sensor sees whatever its beams."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from lidarcfg.geometry import Array
from lidarcfg.report.canvas import (
    LABELS_IN,
    WIDTH_IN,
    draw_values,
    drawing,
    height_in,
    panels,
    panels_in,
    sensor_dots,
)
from lidarcfg.report.evidence import draw_body, draw_posts, finish_map
from lidarcfg.report.table import Cell, Column, Table
from lidarcfg.report.text import MANY
from lidarcfg.returns.post_visibility import AZIMUTHS, WIDTH_M, PostVisibility
from lidarcfg.returns.post_visibility import STEP_M as POST_STEP_M
from lidarcfg.sensors.rig import Rig
from lidarcfg.vsr.subspaces import Subspaces
from lidarcfg.world.footprint import Footprint

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAP = "magma_r"
MARGIN_M = 0.5  # shown around the posts
FEW = 4  # of very many LiDARs: the volumes that fewer see are listed one by one


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


def volumes_table(seen_by_m3: Array) -> Table:
    """The volume by the number of LiDARs that see it (LiDARs + 1,); of very many LiDARs, FEW or more are one row."""
    total = float(seen_by_m3.sum())
    volumes: list[tuple[str, float]] = [(f"{n}", volume) for n, volume in enumerate(seen_by_m3.tolist())]
    if len(volumes) > MANY + 1:
        volumes = [*volumes[:FEW], (f"{FEW} or more", float(seen_by_m3[FEW:].sum()))]
    columns = [Column("LiDARs"), Column("volume", ",.2f", "m³"), Column("part", ".2%")]
    rows = [[name, volume, volume / total] for name, volume in volumes]
    return Table("The region's volume by the number of LiDARs that see it", columns, rows)


def draw_unseen(subspaces: Subspaces, rig: Rig) -> Markup:
    """A map of the unseen height: how much of each upright line of cuboids no LiDAR sees, in metres."""
    region = subspaces.region
    blind = (subspaces.seen_by == 0) & region.included
    metres = np.where(region.included.any(axis=2), blind.sum(axis=2) * region.cuboid_m[2], np.nan)
    size = region.max_m - region.min_m
    tall = float(np.clip((WIDTH_IN - LABELS_IN) * size[1] / size[0], 1.4, 3.5))

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        most = max(float(np.nanmax(metres)), float(region.cuboid_m[2]))
        image = draw_values(axes, region, metres, "top", cmap=MAP, vmin=0, vmax=most)
        sensor_dots(axes, rig, "top", 4)
        axes.set(xlabel="x (m)", ylabel="y (m)", title="unseen height (m)")
        figure.colorbar(image, label="m")

    return drawing("unseen", height_in(tall), "a map of how much is hidden above each position", draw)
