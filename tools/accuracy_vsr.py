#!/usr/bin/env python3
"""How far max VSR is off by each measure and grid, what it costs, and whether the error bars hold.

.venv/bin/python tools/accuracy_vsr.py              about ten minutes on two free cores; writes docs/measure.md
.venv/bin/python tools/accuracy_vsr.py --bodies     only rigs of which bodies, ranges and fields of view limit the sight
.venv/bin/python tools/accuracy_vsr.py --quick      whether it runs: prints, leaves docs/ alone
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from page import ROOT, heading, table, write_section

from lidarcfg.geometry import Array
from lidarcfg.placement.analytic import Level, error_bar, level
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.evaluator import max_vsr
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import Study, load_study, with_solver
from lidarcfg.placement.subspace import segment
from lidarcfg.report import COLOURS, new_figure, save_figure

PAGE = ROOT / "docs/measure.md"
STUDIES = [f"liu2018-{lidars}x{beams}" for beams in (4, 8, 16) for lidars in (1, 2, 3, 4, 5)]
EDGES = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)  # of the paper's; the last is the truth
BEAMS_DEG = [-15, -11, -7, -3, 0, 3, 7, 15]
MOUNTS = {  # of a vehicle: name, lower and upper bound of the position, yaw in degrees
    "sedan": [
        ("roof", [-0.6, -0.5, 1.6], [0.6, 0.5, 1.9], 0),
        ("front", [2.45, -0.7, 0.4], [2.5, 0.7, 0.8], 0),
        ("rear", [-2.5, -0.7, 0.4], [-2.45, 0.7, 0.8], 180),
    ],
    "truck": [
        ("roof", [1.9, -0.8, 2.6], [3.1, 0.8, 3.0], 0),
        ("left", [2.6, 1.2, 1.2], [3.6, 1.5, 2.6], 90),
        ("right", [2.6, -1.5, 1.2], [3.6, -1.2, 2.6], -90),
        ("rear", [-3.75, -0.9, 0.6], [-3.65, 0.9, 2.8], 180),
    ],
    "shuttle": [
        ("front", [2.22, -0.9, 0.4], [2.3, 0.9, 2.4], 0),
        ("rear", [-2.3, -0.9, 0.4], [-2.22, 0.9, 2.4], 180),
        ("roof", [-1, -0.6, 2.55], [1, 0.6, 2.8], 0),
    ],
}
Rows = list[tuple[str, ...]]


def region(study: Study, factor: float) -> Region:
    """The study's, its cuboids' edges multiplied."""
    boxes = tuple((box["min_m"], box["max_m"]) for box in study.file["region"].get("exclude", ()))
    old = study.region
    return Region.from_boxes(old.min_m, old.max_m, old.cuboid_m * factor, boxes)


def drawn(study: Study, seed: int, of: int) -> tuple[Lidar, ...]:
    """The best of so many rigs at random in the bounds, by faces."""
    poses = study.poses(np.random.default_rng(seed).random((of, int(study.free.sum()))))
    values = [vsr_m(segment(study.region, study.lidars(one))).max() for one in poses] if of > 1 else [0.0]
    return study.lidars(poses[int(np.argmin(values))])


def searched(study: Study) -> tuple[Lidar, ...]:
    """The rig of a short search."""
    found = optimize(with_solver(study, method="abc", bees=30, cycles=60), threads=1).rig.mounts
    return study.lidars(np.array([[*mount.position_m, *mount.rpy_rad] for mount in found]))


def timed(function: Callable[[], float]) -> tuple[float, float]:
    """What a function returns and the processor's seconds."""
    started = time.process_time()
    return function(), time.process_time() - started


