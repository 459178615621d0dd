#!/usr/bin/env python3
"""A front of price against objective, beside optimising each combination by itself for the same evaluations in all.

    .venv/bin/python tools/bench_choices.py

Prints the table of docs/choices.md. An argument replaces the number of evaluations of each combination.
"""

import os
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from page import argument

import lidarcfg
from lidarcfg.placement.combinations import combinations
from lidarcfg.placement.front import front, on_front
from lidarcfg.placement.optimize import INFEASIBLE, optimize
from lidarcfg.placement.study import Study, load_study, with_solver

ROOT = Path(__file__).parent.parent
SEEDS = (1, 2)
EVALUATIONS = 1500  # of each combination where they are split evenly
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


def load(name: str, seed: int) -> Study:
    """The study, to be searched so."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(STUDIES[name])
        return with_solver(load_study(path), method="auto", seed=seed)


def run(job: tuple[str, int, int]) -> str:
    """A line of the table."""
    name, seed, evaluations = job
    study = load(name, seed)
    ones = combinations(study)
    found = front(with_solver(study, evaluations=evaluations * len(ones)), threads=1)
    alone = [optimize(with_solver(one.study, evaluations=evaluations), threads=1).objective for one in ones]
    there = on_front([one.price for one in ones], alone)
    gains = []
    for one, cost, yes in zip(ones, alone, there, strict=True):
        if yes:
            ours = [p.placement.objective for p in found.points if p.combination.price <= one.price]
            gains.append(1.0 - min(ours, default=INFEASIBLE) / cost)
    dominated = evaluations * (len(ones) - len(gains))
    row = (
        name,
        seed,
        len(ones),
        f"{len(found.points)} ({len(gains)})",
        f"{sum(gain >= 0 for gain in gains)} of {len(gains)}",
        f"{min(gains):+.1%}, {sorted(gains)[len(gains) // 2]:+.1%}, {max(gains):+.1%}",
        f"{found.dominated_evaluations:,} ({dominated:,})",
    )
    return "| " + " | ".join(map(str, row)) + " |"


def main() -> None:
    evaluations = argument(__doc__, int, EVALUATIONS)
    print(f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, {evaluations:,} evaluations a combination\n")
    head = (
        "study",
        "seed",
        "combinations",
        "on the front",
        "prices at which the front is at least as good",
        "how much lower the objective: least, median, most",
        "evaluations of dominated combinations",
    )
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    jobs = [(name, seed, evaluations) for name in STUDIES for seed in SEEDS]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for row in pool.map(run, jobs):
            print(row, flush=True)


if __name__ == "__main__":
    main()
