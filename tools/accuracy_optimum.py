"""How much worse the rig found on a coarse grid is on a fine one, against the seconds that the coarse one saves."""

import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from page import ROOT, table
from scipy.stats import spearmanr

from lidarcfg.geometry import Array
from lidarcfg.placement.evaluator import Evaluator
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.region import Region
from lidarcfg.placement.solvers.cma_es import CmaEs
from lidarcfg.placement.study import Study, load_study, with_solver
from lidarcfg.report import COLOURS, new_figure, save_figure

STUDIES = {"2 × 8 beams": "liu2018-2x8", "4 × 16 beams": "liu2018-4x16"}
STEP = 0.03  # with which CMA-ES goes on from a rig found before, in the unit cube
FINE = 0.25  # of the paper's edges: the grid on which all rigs are compared
TICKS_S = (0.5, 1, 2, 5, 10, 20)
# the grids of a search, one after the other: edges as multiples of the paper's, and the fraction of the evaluations
SCHEDULES: dict[str, tuple[tuple[float, float], ...]] = {
    "4": ((4, 1),),
    "2": ((2, 1),),
    "2, four times as long": ((2, 4),),
    "1": ((1, 1),),
    "1/2": ((0.5, 1),),
    "2, then 1": ((2, 1), (1, 0.25)),
    "2, then 1/2": ((2, 1), (0.5, 0.25)),
    "1, then 1/2": ((1, 1), (0.5, 0.25)),
}


def recut(study: Study, factor: float) -> Study:
    """The study with its cuboids' edges multiplied."""
    boxes = tuple((box["min_m"], box["max_m"]) for box in study.file["region"].get("exclude", ()))
    old = study.region
    return replace(study, region=Region.from_boxes(old.min_m, old.max_m, old.cuboid_m * factor, boxes))


def evaluator(study: Study, threads: int = 1) -> Evaluator:
    """The study's."""
    return Evaluator(study.region, [slot.lidar for slot in study.slots], threads)


def values(evaluate: Evaluator, poses: Array) -> Array:
    """Max VSR (n,) of rigs (n, sensors, 6)."""
    return evaluate.max_vsr(poses, np.zeros(len(poses), np.int64), poses[:1], np.full(len(poses), np.inf))