def measured(job: tuple[str, str, tuple[float, ...]]) -> Array:
    """(edges, 5) faces and its seconds, analytic and its seconds, its pieces; of one rig, on the study's region."""
    name, kind, edges = job
    study = load_study(ROOT / f"data/studies/{name}.yaml")
    lidars = searched(study) if kind == "searched" else drawn(study, 1, 1)
    level(region(study, 4), lidars)  # loads what is compiled
    rows = []
    for factor in edges:
        grid = region(study, factor)
        faces = timed(lambda: float(vsr_m(segment(grid, lidars)).max()))  # noqa: B023
        started = time.process_time()
        found = level(grid, lidars)
        rows.append((*faces, found.max_vsr_m, time.process_time() - started, found.pieces))
    return np.array(rows)


def held(job: tuple[str, int]) -> Array:
    """(3, 2) the relative error bar and error of pairs of edges 4 and 2, 2 and 1, 1 and 1/2, against 1/4."""
    name, number = job
    study = load_study(ROOT / f"data/studies/{name}.yaml")
    lidars = drawn(study, 100 * number + STUDIES.index(name), (1, 10, 100)[number % 3])
    grid, levels = region(study, 4), []
    for _ in range(5):
        levels.append(level(grid, lidars))
        grid = grid.halved()
    truth = levels[-1].max_vsr_m
    return np.array(
        [(error_bar(coarse, fine) / truth, abs(fine.max_vsr_m / truth - 1)) for coarse, fine in pairwise(levels[:4])]
    )


