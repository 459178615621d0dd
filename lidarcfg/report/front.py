"""The front of price against objective: files, one page, a folder for each point, and the log to resume from."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from lidarcfg import __version__
from lidarcfg.config.document import yaml_text
from lidarcfg.files import remove_outdated
from lidarcfg.geometry import Array
from lidarcfg.report.canvas import EXCLUDED, MARKERS, STYLE, WIDTH_IN, colour, drawing, shade_excluded
from lidarcfg.report.describe import counted, date, describe_objective, describe_solver, price
from lidarcfg.report.inputs import report_inputs
from lidarcfg.report.key_figures import KeyFigure
from lidarcfg.report.misses import percent
from lidarcfg.report.page import PageSection, facts, figure, page
from lidarcfg.report.plots import CUT_OFF, new_figure, save_figure
from lidarcfg.report.repeat import repeat_section
from lidarcfg.report.results import RESULTS, save_placement, save_progress, to_json, write_history, write_text
from lidarcfg.report.rig_report import Commands
from lidarcfg.report.table import COUNT, PRICE, Cell, Column, Row, Table, named
from lidarcfg.report.terminal import print_table, terminal
from lidarcfg.report.text import DRAWN, truncate
from lidarcfg.search.front import Candidate, Front, Point
from lidarcfg.search.log import SearchLog
from lidarcfg.study.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STUDY = "study.yaml"
POINT = (STUDY, *RESULTS)  # the files of a point
PICTURES_MAX = 8  # of rigs, in a row
PICTURE_IN = WIDTH_IN / PICTURES_MAX
PLOT_IN = 3.4
MARGIN = 0.12  # around a rig, as a fraction of its extent
GREY = "0.6"
LEGEND_COLUMNS = 5


def front_dict(study: Study, found: Front) -> dict[str, Any]:
    """What `optimize` writes as front.json where there are sensors to choose."""
    return {
        "objective": describe_objective(study),
        "points": [{"detection": {}} | record for record in points_table(study, found).records],
        "combinations": candidates_table(found).records,
        "evaluations": found.evaluations,
        "dominated_evaluations": found.dominated_evaluations,
        "seconds": found.seconds,
        "interrupted": found.interrupted,
        "seed": study.solver.seed,
        "solver": study.solver.method,
        "version": __version__,
        "study": study.file,
    }


def points_table(study: Study, found: Front) -> Table:
    """A row for each rig on the front."""
    columns = [
        Column("price", PRICE),
        Column("objective", ".6f"),
        Column("misses", ".2%"),
        Column("max VSR", ".6f", "m", "max_vsr_m"),
        *(Column(f"detection of {truncate(one.name)}", ".4f", key=("detection", one.name)) for one in study.detection),
        Column("sensors"),
        Column("rigs tried", COUNT, key="evaluations"),
        Column("name"),
        Column("folder"),
    ]
    rows: list[Row] = []
    for point in found.points:
        name = point.combination.name
        folder = f"points/{name}"
        evaluation = point.placement.evaluation
        rows.append(
            [
                point.combination.price,
                point.placement.objective,
                Cell(missed.mean, percent(missed.mean)) if (missed := evaluation.misses) else None,
                evaluation.max_vsr_m,
                *(evaluation.detection[one.name].rate for one in study.detection),
                point.combination.sensors,
                point.placement.evaluations,
                named(name),
                Cell(folder, f"points/{truncate(name)}", link=f"{folder}/report.html"),
            ]
        )
    return Table("The rigs that no other is both cheaper and better than; each has a report of its own.", columns, rows)


def _shown_points(study: Study, found: Front) -> Table:
    """The columns of the points that people read."""
    every = points_table(study, found)
    if not all(point.placement.evaluation.misses for point in found.points):
        return every.without("name", "misses")
    paper = [column.name for column in every.columns if column.keys[0] in ("max_vsr_m", "detection")]
    return every.without("name", *paper, *["objective"] * study.is_misses)


def candidates_table(found: Front) -> Table:
    """A row for each combination, and whether it is on the front."""
    columns = [
        Column("price", PRICE),
        Column("sensors"),
        Column("objective", ".6f"),
        Column("evaluations", COUNT),
        Column("name"),
        Column("standing", key="on_front"),
    ]
    rows = [
        [
            one.combination.price,
            one.combination.sensors,
            one.objective if math.isfinite(one.objective) else None,
            one.evaluations,
            named(one.combination.name),
            Cell(one.on_front, _standing(found, one)),
        ]
        for one in found.candidates
    ]
    return Table(
        "All combinations, as the search saw them; of those not on the front few rigs were evaluated.", columns, rows
    )


def print_front(study: Study, found: Front) -> None:
    """Print a line for each rig on the front, and what the search spent."""
    print_table(_shown_points(study, found))
    console = terminal()
    tried = sum(one.evaluations > 0 for one in found.candidates)
    all_of_them = counted(len(found.candidates), "combination")
    console.print(f"{counted(len(found.points), 'rig')} on the front; {tried} of {all_of_them} tried")
    console.print(
        f"{found.evaluations:,} evaluations, {found.dominated_evaluations:,} of them of combinations not on the front; "
        f"{found.seconds:.1f} s"
    )


def save_front(
    study: Study, found: Front, folder: Path, commands: Commands, on_point: Callable[[int, Point], None]
) -> None:
    """Write front.html, front.json, front.png, history.csv, search.npz, and points/ with a folder for each point.

    `on_point` is called before each point's folder is written.
    """
    save_front_progress(study, found.log, folder)
    values = front_dict(study, found)
    names = {point.combination.name for point in found.points}
    remove_outdated(path for path in _points(folder) if path.parent.name not in names)
    for number, point in enumerate(found.points):
        on_point(number, point)
        _save_point(point, folder / "points" / point.combination.name, commands)
    write_text(to_json(values) + "\n", folder / "front.json")
    write_history(found.history, folder)
    save_figure(draw_front(study, found), folder / "front.png")
    write_text(front_page(study, found, values, commands), folder / "front.html")
    for other in (folder / "points").glob("*"):
        with suppress(OSError):  # one that holds files stays
            other.rmdir()


def _save_point(point: Point, folder: Path, commands: Commands) -> None:
    """Write the study of a combination, and the results of its search as `optimize` writes them."""
    study = point.combination.study
    found = point.placement
    shown = report_inputs(study, found.rig, found.evaluation, found.midpoint_max_vsr_m)
    write_text(yaml_text(study.file), folder / STUDY)
    save_placement(study, found, shown, folder, commands)


def _points(folder: Path) -> Iterator[Path]:
    """The files that an earlier search may have written of its points."""
    return (point / name for point in (folder / "points").glob("*") for name in POINT)


def save_front_progress(study: Study, log: SearchLog, folder: Path) -> None:
    """Write search.npz as save_progress does; of points of an earlier front nothing remains."""
    save_progress(study, log, folder)
    remove_outdated(_points(folder))


def front_page(study: Study, found: Front, values: dict[str, Any], commands: Commands) -> str:
    """The front as one HTML file beside the folder points/. Raises ConfigError if SOURCE_DATE_EPOCH is not a time."""
    cheapest = found.points[0]
    best = found.points[-1]
    tried = sum(one.evaluations > 0 for one in found.candidates)
    drawn = figure(
        front_svg(study, found),
        "Each dot is a combination of sensors with the best rig found for it: blue on the front, grey is dominated: "
        "another costs no more and is no worse. Above: rigs of the front from the top, with their prices; x points "
        f"right. Objective: {describe_objective(study)}.",
    )
    untried = (
        f"{len(found.candidates) - tried} of them were not tried before the budget was spent. Search longer with "
        "lidarcfg optimize --resume."
    )
    how = (
        "The next evaluations went to the combination that would soonest be on the front; now and then a combination "
        "started from the best rigs of others. A search does not prove an optimum: another seed may find rigs that are "
        "a few per cent better or worse, and a combination that is a little worse than the front may belong on it."
    )
    spent = facts(
        [
            ("solver", describe_solver(study)),
            ("evaluations", f"{found.evaluations:,}"),
            ("… of combinations that are not on the front", f"{found.dominated_evaluations:,}"),
        ]
    )
    ended = "This search was interrupted." if found.interrupted else None
    return page(
        f"Front: {study.name}",
        f"{counted(len(found.points), 'rig')} on the front of price and objective, of "
        f"{counted(len(found.candidates), 'combination')} of sensors; by lidarcfg {__version__} on {date()}",
        [
            PageSection(
                "front",
                "Price and objective",
                [drawn, _shown_points(study, found), "Prices are the study's, without a currency."],
            ),
            PageSection(
                "combinations",
                "All combinations",
                [candidates_table(found).without("name"), untried if tried < len(found.candidates) else None],
            ),
            PageSection("search", "The search", [spent, how, ended]),
            repeat_section(
                "front",
                {"The complete study, with defaults": study.file},
                commands.typed,
                commands.again,
                values["seed"],
                found.seconds,
            ),
        ],
        [
            KeyFigure(Column("the cheapest rig"), price(cheapest.combination.price), _what(cheapest)),
            KeyFigure(Column("the best rig"), price(best.combination.price), _what(best)),
            KeyFigure(Column("evaluations"), f"{found.evaluations:,}", f"{_spent(found)} on the front's combinations"),
        ],
    )


def _what(point: Point) -> str:
    missed = point.placement.evaluation.misses
    told = f"misses {percent(missed.mean)}" if missed else f"objective {point.placement.objective:.4f}"
    return f"{point.combination.sensors}: {told}"


def _spent(found: Front) -> str:
    return f"{1 - found.dominated_evaluations / max(found.evaluations, 1):.0%}"


def _standing(found: Front, one: Candidate) -> str:
    """Whether it is on the front, or which point dominates it."""
    if one.on_front:
        return "on the front"
    if not math.isfinite(one.objective):
        return "no rig keeps the constraints" if one.evaluations else "not tried"
    better = [point for point in found.points if point.combination.price <= one.combination.price][-1]
    return f"dominated by {better.combination.sensors}, {price(better.combination.price)}"


def front_svg(study: Study, found: Front) -> Markup:
    """The plot as SVG."""
    alt = f"price against objective of {len(found.candidates)} combinations; {len(found.points)} are on the front"
    return drawing("front", _plot_height_in(study, found), alt, lambda figure: _draw_front(figure, study, found))


def draw_front(study: Study, found: Front) -> "Figure":
    """The plot as a figure of its own."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = new_figure(WIDTH_IN, _plot_height_in(study, found))
        _draw_front(figure, study, found)
    return figure


