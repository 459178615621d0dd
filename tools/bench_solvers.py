#!/usr/bin/env python3
"""How good a rig the solvers find for so many evaluations, beside the packages of the index.

    .venv/bin/python -m pip install --no-deps mealpy opfunu
    .venv/bin/python tools/bench_solvers.py

Prints the table of docs/benchmarks.md. An argument less than 100,000 shortens every run to so many evaluations.
"""

import os
import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from mealpy import FloatVar
from mealpy.swarm_based.ABC import OriginalABC
from page import argument

import lidarcfg
from lidarcfg.placement.evaluator import Evaluator
from lidarcfg.placement.optimize import INFEASIBLE, optimize
from lidarcfg.placement.study import Study, load_study, with_solver

ROOT = Path(__file__).parent.parent
STUDIES = {
    "2 × 8 beams": "data/studies/liu2018-2x8.yaml",
    "4 × 16 beams": "data/studies/liu2018-4x16.yaml",
    "sedan without its body": "tests/placement/studies/sedan.yaml",
}
METHODS = {
    "auto": "`auto`",
    "annealing": "annealing alone",
    "cmaes": "`cma` alone, restarts of doubled populations",
    "de": "L-SHADE alone, restarts of doubled lengths",
    "abc": "bees, 40 sources",
    "mealpy": "mealpy's bees, 100 sources",
}
MARKS = (20_000, 100_000)
SEEDS = (1, 2, 3, 4, 5)


def mealpy(study: Study, seed: int, evaluations: int) -> list[tuple[int, float]]:
    """The best of mealpy's ABC as it goes on: after how many evaluations, and what it was."""
    dimensions = int(study.free.sum())
    asked, best = [], [np.inf]
    with Evaluator(study.region, [slot.lidar for slot in study.slots], 1) as evaluator:

        def cost(x: np.ndarray) -> float:
            poses = study.poses(np.asarray(x)[None])
            value = INFEASIBLE * (1.0 + float(study.violation(poses)[0]))
            if value == INFEASIBLE:
                value = float(evaluator.costs(poses, np.zeros(1, np.int64), poses, np.full(1, np.inf))[0])
            best[0] = min(best[0], value)
            asked.append((len(asked) + 1, best[0]))
            return value

        problem = {"bounds": FloatVar(lb=[0.0] * dimensions, ub=[1.0] * dimensions), "obj_func": cost, "log_to": None}
        OriginalABC(epoch=10**5, pop_size=100).solve(problem, seed=seed, termination={"max_fe": evaluations})
    return asked


def run(job: tuple[str, str, int, int]) -> tuple[tuple[str, str, int, int], list[float], float]:
    """One search: the best at each mark, and the seconds it took."""
    name, method, seed, evaluations = job
    study = load_study(ROOT / STUDIES[name])
    started = time.perf_counter()
    if method == "mealpy":
        history = mealpy(study, seed, evaluations)
    else:
        bees = {"bees": 40} if method == "abc" else {}
        study = with_solver(study, method=method, seed=seed, evaluations=evaluations, cycles=None, seconds=None, **bees)
        history = [(cycle.evaluations, cycle.best) for cycle in optimize(study, threads=1).history]
    best = [[value for asked, value in history if asked <= max(mark, history[0][0])][-1] for mark in MARKS]
    return job, best, time.perf_counter() - started


def main() -> None:
    evaluations = argument(__doc__, int, MARKS[-1])
    print(f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, {evaluations:,} evaluations, seeds {SEEDS}")
    jobs = [(name, method, seed, evaluations) for name in STUDIES for seed in SEEDS for method in METHODS]
    found, seconds = {}, {}
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for n, (job, best, took) in enumerate(pool.map(run, jobs), 1):
            found[job[:3]], seconds[job[:3]] = best, took
            print(f"{n} of {len(jobs)}: {job[:3]} {best} {took:.0f} s", file=sys.stderr, flush=True)
    for place, mark in enumerate(MARKS):
        print(f"\n| max VSR (m) after {mark:,} evaluations: best, median, worst of 5 | " + " | ".join(STUDIES) + " |")
        print("|---" * (len(STUDIES) + 1) + "|")
        for method, title in METHODS.items():
            cells = []
            for name in STUDIES:
                values = sorted(found[name, method, seed][place] for seed in SEEDS)
                least = min(statistics.median(found[name, other, seed][place] for seed in SEEDS) for other in METHODS)
                over = statistics.median(values) / least - 1.0
                mark_up = "" if over else ", the best median"
                cells.append(f"{values[0]:.4f} {values[2]:.4f} {values[4]:.4f} ({over:+.1%}{mark_up})")
            print(f"| {title} | " + " | ".join(cells) + " |")
    print("\n| seconds of a run, one thread, two at a time | " + " | ".join(STUDIES) + " |")
    print("|---" * (len(STUDIES) + 1) + "|")
    for method, title in METHODS.items():
        print(
            f"| {title} | "
            + " | ".join(f"{statistics.median(seconds[name, method, seed] for seed in SEEDS):.0f}" for name in STUDIES)
            + " |"
        )


if __name__ == "__main__":
    main()
