"""Stills: pictures drawn without a screen, a GPU or a display server."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import viewer as core
from lidarcfg.errors import CloudError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array, transform
from lidarcfg.inputs import check_memory
from lidarcfg.report.canvas import spread
from lidarcfg.report.describe import counted
from lidarcfg.report.text import truncate
from lidarcfg.sensors.rig import Mount
from lidarcfg.viewer.bodies import RigScore, base_area_m, base_discs_m, region_bodies, score
from lidarcfg.viewer.camera import Camera
from lidarcfg.viewer.colours import (
    BACKGROUND,
    BASE,
    BASE_AREA,
    EXCLUDED,
    NIGHT,
    RETRO,
    UNKNOWN,
    VEHICLE,
    WORST,
    ZONE,
    By,
    colour,
    point_colours,
    rgb,
    scaled,
    sensor_colours,
    span,
)
from lidarcfg.viewer.contents import Contents
from lidarcfg.viewer.mounting import has_its_sensors
from lidarcfg.viewer.timeline import mesh_at
from lidarcfg.world.meshes import Mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE: tuple[int, int] = (1920, 1080)
PIXEL_BYTES = 22  # of memory to draw one, measured
LETTER = 0.62  # the mean width of a letter in sizes of its text
LINE = 1.3  # the height of a line
DOT = 16.0  # pixels of a sensor's dot in a picture of 626 rows
BAND = 256  # rows of pixels that labels and lines are blended into at a time
NEAR_M = 0.05
GROUND_M = 200.0  # of the ground, to each side of the vehicle
AXIS_M = 0.6
BASE_AHEAD_M = 0.5  # before the triangles of the body that a sensor sits on
Bodies = list[tuple[Array, str]]  # faces (F, 4, 3) and colour
AXES_COLOURS = ("#FF7F50", "#2ED9A3", "#56B4E9")  # x, y, z
LABELS_EM = 6.0  # at the left of the view from above, at least
REACH_M = 48.0  # of the view from above, to each side of the center at most
LEAST_M = 4.0  # across it
EYE_M = np.array([-21.0, -7.0, 7.5])  # from the center, and of the target, where the view from above reaches NEAR_EYE_M
TARGET_M = np.array([8.0, 0.5, 0.5])
NEAR_EYE_M = 24.0  # half its length; where it is shorter, the eye is nearer in proportion
NEAREST = 0.2  # at most so much
DENSE = 200_000  # points in the view from above, of which each is a pixel; fewer are larger
LARGEST_PX = 4
MARGIN = 1.06  # around what the view from above shows
WORST_SHOWN = 3  # of the worst subspaces, where they hide no points


def save_still(
    contents: Contents,
    path: str | Path,
    size: tuple[int, int] = SIZE,
    camera: Camera | None = None,
    by: By = "sensor",
    worst: int | None = None,
) -> None:
    """Draw what was loaded as a PNG of `size` pixels, from the camera; or without one in perspective and from above.

    So many of the `worst` subspaces are drawn; by default 3, or none where there are points.
    Raises CloudError if there is nothing to draw, or nothing in view; LidarcfgError where memory
    does not hold the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    if not (len(contents.cloud.xyz) or contents.rigs or contents.study or contents.scenes):
        raise CloudError("the cloud is empty; there is nothing to draw")
    width, height = size
    check_memory(f"a picture of {width} x {height} pixels", PIXEL_BYTES * width * height)
    colours = point_colours(contents, by)
    if worst is None:
        worst = 0 if len(contents.cloud.xyz) else WORST_SHOWN
    found = score(contents.study, contents.rigs[0], worst) if contents.study else None
    bodies = region_bodies(contents.study, found) if contents.study and found else []
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="none")  # lines and labels only
    canvas: Any = FigureCanvasAgg(figure)  # matplotlib has no types here
    pixels = np.full((height, width, 3), rgb([NIGHT])[0], np.uint8)
    if camera:
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        _draw_perspective(axes, pixels, contents, colours, camera, bodies)
    else:
        center = _center(contents)
        frame = _frame(contents, center)
        ahead, above = _layout(width, height, frame)
        nearer = np.clip((frame[1] - frame[0]).max() / (2 * NEAR_EYE_M), NEAREST, 1.0)
        camera = Camera(center + nearer * EYE_M, center + nearer * TARGET_M, 74.0)
        axes = figure.add_axes(ahead.of(width, height))
        _draw_perspective(axes, ahead.within(pixels), contents, colours, camera, bodies)
        below = figure.add_axes(above.of(width, height))
        _draw_above(below, above.within(pixels), contents, colours, frame, height, bodies)
    _legend(axes, contents, by, height, found)
    drawn, _ = canvas.print_to_buffer()  # RGBA
    _blend(np.frombuffer(drawn, np.uint8).reshape(height, width, 4), pixels)
    with replacing(path, "wb") as file:
        Image.fromarray(pixels).save(file, format="png")


