"""Draw docs/robust.png: max VSR of the sedan's rigs with each LiDAR lost, the plain optimum beside the robust one.

Usage: .venv/bin/python tools/draw_robust.py [EVALUATIONS]
"""

from dataclasses import replace
from pathlib import Path

from page import argument

import lidarcfg
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.robustness import Robust
from lidarcfg.placement.sensitivity import robustness
from lidarcfg.placement.study import with_solver
from lidarcfg.report import new_figure, save_figure
from lidarcfg.report.robustness import lost_view

ROOT = Path(__file__).parent.parent
TITLES = {"best as a whole": None, "best with any one lost": Robust(lost=1)}


def main() -> None:
    """Search twice, then draw the bars that reports have."""
    evaluations = argument(__doc__, int, 20_000)
    study = with_solver(lidarcfg.load_study(ROOT / "data/studies/sedan.yaml"), evaluations=evaluations)
    titled = []
    for title, robust in TITLES.items():
        rig = optimize(replace(study, robust=robust)).rig
        found = robustness(study, rig)
        assert found
        titled.append((title, found))
        left = ", ".join(f"without {one.lost} {one.max_vsr_m:.4f}" for one in found.without)
        print(f"{title}: max VSR {found.whole.max_vsr_m:.4f} m; {left}")
    figure = new_figure(8, 3.6)
    lost_view(figure.subplots(), titled)
    save_figure(figure, ROOT / "docs/robust.png")


if __name__ == "__main__":
    main()