def _plot_height_in(study: Study, found: Front) -> float:
    low, high = _pictures_extent(study, found)
    return PLOT_IN + _tall(low, high) * PICTURE_IN + 0.3


def _tall(low: Array, high: Array) -> float:
    """The height of a picture as a fraction of its width."""
    return float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.3, 2.0))


def _draw_front(figure: "Figure", study: Study, found: Front) -> None:
    from matplotlib.patches import ConnectionPatch

    low, high = _pictures_extent(study, found)
    grid = figure.add_gridspec(2, PICTURES_MAX, height_ratios=(_tall(low, high) * PICTURE_IN, PLOT_IN))
    plot = figure.add_subplot(grid[1, :])
    _draw_plot(plot, study, found)
    models = _models(found)
    shown = _pictured(found)
    first = (PICTURES_MAX - len(shown)) // 2
    for place, point in enumerate(shown, first):
        axes = figure.add_subplot(grid[0, place])
        _draw_rig(axes, study, point, models)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[], aspect="equal")
        axes.set_title(price(point.combination.price), fontsize=7, loc="center")
        for spine in axes.spines.values():
            spine.set(visible=True, color="0.85")
        at = (point.combination.price, point.placement.objective)
        line = ConnectionPatch((0.5, 0.0), at, "axes fraction", "data", axesA=axes, axesB=plot)
        line.set(color=GREY, lw=0.6, zorder=1)
        line.set_in_layout(False)
        figure.add_artist(line)
    _name_models(plot, models)


