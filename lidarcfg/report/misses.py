"""What rigs miss, side by side: a table by object, in words, and maps from above."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.report.canvas import BAR_IN, LABELS_IN, TITLE_IN, WIDTH_IN, drawing, label, sensor_dots
from lidarcfg.report.evidence import draw_body, finish_map
from lidarcfg.report.table import Cell, Column, Row, Table
from lidarcfg.report.text import truncate
from lidarcfg.returns.missed_map import missed_map
from lidarcfg.returns.misses import Z_95, Interval, MissesFound, ObjectMisses
from lidarcfg.search.run import Believed, Placement
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation
from lidarcfg.study.study import Study
from lidarcfg.world.footprint import Footprint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize
    from matplotlib.figure import Figure

THIS = "this rig"
PLAIN = "best plain rig"
MIDPOINT = "middle of the bounds"
BASELINE = "baseline"
# from nothing missed to everything, at even steps of the share's square root, as most shares are small
COLOURS = ("#E8EEF2", "#FDD49E", "#FC8D59", "#D7301F", "#7F0000")
TICKS = 0.0, 0.01, 0.05, 0.1, 0.25, 0.5, 1.0
MISSED = "#08306B"  # a place of the worst object
LIKELY = 0.5  # from this probability on a place is marked
DOTS_MAX = 1000  # beyond which they are drawn as an image
LEGEND_IN = 0.25


@dataclass(frozen=True)
class SeenBy:
    """A rig and what it misses."""

    title: str
    rig: Rig
    misses: MissesFound

    def is_at(self, other: "SeenBy") -> bool:
        """Whether both rigs' sensors have the same poses."""
        one, two = ([(mount.position_m, mount.rpy_rad) for mount in rig.mounts] for rig in (self.rig, other.rig))
        return one == two


def rigs_seen(
    study: Study,
    rig: Rig,
    found: Evaluation,
    placement: Placement | None = None,
    baseline: tuple[Rig, Evaluation] | None = None,
) -> tuple[SeenBy, ...]:
    """A rig, then what it is compared with: the best plain rig of its search, the baseline, the middle of the bounds.

    None without a vehicle, or where sensors lack facts.
    """
    if found.misses is None:
        return ()
    rigs = [SeenBy(THIS, rig, found.misses)]
    told = placement.believed if placement else None
    if told and told.plain:
        rigs.append(SeenBy(PLAIN, told.plain.rig, told.plain.misses))
    if baseline and baseline[1].misses:
        rigs.append(SeenBy(BASELINE, baseline[0], baseline[1].misses))
    if middle := _midpoint(study, told):
        rigs.append(middle)
    return tuple(rigs)


def _midpoint(study: Study, told: Believed | None) -> SeenBy | None:
    """The rig at the midpoint of the bounds; None where its sensors are yet to be chosen, or lack facts."""
    if study.misses is None or study.to_choose:
        return None
    rig = study.rig(study.space.midpoint)
    if told:
        return SeenBy(MIDPOINT, rig, told.midpoint)
    try:
        return SeenBy(MIDPOINT, rig, study.misses.found(rig.mounts))
    except ConfigError:
        return None


def percent(share: float) -> str:
    """A share of places."""
    return f"{share:.2%}".replace("%", " %")


def cell(share: float, interval: Interval) -> str:
    """A share with its interval of 95 %, in per cent."""
    low, high = interval
    return f"{percent(share)} ({100 * low:.2f} … {100 * high:.2f})"


def describe_interval(interval: Interval) -> str:
    """An interval of 95 % in words."""
    low, high = interval
    return f"95 % interval {100 * low:.2f} … {100 * high:.2f} %"


def describe_misses(found: MissesFound) -> str:
    """What misses are, and at which places they are counted."""
    near_m, far_m = found.within_m
    return (
        f"the share of places where an object gets fewer than {found.returns} returns in a revolution; "
        f"{len(found.objects[0].places):,} places of each object that no search has seen, {near_m:g} to {far_m:g} m "
        "from the body, at any heading"
    )


def misses_table(rigs: Sequence[SeenBy]) -> Table:
    """What each rig misses: a row for each object, and the last for their mean."""
    first = rigs[0].misses
    alike = len(set(first.weights.tolist())) == 1
    rows: list[Row] = []
    for number, one in enumerate(first.objects):
        each = [rig.misses.objects[number] for rig in rigs]
        name = Cell(one.name, truncate(one.name) + (f" × {one.weight:g}" if not alike else ""))
        rows.append([name, *(Cell(item.share, cell(item.share, item.interval)) for item in each)])
    totals = [Cell(rig.misses.mean, cell(rig.misses.mean, rig.misses.interval), mark="total") for rig in rigs]
    rows.append(["mean" if alike else "weighted mean", *totals])
    caption = f"Misses: {describe_misses(first)}. In brackets: the interval of 95 %"
    return Table(caption, [Column("misses"), *(Column(rig.title, ".2%") for rig in rigs)], rows)


def compared_with(rigs: Sequence[SeenBy]) -> SeenBy | None:
    """The first of the rigs that the first one is compared with, and that is another."""
    return next((one for one in rigs[1:] if not one.is_at(rigs[0])), None)


def misses_lines(study: Study, rigs: Sequence[SeenBy], placement: Placement | None = None) -> list[str]:
    """How much better the first rig is than another, and what its search believed."""
    lines = [_comparison(rigs)]
    if placement and placement.believed:
        lines.append(_belief(study, placement, placement.believed))
    return lines


