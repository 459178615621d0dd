"""Detection rates counted, by Sobol points and by plain Monte Carlo: their error against seconds."""

import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from accuracy_optimum import recut
from page import ROOT, table
from scipy.stats import qmc

from lidarcfg.core import analytic as core
from lidarcfg.geometry import Array
from lidarcfg.placement.detection import DetectionObject, detection
from lidarcfg.placement.region import cuboids_needed
from lidarcfg.placement.study import Study, load_study
from lidarcfg.placement.subspace import Subspaces, segment
from lidarcfg.report import COLOURS, new_figure, save_figure

SIZES = {"pedestrian": (0.5, 0.5, 1.7), "car": (4.5, 1.8, 1.5), "box": (0.5, 0.5, 0.5)}
COUNT_MOST = 1e9  # cuboids of all places together, beyond which counting takes too long
SHRINK_M = 1e-6  # a box on the grid is so much smaller, so that rounding does not make it touch a neighbour


def item(name: str, samples: int | None = None) -> DetectionObject:
    """An object, by counting or by so many samples."""
    return DetectionObject(name=name, size_m=SIZES[name], samples=samples)


def on_grid(spaces: Subspaces, name: str, u: Array) -> float:
    """The rate over places of the grid, drawn by points u (n, 3) of the unit cube, as in the paper (II-C)."""
    edge, low = spaces.region.cuboid_m, spaces.region.min_m
    cuboids = np.array(cuboids_needed(SIZES[name], edge))
    corner = low + np.floor(u * (np.array(spaces.region.shape) - cuboids + 1)) * edge
    size = cuboids * edge
    box = np.column_stack([corner[:, :2] + size[:2] / 2, corner[:, 2] + SHRINK_M / 2, np.zeros(len(u))])
    x, y, z = (size - SHRINK_M).tolist()
    detected, places = core.detected_boxes(spaces.label, low, edge, box, (x, y, z), 1)
    return detected / places


def anywhere(spaces: Subspaces, name: str, u: Array) -> float:
    """The rate over all places and headings, drawn by points u (n, 4) of the unit cube."""
    low, high = spaces.region.min_m, spaces.region.max_m
    length, width, height = SIZES[name]
    heading = 2 * np.pi * u[:, 3]
    c, s = abs(np.cos(heading)), abs(np.sin(heading))
    reach = np.column_stack([length * c + width * s, length * s + width * c]) / 2
    middle = low[:2] + reach + u[:, :2] * (high[:2] - low[:2] - 2 * reach)
    box = np.column_stack([middle, low[2] + u[:, 2] * (high[2] - low[2] - height), heading])
    detected, places = core.detected_boxes(spaces.label, low, spaces.region.cuboid_m, box, SIZES[name], 1)
    return detected / places


def by_grid(study: Study, rigs: Array, cuts: tuple[int, ...]) -> list[str]:
    """The table of mean rates by the cuboids' edges: what the grid itself does to them."""
    rows = []
    for cut in cuts:
        region = recut(study, 1 / cut).region
        spaces = [segment(region, study.lidars(poses)) for poses in rigs]
        for name, size in SIZES.items():
            counted = "–"
            if np.prod(cuboids_needed(size, region.cuboid_m)) * region.included.size < COUNT_MOST:
                counted = f"{np.mean([detection(one, item(name)).rate for one in spaces]):.3f}"
            drawn = np.mean([detection(one, item(name, 2**14)).rate for one in spaces])
            rows.append((name, f"1/{cut}" if cut > 1 else "1", counted, f"{drawn:.3f}"))
    order = [*SIZES]
    rows.sort(key=lambda row: order.index(row[0]))
    return table(("object", "edges", "mean rate, counted on the grid", "mean rate, anywhere"), rows)


