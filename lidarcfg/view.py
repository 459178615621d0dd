"""Merged clouds to look at: a still drawn without a screen or GPU, and Open3D's window where there is one."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.cloud import PointCloud
from lidarcfg.config import replacing
from lidarcfg.errors import CloudError
from lidarcfg.geometry import Array
from lidarcfg.rig import Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BACKGROUND = (16, 20, 28)
NIGHT = "#{:02x}{:02x}{:02x}".format(*BACKGROUND)
BRIGHT = (
    "#56B4E9",
    "#E69F00",
    "#2ED9A3",
    "#F5A9D6",
    "#F0E442",
    "#FF7F50",
)  # on NIGHT; told apart by colour-blind people


@dataclass(frozen=True)
class Camera:
    """A pinhole: where it stands, what it looks at, and how wide it sees."""

    eye_m: Array  # (3,)
    target_m: Array  # (3,)
    field_deg: float  # across the picture's width

    def project(self, xyz: Array, width: int, height: int) -> tuple[Array, Array, Array]:
        """Columns, rows (fractional pixels) and depth in metres of points (N, 3); behind it: depth <= 0."""
        forward = self.target_m - self.eye_m
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        view = (xyz - self.eye_m) @ np.stack([right, np.cross(right, forward), forward], axis=1)
        depth = view[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = view[:, :2] / depth[:, None] * (width / 2 / np.tan(np.radians(self.field_deg) / 2))
        return width / 2 + flat[:, 0], height / 2 - flat[:, 1], depth


def save_still(cloud: PointCloud, path: Path, rig: Rig | None = None) -> None:
    """Draw the cloud coloured by sensor, in perspective and from above, as a PNG of 1920 × 1080.

    The points stand in the vehicle frame if `rig` is given, whose sensors are then marked.
    Raises CloudError where there is nothing to draw.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    if not len(cloud.xyz):
        raise CloudError("the cloud is empty; there is nothing to draw")
    colours = _shaded(cloud)
    figure = Figure(figsize=(19.2, 10.8), dpi=100, facecolor=NIGHT)
    scene = figure.add_axes((0.0, 0.42, 1.0, 0.58))
    above = figure.add_axes((0.04, 0.055, 0.95, 0.35))
    middle = _middle(cloud, rig)
    _draw_perspective(scene, cloud.xyz, colours, middle, rig)
    _draw_above(above, cloud.xyz, colours, middle, rig)
    counts = np.bincount(cloud.sensor, minlength=len(cloud.sensor_names))
    dots = [
        Line2D([], [], ls="", marker="o", color=_colour(i), label=f"{name}: {count:,} points")
        for i, (name, count) in enumerate(zip(cloud.sensor_names, counts, strict=True))
    ]
    legend = scene.legend(handles=dots, loc="upper left", facecolor=NIGHT, edgecolor="0.4", labelcolor="w", fontsize=13)
    for text in legend.get_texts():
        text.set_parse_math(False)
    with replacing(path, "wb") as file:
        figure.savefig(file, format="png", facecolor=NIGHT)


def show_window(cloud: PointCloud) -> None:
    """Open Open3D's window on the cloud. Raises CloudError where there is no screen."""
    import open3d as o3d

    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise CloudError("there is no screen for a window; --png FILE draws a still without one")
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.xyz))
    points.colors = o3d.utility.Vector3dVector(_shaded(cloud) / 255.0)
    window = o3d.visualization.Visualizer()
    if not window.create_window("lidarcfg"):
        raise CloudError("Open3D could not open a window on this screen; --png FILE draws a still")
    window.add_geometry(points)
    window.add_geometry(o3d.geometry.TriangleMesh.create_coordinate_frame(1.0))
    window.get_render_option().background_color = np.array(BACKGROUND) / 255.0
    window.get_render_option().point_size = 2.0
    window.run()
    window.destroy_window()


def _colour(sensor: int) -> str:
    return BRIGHT[sensor % len(BRIGHT)]


def _shaded(cloud: PointCloud) -> NDArray[np.uint8]:
    """(N, 3): the sensor's colour, darker for dark objects."""
    from matplotlib.colors import to_rgb

    base = np.array([to_rgb(_colour(i)) for i in range(max(len(cloud.sensor_names), 1))])
    light = 0.7 + 0.3 * np.sqrt(np.minimum(cloud.intensity, 100) / 100)
    return np.asarray(255 * base[cloud.sensor] * light[:, None], np.uint8)