def _comparison(rigs: Sequence[SeenBy]) -> str:
    own = rigs[0]
    same = [one.title for one in rigs[1:] if one.is_at(own)]
    what = f"This rig is the {same[0]}. It" if same else "This rig"
    said = f"{what} misses {percent(own.misses.mean)}"
    other = compared_with(rigs)
    if other is None:
        return f"{said}."
    less, error = own.misses.compared(other.misses)
    half = Z_95 * error
    told = f"the difference is {100 * abs(less):.2f} ± {100 * half:.2f} percentage points (95 %)"
    than = f"the {other.title} ({percent(other.misses.mean)})"
    if abs(less) <= half:
        return f"{said}, no better or worse than {than} as far as these places tell: {told}."
    part = _part(abs(less) / other.misses.mean) if other.misses.mean else ""
    return f"{said}, {part}{'fewer' if less > 0 else 'more'} than {than}; {told}."


def _part(fraction: float) -> str:
    """A fraction in per cent, and a blank; 100 % only of all."""
    return f"{min(100 * fraction, 99.9):.1f} % " if 0.99 <= fraction < 1 else f"{100 * fraction:.0f} % "


def _belief(study: Study, found: Placement, told: Believed) -> str:
    """What the search believed, beside the figure at fresh places."""
    believed, fresh = (percent(one) if study.is_misses else f"{one:.4f}" for one in (told.objective, found.objective))
    what = "it misses" if study.is_misses else "its objective is"
    places = f"the {told.places:,} places of each object that it counted at"
    if told.plain and found.objective == told.plain.objective:
        return f"The search believed {believed} of its best rig, from {places}; at fresh places that rig is no better."
    return f"The search believed {believed} of it, from {places}; at fresh places {what} {fresh}."


def colours(share: Array) -> NDArray[np.uint8]:
    """(n, 3) the colours of shares (n,), red, green and blue."""
    stops = np.array([tuple(bytes.fromhex(code[1:])) for code in COLOURS])
    at = np.linspace(0, 1, len(COLOURS))
    return np.stack([np.rint(np.interp(np.sqrt(share), at, stops[:, axis])) for axis in range(3)], 1).astype(np.uint8)


def _scale() -> "tuple[Colormap, Normalize]":
    """The same for matplotlib."""
    from matplotlib.colors import LinearSegmentedColormap, PowerNorm

    return LinearSegmentedColormap.from_list("missed", COLOURS), PowerNorm(0.5, 0.0, 1.0)


def worst_object(found: MissesFound) -> ObjectMisses:
    """The object that is missed most."""
    return max(found.objects, key=lambda one: one.share)


def draw_misses(body: Footprint | None, rigs: Sequence[SeenBy]) -> Markup:
    """Maps around the vehicle, one for each of at most two rigs: what is missed where, by the same colours."""
    shown = missed_map(rigs[0].misses)
    width, height = shown.high_m - shown.low_m
    across = (WIDTH_IN - LABELS_IN - BAR_IN) / 2
    tall = across * float(height / width)
    names = " and ".join(one.title for one in rigs)

    def draw(figure: "Figure") -> None:
        every = figure.subplots(1, 2, sharex=True, sharey=True, squeeze=False)[0]
        for axes in every[len(rigs) :]:
            axes.set_visible(False)
        for axes, one in zip(every, rigs, strict=False):
            _draw_map(axes, one, worst_object(rigs[0].misses).name)
            draw_body(axes, body)
            sensor_dots(axes, one.rig, "top", 3.5)
            finish_map(axes, shown.low_m, shown.high_m)
            axes.set_title(f"{one.title}: misses {percent(one.misses.mean)}")
        every[0].label_outer()
        every[1].label_outer()
        _draw_legend(figure, every[: len(rigs)])

    return drawing(
        "misses", tall + LABELS_IN + TITLE_IN + LEGEND_IN, f"what is missed where, from above: {names}", draw
    )


def _draw_map(axes: "Axes", one: SeenBy, name: str) -> None:
    """The share of objects missed in each cell, and the places at which one of them is likely missed."""
    cells = missed_map(one.misses)
    (left, bottom), (right, top) = cells.low_m, cells.high_m
    colours, scale = _scale()
    axes.imshow(cells.share.T, extent=(left, right, bottom, top), origin="lower", cmap=colours, norm=scale)
    item = next(item for item in one.misses.objects if item.name == name)
    x, y = item.places[item.probability >= LIKELY][:, :2].T
    axes.plot(x, y, ".", color=MISSED, ms=2.2, mew=0, label=f"{label(name)} missed", rasterized=len(x) > DOTS_MAX)


def _draw_legend(figure: "Figure", every: "Sequence[Axes]") -> None:
    """What colours and dots mean."""
    from matplotlib.cm import ScalarMappable

    colours, scale = _scale()
    bar = figure.colorbar(ScalarMappable(scale, colours), ax=list(every), shrink=0.9, label="of objects, missed here")
    bar.set_ticks(TICKS, labels=[f"{share:.0%}".replace("%", " %") for share in TICKS], minor=False)
    where: Literal["outside lower center"] = "outside lower center"
    figure.legend(handles=[every[0].lines[0]], loc=where, markerscale=3)
