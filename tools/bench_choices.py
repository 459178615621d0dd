#!/usr/bin/env python3
"""A front of price against objective, beside optimising each combination by itself for the same evaluations in all.

    .venv/bin/python tools/bench_choices.py

Prints the table of docs/choices.md. An argument replaces the number of evaluations of each run.
"""

import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import lidarcfg
from lidarcfg.placement.combinations import combinations
from lidarcfg.placement.front import front, on_front
from lidarcfg.placement.optimize import INFEASIBLE, optimize
from lidarcfg.placement.study import Study, load_study, with_solver

ROOT = Path(__file__).parent.parent
SEEDS = (1, 2)
EVALUATIONS = 15_000
HALL = """\
region: {min_m: [-10, -6, 0], max_m: [10, 6, 4], cuboid_m: [1, 1, 0.25]}
prices: {vlp-16: 4000, os1-32: 8000, os1-64: 12000}
sensors:
  - name: top
    choose: [vlp-16, os1-32, none]
    count: 2
    min: {position_m: [-1, -1, 2], rpy_deg: [-20, -20, 0]}
    max: {position_m: [1, 1, 2.5], rpy_deg: [20, 20, 0]}
  - name: side
    choose: [vlp-16, os1-64, none]
    count: 2
    mirror_y_m: 0
    min: {position_m: [-1, 1, 0.5], rpy_deg: [-20, -20, 0]}
    max: {position_m: [1, 1.5, 2.5], rpy_deg: [20, 20, 0]}
"""
SEDAN = f"""\
region: {{min_m: [-20, -8, 0], max_m: [20, 8, 3], cuboid_m: [2, 1, 0.25]}}
vehicle: {{meshes: [{{name: body, file: {ROOT}/data/vehicles/sedan.ply, exclude: true}}]}}
prices: {{vlp-16: 4000, os0-128: 18000}}
sensors:
  - name: roof
    choose: [vlp-16, os0-128, none]
    count: 2
    min: {{position_m: [-0.6, -0.5, 1.65], rpy_deg: [-15, -15, 0]}}
    max: {{position_m: [0.6, 0.5, 1.90], rpy_deg: [15, 15, 0]}}
  - name: nose
    choose: [vlp-16, none]
    min: {{position_m: [2.45, -0.7, 0.4], rpy_deg: [-10, -10, 0]}}
    max: {{position_m: [2.45, 0.7, 0.8], rpy_deg: [10, 10, 0]}}
objective: {{max_vsr: 1, seen_by_two: 0.5}}
"""
STUDIES = {
    "a hall, max VSR": HALL,
    "the sedan with its body, max VSR and seen by two": SEDAN,
    "`data/studies/truck-prices.yaml`, max VSR": (ROOT / "data/studies/truck-prices.yaml")
    .read_text()
    .replace("../vehicles", f"{ROOT}/data/vehicles")
    .replace("cuboid_m: [1, 1, 0.25]", "cuboid_m: [2, 1, 0.25]"),
}


def load(name: str, seed: int, evaluations: int) -> Study:
    """The study, to be searched so."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(STUDIES[name])
        return with_solver(load_study(path), method="auto", seed=seed, evaluations=evaluations)


def alone(study: Study, evaluations: int) -> list[float]:
    """The objective of each combination, the evaluations split evenly."""
    ones = combinations(study)
    split = [with_solver(one.study, evaluations=evaluations // len(ones)) for one in ones]
    return [optimize(one, threads=1).objective for one in split]


def run(job: tuple[str, int, int]) -> tuple[tuple[str, int, int], str]:
    """A line of the table."""
    name, seed, evaluations = job
    study = load(name, seed, evaluations)
    started = time.perf_counter()
    found = front(study, threads=1)
    middle = time.perf_counter()
    ones, objectives = combinations(study), alone(study, evaluations)
    seconds = middle - started, time.perf_counter() - middle
    there = on_front([one.price for one in ones], objectives)
    theirs = sorted((one.price, cost) for one, cost, yes in zip(ones, objectives, there, strict=True) if yes)
    gains = []
    for price, cost in theirs:
        ours = min([p.placement.objective for p in found.points if p.combination.price <= price], default=INFEASIBLE)
        gains.append(1.0 - ours / cost)
    dominated = evaluations // len(ones) * (len(ones) - len(theirs))
    row = (
        name,
        seed,
        len(ones),
        f"{len(found.points)} ({len(theirs)})",
        f"{sum(gain >= 0 for gain in gains)} of {len(gains)}",
        f"{min(gains):+.1%}, {sorted(gains)[len(gains) // 2]:+.1%}, {max(gains):+.1%}",
        f"{found.dominated_evaluations:,} ({dominated:,})",
        f"{seconds[0]:.0f} ({seconds[1]:.0f})",
    )
    return job, "| " + " | ".join(map(str, row)) + " |"


def main() -> None:
    evaluations = int(sys.argv[1]) if len(sys.argv) > 1 else EVALUATIONS
    print(f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, {evaluations:,} evaluations a run\n")
    head = (
        "study",
        "seed",
        "combinations",
        "on the front (split evenly)",
        "prices at which the front is at least as good",
        "how much lower the objective: least, median, most",
        "evaluations of dominated combinations (split evenly)",
        "seconds, one thread (split evenly)",
    )
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    jobs = [(name, seed, evaluations) for name in STUDIES for seed in SEEDS]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for _, row in pool.map(run, jobs):
            print(row, flush=True)


if __name__ == "__main__":
    main()
