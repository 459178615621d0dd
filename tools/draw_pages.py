"""Charts of single pages of the documentation. Drawn by tools/draw_concepts.py."""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Rectangle, Wedge

import lidarcfg
from lidarcfg.placement.study import with_solver
from lidarcfg.report.plots import COLOURS, new_figure, save_figure

ROOT = Path(__file__).parent.parent
BENCHMARKS = ROOT / "docs/benchmarks.md"
# What was aimed at: name, how its row begins and which of its cells counts; the aim, and whether more is better.
TARGETS = (
    ("encode and write, one thread", "encode + write alone", 1, 20, True),
    ("a first hit, beside Open3D", "first hit, four VLP-16", 3, 1.2, True),
    ("any hit, the paper's cuboids, beside Open3D", "any hit, the paper's", 3, 2, True),
    ("export, beside bare cast_rays", "export's rate against", 1, 75, True),
    ("export, standing, × real time", "export to pcap, × real time", 1, 8, True),
    ("export, driven, × real time", "export while they are driven", 1, 8, True),
    ("export with wide beams, × thin ones", "with wide beams, times", 1, 3, False),
    ("decode VLP-16, beside velodyne-decoder", "VLP-16, strongest", 3, 4, True),
    ("an evaluation with a body, ms", "an evaluation in full, 48,000 cuboids, median", 1, 6, False),
    ("an evaluation, beside cc3d", "numpy + cc3d + bincount, rigs at random", 3, 8, True),
    ("a robust search, × a plain one", "`abc`, 12,000 evaluations", 3, 3, False),
    ("returns at all places, five objects, s", "all five", 1, 3, False),
    ("first optimize on a machine, s", "optimize, 5 s of search", 1, 12, False),
    ("first export on a machine, s", "export of 1 s", 1, 8, False),
    ("an evaluate after that, s", "evaluate", 4, 1, False),
)
STUDIES = {"the paper's four VLP-16": "liu2018-4x16", "the sedan, with its body": "sedan"}
BEES, CYCLES = 200, 800  # the paper's search


def targets(path: Path) -> None:
    """How far each figure of docs/benchmarks.md is beyond its target, or short of it."""
    figure = new_figure(9, 5)
    axis = figure.subplots()
    for y, ratio in enumerate(ratios()):
        axis.barh(y, ratio - 1, left=1, height=0.6, color=COLOURS[0] if ratio >= 1 else COLOURS[5])
        side = 1 if ratio >= 1 else -1
        axis.annotate(
            f"{ratio:.2f}", (ratio, y), (4 * side, 0), textcoords="offset points", va="center", fontsize=9,
            ha="left" if side > 0 else "right",
        )  # fmt: skip
    axis.set_yticks(range(len(TARGETS)), [target[0] for target in TARGETS])
    axis.set(xscale="log", xlim=(0.12, 8), xlabel="times as good as aimed at; 1 is the target")
    axis.set_xticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"])
    axis.minorticks_off()
    axis.invert_yaxis()
    axis.axvline(1, color="0.2", linewidth=1)
    axis.grid(alpha=0.3, axis="x")
    save_figure(figure, path)


def ratios() -> list[float]:
    """By how much each figure is better than its target."""
    rows = {cells[0]: cells for cells in _cells(BENCHMARKS.read_text("utf-8"))}
    found = []
    for _, begins, cell, aim, more in TARGETS:
        value = float(
            re.findall(r"[\d.]+", next(row for name, row in rows.items() if name.startswith(begins))[cell])[0]
        )
        found.append(value / aim if more else aim / value)
    return found


def _cells(page: str) -> list[list[str]]:
    """The rows of a page's tables."""
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in page.splitlines() if line.startswith("| ")]


