"""Regret of the solvers against seconds: curves with their spread over seeds."""

import json
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from page import ROOT, table

from lidarcfg.geometry import Array
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.study import load_study, with_solver
from lidarcfg.report import COLOURS, new_figure, save_figure

STUDIES = {
    "2 × 8 beams": "data/studies/liu2018-2x8.yaml",
    "4 × 16 beams": "data/studies/liu2018-4x16.yaml",
    "sedan without its body": "tests/placement/studies/sedan.yaml",
}
METHODS = ("auto", "annealing", "cmaes", "de", "abc")
BEST = json.loads((ROOT / "data/reference/best_known.json").read_text())
KNOWN_M = dict(zip(STUDIES.values(), (BEST["2x8"]["max_vsr_m"], BEST["4x16"]["max_vsr_m"], 0.2044), strict=True))
MARKS_S = (0.5, 2.0, 6.0)


def search(job: tuple[str, str, int, float]) -> tuple[Array, Array]:
    """One search on one thread: seconds and the best so far, cycle by cycle."""
    file, method, seed, seconds = job
    study = load_study(ROOT / file)
    small = with_solver(study, method=method, seed=seed, evaluations=10)
    optimize(small, threads=1)  # loads what is compiled
    found = optimize(with_solver(study, method=method, seed=seed, seconds=seconds), threads=1)
    return np.array([cycle.seconds for cycle in found.history]), np.array([cycle.best for cycle in found.history])


def run(quick: bool, plots: Path) -> list[str]:
    """The section's lines; draws solvers.png."""
    seeds, seconds = (2, 0.2) if quick else (5, MARKS_S[-1])
    studies = dict([*STUDIES.items()][:1]) if quick else STUDIES
    jobs = [
        (file, method, seed, seconds) for file in studies.values() for method in METHODS for seed in range(1, seeds + 1)
    ]
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        found = dict(zip(jobs, pool.map(search, jobs), strict=True))
    at_s = np.geomspace(0.05, seconds, 60)
    marks = MARKS_S[:1] if quick else MARKS_S
    figure = new_figure(4 * len(studies), 4)
    rows = []
    for axes, (title, file) in zip(
        figure.subplots(1, len(studies), sharey=True, squeeze=False)[0], studies.items(), strict=True
    ):
        least = min(best[-1] for job, (_, best) in found.items() if job[0] == file)
        least = min(least, KNOWN_M.get(file, np.inf))
        for method, colour in zip(METHODS, COLOURS, strict=False):
            curves = [found[file, method, seed, seconds] for seed in range(1, seeds + 1)]
            regret = 100 * (np.array([held(at_s, *curve) for curve in curves]) / least - 1)
            axes.plot(at_s, np.median(regret, axis=0), color=colour, label=method)
            axes.fill_between(at_s, regret.min(axis=0), regret.max(axis=0), color=colour, alpha=0.15, lw=0)
            then = 100 * (np.array([held(np.array(marks), *curve) for curve in curves]) / least - 1)
            spread = [f"{np.median(c):.1f} ({c.min():.1f} to {c.max():.1f})" for c in then.T]
            rows.append((title, f"`{method}`", *spread))
        axes.set(xlabel="time (s)", title=f"{title}, least {least:.4f} m", xscale="log", ylim=(0, 150))
        axes.set_yscale("symlog", linthresh=1)
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("regret (% over the least known)")
    figure.axes[0].legend(fontsize=8)
    save_figure(figure, plots / "solvers.png")
    return [
        *table(("study", "solver", *(f"regret after {mark:g} s (%)" for mark in marks)), rows),
        "",
        f"Median, and least to most, of {seeds} seeds; one thread a search, {os.cpu_count()} searches at a time. "
        "Regret: by how much max VSR lies over the least that is known, from these runs or from longer ones.",
    ]


def held(at_s: Array, seconds: Array, best: Array) -> Array:
    """The best so far at some times; before the first cycle is over, that of the first."""
    return best[np.maximum(np.searchsorted(seconds, at_s, side="right") - 1, 0)]
