"""The key figures of a rig: what they are called, how they are written, and which of several rigs has the best.

Summaries, the terminal and comparisons are made from them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lidarcfg.report.describe import beams, beams_alone, describe_places, has_cones, vector
from lidarcfg.report.evaluation import FAR
from lidarcfg.report.inputs import Coverage
from lidarcfg.report.misses import describe_interval, percent
from lidarcfg.report.table import COUNT, Cell, Column, Row, Table, as_written
from lidarcfg.report.text import DRAWN, truncate
from lidarcfg.report.verdict import verdict_text
from lidarcfg.returns.post_visibility import PostVisibility
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation, Robustness
from lidarcfg.study.extrapolation import Extrapolated
from lidarcfg.study.study import Study


@dataclass(frozen=True)
class KeyFigure:
    """A figure with its name, format and unit."""

    column: Column
    value: Any  # a number, or a cell with words of its own
    detail: str = ""  # beside it where it stands alone; none: it is for comparisons
    rank: float | None = None  # less is better; None: neither is
    error: float = 0.0  # of the rank: what may be the best counts as such
    is_main: bool = False  # whether a summary has it

    @property
    def title(self) -> str:
        """The name at the beginning of a line."""
        return self.column.name[0].upper() + self.column.name[1:]

    @property
    def text(self) -> str:
        """The value with its unit."""
        return f"{self.cell.text} {self.column.unit}".rstrip()

    @property
    def cell(self) -> Cell:
        """The value with its format."""
        return self.column.cell(self.value)


def key_figures(
    study: Study,
    rig: Rig,
    found: Evaluation,
    coverage: Coverage | None = None,
    midpoint_max_vsr_m: float | None = None,
) -> list[KeyFigure]:
    """The figures of an evaluated rig; those of its coverage, and the midpoint of the bounds, where they are known."""
    max_vsr = max_vsr_figures(rig, found, midpoint_max_vsr_m)
    posts = [figure for posts in found.posts for figure in _posts(posts)]
    sight = list(_sight(found)) if study.visibility else []
    return [
        *_verdict(found),
        *_misses(found),
        _figure("sensors", COUNT, len(rig.mounts)),
        _figure("beams", COUNT, beams(rig)),
        *(_beside_misses(one, found) if has_cones(rig) else replace(one, detail="", is_main=False) for one in max_vsr),
        *_detection(study, found),
        *(_beside_misses(one, found) for one in (*posts, *sight)),
        *(_coverage(coverage) if coverage else []),
    ]


def _beside_misses(one: KeyFigure, found: Evaluation) -> KeyFigure:
    """A figure that summaries have only where misses are not known."""
    return replace(one, is_main=one.is_main and not found.misses)


def _figure(
    name: str,
    form: str,
    value: float,
    sign: int = 0,
    *,
    unit: str = "",
    of: str = "",
    detail: str = "",
    is_main: bool = False,
) -> KeyFigure:
    """A number, `of` an object or a zone; `sign`: 1 if more is better, −1 if less is."""
    rank = -sign * as_written(float(value), form) if sign else None
    column = Column(f"{name} {truncate(of, DRAWN)}".rstrip(), form, unit, (name, of))
    return KeyFigure(column, float(value), detail, rank, is_main=is_main)


def _verdict(found: Evaluation) -> Iterator[KeyFigure]:
    """Whether each requirement is met, and by how much."""
    for one in found.verdict.requirements if found.verdict else ():
        column = Column(truncate(one.name, DRAWN), ".6g", key=("verdict", one.name))
        yield KeyFigure(column, Cell(one.margin, verdict_text(one)), rank=-one.relative_margin)


def _misses(found: Evaluation) -> Iterator[KeyFigure]:
    """What is missed, over all objects and by object."""
    if found.misses:
        what = f"places where an object gets fewer than {found.misses.returns} returns"
        detail = f"{what}; {describe_interval(found.misses.interval)}"
        mean = _figure("misses", ".2%", found.misses.mean, -1, detail=detail, is_main=True)
        by_object = [_figure("misses of", ".2%", one.share, -1, of=one.name) for one in found.misses.objects]
        for one in (mean, *by_object):
            yield replace(one, value=Cell(one.value, percent(one.value)))


def max_vsr_figures(rig: Rig, found: Evaluation, midpoint_m: float | None) -> Iterator[KeyFigure]:
    """How large the gaps between beams are, the paper's measures."""
    worst = found.worst[0]
    largest = beams_alone(rig) or f"the paper's measure: the largest of {len(found.subspaces):,} subspaces"
    midpoint = "" if midpoint_m is None else f"; {midpoint_m:.6f} m at the midpoint of the bounds"
    yield _figure("max VSR", ".6f", found.max_vsr_m, -1, unit="m", detail=f"{largest}{midpoint}", is_main=True)
    if found.extrapolated:
        yield extrapolated_figure(found.extrapolated)
    for zone in found.zones:
        yield _figure("max VSR in", ".6f", zone.max_vsr_m, -1, unit="m", of=zone.name)
    if found.robustness:
        yield from _robustness(found.robustness)
    yield _figure("subspaces", COUNT, len(found.subspaces))
    yield _figure("volume of the worst", ".2f", worst.volume_m3, -1, unit="m³")
    at = f"of the largest sphere in the worst subspace, at {vector(worst.centroid_m, '.1f')} m"
    yield _figure("inner radius of the worst", ".3f", worst.inscribed_radius_m, -1, unit="m", detail=at, is_main=True)
    yield _figure("largest inner radius of any", ".3f", found.sphere_m, -1, unit="m")