def _faded(colours: NDArray[np.uint8], depth: Array) -> NDArray[np.uint8]:
    """The colours (N, 3) going into the background with the distance (N,)."""
    share = np.clip(1.1 - depth / 110, 0.35, 1.0)[:, None]
    return np.asarray(share * colours + (1 - share) * np.array(BACKGROUND), np.uint8)


def _middle(cloud: PointCloud, rig: Rig | None) -> Array:
    """(3,) what the picture is about: the sensors, or else the points, on the ground."""
    about = np.array([m.position_m for m in rig.mounts]).mean(axis=0) if rig else np.median(cloud.xyz, axis=0)
    return np.array([about[0], about[1], np.percentile(cloud.xyz[:, 2], 5)])


def _draw_perspective(axes: "Axes", xyz: Array, colours: NDArray[np.uint8], middle: Array, rig: Rig | None) -> None:
    width, height = 1920, 626
    camera = Camera(middle + np.array([-21.0, -7.0, 7.5]), middle + np.array([8.0, 0.5, 0.5]), 74.0)
    column, row, depth = camera.project(xyz, width, height)
    faded = _faded(colours, depth)
    image = np.full((height, width, 3), BACKGROUND, np.uint8)
    seen = np.flatnonzero((depth > 0.5) & (column > -1) & (column < width) & (row > -1) & (row < height))
    seen = seen[np.argsort(-depth[seen], kind="stable")]  # far first, so that near points cover them
    for side in range(3):  # the nearer a point, the larger its square
        near = seen[depth[seen] < (np.inf, 60.0, 22.0)[side]]
        for step_row, step_column in np.ndindex(side + 1, side + 1):
            if max(step_row, step_column) == side:
                r, c = row[near].astype(int) + step_row, column[near].astype(int) + step_column
                fits = (r >= 0) & (r < height) & (c >= 0) & (c < width)
                image[r[fits], c[fits]] = faded[near[fits]]
    axes.imshow(image, aspect="auto", extent=(0, width, height, 0), interpolation="nearest")
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    for i, mount in enumerate(rig.mounts if rig else ()):
        at = np.array(mount.position_m)
        foot = np.array([at[0], at[1], middle[2]])
        x, y, _ = camera.project(np.stack([at, foot]), width, height)
        axes.plot(x, y, color="w", lw=0.8, alpha=0.7)
        axes.plot(x[0], y[0], "o", color=_colour(i), ms=11, mec="w", mew=1.8)
        above = 26 + 22 * (i % 2)
        axes.annotate(
            mount.name, (x[0], y[0]), (0, above), textcoords="offset points", ha="center", color="w", parse_math=False
        )


def _draw_above(axes: "Axes", xyz: Array, colours: NDArray[np.uint8], middle: Array, rig: Rig | None) -> None:
    width, height, reach = 1824, 378, 48.0  # metres to either side along x
    scale = width / (2 * reach)
    column = np.floor((xyz[:, 0] - middle[0]) * scale + width / 2).astype(int)
    row = np.floor(height / 2 - (xyz[:, 1] - middle[1]) * scale).astype(int)
    image = np.full((height, width, 3), BACKGROUND, np.uint8)
    fits = np.flatnonzero((column >= 0) & (column < width) & (row >= 0) & (row < height))
    fits = fits[np.argsort(xyz[fits, 2], kind="stable")]  # low first
    image[row[fits], column[fits]] = colours[fits]
    side = height / 2 / scale
    extent = (middle[0] - reach, middle[0] + reach, middle[1] - side, middle[1] + side)
    axes.imshow(image, extent=extent, aspect="auto", interpolation="nearest")
    for i, mount in enumerate(rig.mounts if rig else ()):
        axes.plot(*mount.position_m[:2], "o", color=_colour(i), ms=7, mec="w", mew=1.2)
    axes.set(xlabel="x (m)", ylabel="y (m)", facecolor=NIGHT)
    axes.tick_params(colors="0.8")
    axes.xaxis.label.set_color("0.8")
    axes.yaxis.label.set_color("0.8")
