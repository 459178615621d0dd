"""Draw points by their objects, with the boxes of these, seen from above: those of an export to .npz.

Usage: .venv/bin/python tools/draw_truth.py CLOUD.npz PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lidarcfg.report import new_figure, save_figure

X_M, Y_M = (-15, 40), (-17, 17)  # what is shown
EVERY = 6  # of an object's boxes that are drawn
CORNERS = np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0], [0, 0, 0], [1, -1, 0]]) / 2


def main() -> None:
    """Draw each object's points in a colour of its own, and some of its boxes, with a mark from the front."""
    source, output = map(Path, sys.argv[1:])
    with np.load(source) as arrays:
        xyz, objects, names, boxes = (arrays[key] for key in ("xyz", "object", "object_names", "boxes"))
    figure = new_figure(9, 5.8)
    axes = figure.subplots()
    for i in np.unique(objects):
        mine = xyz[objects == i]
        has_box = i in boxes["object"]
        axes.scatter(mine[:, 0], mine[:, 1], s=1.5 if has_box else 0.3, color=None if has_box else "0.75", linewidths=0)
    for i in np.unique(boxes["object"]):
        mine = boxes[boxes["object"] == i]
        for box in mine[::EVERY]:
            size = [box[f"{key}_m"] for key in ("length", "width", "height")]
            turned = Rotation.from_quat([box[f"q{key}"] for key in "xyzw"]).apply(CORNERS * size)
            axes.plot(turned[:, 0] + box["x"], turned[:, 1] + box["y"], color="black", linewidth=0.8)
        place = mine[0]["x"], mine[0]["y"] + mine[0]["length_m"] / 2
        paper = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}
        axes.annotate(names[i], place, xytext=(10, 8), textcoords="offset points", fontsize=8, bbox=paper)
    axes.set(aspect="equal", xlim=X_M, ylim=Y_M, xlabel="x (m)", ylabel="y (m)")
    save_figure(figure, output)


if __name__ == "__main__":
    main()
