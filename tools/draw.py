"""Draw docs/pictures/: subspaces, terms, axes and angles, a mounted vehicle, a height field, what sensors see.

Usage: .venv/bin/python tools/draw.py [NAME …]
"""

import argparse
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
from draw_scenes import Camera, picture, save, seen_at
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Arc, Rectangle, Wedge
from PIL import Image, ImageDraw
from suburb_road import road

from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import PointCloud, load_cloud
from lidarcfg.geometry import pose, rotation, transform
from lidarcfg.report.plots import COLOURS, new_figure, save_figure
from lidarcfg.sensors.rig import load_rig
from lidarcfg.vsr.cones import Lidar, gaps_at, lidar
from lidarcfg.vsr.metric import vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from lidarcfg.world.meshes import read_mesh
from lidarcfg.world.scene import load_scene

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "docs/pictures"
PALE = ("#cfe3f3", "#f9e3b4", "#c3e8da", "#f0d6e4", "#dcdcdc", "#fad4c0", "#f6f0b8", "#d9d2ec")
BEAMS_DEG = (-25.0, -12.0, 0.0, 12.0)
REGION = Region.from_boxes((-8, -0.05, 0), (8, 0.05, 4), (0.1, 0.1, 0.1))  # one cuboid thick: a section
SENSORS = tuple(lidar((x, 0, 1.9), (0, 0, 0), np.sin(np.radians(BEAMS_DEG))) for x in (-2.5, 2.5))


def subspace(path: Path) -> None:
    """A section through a region with two LiDARs of four beams: beams, the gaps of one, the subspaces of both."""
    figure = new_figure(8.5, 8)
    axes = figure.subplots(3, 1, sharex=True)
    x, _, z = REGION.centres()
    points = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1).reshape(-1, 3)
    gaps = gaps_at(points, SENSORS[0]).reshape(len(x), len(z))
    both = segment(REGION, SENSORS)
    worst = int(vsr_m(both).argmax())
    labels = both.label[:, 0]
    _cuboids(axes[0], np.zeros_like(gaps), ["#ffffff"])
    axes[0].set_title("1. Two LiDARs, four beams each, cut the region.")
    _cuboids(axes[1], gaps, list(PALE[:5]))
    for number in range(5):
        i, k = np.argwhere((gaps == number) & (x[:, None] > -1)).mean(axis=0)
        axes[1].text(-8 + i / 10, k / 10, str(number), ha="center", va="center")
    axes[1].set_title("2. Beam gap index for the left LiDAR: how many of its beams pass at or below a cuboid's centre.")
    _cuboids(axes[2], _coloured(labels), [*PALE, COLOURS[5]], labels == worst)
    axes[2].set_title(
        f"3. Connected cuboids of equal indices are a subspace: {len(both)} here. Red: the largest VSR, the worst."
    )
    for axis in axes:
        for one, colour in zip(SENSORS, (COLOURS[0], COLOURS[1]), strict=True):
            _beams(axis, one, colour if axis is not axes[1] or one is SENSORS[0] else "none")
        axis.set(xlim=(-8, 8), ylim=(0, 4), aspect="equal", ylabel="z [m]")
    axes[2].set_xlabel("x [m]")
    save_figure(figure, path)


def _coloured(labels: np.ndarray) -> np.ndarray:
    """Colours for subspaces, such that no two that touch have the same."""
    out = np.full(labels.max() + 1, -1)
    touching = {
        tuple(sorted(pair))
        for a, b in ((labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1]))
        for pair in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True)
        if pair[0] != pair[1]
    }
    for number in range(len(out)):
        taken = {out[a if b == number else b] for a, b in touching if number in (a, b)}
        out[number] = next(c for c in range(len(out)) if c not in taken)
    return out[labels]


def _cuboids(axis: Axes, values: np.ndarray, colours: list[str], worst: np.ndarray | None = None) -> None:
    """Squares of the section in the colours of their values; the worst subspace in the last colour."""
    shown = values % (len(colours) - (worst is not None))
    if worst is not None:
        shown = np.where(worst, len(colours) - 1, shown)
    image = ListedColormap(colours)(shown.T.astype(int))
    axis.imshow(image, origin="lower", extent=(-8, 8, 0, 4), interpolation="nearest")