def skipping(path: Path) -> None:
    """How much of the work two searches did, of what evaluating every trial in full would have taken."""
    figure = new_figure(9, 3.2)
    axis = figure.subplots()
    y, names = 0, []
    for colour, (title, name) in zip((COLOURS[0], COLOURS[1]), STUDIES.items(), strict=True):
        study = with_solver(
            lidarcfg.load_study(ROOT / f"data/studies/{name}.yaml"),
            method="abc",
            bees=BEES,
            cycles=CYCLES,
        )
        found = lidarcfg.optimize(study)
        trials = found.evaluated
        parts = {"trials evaluated in full": found.full_evaluations / trials}
        parts["cuboids evaluated"] = found.cuboids / (trials * study.region.included.size)
        if study.segments:
            parts["segments cast against the body"] = found.segments / (trials * study.segments)
        for part, fraction in parts.items():
            axis.barh(y, 1, color="0.92", height=0.7)
            axis.barh(y, fraction, color=colour, height=0.7, label=title if part == "cuboids evaluated" else None)
            axis.text(
                fraction + 0.01, y, f"{fraction:.2%}" if fraction < 0.01 else f"{fraction:.1%}", va="center", fontsize=9
            )
            names.append(part)
            y += 1
    axis.set_yticks(range(y), names)
    axis.set(
        xlim=(0, 1), xlabel=f"of the work that {BEES} bees and {CYCLES} cycles take if every trial is evaluated in full"
    )
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axis.invert_yaxis()
    axis.legend(loc="lower right")
    save_figure(figure, path)


def writing(path: Path) -> None:
    """What is on the disk while an output is written, and what a kill leaves at each moment."""
    figure = new_figure(9, 4.4)
    axis = figure.subplots()
    old, new, aside = "#cfe3f3", "#c3e8da", "#fbeccb"
    for y, x, wide, colour, text in (
        (3, 0, 7, old, "the old file, whole"),
        (3, 7, 3, new, "the new file, whole"),
        (2, 3, 4, aside, "grows; locked\nwhile its writer lives"),
    ):
        axis.add_patch(Rectangle((x, y), wide, 0.7, facecolor=colour, edgecolor="0.4"))
        axis.text(x + 0.2, y + 0.35, text, ha="left", va="center")
    for y, name in ((3, "rig.yaml"), (2, ".rig.yaml.xxxxxxxx.part")):
        axis.text(-0.15, y + 0.35, name, ha="right", va="center", family="monospace", fontsize=9)
    axis.annotate("", (7, 3.05), (7, 2.65), arrowprops={"arrowstyle": "-|>", "linewidth": 1.8})
    axis.text(7.15, 2.8, "rename", va="center")
    for x, text in (
        (2.2, "killed while it computes:\nthe old file"),
        (5.9, "killed while it writes:\nthe old file, and a .part\nthat the next run removes"),
        (9.4, "killed afterwards:\nthe new file"),
    ):
        axis.plot([x, x], [1.45, 3.85], color=COLOURS[5], linestyle="--", linewidth=1.4)
        axis.plot(x, 3.95, marker="X", markersize=9, color=COLOURS[5])
        axis.text(x, 1.3, text, ha="center", va="top", fontsize=9.5)
    axis.annotate("", (10, 0.25), (0, 0.25), arrowprops={"arrowstyle": "-|>", "color": "0.4"})
    axis.text(10, 0.05, "time", ha="right", va="top", color="0.3")
    axis.set(xlim=(-2.5, 10.6), ylim=(-0.2, 4.2))
    axis.axis("off")
    save_figure(figure, path)


def terms(path: Path) -> None:
    """Words of the glossary on a sensor from the side and from above."""
    figure = new_figure(11, 4.6)
    side, above = figure.subplots(1, 2, width_ratios=(1.25, 1))
    _from_the_side(side)
    _from_above(above)
    save_figure(figure, path)