def _blend(drawn: NDArray[np.uint8], pixels: NDArray[np.uint8]) -> None:
    """Blend what was drawn, (H, W, 4) with its opacity last, into pixels (H, W, 3)."""
    for top in range(0, len(pixels), BAND):
        band = slice(top, top + BAND)
        opacity = drawn[band, :, 3:].astype(np.uint32)
        pixels[band] = (drawn[band, :, :3] * opacity + pixels[band] * (255 - opacity) + 127) // 255


def _faded(colours: NDArray[np.uint8], depth: Array) -> NDArray[np.uint8]:
    """The colours (N, 3), fading into the background with distance (N,)."""
    near = np.clip(1.1 - depth / 110, 0.35, 1.0)[:, None]
    return np.asarray(near * colours + (1 - near) * np.array(BACKGROUND), np.uint8)


def _mounts(contents: Contents) -> list[Mount]:
    return [mount for rig in contents.rigs for mount in rig.mounts]


def _center(contents: Contents) -> Array:
    """(3,) the picture's center on the ground, by the sensors or else the points."""
    low = [float(np.percentile(contents.cloud.xyz[:, 2], 5))] if len(contents.cloud.xyz) else []
    if contents.study:
        low.append(float(contents.study.region.min_m[2]))
    mounts = _mounts(contents)
    if mounts:
        about = np.array([mount.position_m for mount in mounts]).mean(axis=0)
    elif len(contents.cloud.xyz):
        about = np.median(contents.cloud.xyz, axis=0)
    elif contents.study:
        about = (contents.study.region.min_m + contents.study.region.max_m) / 2
    else:
        about = np.zeros(3)
    return np.array([about[0], about[1], min(low, default=0.0)])


def _frame(contents: Contents, center: Array) -> Array:
    """(2, 2) the lower and the upper corner of what a view from above shows: all but a few of the points, and what
    else there is, within REACH_M of the center."""
    parts = [np.array([mount.position_m[:2] for mount in _mounts(contents)]).reshape(-1, 2)]
    near = contents.cloud.xyz[(abs(contents.cloud.xyz - center)[:, :2] <= REACH_M).all(axis=1), :2]
    if len(near):
        parts.append(np.percentile(near, (1, 99), axis=0))
    if contents.vehicle:
        parts.append(contents.vehicle.scene.mesh()[0][:, :2])
    if contents.study:
        parts.append(np.array([contents.study.region.min_m[:2], contents.study.region.max_m[:2]]))
    if not len(contents.cloud.xyz):
        parts += [vertices[:, :2] for vertices, _ in _scenery(contents)]
    places = np.clip(np.concatenate([center[None, :2], *parts]), center[:2] - REACH_M, center[:2] + REACH_M)
    low = places.min(axis=0)
    high = places.max(axis=0)
    half = np.maximum(MARGIN * (high - low), LEAST_M) / 2
    return np.array([(low + high) / 2 - half, (low + high) / 2 + half])