def _beams(axis: Axes, one: Lidar, colour: str) -> None:
    """A LiDAR and its beams in the section, to both sides."""
    x, z = one.position_m[[0, 2]]
    for sine in one.sin_elevation:
        for side in (-1, 1):
            axis.plot([x, x + side * 20 * np.sqrt(1 - sine**2)], [z, z + 20 * sine], color=colour, linewidth=1)
    if colour != "none":
        axis.plot(x, z, "o", color=colour, markersize=7, markeredgecolor="black")


def axes_and_angles(path: Path) -> None:
    """The vehicle frame from above, from the left and from behind, and which way positive angles turn a sensor."""
    vertices, triangles = read_mesh(ROOT / "data/vehicles/sedan.ply")
    views = (
        ("from above: positive yaw\nturns left", 0, 1, "yaw", (0, 0, 30), (0.0, 0.0)),
        ("from the right: positive pitch\nlooks down", 0, 2, "pitch", (0, 20, 0), (0.0, 1.75)),
        ("from behind: positive roll\nlifts the left side", 1, 2, "roll", (20, 0, 0), (0.0, 1.75)),
    )
    figure = new_figure(11, 4.2)
    panels = figure.subplots(1, 3, width_ratios=(1.35, 1.35, 1))
    for axis, (title, across, up, name, rpy_deg, place) in zip(panels, views, strict=True):
        axis.tripcolor(
            vertices[:, across], vertices[:, up], triangles, np.zeros(len(triangles)), cmap=ListedColormap(["#e3e7ec"])
        )
        R = rotation(np.radians(rpy_deg))
        for number, (letter, colour) in enumerate(zip("xyz", (COLOURS[5], COLOURS[2], COLOURS[0]), strict=True)):
            _arrow(axis, (0, 0), np.eye(3)[number][[across, up]] * 1.6, letter, colour, "-")
            _arrow(axis, place, R[:, number][[across, up]] * 0.9, "", colour, "--")
        axis.plot(*place, "ko", markersize=6)
        axis.annotate(
            f"a sensor with\n{name} {max(rpy_deg)}°", place, (place[0] - 0.35, place[1] + 0.95), ha="right", fontsize=9
        )
        axis.set(aspect="equal", title=title, xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
        axis.title.set_fontsize(10)
        axis.set_ylim((-2.2, 2.2) if up == 1 else (-0.4, 3.3))
        if across == 1:
            axis.set_xlim(2.2, -2.2)  # seen from behind, y points left
        else:
            axis.set_xlim(-2.8, 2.8)
    save_figure(figure, path)


def _arrow(axis: Axes, start: tuple[float, float], along: np.ndarray, name: str, colour: str, line: str) -> None:
    """An arrow with a name at its tip; of an axis that points at the eye, a ring."""
    if np.hypot(*along) < 0.05:
        axis.plot(*start, "o", markersize=9, markerfacecolor="none", markeredgecolor=colour)
        return
    end = np.add(start, along)
    axis.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": colour, "linestyle": line, "linewidth": 1.8})
    axis.text(*np.add(start, 1.1 * along), name, color=colour, ha="center", va="center", fontweight="bold")


def mounted(path: Path) -> None:
    """The saloon with the rig of data/rigs/roof.yaml and a sensor in the front bumper, named."""
    rig = load_rig(ROOT / "data/rigs/roof.yaml")
    sensors = {mount.name: mount.T_vehicle_sensor for mount in rig.mounts}
    sensors["front"] = pose((2.47, 0.0, 0.6), (0.0, 0.0, 0.0))
    lines = ["name: car", "ground: {z_m: 0, reflectivity: 10}", "meshes:"]
    lines.append(
        f"  - {{name: body, file: {ROOT / 'data/vehicles/sedan.ply'}, position_m: [0, 0, 0], reflectivity: 20}}"
    )
    lines.append("cylinders:")
    for name, T in sensors.items():
        base = [round(float(value), 3) for value in T[:3, 3] - (0, 0, 0.036)]
        lines.append(f"  - {{name: lidar_{name}, base_m: {base}, radius_m: 0.052, height_m: 0.072, reflectivity: 20}}")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.yaml").write_text("\n".join(lines))
        scene = load_scene(Path(folder) / "scene.yaml")
    camera = Camera((6.0, -4.6, 3.0), (0.3, 0.1, 0.95), 38, (900, 520))
    image = picture(scene, camera, np.empty((0, 2)))
    pen = ImageDraw.Draw(image)
    colours = {"x": (205, 70, 20), "y": (0, 140, 100), "z": (0, 100, 170)}
    for name, T in [("vehicle frame", np.eye(4)), *sensors.items()]:
        size = 1.0 if name == "vehicle frame" else 0.45
        tips = transform(T, size * np.eye(3))
        start = tuple(seen_at(camera, T[None, :3, 3])[0])
        for (letter, colour), tip in zip(colours.items(), seen_at(camera, tips), strict=True):
            pen.line([start, tuple(tip)], fill=colour, width=3 if size == 1.0 else 2)
            pen.text((tip[0] + 3, tip[1] - 8), letter, fill=colour, font_size=15, stroke_width=2, stroke_fill="white")
        pen.text(
            (start[0] + 8, start[1] + 6), name, fill=(20, 20, 20), font_size=16, stroke_width=2, stroke_fill="white"
        )
    save(image, path)


def height_field(path: Path) -> None:
    """A grid of heights: where rows and columns lie, and how cells are cut."""
    heights = np.array(
        [[0.0, 0.1, 0.2, 0.1, 0.0], [0.1, 0.6, 0.9, 0.5, 0.1], [0.0, 0.5, 0.8, 0.4, 0.0], [0, 0.1, 0.2, 0.1, 0]]
    )
    figure = new_figure(7, 4.6)
    axis = figure.subplots()
    rows, columns = heights.shape
    x, y = np.meshgrid(np.arange(columns), np.arange(rows)[::-1])
    index = np.arange(rows * columns).reshape(rows, columns)
    south_west, north_east = index[1:, :-1].ravel(), index[:-1, 1:].ravel()
    halves = [np.stack([south_west, side.ravel(), north_east], axis=1) for side in (index[1:, 1:], index[:-1, :-1])]
    axis.tripcolor(
        x.ravel(), y.ravel(), np.concatenate(halves), heights.ravel(), shading="gouraud", cmap="YlGn", alpha=0.6
    )
    for row in range(rows):
        axis.text(columns - 0.55, rows - 1 - row, f"row {row}", va="center")
    for column in range(columns):
        axis.text(column, rows - 0.55, f"column {column}", ha="center")
    for a, b in pairwise(range(columns)):
        for c, d in pairwise(range(rows)):
            axis.plot([a, b], [c, d], color="0.45", linewidth=0.8)
    axis.vlines(np.arange(columns), 0, rows - 1, "0.45", linewidth=0.8)
    axis.hlines(np.arange(rows), 0, columns - 1, "0.45", linewidth=0.8)
    for i, j, height in zip(x.ravel(), y.ravel(), heights.ravel(), strict=True):
        axis.text(
            i,
            j,
            f"{height:g}",
            ha="center",
            va="center",
            bbox={"boxstyle": "round", "facecolor": "white", "linewidth": 0.5},
        )
    axis.plot(0, 0, "o", markersize=26, markerfacecolor="none", markeredgecolor=COLOURS[5], markeredgewidth=2)
    axis.annotate("position_m", (0, 0), (-0.75, -0.62), color=COLOURS[5], fontweight="bold")
    axis.annotate("", (1, -0.35), (0, -0.35), arrowprops={"arrowstyle": "<->"})
    axis.text(0.5, -0.62, "cell_m", ha="center")
    _arrow(axis, (3.9, -0.75), np.array([0.5, 0.0]), "x", COLOURS[5], "-")
    _arrow(axis, (3.9, -0.75), np.array([0.0, 0.5]), "y", COLOURS[2], "-")
    axis.set(xlim=(-0.9, columns), ylim=(-0.85, rows - 0.3), aspect="equal")
    axis.axis("off")
    save_figure(figure, path)


def terms(path: Path) -> None:
    """Words of the glossary on a sensor from the side and from above."""
    figure = new_figure(11, 4.6)
    side, above = figure.subplots(1, 2, width_ratios=(1.25, 1))
    _from_the_side(side)
    _from_above(above)
    save_figure(figure, path)


def _from_the_side(axis: Axes) -> None:
    """Beams with their rings, and the gaps between them."""
    elevations_deg = (-25.0, -12.0, 0.0, 12.0)
    height = 1.9
    reach = 9.0
    ends = [(reach, height + reach * np.tan(np.radians(angle))) for angle in elevations_deg]
    for ring, (x, z) in enumerate(ends):
        axis.plot([0, x], [height, z], color=COLOURS[0], linewidth=1.6)
        axis.text(x + 0.1, z, f"ring {ring}", color=COLOURS[0], va="center")
    edges = [-40.0, *elevations_deg, 30.0]
    for gap, (low, high) in enumerate(pairwise(edges)):
        angle = np.radians((low + high) / 2)
        axis.text(
            5.2 * np.cos(angle),
            height + 5.2 * np.sin(angle),
            f"{gap}",
            ha="center",
            va="center",
            fontsize=13,
            color="0.35",
        )
    axis.text(2.1, 4.6, "0 … 4: beam gap index,\nhow many beams pass\nat or below a point", color="0.35", ha="center")
    axis.add_patch(Arc((0, height), 13, 13, theta1=0, theta2=12, color=COLOURS[5], linewidth=1.6))
    axis.annotate("elevation 12°", (6.45, height + 0.7), (6.9, height + 3.2), color=COLOURS[5], ha="center",
                  arrowprops={"arrowstyle": "-", "color": COLOURS[5]})  # fmt: skip
    axis.plot(0, height, "ko", markersize=9)
    axis.text(-0.15, height + 0.35, "origin of the\nsensor frame", ha="right", va="bottom", fontsize=9)
    axis.set(xlim=(-2.6, 10.4), ylim=(-3.6, 6.6), aspect="equal", title="From the side: beams, rings, gaps")
    axis.axis("off")


def _from_above(axis: Axes) -> None:
    """A field of view, a beam that widens with two echoes, and what a body hides."""
    axis.add_patch(Wedge((0, 0), 7.6, -110, 110, facecolor="#eaf2fa", edgecolor="none"))
    axis.text(-1.2, -5.6, "horizontal field\nof view", ha="left", color=COLOURS[0])
    axis.add_patch(Wedge((0, 0), 7.6, -62, -38, width=5.1, facecolor="0.8", edgecolor="none"))
    axis.add_patch(Rectangle((1.2, -2.1), 1.3, 0.9, facecolor="0.35"))
    axis.text(3.35, -4.0, "blind", ha="center", va="center")
    axis.text(2.65, -1.7, "body", fontsize=9.5)
    head = np.radians(20)
    for turn in (-0.055, 0.055):
        axis.plot([0, 7.2 * np.cos(head + turn)], [0, 7.2 * np.sin(head + turn)], color=COLOURS[1], linewidth=1)
    axis.plot(*(4.1 * np.array([np.cos(head + 0.045), np.sin(head + 0.045)])), "o", color=COLOURS[2], markersize=9)
    axis.annotate(
        "first echo:\na pole", (3.9, 1.6), (3.2, 3.1), ha="center", arrowprops={"arrowstyle": "-"}, fontsize=9.5
    )
    wall = 7.2 * np.array([[np.cos(head - 0.1), np.sin(head - 0.1)], [np.cos(head + 0.1), np.sin(head + 0.1)]])
    axis.plot(*wall.T, color="0.2", linewidth=4)
    axis.annotate("last echo: a wall;\nthe beam has widened\nby its divergence", wall[1], (5.6, 4.1), ha="center",
                  va="bottom", arrowprops={"arrowstyle": "-"}, fontsize=9.5)  # fmt: skip
    axis.add_patch(Arc((0, 0), 2.2, 2.2, theta1=-102, theta2=0, color=COLOURS[5], linewidth=1.6))
    tip, back = (1.1 * np.array([np.cos(angle), np.sin(angle)]) for angle in np.radians((-110, -100)))
    axis.annotate("", tip, back, arrowprops={"arrowstyle": "-|>", "color": COLOURS[5]})
    axis.text(-0.7, -1.1, "azimuth 110°,\nclockwise from x", color=COLOURS[5], fontsize=9.5, ha="right", va="center")
    axis.annotate("", (8.1, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.4"})
    axis.annotate("", (0, 3.2), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.4"})
    axis.text(8.15, 0, "x", va="center")
    axis.text(0, 3.3, "y", ha="center")
    axis.plot(0, 0, "ko", markersize=9)
    axis.set(xlim=(-3.2, 8.6), ylim=(-6.6, 6.2), aspect="equal", title="From above: what is seen, and what comes back")
    axis.axis("off")


MAKERS = {
    "vlp-16": "Velodyne VLP-16",
    "os1-64": "Ouster OS1-64",
    "pandar-xt32": "Hesai PandarXT-32",
    "helios-32": "RoboSense Helios-32",
}
PLACE = 40.0, -1.6, 0.0  # in the suburb, between hedges and parked cars


def makers(path: Path) -> None:
    """One revolution of a sensor of each maker in the same place of the suburb, from above, by height."""
    figure = new_figure(10, 9.6)
    with tempfile.TemporaryDirectory() as name:
        for axis, (model, title) in zip(figure.subplots(2, 2).ravel(), MAKERS.items(), strict=True):
            cloud = _revolution(model, Path(name))
            x, y, z = cloud.xyz[np.abs(cloud.xyz[:, :2]).max(axis=1) < 25].T
            axis.scatter(x, y, s=0.6, c=z, cmap="viridis", vmin=0, vmax=5, linewidths=0)
            axis.set(aspect="equal", xlim=(-25, 25), ylim=(-25, 25), title=f"{title}: {len(cloud.xyz):,} returns")
            axis.set(xlabel="x (m)", ylabel="y (m)")
    save_figure(figure, path)
    save(Image.open(path).convert("RGB"), path)


def _revolution(model: str, folder: Path) -> PointCloud:
    """What a sensor on a roof sees in a tenth of a second."""
    rig = folder / f"{model}.yaml"
    capture = folder / f"{model}.pcap"
    rig.write_text(
        f"name: {model}\nsensors: [{{name: {model}, model: {model}, position_m: [0.3, 0, 1.9], rpm: 600}}]\n"
    )
    at = f"--at={','.join(map(str, PLACE))}"
    for words in (
        ["export", rig, "--scene", ROOT / "data/scenes/suburb.yaml", at, "--duration", "0.1", "-o", capture],
        ["decode", capture, "--rig", rig, "-o", folder / f"{model}.npz"],
    ):
        cli.main([*map(str, words), "--quiet"], standalone_mode=False)
    return load_cloud(folder / f"{model}.npz", print)


def suburb(path: Path) -> None:
    """The suburb of data/scenes, from above."""
    camera = Camera((38, -40, 24), (82, 14, 0), 62, (900, 480))
    save(picture(load_scene(ROOT / "data/scenes/suburb.yaml"), camera, road().points_m), path)


def depot(path: Path) -> None:
    """The depot of data/scenes, from above one of its gates."""
    camera = Camera((-42, -20, 13), (6, 4, 0), 58, (900, 480))
    save(picture(load_scene(ROOT / "data/scenes/depot.yaml"), camera, np.zeros((1, 2))), path)


PICTURES = {
    "subspace": subspace,
    "axes": axes_and_angles,
    "mounted": mounted,
    "height-field": height_field,
    "makers": makers,
    "suburb": suburb,
    "depot": depot,
    "terms": terms,
}


def main() -> None:
    """All pictures, or those that are named."""
    FOLDER.mkdir(exist_ok=True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PICTURES))
    names = parser.parse_args().names
    if unknown := set(names) - PICTURES.keys():
        parser.error(f"no picture is called {', '.join(sorted(unknown))}; allowed: {', '.join(PICTURES)}")
    for name in names or PICTURES:
        PICTURES[name](path := FOLDER / f"{name}.png")
        print(f"{path.name}: {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
