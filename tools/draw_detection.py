"""Draw docs/detection.png: what comes back from five objects around the sedan in one revolution, in the worst phase.

Usage: .venv/bin/python tools/draw_detection.py
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np

import lidarcfg
from lidarcfg.placement.evaluation import evaluate

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.colors import LogNorm

ROOT = Path(__file__).parent.parent
OBJECTS = {"pedestrian": 20, "child": 20, "cyclist": 20, "car": 50, "tyre": 5}


def main() -> None:
    """A map for each object of docs/examples/returns.yaml."""
    study = lidarcfg.load_study(ROOT / "docs/examples/returns.yaml")
    found = evaluate(study, lidarcfg.load_rig(ROOT / "data/rigs/roof.yaml"))
    figure, grid = plt.subplots(1, len(study.detection_targets), figsize=(11, 3.4), sharey=True, layout="constrained")
    outline = study.vehicle.scene.mesh()[0] if study.vehicle else np.zeros((1, 3))
    for axes, (name, seen) in zip(grid, found.return_counts.items(), strict=True):
        low, step = seen.target.low_m, seen.target.step_m
        high = low + step * np.array(seen.target.grid)
        headings = seen.from_above(np.ones(len(seen.worst)))
        with np.errstate(divide="ignore", invalid="ignore"):
            least = seen.from_above(seen.worst) / headings
        axes.set_facecolor("0.8")
        shown = axes.imshow(
            np.maximum(least, 0.5), extent=(low[1], high[1], low[0], high[0]), origin="lower",
            norm=LogNorm(1, 1000), cmap="viridis",
        )  # fmt: skip
        shown.cmap.set_under("white")
        axes.fill(*outline[_hull(outline)][:, 1::-1].T, color="black", alpha=0.6)
        axes.invert_xaxis()
        rate = found.detection[name]
        axes.set_title(f"{name}\nrate {rate.rate:.3f} by {seen.target.enough} returns", fontsize=9)
        axes.set_xlabel("y (m)")
    grid[0].set_ylabel("x (m)")
    figure.colorbar(shown, ax=grid, label="returns in the worst phase", shrink=0.9)
    figure.savefig(ROOT / "docs/detection.png", dpi=90)


def _hull(points: np.ndarray) -> np.ndarray:
    from scipy.spatial import ConvexHull

    return np.asarray(ConvexHull(points[:, :2]).vertices)


if __name__ == "__main__":
    main()
