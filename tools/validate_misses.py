"""Do misses tell what a detector sees? 23 rigs that a learned detector judged: data/reference/learned_judge.json.

Usage: .venv/bin/python tools/validate_misses.py

Writes the section "learned-judge" of docs/evidence/validation.md, and its plot.
"""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from page import ROOT, table, write_section
from scipy.stats import spearmanr

from lidarcfg.geometry import Array
from lidarcfg.placement.study import load_study
from lidarcfg.report.plots import COLOURS, new_figure, save_figure

PAGE = ROOT / "docs/evidence/validation.md"
PLOT = PAGE.parent / "validation/learned-judge.png"
RETURNS = range(1, 11)
NAMED = {
    "smallest max VSR": "smallest max VSR",
    "by hand, roof tilted 12°": "by hand, tilted",
    "upright, all low, roof along x": "by hand, upright",
    "annealed, 64 places": "searched by misses",
}


def rho(values: Array, mean_precision: Array) -> float:
    """Spearman's."""
    return float(spearmanr(values, mean_precision).statistic)


def main() -> None:
    """Count, write the table, and draw the plot."""
    rigs = json.loads((ROOT / "data/reference/learned_judge.json").read_text())["rigs"]
    study = load_study(ROOT / "data/studies/sedan.yaml")
    assert study.misses
    mounts = [study.rig(np.array(one["poses"])).mounts for one in rigs]
    own = np.array(
        [
            [replace(study.misses, returns=least).found_at(study.misses.fresh, one).mean for least in RETURNS]
            for one in mounts
        ]
    )
    judge = np.array([one["missed_percent"] for one in rigs]) / 100
    precision = np.array([np.mean(one["ap"]) for one in rigs])
    max_vsr_m = np.array([one["max_vsr_m"][0] for one in rigs])
    rows = [
        ("misses by lidarcfg", *(f"{rho(column, precision):.2f}" for column in own.T)),
        ("misses by `tools/judge_misses.py`'s objects", *(f"{rho(column, precision):.2f}" for column in judge.T)),
    ]
    write_section("learned-judge", table(("fewer returns than", *RETURNS), rows), PAGE)
    draw(100 * own[:, 2], max_vsr_m, precision, [one["name"] for one in rigs])


def draw(missed_percent: Array, max_vsr_m: Array, precision: Array, names: Sequence[str]) -> None:
    """The detector's mAP of rigs over both measures."""
    figure = new_figure(10, 4.2)
    for axes, values, label in zip(
        figure.subplots(1, 2, sharey=True),
        (missed_percent, max_vsr_m),
        ("misses: places with fewer than 3 returns (%)", "max VSR with the body (m)"),
        strict=True,
    ):
        axes.plot(values, precision, "o", color=COLOURS[0], ms=5, alpha=0.8)
        axes.set(xlabel=label, title=f"ρ = {rho(values, precision):.2f}")
        axes.grid(alpha=0.3)
        axes.margins(x=0.2)
        for x, y, name in zip(values, precision, names, strict=True):
            if name in NAMED:
                axes.plot(x, y, "o", color=COLOURS[5], ms=6)
                axes.annotate(NAMED[name], (x, y), (8, 2), textcoords="offset points", fontsize=8)
    figure.axes[0].set_ylabel("mAP of the detector")
    save_figure(figure, PLOT)


if __name__ == "__main__":
    main()