class Pane(NamedTuple):
    """A part of a picture, in pixels from its left and its bottom."""

    left: int
    bottom: int
    width: int
    height: int

    def of(self, width: int, height: int) -> tuple[float, float, float, float]:
        """The part as fractions of the picture's size."""
        return self.left / width, self.bottom / height, self.width / width, self.height / height

    def within(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Its pixels, of those of the picture (H, W, 3)."""
        top = len(pixels) - self.bottom - self.height
        return pixels[top : top + self.height, self.left : self.left + self.width]


def _layout(width: int, height: int, frame: Array) -> tuple[Pane, Pane]:
    """Where the perspective is, and below or beside it, where it is larger, the view from above of a frame (2, 2)."""
    labels = round(LABELS_EM * _text_pt(height) * 100 / 72)
    margin = round(0.01 * width)
    bottom = round(0.055 * height)
    layouts = []
    for wide, high in ((1.0, 0.58), (0.52, 1.0)):  # of the perspective, as fractions of the picture
        ahead = Pane(0, height - round(high * height), round(wide * width), round(high * height))
        before = ahead.width if wide < 1 else 0
        left = before + min(max(labels, round(0.04 * width)), (width - before) // 2)
        above_height = (ahead.bottom or height) - bottom - margin
        layouts.append((ahead, Pane(left, bottom, max(width - margin - left, 1), max(above_height, 1))))
    return max(layouts, key=lambda layout: _scale(layout[1].width, layout[1].height, frame))


def _scale(width: int, height: int, frame: Array) -> float:
    """Pixels a metre of a frame (2, 2) that fits into so many."""
    return float(np.min((width, height) / (frame[1] - frame[0])))


def _scenery(contents: Contents) -> list[Mesh]:
    """The scenes, without their ground."""
    found = []
    for scene in contents.scenes:
        vertices, triangles = mesh_at(scene, contents.first_ns - contents.zero_ns)
        found.append((transform(contents.T_vehicle_world, vertices), triangles))
    return found


def _draw_perspective(
    axes: "Axes",
    pixels: NDArray[np.uint8],
    contents: Contents,
    colours: NDArray[np.uint8],
    camera: Camera,
    bodies: Bodies,
) -> None:
    height, width = pixels.shape[:2]
    column, row, depth = camera.project(contents.cloud.xyz, width, height)
    faded = _faded(colours, depth)
    image = np.full((height, width, 3), BACKGROUND, np.float32)
    nearest_m = np.full((height, width), np.inf, np.float32)
    seen = np.flatnonzero((depth > 0.5) & (column > -3) & (column < width) & (row > -3) & (row < height))
    seen = seen[np.argsort(-depth[seen], kind="stable")]  # far first, so that near points cover them
    for side in range(3):  # the nearer a point, the larger its square
        near = seen[depth[seen] < (np.inf, 60.0, 22.0)[side]]
        for step_row, step_column in np.ndindex(side + 1, side + 1):
            if max(step_row, step_column) == side:
                r = row[near].astype(int) + step_row
                c = column[near].astype(int) + step_column
                fits = (r >= 0) & (r < height) & (c >= 0) & (c < width)
                image[r[fits], c[fits]] = faded[near[fits]]
                nearest_m[r[fits], c[fits]] = depth[near[fits]]
    drawn = int(np.isfinite(nearest_m).sum()) + _draw_bodies(image, nearest_m, contents, camera, bodies)
    pixels[:] = image
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    drawn += _draw_region(axes, contents, camera, width, height) + _draw_mounts(axes, contents, camera, width, height)
    if not drawn:
        eye, target = (",".join(f"{v:g}" for v in point) for point in (camera.eye_m, camera.target_m))
        raise CloudError(f"nothing is in view of a camera at {eye} that looks at {target}")


class Shape(NamedTuple):
    """A translucent body."""

    triangles: Array  # (T, 3, 3)
    colour: str
    opacity: float
    ahead_m: float = 0.0  # of what is as far away, in the order of drawing


def _draw_bodies(
    image: NDArray[np.float32], nearest_m: NDArray[np.float32], contents: Contents, camera: Camera, bodies: Bodies
) -> int:
    """Blend the translucent bodies into the image in front of its points; returns the number of pixels."""
    shapes = _shapes(contents, bodies)
    if not shapes:
        return 0
    triangles = camera.view(np.concatenate([shape.triangles for shape in shapes]))
    sizes = [len(shape.triangles) for shape in shapes]
    colours = np.repeat(rgb([shape.colour for shape in shapes]).astype(np.float64), sizes, axis=0)
    alpha, ahead_m = (np.repeat([shape[i] for shape in shapes], sizes) for i in (2, 3))
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    with np.errstate(invalid="ignore"):
        light = 0.6 + 0.4 * abs(np.nan_to_num(sides[:, 2] / np.linalg.norm(sides, axis=1)))
    order = np.argsort(ahead_m - triangles[:, :, 2].mean(axis=1), kind="stable")
    focal_px = camera.focal_px(image.shape[1])
    shaded = (colours * light[:, None])[order]
    return core.blend_triangles(image, nearest_m, triangles[order], shaded, alpha[order], focal_px, NEAR_M)


def _shapes(contents: Contents, bodies: Bodies) -> list[Shape]:
    """Scenes, the vehicle with the bases and where they fit, exclusions of the region, worst subspaces."""
    shapes: list[Shape] = []
    shapes += [Shape(vertices[corners_of], EXCLUDED, 0.13) for vertices, corners_of in _scenery(contents)]
    for scene in contents.scenes:
        if scene.file.ground:
            corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * GROUND_M
            corners[:, 2] = transform(contents.T_vehicle_world, [[0, 0, scene.file.ground.z_m]])[0, 2]
            shapes.append(Shape(_halved(corners[None]), EXCLUDED, 0.05))
    if contents.vehicle:
        vertices, corners_of = contents.vehicle.scene.mesh()
        shapes.append(Shape(vertices[corners_of], VEHICLE, 0.8))
    if contents.study and has_its_sensors(contents.study, contents.rigs[0]):
        shapes.append(Shape(_halved(base_area_m(contents.study)), BASE_AREA, 0.7, BASE_AHEAD_M))
        shapes.append(Shape(base_discs_m(contents.study, contents.rigs[0]), BASE, 0.9, BASE_AHEAD_M))
    return shapes + [Shape(_halved(quads), code, 0.28) for quads, code in bodies]


def _halved(quads: Array) -> Array:
    """(2F, 3, 3) triangles of quads (F, 4, 3)."""
    return np.concatenate([quads[:, (0, 1, 2)], quads[:, (0, 2, 3)]])


def _draw_lines(axes: "Axes", ends_m: Array, camera: Camera, width: int, height: int, **look: Any) -> int:
    """Draw lines (L, 2, 3), clipped at the camera; returns how many are in the picture."""
    from matplotlib.collections import LineCollection

    view = camera.view(ends_m)
    ahead = view[..., 2] >= NEAR_M
    view = view[ahead.any(axis=1)]
    ahead = ahead[ahead.any(axis=1)]
    for here, there in ((0, 1), (1, 0)):  # clip at the near plane
        a = view[~ahead[:, here], here]
        b = view[~ahead[:, here], there]
        view[~ahead[:, here], here] = a + ((NEAR_M - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None] * (b - a)
    flat = view[..., :2] / view[..., 2:] * camera.focal_px(width)
    ends = np.stack([width / 2 + flat[..., 0], height / 2 - flat[..., 1]], axis=-1)
    axes.add_collection(LineCollection(list(ends), **look), autolim=False)
    low = ends.min(axis=1)
    high = ends.max(axis=1)
    return int(((high >= 0) & (low <= (width, height))).all(axis=1).sum())


def _draw_region(axes: "Axes", contents: Contents, camera: Camera, width: int, height: int) -> int:
    """The edges of the region and of its zones, and the zones' names."""
    if not contents.study:
        return 0
    region = contents.study.region
    seen = 0
    boxes = [(region.min_m, region.max_m, EXCLUDED), *((*zone.box_m, ZONE) for zone in contents.study.zones)]
    for low, high, code in boxes:
        seen += _draw_lines(axes, _edges(low, high), camera, width, height, colors=code, linewidths=0.8)
    for zone in contents.study.zones:
        top = np.array([*np.mean(zone.box_m, axis=0)[:2], zone.box_m[1][2]])
        x, y, depth = camera.project(top[None], width, height)
        if depth[0] >= NEAR_M and 0 <= x[0] <= width and 0 <= y[0] <= height:
            axes.annotate(
                truncate(zone.name), (x[0], y[0]), ha="center", color=ZONE, fontsize=5 + height / 125, parse_math=False
            )
    return seen


def _edges(low: Array, high: Array) -> Array:
    """(12, 2, 3) the edges of a box."""
    unit = np.array(list(np.ndindex(2, 2, 2)))
    pairs = [(i, j) for i in range(8) for j in range(i) if abs(unit[i] - unit[j]).sum() == 1]
    edges: Array = (low + unit * (high - low))[np.array(pairs)]
    return edges


def _draw_mounts(axes: "Axes", contents: Contents, camera: Camera, width: int, height: int) -> int:
    """Each sensor: its position, a line down to the ground, its axes and its name."""
    mounts = _mounts(contents)
    shown = sensor_colours(contents)
    seen = 0
    if not mounts:
        return 0
    ground_m = _center(contents)[2]
    size = height / 626
    places: list[tuple[float, float]] = []
    names: list[str] = []
    for mount in mounts:
        at = np.array(mount.position_m)
        T = mount.T_vehicle_sensor
        lines = np.stack(
            [np.repeat(at[None], 4, axis=0), [*(at + AXIS_M * T[:3, :3].T), [at[0], at[1], ground_m]]], axis=1
        )
        _draw_lines(axes, lines, camera, width, height, colors=[*AXES_COLOURS, "#FFFFFFA0"], linewidths=0.8 + size)
        x, y, depth = camera.project(at[None], width, height)
        if depth[0] < NEAR_M or not (0 <= x[0] <= width and 0 <= y[0] <= height):
            continue
        seen += 1
        axes.plot(x, y, "o", color=shown[mount.name], ms=3 + 8 * size, mec="w", mew=0.8 + size)
        places.append((float(x[0]), float(y[0])))
        names.append(truncate(mount.name))
    if names:
        name_mounts(axes, np.array(places), names, size)
    return seen


def name_mounts(axes: "Axes", places: Array, names: list[str], size: float) -> None:
    """Write the sensors' names above their places (n, 2) in pixels, none over another or over a sensor's dot."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    text_pt = 5 + 5 * size
    line = text_pt * 100 / 72
    boxes = np.array([(LETTER * len(name) * line, LINE * line) for name in names])
    dots = np.full((len(names), 2), DOT * size)
    above = places - (0.0, 26 * size * 100 / 72)
    corner = np.array([right - left, bottom - top])
    found = spread(np.concatenate([places, above]), np.concatenate([dots, boxes]), np.zeros(2), corner)[len(names) :]
    for (x, y), name in zip(found.tolist(), names, strict=True):
        axes.text(x, y, name, ha="center", va="center", color="w", fontsize=text_pt, parse_math=False, clip_on=True)


def _text_pt(picture_height: int) -> float:
    """The font size beside the view from above, in points."""
    return 3 + 7 * picture_height / 1080


def _draw_above(
    axes: "Axes",
    pixels: NDArray[np.uint8],
    contents: Contents,
    colours: NDArray[np.uint8],
    frame: Array,
    picture_height: int,
    bodies: Bodies,
) -> None:
    """Draw a frame (2, 2) of the points, the vehicle's outline, the region and the sensors from above."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Rectangle

    xyz = contents.cloud.xyz
    height, width = pixels.shape[:2]
    middle = frame.mean(axis=0)
    scale = _scale(width, height, frame)
    column = np.floor((xyz[:, 0] - middle[0]) * scale + width / 2).astype(int)
    row = np.floor(height / 2 - (xyz[:, 1] - middle[1]) * scale).astype(int)
    pixels[:] = BACKGROUND
    fits = np.flatnonzero((column >= 0) & (column < width) & (row >= 0) & (row < height))
    fits = fits[np.argsort(xyz[fits, 2], kind="stable")]  # low first
    side = int(np.clip(np.sqrt(DENSE / max(len(xyz), 1)), 1, LARGEST_PX))
    for down, right in np.ndindex(side, side):
        pixels[np.minimum(row[fits] + down, height - 1), np.minimum(column[fits] + right, width - 1)] = colours[fits]
    half = np.array([width, height]) / (2 * scale)
    low, high = middle - half, middle + half
    if not len(xyz):
        seen = [vertices[triangles][..., :2] for vertices, triangles in _scenery(contents)]
        for triangles in seen:
            axes.add_collection(PolyCollection(list(triangles), facecolors=EXCLUDED, alpha=0.13, lw=0), autolim=False)
    for outline in contents.vehicle.footprint.outlines_m if contents.vehicle else ():
        axes.fill(*outline.T, facecolor=f"{VEHICLE}40", edgecolor=VEHICLE, lw=1.0)
    for quads, code in bodies:
        flat = quads[np.ptp(quads[..., 2], axis=1) == 0][..., :2]
        axes.add_collection(PolyCollection(list(flat), facecolors=code, alpha=0.2, linewidths=0), autolim=False)
    if contents.study:
        least = contents.study.region.min_m
        edges = contents.study.region.max_m - least
        axes.add_patch(Rectangle((least[0], least[1]), edges[0], edges[1], fill=False, ec=EXCLUDED, lw=0.8))
    shown = sensor_colours(contents)
    for mount in _mounts(contents):
        at = mount.position_m
        axes.plot(
            at[0],
            at[1],
            "o",
            color=shown[mount.name],
            ms=1 + 6 * picture_height / 1080,
            mec="w",
            mew=1.2,
        )
    text = _text_pt(picture_height)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), facecolor="none")
    axes.set_xlabel("x (m)", color="0.8", fontsize=text)
    axes.set_ylabel("y (m)", color="0.8", fontsize=text)
    axes.tick_params(colors="0.8", labelsize=text)
    axes.ticklabel_format(useOffset=False, style="plain")