def run(quick: bool, plots: Path) -> list[str]:
    """The section's lines; draws detection.png."""
    rigs, powers, most = (1, (8, 10), 14) if quick else (8, tuple(range(8, 19)), 21)
    study = load_study(ROOT / "data/studies/liu2018-4x16.yaml")
    rng = np.random.default_rng(1)
    unit = rng.random((rigs, int(study.free.sum())))
    cases = [(segment(study.region, study.lidars(poses)), name) for poses in study.poses(unit) for name in SIZES]
    detection(cases[0][0], item("box", 16)), detection(cases[0][0], item("box"))  # compiles
    grid, free = "on the grid", "anywhere"
    found: dict[tuple[str, str, int], list[tuple[float, float]]] = defaultdict(list)  # error, seconds
    counted, covered = [], []
    for spaces, name in cases:
        started = time.process_time()
        exact = detection(spaces, item(name)).rate
        counting = time.process_time() - started
        truth = detection(spaces, item(name, 2**most)).rate
        counted.append((exact - truth, counting))
        for n in (2**power for power in powers):
            started = time.process_time()
            drawn = detection(spaces, item(name, n))
            found[free, "Sobol", n].append((drawn.rate - truth, time.process_time() - started))
            covered.append(abs(drawn.rate - truth) <= drawn.half_width)
            for where, method, rate, points in (
                (free, "Monte Carlo", anywhere, lambda n: rng.random((n, 4))),
                (grid, "Monte Carlo", on_grid, lambda n: rng.random((n, 3))),
                (grid, "Sobol", on_grid, lambda n: qmc.Sobol(3, rng=rng).random(n)),
            ):
                started = time.process_time()
                error = rate(spaces, name, points(n)) - (exact if where == grid else truth)
                found[where, method, n].append((error, time.process_time() - started))

    figure = new_figure(9, 4)
    rows = []
    exact_ms = 1e3 * float(np.median([seconds for _, seconds in counted]))
    bias = rms(counted)
    for axes, where in zip(figure.subplots(1, 2, sharey=True), (grid, free), strict=True):
        for method, colour, mark in (("Monte Carlo", COLOURS[1], "o-"), ("Sobol", COLOURS[0], "s-")):
            lines = [found[where, method, 2**power] for power in powers]
            ms = [1e3 * float(np.median([seconds for _, seconds in line])) for line in lines]
            axes.loglog(ms, [rms(line) for line in lines], mark, color=colour, label=method)
            for n, line, took in [*zip((2**p for p in powers), lines, ms, strict=True)][:: 1 if quick else 4]:
                rows.append((where, f"{method}, {n:,} places", f"{took:.2f}", f"{rms(line):.5f}"))
        if where == grid:
            axes.axvline(exact_ms, color=COLOURS[2], ls="--", label="counted: no error")
        else:
            axes.plot(exact_ms, bias, "D", color=COLOURS[2], label="counted on the grid")
        axes.set(xlabel="median processor time (ms)", title=f"places {where}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.axes[0].set_ylabel("RMS error of the rate (1)")
    save_figure(figure, plots / "detection.png")
    rows.insert(len(rows) // 2, (grid, "counted, all places", f"{exact_ms:.2f}", "0"))
    rows.append((free, "counted on the grid", f"{exact_ms:.2f}", f"{bias:.5f}"))
    held = np.mean(covered)
    return [
        *table(("places", "method", "median processor time (ms)", "RMS error of the rate"), rows),
        "",
        f"{rigs} rigs of 4 × 16 beams at random, three objects, the paper's cuboids. Truth: the count on the grid; "
        f"2^{most} Sobol points anywhere. The 95 % intervals that `detection` gives held {held:.1%} of "
        f"{len(covered)} times.",
        "",
        *by_grid(study, study.poses(unit)[:4], (1,) if quick else (1, 2, 4)),
        "",
        "Edges as multiples of the paper's; the mean of the first four of these rigs.",
    ]


def rms(found: list[tuple[float, float]]) -> float:
    """Of the errors."""
    return float(np.sqrt(np.mean([error**2 for error, _ in found])))