def _draw_plot(axes: "Axes", study: Study, found: Front) -> None:
    prices = [point.combination.price for point in found.points]
    best = [point.placement.objective for point in found.points]
    top = CUT_OFF * max(best) or None
    others = [(one.combination.price, one.objective) for one in found.candidates if not one.on_front]
    shown = np.array([pair for pair in others if pair[1] <= (top or np.inf)] or np.empty((0, 2)))
    axes.plot(shown[:, 0], shown[:, 1], "o", color=GREY, ms=4, label="dominated")
    right = max([*prices, *shown[:, 0].tolist()]) * 1.05
    axes.plot([*prices, right], [*best, best[-1]], drawstyle="steps-post", color=colour(0), zorder=2)
    axes.plot(prices, best, "o", color=colour(0), ms=6, label="front", zorder=3)
    value = "max VSR (m)" if study.is_max_vsr else "misses (share of places)" if study.is_misses else "objective"
    axes.set(xlabel="price", ylabel=value, xlim=(0, right), ylim=(0, None))
    axes.xaxis.set_major_formatter("{x:,.0f}" if right > 10 else "{x:g}")
    axes.grid(True)


def _pictured(found: Front) -> list[Point]:
    """The points that have a picture: the first, the last, and some between."""
    count = min(len(found.points), PICTURES_MAX)
    return [found.points[i] for i in np.linspace(0, len(found.points) - 1, count).round().astype(int)]