def _legend(axes: "Axes", contents: Contents, by: By, height: int, found: RigScore | None) -> None:
    """What the colours mean: sensors or objects with their counts, or the colour scale."""
    from matplotlib.lines import Line2D

    entries: list[tuple[str, str]] = []
    if by in ("sensor", "object") and len(contents.cloud.xyz):
        if by == "object" and contents.objects:
            names = contents.objects.names
            index = contents.objects.index
            shown = [*(colour(i) for i in range(len(names) - 1)), UNKNOWN]
        else:
            names = contents.cloud.sensor_names
            index = contents.cloud.sensor
            of_sensor = sensor_colours(contents)
            shown = [of_sensor[name] for name in names]
        counts = np.bincount(index, minlength=len(names))
        most = np.argsort(-counts, kind="stable")[:12] if by == "object" else np.arange(len(names))
        entries = [
            (f"{truncate(names[i])}: {counted(int(counts[i]), 'point')}", shown[i])
            for i in most.tolist()
            if counts[i] or by == "sensor"
        ]
    elif len(contents.cloud.xyz):
        low, high = span(contents, by)
        unit = {"intensity": " %", "height": " m", "time": " s"}.get(by, "")
        for fraction in (1.0, 0.5, 0.0):
            code = scaled([fraction], 0.0, 1.0)[0].astype(int)
            value = round(low + fraction * (high - low), 3) + 0.0  # no -0
            entries.append((f"{by} {value:.4g}{unit}", "#{:02x}{:02x}{:02x}".format(*code)))
        if by == "intensity":
            entries.append(("retro-reflector", RETRO))
    if found and found.worst:
        entries.append((f"worst subspace: max VSR {found.max_vsr_m:.4f} m", WORST))
    if not entries:
        return
    dots = [Line2D([], [], ls="", marker="o", color=code, label=text) for text, code in entries]
    size = 5 + 8 * min(height / 1080, 1.5)
    legend = axes.legend(
        handles=dots, loc="upper left", facecolor=NIGHT, edgecolor="0.4", labelcolor="w", fontsize=size
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