def extrapolated_figure(found: Extrapolated) -> KeyFigure:
    """The max VSR for ever smaller cuboids, its error bar, and whether that is the tolerance asked for."""
    edges = " × ".join(f"{edge:g}" for edge in found.cuboid_m)
    part = found.error_m / found.max_vsr_m
    reached = f"within the tolerance of {found.tolerance:.3g}" if found.tolerance < 1 else "by two halvings"
    if not found.reached:
        reached = f"NOT within the tolerance of {found.tolerance:.3g}, but of {part:.2g}: no finer grid is tried"
    return KeyFigure(
        Column("max VSR, extrapolated", ".6f", "m"),
        Cell(found.max_vsr_m, f"{found.max_vsr_m:.6f} ± {found.error_m:.6f}"),
        f"± {part:.1%}, for ever smaller cuboids, {reached} ({found.cuboids:,} cuboids of {edges} m)",
        found.max_vsr_m,
        found.error_m,
        is_main=True,
    )


def _robustness(found: Robustness) -> Iterator[KeyFigure]:
    """The worst effects of failures and mounting errors."""
    if worst := found.worst:
        more = worst.max_vsr_m / found.whole.max_vsr_m - 1
        detail = f"that is {truncate(worst.lost or '')}: {more:+.1%}"
        yield _figure("max VSR with the worst LiDAR lost", ".6f", worst.max_vsr_m, -1, unit="m", detail=detail)
    for angles, far in zip((False, True), FAR, strict=True):
        growth_mm = 1e3 * found.largest_m(angles)
        detail = "at most, one coordinate of one mount"
        yield _figure(f"max VSR grows with a mount {far} off", ".1f", growth_mm, -1, unit="mm", detail=detail)


def _detection(study: Study, found: Evaluation) -> Iterator[KeyFigure]:
    """The rates of objects; beside misses, the paper's are for comparisons."""
    for item in study.detection:
        rate = found.detection[item.name]
        detail = describe_places(study, item, rate) if item.returns or not found.misses else ""
        yield _figure("detection of", ".4f", rate.rate, 1, of=item.name, detail=detail, is_main=bool(detail))


def _posts(posts: PostVisibility) -> Iterator[KeyFigure]:
    """Where a post is seen."""
    what = f"post of {posts.height_m:g} m"
    first_m = float(posts.first_seen_m[posts.known].max())
    gap_m = float(np.nanmax(posts.longest_gap_m))
    detail = f"from the body, at the worst azimuth, within {posts.limit_m:g} m; "
    detail += f"longest gap beyond {gap_m:.2f} m" if gap_m else "no gap beyond"
    first = _figure(f"{what}, first seen at most", ".2f", first_m, -1, unit="m", detail=detail, is_main=True)
    yield first if math.isfinite(first_m) else replace(first, value=Cell(first_m, "never"))
    yield _figure(f"{what}, longest gap", ".2f", gap_m, -1, unit="m")


def _sight(found: Evaluation) -> Iterator[KeyFigure]:
    """Volumes by the number of LiDARs that see them."""
    none, one, *more = found.seen_by_m3.tolist()
    part = none / float(found.seen_by_m3.sum())
    detail = f"seen by no sensor, whatever its beams: {part:.2%} of the region"
    yield _figure("shadow", ",.2f", none, -1, unit="m³", detail=detail, is_main=True)
    yield _figure("volume seen by one LiDAR", ",.2f", one, unit="m³")
    yield _figure("volume seen by two or more", ",.2f", sum(more), 1, unit="m³")


def _coverage(found: Coverage) -> Iterator[KeyFigure]:
    """Beams across upright lines of cuboids."""
    yield _figure("beams across an upright pole, median", "g", found.median_beams, 1)
    yield _figure("positions with no beam", ".2%", found.by_none, -1)
    yield _figure("positions with one sensor's beams", ".2%", found.by_one_sensor, -1)


def figures_table(figures: Sequence[KeyFigure]) -> Table:
    """A row for each figure that stands alone."""
    rows: list[Row] = [[figure.column.head, figure.cell, figure.detail] for figure in figures if figure.detail]
    return Table("Key figures", [Column("figure"), Column("value", ".6f"), Column("")], rows)


def compared_rows(rigs: Sequence[Sequence[KeyFigure]]) -> list[Row]:
    """A row for each figure that all rigs have; the best of a row is marked, unless all are alike."""
    by_key = [{figure.column.keys: figure for figure in figures} for figures in rigs]
    of_each = [[known.get(figure.column.keys) for known in by_key] for figure in rigs[0]]
    known_of_all = [[one for one in ones if one] for ones in of_each if all(ones)]
    return [[ones[0].column.head, *_marked(ones)] for ones in known_of_all]


def _marked(figures: Sequence[KeyFigure]) -> list[Cell]:
    """The figures of one kind as cells, the best of them marked; none if all are alike."""
    ranks = [(figure.rank, figure.error) for figure in figures if figure.rank is not None]
    reach = min((rank + error for rank, error in ranks), default=0.0)
    best = [rank - error <= reach for rank, error in ranks]
    if all(best):
        return [figure.cell for figure in figures]
    return [replace(figure.cell, mark="best" if one else "") for figure, one in zip(figures, best, strict=True)]


def summary(figures: Sequence[KeyFigure], baseline: Sequence[KeyFigure] = ()) -> list[KeyFigure]:
    """The main figures, each with the baseline's beside it."""
    known = {figure.column.keys: f"; the baseline: {figure.text}" for figure in baseline}
    return [replace(one, detail=one.detail + known.get(one.column.keys, "")) for one in figures if one.is_main]