def _from_the_side(axis: Axes) -> None:
    """Beams with their rings, and the gaps between them."""
    elevations_deg = (-25.0, -12.0, 0.0, 12.0)
    height, reach = 1.9, 9.0
    ends = [(reach, height + reach * np.tan(np.radians(angle))) for angle in elevations_deg]
    for ring, (x, z) in enumerate(ends):
        axis.plot([0, x], [height, z], color=COLOURS[0], linewidth=1.6)
        axis.text(x + 0.1, z, f"ring {ring}", color=COLOURS[0], va="center")
    edges = [-40.0, *elevations_deg, 30.0]
    for gap, (low, high) in enumerate(pairwise(edges)):
        angle = np.radians((low + high) / 2)
        axis.text(
            5.2 * np.cos(angle),
            height + 5.2 * np.sin(angle),
            f"{gap}",
            ha="center",
            va="center",
            fontsize=13,
            color="0.35",
        )
    axis.text(2.1, 4.6, "0 … 4: beam gap index,\nhow many beams pass\nat or below a point", color="0.35", ha="center")
    axis.add_patch(Arc((0, height), 13, 13, theta1=0, theta2=12, color=COLOURS[5], linewidth=1.6))
    axis.annotate("elevation 12°", (6.45, height + 0.7), (6.9, height + 3.2), color=COLOURS[5], ha="center",
                  arrowprops={"arrowstyle": "-", "color": COLOURS[5]})  # fmt: skip
    axis.plot(0, height, "ko", markersize=9)
    axis.text(-0.15, height + 0.35, "origin of the\nsensor frame", ha="right", va="bottom", fontsize=9)
    axis.set(xlim=(-2.6, 10.4), ylim=(-3.6, 6.6), aspect="equal", title="From the side: beams, rings, gaps")
    axis.axis("off")


def _from_above(axis: Axes) -> None:
    """A field of view, a beam that widens with two echoes, and what a body hides."""
    axis.add_patch(Wedge((0, 0), 7.6, -110, 110, facecolor="#eaf2fa", edgecolor="none"))
    axis.text(-1.2, -5.6, "horizontal field\nof view", ha="left", color=COLOURS[0])
    axis.add_patch(Wedge((0, 0), 7.6, -62, -38, width=5.1, facecolor="0.8", edgecolor="none"))
    axis.add_patch(Rectangle((1.2, -2.1), 1.3, 0.9, facecolor="0.35"))
    axis.text(3.35, -4.0, "blind", ha="center", va="center")
    axis.text(2.65, -1.7, "body", fontsize=9.5)
    head = np.radians(20)
    for turn in (-0.055, 0.055):
        axis.plot([0, 7.2 * np.cos(head + turn)], [0, 7.2 * np.sin(head + turn)], color=COLOURS[1], linewidth=1)
    axis.plot(*(4.1 * np.array([np.cos(head + 0.045), np.sin(head + 0.045)])), "o", color=COLOURS[2], markersize=9)
    axis.annotate(
        "first echo:\na pole", (3.9, 1.6), (3.2, 3.1), ha="center", arrowprops={"arrowstyle": "-"}, fontsize=9.5
    )
    wall = 7.2 * np.array([[np.cos(head - 0.1), np.sin(head - 0.1)], [np.cos(head + 0.1), np.sin(head + 0.1)]])
    axis.plot(*wall.T, color="0.2", linewidth=4)
    axis.annotate("last echo: a wall;\nthe beam has widened\nby its divergence", wall[1], (5.6, 4.1), ha="center",
                  va="bottom", arrowprops={"arrowstyle": "-"}, fontsize=9.5)  # fmt: skip
    axis.add_patch(Arc((0, 0), 2.2, 2.2, theta1=-102, theta2=0, color=COLOURS[5], linewidth=1.6))
    tip, back = (1.1 * np.array([np.cos(angle), np.sin(angle)]) for angle in np.radians((-110, -100)))
    axis.annotate("", tip, back, arrowprops={"arrowstyle": "-|>", "color": COLOURS[5]})
    axis.text(-0.7, -1.1, "azimuth 110°,\nclockwise from x", color=COLOURS[5], fontsize=9.5, ha="right", va="center")
    axis.annotate("", (8.1, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.4"})
    axis.annotate("", (0, 3.2), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.4"})
    axis.text(8.15, 0, "x", va="center")
    axis.text(0, 3.3, "y", ha="center")
    axis.plot(0, 0, "ko", markersize=9)
    axis.set(xlim=(-3.2, 8.6), ylim=(-6.6, 6.2), aspect="equal", title="From above: what is seen, and what comes back")
    axis.axis("off")