def body_study(vehicle: str, limited: bool, sensors: int | None) -> Study:
    """A body in a region of the paper's cuboids, and its first so many LiDARs; with ranges and fields of view too."""
    groups = []
    for name, low, high, yaw_deg in MOUNTS[vehicle][:sensors]:
        low_deg, high_deg = [-15, -15, yaw_deg], [15, 15, yaw_deg]
        limits = {"range_m": [0.5, 12]} | ({"azimuth_fov_deg": [270, 90]} if name != "roof" else {})
        bounds = {"min": {"position_m": low, "rpy_deg": low_deg}, "max": {"position_m": high, "rpy_deg": high_deg}}
        count = 2 if (vehicle, name) == ("sedan", "roof") else 1
        groups.append(
            {"name": name, "elevation_deg": BEAMS_DEG, "count": count, **bounds, **(limits if limited else {})}
        )
    body = {"name": "body", "file": str(ROOT / f"data/vehicles/{vehicle}.ply"), "exclude": True}
    edges = {"min_m": [-16, -8, 0], "max_m": [16, 8, 4], "cuboid_m": [1, 0.5, 0.2]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(json.dumps({"region": edges, "vehicle": {"meshes": [body]}, "sensors": groups}))
        return load_study(path)


def body_levels(job: tuple[str, bool, int | None, int, int]) -> list[tuple[float, float, float]]:
    """Max VSR, pieces and seconds on 4, 2, 1, … of the edges; of one at random, or the best of 10 or 30, in turn."""
    vehicle, limited, sensors, number, depth = job
    study = body_study(vehicle, limited, sensors)
    poses = study.poses(np.random.default_rng(1000 + number).random(((1, 10, 30)[number % 3], int(study.free.sum()))))
    values = [max_vsr(study.region, study.lidars(one), study.visibility) for one in poses]
    lidars, old = study.lidars(poses[int(np.argmin(values))]), study.region
    grid = Region.from_boxes(old.min_m, old.max_m, 4 * old.cuboid_m).without(study.vehicle)
    level(grid, lidars, study.visibility)  # loads what is compiled
    out = []
    for _ in range(depth):
        started = time.process_time()
        found = level(grid, lidars, study.visibility)
        out.append((found.max_vsr_m, found.pieces, time.process_time() - started))
        grid = grid.halved()
    return out


def bodies(pool: ProcessPoolExecutor, quick: bool) -> list[str]:
    """The tables of rigs whose sight is limited."""
    kinds = [(vehicle, limited) for vehicle in MOUNTS for limited in (False, True)]
    deep = [(*kind, None, number, 4 if quick else 6) for kind in kinds for number in range(1 if quick else 5)]
    more = [
        (*kind, sensors, 10 + number, 4 if quick else 5)
        for kind in kinds
        for sensors in (1, 2, None)
        for number in range(1 if quick else 4)
    ]
    found, others = np.array(list(pool.map(body_levels, deep))), np.array(list(pool.map(body_levels, more)))
    truth = found[:, -1:, 0]
    rows: Rows = [
        (f"{EDGES[i]:g}", cell(abs(found[:, i, 0] / truth[:, 0] - 1)), f"{np.median(found[:, i, 2]):.3f}")
        for i in range(found.shape[1])
    ]
    pairs = {}
    for i in range(others.shape[1] - 2):
        coarse, fine, best = others[:, i], others[:, i + 1], others[:, -1, 0]
        bar = [error_bar(Level(*a), Level(*b), True) for a, b in zip(coarse[:, :2], fine[:, :2], strict=True)]
        pairs[f"{EDGES[i]:g} and {EDGES[i + 1]:g}"] = np.stack([bar / best, abs(fine[:, 0] / best - 1)], axis=1)
    return [
        *table(("edges", "analytic (%)", "seconds"), rows),
        "",
        f"Error of max VSR, median / worst over {len(found)} rigs of 3 or 4 LiDARs of 8 beams on a saloon, a truck and "
        "a shuttle whose bodies hide, and end the region; half of them with ranges of 0.5 to 12 m and fields of view "
        "of 180°. Edges as multiples of 1 × 0.5 × 0.2 m; truth: analytic on "
        f"{EDGES[found.shape[1] - 1]:g} of them. Medians of processor time, of one grid.",
        "",
        *coverage_table(pairs),
        "",
        f"{len(others)} such rigs, of 1 to 4 LiDARs. Truth: {EDGES[others.shape[1] - 1]:g} of the edges.",
    ]


def cell(error: Array) -> str:
    """Median / worst in per cent."""
    return f"{100 * np.median(error):.2g} / {100 * error.max():.2g}"


def errors(found: Array, plot: Path) -> list[str]:
    """The table of errors and seconds, found (rigs, edges, 5); draws it."""
    truth = found[:, -1:, 2]
    faces, faces_s, lines, lines_s = (found[:, :, i] for i in range(4))
    methods = {
        "faces": (faces, faces_s),
        "faces, extrapolated": (2 * faces[:, 1:] - faces[:, :-1], faces_s[:, 1:] + faces_s[:, :-1]),
        "analytic": (lines[:, :-1], lines_s[:, :-1]),
        "analytic, two grids": (lines[:, 1:-1], lines_s[:, 1:-1] + lines_s[:, :-2]),
        "analytic, extrapolated": ((4 * lines[:, 1:-1] - lines[:, :-2]) / 3, lines_s[:, 1:-1] + lines_s[:, :-2]),
    }
    figure = new_figure(7, 4.5)
    axes = figure.subplots()
    columns = []
    for (method, (value, seconds)), colour, mark in zip(methods.items(), COLOURS, "osD^v", strict=False):
        error = abs(value / truth - 1)
        middle, worst, cost = 100 * np.median(error, axis=0), 100 * error.max(axis=0), np.median(seconds, axis=0)
        axes.plot(cost, middle, "-" + mark, color=colour, label=method)
        axes.plot(cost, worst, ":" + mark, color=colour, ms=3, alpha=0.6)
        cells = [cell(error[:, i]) for i in range(error.shape[1])]
        columns.append(cells + ["–"] * (len(EDGES) - len(cells)))
    axes.set(xlabel="processor time (s)", ylabel="error of max VSR (%)", xscale="log", yscale="log")
    axes.grid(alpha=0.3)
    axes.legend(title="median; dotted: worst", fontsize=8)
    save_figure(figure, plot)
    rows: Rows = []
    for i in range(found.shape[1]):
        costs = f"{np.median(faces_s[:, i]):.3f}", f"{np.median(lines_s[:, i]):.3f}"
        rows.append((f"{EDGES[i]:g}", *(column[i] for column in columns), *costs))
    return [
        *table(("edges", *(f"{method} (%)" for method in methods), "faces (s)", "analytic (s)"), rows),
        "",
        f"Error of max VSR, median / worst over {len(found)} rigs of 1 to 5 LiDARs of 4, 8 or 16 beams, half of them "
        "at random in the paper's bounds and half from a short search. Edges as multiples of the paper's; truth: "
        f"analytic on {EDGES[found.shape[1] - 1]:g} of them. Two grids, and extrapolated: this one and half its edges. "
        "Medians of processor time, of one grid.",
    ]


def by_pair(bars: Array, found: Array) -> dict[str, Array]:
    """Cases (n, 2) of `held` by pair of edges, and with them those that the rigs of `measured` make."""
    pairs = {"4 and 2": bars[:, 0], "2 and 1": bars[:, 1], "1 and 1/2": bars[:, 2]}
    for i in range(2, found.shape[1] - 2):
        truth, coarse, fine = found[:, -1, 2], found[:, i], found[:, i + 1]
        bar = np.array(
            [error_bar(Level(*a), Level(*b)) for a, b in zip(coarse[:, [2, 4]], fine[:, [2, 4]], strict=True)]
        )
        name = f"{EDGES[i]:g} and {EDGES[i + 1]:g}, of the table above"
        pairs[name] = np.stack([bar / truth, abs(fine[:, 2] / truth - 1)], axis=1)
    return pairs


def coverage_table(pairs: dict[str, Array]) -> list[str]:
    """How often error bars hold, by pair of edges (cases, 2)."""
    rows: Rows = []
    whole = np.concatenate(list(pairs.values()))
    for name, cases in {**pairs, "all": whole}.items():
        bar, error = cases[:, 0], cases[:, 1]
        rows.append((name, str(len(cases)), f"{(error <= bar).mean():.1%}", f"{100 * np.median(bar):.2g}", cell(error)))
    return table(("edges", "cases", "bar covers the truth", "bar, median (%)", "error, median / worst (%)"), rows)


def coverage(pairs: dict[str, Array]) -> list[str]:
    """The table of error bars, and whose they are."""
    return [
        *coverage_table(pairs),
        "",
        "Rigs of the paper's 15 studies of 4 to 16 beams: one at random, the best of 10 and the best of 100 in turn; "
        "and those of the table above. Truth: analytic on 1/4 of the edges, for those of the table above on 1/8.",
    ]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="tiny sizes; prints only")
    parser.add_argument("--bodies", action="store_true", help="only the rigs whose sight is limited")
    given = parser.parse_args(arguments)
    quick = given.quick
    started = time.perf_counter()
    studies, edges, repeats = (STUDIES[:3], EDGES[:4], 1) if quick else (STUDIES, EDGES, 8)
    jobs = [(name, kind, edges) for kind in ("searched", "at random") for name in studies]
    more = [(name, number) for number in range(repeats) for name in studies]
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        limited = bodies(pool, quick)
        sections = {"bodies": [heading(time.perf_counter() - started), "", *limited]}
        if given.bodies:
            show(sections, quick)
            return
        started = time.perf_counter()
        bars = np.array(list(pool.map(held, more)))
        found = np.array(list(pool.map(measured, jobs)))
    with tempfile.TemporaryDirectory() as scratch:
        plots = Path(scratch) if quick else ROOT / "docs/accuracy"
        rows = errors(found, plots / "vsr.png")
    sections["errors"] = [heading(time.perf_counter() - started), "", *rows]
    sections["bars"] = coverage(by_pair(bars, found))
    show(sections, quick)


def show(sections: dict[str, list[str]], quick: bool) -> None:
    """Print sections, and write them to the page unless it is only to see whether all runs."""
    for name, lines in sections.items():
        print(*lines, "", sep="\n", flush=True)
        if not quick:
            write_section(name, lines, PAGE)


if __name__ == "__main__":
    main()