def go_on(study: Study, unit: Array, evaluations: int, seed: int) -> tuple[Array, float]:
    """The best point of the unit cube and its max VSR, by CMA-ES from a point on."""
    walk = CmaEs(len(unit), seed, unit, STEP)
    with evaluator(study) as fine:
        walk.best_x, walk.best_cost = unit, float(values(fine, study.poses(unit[None]))[0])
        for _ in range(evaluations // len(walk.ask().x)):
            walk.tell(values(fine, study.poses(walk.ask().x)))
    return walk.best_x, walk.best_cost


def search(job: tuple[str, str, int, int]) -> tuple[Array, float, float]:
    """The rig of one schedule of grids: its poses, what its own last grid says, and the seconds of the processor."""
    file, schedule, seed, evaluations = job
    paper = load_study(ROOT / f"data/studies/{file}.yaml")
    (first, fraction), *then = SCHEDULES[schedule]
    study = with_solver(recut(paper, first), method="auto", seed=seed, evaluations=int(fraction * evaluations))
    optimize(with_solver(recut(paper, 4), evaluations=10), threads=1)  # loads what is compiled
    started = time.process_time()
    found = optimize(study, threads=1)
    poses = np.array([[*mount.position_m, *mount.rpy_rad] for mount in found.rig.mounts])
    value = found.objective
    free = study.free
    for factor, fraction in then:
        unit = ((poses - study.lower)[free] / (study.upper - study.lower)[free]).clip(0, 1)
        unit, value = go_on(recut(paper, factor), unit, int(fraction * evaluations), seed)
        poses = study.poses(unit[None])[0]
    return poses, value, time.process_time() - started


def agreement(file: str, around: Array, rigs: int, edges: float) -> list[tuple[str, ...]]:
    """How well coarse grids rank rigs as a fine one does: at random, and around a good one."""
    study = load_study(ROOT / f"data/studies/{file}.yaml")
    rng = np.random.default_rng(1)
    random = study.poses(rng.random((rigs, int(study.free.sum()))))
    span = study.upper - study.lower
    near = np.clip(around + rng.normal(0, STEP, (rigs, *around.shape)) * span, study.lower, study.upper)
    cells: dict[float, list[str]] = {}
    for poses in (random, near):
        fine = values(evaluator(recut(study, edges), 2), poses)
        for factor in (4, 2, 1, 0.5):
            coarse = values(evaluator(recut(study, factor), 2), poses)
            ratio = coarse / fine
            text = f"{spearmanr(coarse, fine).statistic:.2f}", f"{ratio.mean():.3f} ± {ratio.std():.3f}"
            cells.setdefault(factor, []).extend(text)
    return [(f"{factor:g}", *cell) for factor, cell in cells.items()]


def run(quick: bool, plots: Path) -> list[str]:
    """The section's lines; draws optimum.png."""
    evaluations, seeds, rigs, fine = (250, 1, 4, 2.0) if quick else (3000, 4, 40, FINE)
    studies = dict([*STUDIES.items()][:1]) if quick else STUDIES
    schedules = ("4", "2, then 1") if quick else tuple(SCHEDULES)
    jobs = [
        (file, schedule, seed, evaluations)
        for file in studies.values()
        for schedule in schedules
        for seed in range(1, seeds + 1)
    ]
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        found = dict(zip(jobs, pool.map(search, jobs), strict=True))
    figure = new_figure(4.5 * len(studies), 4)
    rows, ranks = [], []
    for axes, (title, file) in zip(figure.subplots(1, len(studies), squeeze=False)[0], studies.items(), strict=True):
        of = {
            schedule: [found[file, schedule, seed, evaluations] for seed in range(1, seeds + 1)]
            for schedule in schedules
        }
        study = recut(load_study(ROOT / f"data/studies/{file}.yaml"), fine)
        fine_m = {
            schedule: values(evaluator(study, 2), np.array([poses for poses, _, _ in runs]))
            for schedule, runs in of.items()
        }
        least = min(value.min() for value in fine_m.values())
        for schedule, colour, mark in zip(schedules, COLOURS, "osD^vP<>", strict=False):
            seconds, own = np.median([run[2] for run in of[schedule]]), np.median([run[1] for run in of[schedule]])
            worse = 100 * (fine_m[schedule] / least - 1)
            axes.plot([run[2] for run in of[schedule]], worse, mark, color=colour, label=schedule, alpha=0.8)
            spread = f"{np.median(worse):.1f} ({worse.min():.1f} to {worse.max():.1f})"
            rows.append((title, schedule, f"{seconds:.1f}", f"{own:.4f}", f"{np.median(fine_m[schedule]):.4f}", spread))
        axes.set(xlabel="processor time of the search (s)", xscale="log", ylim=(0, None), title=title)
        axes.set_xticks(TICKS_S, [f"{tick:g}" for tick in TICKS_S])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        best = min(
            ((fine_m[schedule][i], schedule, i) for schedule in schedules for i in range(seeds)), key=lambda one: one[0]
        )
        around = of[best[1]][best[2]][0]
        ranks += [(title, *row) for row in agreement(file, around, rigs, fine)]
    figure.axes[0].set_ylabel("worse than the best, on the finest grid (%)")
    figure.axes[-1].legend(title="edges", fontsize=8)
    save_figure(figure, plots / "optimum.png")
    return [
        *table(
            (
                "study",
                "edges",
                "processor (s)",
                "max VSR by its own grid (m)",
                f"evaluated at {fine:g} (m)",
                "worse than the best (%)",
            ),
            rows,
        ),
        "",
        f"Edges as multiples of the paper's; `auto`, {evaluations:,} evaluations, a quarter of that for going on; "
        f"medians (least to most) of {seeds} seeds; one thread a search, {os.cpu_count()} at a time.",
        "",
        *table(
            ("study", "edges", "rank, at random", "ratio, at random", "rank, near the best", "ratio, near the best"),
            ranks,
        ),
        "",
        f"Rank correlation (Spearman) with max VSR at {fine:g} of the edges, and the ratio to it (mean ± standard "
        f"deviation), of {rigs} rigs at random and of {rigs} around the best one found (standard deviation {STEP:g} of "
        "the bounds).",
    ]
