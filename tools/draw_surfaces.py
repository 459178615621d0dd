"""Draw docs/surfaces.png: where the sensors of data/studies/mounts.yaml may sit, and where they do after a search.

Usage: .venv/bin/python tools/draw_surfaces.py
"""

from pathlib import Path

import matplotlib as mpl

import lidarcfg
from lidarcfg.placement.study import with_solver
from lidarcfg.report.canvas import STYLE, WIDTH_IN, height_in
from lidarcfg.report.plots import new_figure, save_figure
from lidarcfg.report.surfaces import fill_figure, heights_in

ROOT = Path(__file__).parent.parent
EVALUATIONS = 2000


def main() -> None:
    """The picture of a short search."""
    study = with_solver(lidarcfg.load_study(ROOT / "data/studies/mounts.yaml"), evaluations=EVALUATIONS)
    found = lidarcfg.optimize(study)
    with mpl.rc_context(STYLE):
        figure = new_figure(WIDTH_IN, height_in(*heights_in(study)))
        fill_figure(figure, study, found.rig)
        save_figure(figure, ROOT / "docs/surfaces.png")
    print(f"max VSR {found.objective:.4f} m after {found.evaluations:,} evaluations")


if __name__ == "__main__":
    main()