def _models(found: Front) -> list[str]:
    """The models on the front, the most frequent first."""
    counts = Counter(mount.sensor.name for point in found.points for mount in point.placement.rig.mounts)
    return [name for name, _ in counts.most_common()]


def _name_models(axes: "Axes", models: list[str]) -> None:
    """The legend of the plot, and of the pictures."""
    handles, names = axes.get_legend_handles_labels()
    for i, name in enumerate(models):
        handles += axes.plot([], [], _marker(i), color=colour(i + 1), mec="w", mew=0.4, ms=6)
        names.append(truncate(name, DRAWN))
    axes.legend(handles, names, loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=LEGEND_COLUMNS)  # below


def _marker(model: int) -> str:
    return MARKERS[model % len(MARKERS)]


def _pictures_extent(study: Study, found: Front) -> tuple[Array, Array]:
    """The corners of all pictures: the extent of the vehicle and the sensors."""
    at = [mount.position_m[:2] for point in found.points for mount in point.placement.rig.mounts]
    outlines = study.body.outlines_m if study.body else ()
    points = np.concatenate([np.array(at), *outlines])
    low = points.min(axis=0)
    high = points.max(axis=0)
    size = max(float((high - low).max()), 0.5)
    more = np.maximum(0.5 * size - (high - low), 0.0) / 2 + MARGIN * size
    return low - more, high + more


def _draw_rig(axes: "Axes", study: Study, point: Point, models: list[str]) -> None:
    if study.body:
        for outline in study.body.outlines_m:
            axes.fill(*outline.T, color=EXCLUDED, alpha=0.35, lw=0)
    elif not study.region.included.all():
        shade_excluded(axes, study.region, "top")
    for mount in point.placement.rig.mounts:
        model = models.index(mount.sensor.name)
        x, y, _ = mount.position_m
        axes.plot([x], [y], _marker(model), color=colour(model + 1), mec="w", mew=0.4, ms=4.5)
