#!/usr/bin/env python3
"""Every figure and finding of Liu, Arief and Zhao 2018, computed by the paper's text, beside what was published.

    .venv/bin/python tools/reproduce_paper.py            full size: 200 bees × 800 cycles a run
    .venv/bin/python tools/reproduce_paper.py --cycles 20    a quick look; says so in what it writes

Writes docs/evidence/paper.md's tables between its markers and the plots in docs/evidence/paper/.
"""

import argparse
import json
import time

import numpy as np
from page import ROOT, write_section
from rich.progress import Progress
from scipy.stats import spearmanr

from lidarcfg.report.drawings import draw_rig
from lidarcfg.report.plots import COLOURS, draw_convergence, new_figure, save_figure
from lidarcfg.search.optimize import optimize
from lidarcfg.search.run import Placement
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.study import Study, with_solver
from lidarcfg.vsr.detection import DetectionObject, detection
from lidarcfg.vsr.metric import vsr_m
from lidarcfg.vsr.subspaces import segment

REFERENCE = json.loads((ROOT / "data/reference/liu2018.json").read_text())
BEAMS = (4, 8, 16)
LIDARS = (1, 2, 3, 4, 5)
SMALL = DetectionObject(name="box", size_m=(0.5, 0.5, 0.5))


def paper_study(lidars: int, beams: int, cycles: int) -> Study:
    """The paper's study for so many LiDARs of so many beams."""
    study = load_study(ROOT / f"data/studies/liu2018-{lidars}x{beams}.yaml")
    return with_solver(study, method="abc", bees=200, cycles=cycles)


def published(lidars: int, beams: int) -> dict | None:
    """The authors' run on the paper's cuboids, if they published one."""
    for row in REFERENCE["rows"]:
        if (row["lidars"], row["beams"], row["cuboid_m"], row["bees"]) == (lidars, beams, [1.0, 0.5, 0.2], 200):
            return row
    return None


def vsr_and_detection(rigs: int) -> np.ndarray:
    """(rigs, 2): max VSR and the detection rate of a small box, for rigs drawn at random from the paper's bounds."""
    rng = np.random.default_rng(1)
    rows = []
    for n in range(rigs):
        lidars = LIDARS[n % 5]
        beams = BEAMS[n // 5 % 3]
        study = paper_study(lidars, beams, 1)
        poses = study.space.poses(rng.random((1, study.space.dimensions)))[0]
        spaces = segment(study.region, lidars_at(study.slots, poses))
        rows.append((vsr_m(spaces).max(), detection(spaces, SMALL).rate))
    return np.array(rows)


def table(found: dict[tuple[int, int], Placement]) -> list[str]:
    """Best max VSR by LiDARs and beams: published, the published poses by the text, and ours."""
    lines = [
        "| LiDARs × beams | published | its poses by the text | found here | detection of a 0.5 m box | seconds |",
        "|---|---|---|---|---|---|",
    ]
    for (lidars, beams), one in sorted(found.items(), key=lambda item: item[0][::-1]):
        row = published(lidars, beams)
        theirs = f"{row['published_max_vsr_m']:.4f} | {row['paper_method_max_vsr_m']:.4f}" if row else "– | –"
        rate = detection(one.evaluation.subspaces, SMALL).rate
        best = f"{one.evaluation.max_vsr_m:.4f}"
        lines.append(f"| {lidars} × {beams} | {theirs} | {best} | {rate:.3f} | {one.seconds:.0f} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=800)
    parser.add_argument("--rigs", type=int, default=300, help="random rigs for the relation of VSR and detection")
    arguments = parser.parse_args()
    plots = ROOT / "docs/evidence/paper"
    plots.mkdir(exist_ok=True)
    found: dict[tuple[int, int], Placement] = {}
    with Progress() as progress:
        task = progress.add_task("", total=len(BEAMS) * len(LIDARS) * arguments.cycles)
        for beams in BEAMS:
            for lidars in LIDARS:
                study = paper_study(lidars, beams, arguments.cycles)
                progress.update(task, description=f"{lidars} × {beams} beams")
                found[lidars, beams] = optimize(study, on_cycle=lambda *_: progress.advance(task))
                if (lidars, beams) == (4, 16):
                    save_figure(draw_convergence(study, found[4, 16]), plots / "convergence.png")
                if beams == 16 and lidars < 5:
                    one = found[lidars, beams]
                    save_figure(draw_rig(study, one.rig, one.evaluation), plots / f"rig-{lidars}x16.png")
    figure = new_figure(7, 4.2)
    axes = figure.subplots()
    for beams, colour in zip(BEAMS, COLOURS, strict=False):
        best = [found[n, beams].evaluation.max_vsr_m for n in LIDARS]
        axes.plot(LIDARS, best, "o-", color=colour, label=f"{beams} beams")
        rows = [(n, row["published_max_vsr_m"]) for n in LIDARS if (row := published(n, beams))]
        axes.plot(*zip(*rows, strict=True), "x:", color=colour, label=f"{beams} beams, published")
    axes.set(xlabel="LiDARs", ylabel="best max VSR (m)", xticks=LIDARS, ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend(ncols=3, fontsize=8)
    save_figure(figure, plots / "best-vsr.png")
    cloud = vsr_and_detection(arguments.rigs)
    rank = spearmanr(cloud[:, 0], cloud[:, 1])
    figure = new_figure(6, 4.2)
    axes = figure.subplots()
    axes.plot(cloud[:, 0], cloud[:, 1], ".", color=COLOURS[0])
    axes.set(xlabel="max VSR (m)", ylabel="detection rate of a 0.5 m box", ylim=(0, 1))
    axes.set_title(f"{len(cloud)} rigs at random: rank correlation {rank.statistic:.2f}")
    axes.grid(alpha=0.3)
    save_figure(figure, plots / "vsr-and-detection.png")
    size = f"200 bees × {arguments.cycles} cycles, seed 1"
    lines = [
        f"Run on {time.strftime('%Y-%m-%d')}: {size}. All in metres.",
        "",
        *table(found),
        "",
        f"Rank correlation (Spearman) of max VSR and the detection rate over {len(cloud)} rigs drawn at random from "
        f"the paper's bounds: {rank.statistic:.3f} (p = {rank.pvalue:.1e}).",
    ]
    page = ROOT / "docs/evidence/paper.md"
    write_section("reproduced", lines, page)
    print("\n".join(lines))


if __name__ == "__main__":
    main()
