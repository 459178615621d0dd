"""Draw the pictures of docs/open3d.md from what the page's own code makes.

Usage: .venv/bin/python tools/draw_open3d.py [FOLDER]
"""

import os
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from page import ROOT, argument
from PIL import Image

COLOURS = 64  # of a palette: the pictures need no more
NEAR_M = 30.0  # of the points that are drawn


def session() -> dict[str, Any]:
    """What the page's code has at its end, run in a folder of its own."""
    blocks = re.findall(r"^```python\n(.*?)^```$", (ROOT / "docs/open3d.md").read_text(), re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for name in ("data", "sensors"):
            Path(name).symlink_to(ROOT / name)
        Path("out").mkdir()
        for block in blocks:
            exec(compile(block, "docs/open3d.md", "exec"), names)
        os.chdir(ROOT)
    return names


def from_above(xyz: np.ndarray, colour: np.ndarray, palette: str) -> Figure:
    """Points (N, 3) from above, each in its colour of a palette."""
    near = (abs(xyz[:, :2]) < NEAR_M).all(axis=1)
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    axes.scatter(xyz[near, 0], xyz[near, 1], s=0.4, c=colour[near], cmap=palette, linewidths=0)
    axes.set(aspect="equal", xlim=(-NEAR_M, NEAR_M), ylim=(-NEAR_M / 2, NEAR_M / 2), xlabel="x (m)", ylabel="y (m)")
    return figure


def solids(meshes: list[tuple[Any, str, float]]) -> Figure:
    """Meshes of Open3D, each in its colour, shaded, and as opaque as given."""
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    for number, (mesh, colour, alpha) in enumerate(meshes):
        corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
        drawn = Poly3DCollection(corners, facecolors=colour, alpha=alpha, shade=True, zorder=number)
        axes.add_collection3d(drawn)
    axes.set(xlim=(-4, 4), ylim=(-2.5, 2.5), zlim=(0, 2), xlabel="x (m)", ylabel="y (m)")
    axes.set_box_aspect((8, 5, 2), zoom=1.2)
    axes.view_init(28, -55)
    return figure


def main(folder: Path) -> None:
    """Draw all of them."""
    made = session()
    cloud = made["cloud"]
    clusters = made["above"].point.positions.numpy()
    known = made["label"] >= 0
    hues = np.random.default_rng(1).permutation(made["label"].max() + 1)
    figures = {
        "points": from_above(cloud.xyz, cloud.intensity.astype(float), "viridis"),
        "clusters": from_above(clusters[known], hues[made["label"][known]].astype(float), "gist_ncar"),
        "shadow": solids(
            [
                (made["o3d"].io.read_triangle_mesh(str(ROOT / "data/vehicles/sedan.ply")), "#7a96c4", 1.0),
                (made["shadow"], "#e08a2c", 0.25),
            ]
        ),
    }
    for name, figure in figures.items():
        path = folder / f"open3d-{name}.png"
        figure.savefig(path, dpi=110)
        Image.open(path).convert("RGB").quantize(COLOURS).save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(argument(__doc__, Path, ROOT / "docs"))
