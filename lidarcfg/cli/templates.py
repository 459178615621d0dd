"""Commented files to start from."""

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from lidarcfg.config.document import inline
from lidarcfg.config.kinds import YAML_SUFFIXES
from lidarcfg.config.models import Section, Vec3
from lidarcfg.errors import ConfigError, ConversionError, SceneError
from lidarcfg.files import example, replacing, shipped
from lidarcfg.sensors.rig import Rig, save_rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.world.robot import SUFFIXES as ROBOTS

KINDS = ("study", "rig", "scene", "sensor")
MODEL = "vlp-16"
CAR = (-2.4, -0.95, 0.0), (2.4, 0.95, 1.5)  # the bounds of a vehicle without a mesh
SUNK_M = 0.05  # how far a body on the ground may be below it, by its mesh
AS_IS: Vec3 = (0.0, 0.0, 0.0)
SIDE_M = 0.1, 50.0  # of a box
BOX = re.compile(r"\d+\.?\d*(x\d+\.?\d*)+")  # length, width and height in metres


@dataclass(frozen=True)
class TemplateBody:
    """The vehicle that a study is made around."""

    low_m: tuple[float, ...]  # of its bounds in the vehicle frame
    high_m: tuple[float, ...]
    closed: bool
    keys: tuple[str, ...] = ()  # that bring it into the vehicle frame
    looks: tuple[str, ...] = ()  # what is said of them
    files: tuple[Path, ...] = ()  # that its file needs
    size_m: tuple[float, ...] = ()  # of a box


def vehicles() -> dict[str, Path]:
    """The bodies that come with the package, by name."""
    folder = shipped("data") / "vehicles"
    return {path.stem: path for path in sorted((*folder.glob("*.ply"), *folder.glob("*.urdf")))}


def write_template(
    kind: str,
    path: Path,
    vehicle: str | None = None,
    on_warning: Callable[[str], None] = lambda _: None,
    model: str = MODEL,
) -> list[Path]:
    """Write one of the `KINDS` of files to start from. Returns what was written.

    A study is made around a vehicle: one of `vehicles`, whose files are copied beside the study, a mesh file, a robot
    in a URDF, whose sensors become a rig beside it, or a box on the ground, as 0.8x0.6x0.4. Its sensors are of a
    `model`. `on_warning` gets what was left out. Raises ConfigError if a file exists already, or if the vehicle or the
    model is unknown or cannot be read.
    """
    sensor = load_sensor(model)
    if vehicle and not sensor.fires:
        raise ConfigError(
            f"model {model}: it is not known how it fires, so that returns cannot be counted; allowed: another"
        )
    own_model = Path(model).suffix in YAML_SUFFIXES
    known = vehicles()
    box = _box(vehicle) if vehicle else None
    file = None if vehicle is None or box else known.get(vehicle, Path(vehicle))
    if file and vehicle not in known and not file.suffix:
        allowed = f"{', '.join(known)}, a mesh file, a URDF, or length, width and height in metres, as 0.8x0.6x0.4"
        raise ConfigError(f"no vehicle is called {vehicle!r}; allowed: {allowed}")
    body = _body(file) if file else box or TemplateBody(*CAR, closed=True)
    copied = {path.parent / one.name: one for one in (file, *body.files)} if file and vehicle in known else {}
    named = path.parent / file.name if copied and file else file
    rig = _rig(file, named, on_warning) if file and named and file.suffix.lower() in ROBOTS else None
    rig_path = path.with_name(f"{path.stem}-rig.yaml")
    template = Environment(undefined=StrictUndefined, keep_trailing_newline=True).from_string(
        (shipped("data") / "templates" / f"{kind}.yaml.j2").read_text("utf-8")
    )
    text = template.render(
        file=path,
        model=inline(os.path.relpath(model, path.parent) if own_model else model),
        has_cones=sensor.scan_pattern is None,
        size=list(body.size_m),
        body=named and inline(os.path.relpath(named, path.parent)),
        body_keys="".join(f", {key}" for key in body.keys),
        closed=body.closed,
        looks=" and ".join(body.looks),
        rig=rig and rig_path,
        apart_m=round(min(0.3, (body.high_m[1] - body.low_m[1]) / 6), 2),
        **_study(body.low_m, body.high_m),
    )
    for new in (path, *copied, *((rig_path,) if rig else ())):
        if not (new in copied and new.exists() and new.read_bytes() == copied[new].read_bytes()):
            _check_new(new)
    for new, old in copied.items():
        if not new.exists():
            with replacing(new, "wb") as out:
                out.write(old.read_bytes())
    if rig:
        save_rig(rig, rig_path)
    with replacing(path) as out:
        out.write(text)
    return [path, *copied, *((rig_path,) if rig else ())]


def write_simplified(
    study: Path, body: Path, triangles: int, on_progress: Callable[[float, str], None]
) -> tuple[Path, str]:
    """Write a mesh of no more triangles beside a study that is to be written. Returns its file, and what was done.

    Raises ConfigError if there is the study or the file already, or if the mesh cannot be simplified so far.
    """
    from lidarcfg.world.mesh_frame import likely_scale
    from lidarcfg.world.meshes import ply_file, read_mesh
    from lidarcfg.world.simplify import SAMPLES, greatest_distance, simplify

    body = example(body)
    path = study.parent / f"{body.stem}-{triangles}.ply"
    _check_new(study)
    _check_new(path)
    try:
        on_progress(0.0, f"reading {body}")
        mesh = read_mesh(body)
        on_progress(0.1, f"simplifying {len(mesh[1]):,} triangles to {triangles:,}")
        fewer = simplify(mesh, triangles)
    except SceneError as error:
        what = str(error)
        raise ConfigError(what if what.startswith(str(body)) else f"{body}: {what}") from None
    on_progress(0.9, "measuring how far the surfaces are apart")
    apart_mm = 1000 * likely_scale(mesh[0].max(axis=0) - mesh[0].min(axis=0)) * greatest_distance(mesh, fewer)
    with replacing(path, "wb") as out:
        out.write(ply_file(fewer))
    on_progress(1.0, f"written {path}")
    said = f"{len(mesh[1]):,} triangles are now {len(fewer[1]):,}, at most {apart_mm:.2g} mm from their surface"
    return path, f"{said}, by {SAMPLES:,} points of each"


def _check_new(path: Path) -> None:
    if path.exists():
        raise ConfigError(f"{path}: exists already; name another file, or remove it")


def _box(size: str) -> TemplateBody | None:
    """A box on the ground, whose length, width and height are given; None if they are not. Raises ConfigError."""
    if not BOX.fullmatch(size):
        return None
    sides_m = tuple(map(float, size.split("x")))
    if len(sides_m) != 3 or not all(SIDE_M[0] <= side_m <= SIDE_M[1] for side_m in sides_m):
        allowed = f"length, width and height, {SIDE_M[0]:g} to {SIDE_M[1]:g} m each, as 0.8x0.6x0.4"
        raise ConfigError(f"vehicle {size}: no box; allowed: {allowed}")
    length, width, height = sides_m
    low_m, high_m = (-length / 2, -width / 2, 0.0), (length / 2, width / 2, height)
    return TemplateBody(low_m, high_m, closed=True, size_m=sides_m)


def _body(file: Path) -> TemplateBody:
    """The body in a file, with the scale, rotation and shift that bring a mesh into the vehicle frame, by its looks."""
    import numpy as np

    from lidarcfg.geometry import pose, transform
    from lidarcfg.world.gltf import SUFFIXES as GLTF
    from lidarcfg.world.mesh_frame import gltf_rpy_deg, likely_position_m, likely_rpy_deg, likely_scale
    from lidarcfg.world.meshes import read_mesh
    from lidarcfg.world.robot_body import robot_body
    from lidarcfg.world.solids import merge_vertices, open_edges

    keys: tuple[str, ...] = ()
    looks: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    try:
        if file.suffix.lower() in ROBOTS:
            robot = robot_body(file)
            vertices_m, triangles = robot.mesh
            files = robot.files
            keys = (f"without: [{', '.join(map(inline, robot.without))}]",) if robot.without else ()
        else:
            vertices, triangles = read_mesh(file)
            turn = gltf_rpy_deg if file.suffix.lower() in GLTF else likely_rpy_deg
            scale, rpy_deg = likely_scale(np.ptp(vertices, axis=0)), turn((vertices, triangles))
            vertices_m = transform(pose((0, 0, 0), np.radians(rpy_deg)), scale * vertices)
            position_m = likely_position_m((vertices_m, triangles))
            vertices_m += position_m
            keys, looks = _frame_keys(scale, rpy_deg, position_m)
    except SceneError as error:
        raise ConfigError(str(error)) from None
    closed = not len(open_edges(merge_vertices((vertices_m, triangles))))
    low_m, high_m = (tuple(corner.tolist()) for corner in (vertices_m.min(axis=0), vertices_m.max(axis=0)))
    return TemplateBody(low_m, high_m, closed, keys, looks, files)


def _rig(file: Path, named: Path, on_warning: Callable[[str], None]) -> Rig | None:
    """The rig of a robot's LiDARs, on the body in the file `named`; None without LiDARs, or if a model is not known."""
    from lidarcfg.io.rig_importers.sensor_kit import rig_of_kit
    from lidarcfg.io.urdf import read_urdf

    kit = read_urdf(file, {})
    if not kit.frames:
        return None
    if kit.vehicle:
        meshes = tuple(mesh | {"file": os.path.realpath(named)} for mesh in kit.vehicle.values["meshes"])
        kit = replace(kit, vehicle=Section({"meshes": meshes}))
    try:
        return rig_of_kit(kit, {}, on_warning)
    except ConversionError as error:
        on_warning(f"no rig of its sensors: {error}")
        return None


def _frame_keys(scale: float, rpy_deg: Vec3, position_m: Vec3) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The keys that bring a mesh into the vehicle frame, and what is said of them."""
    from lidarcfg.world.mesh_frame import TURNS, UNITS

    keys, looks = [], []
    if scale != 1:
        keys.append(f"scale: {scale}")
        looks.append(f"its file's unit is the {UNITS[scale]}")
    if rpy_deg in TURNS:
        keys.append(f"rpy_deg: [{', '.join(f'{angle:g}' for angle in rpy_deg)}]")
        looks.append(f"in its file {TURNS[rpy_deg]}")
    if position_m != AS_IS:
        keys.append(f"position_m: [{', '.join(f'{value:g}' for value in position_m)}]")
        looks.append(f"in its file {math.hypot(*position_m):.0f} m away")
    return tuple(keys), tuple(looks)


def _study(low: tuple[float, ...], high: tuple[float, ...]) -> dict[str, Any]:
    """A study's region, the bounds of its sensors and what its examples ask, around a vehicle's bounds.

    A robot moves slowly, among people and in any direction: what is near it counts, and its region is a square.
    """
    import numpy as np

    from lidarcfg.returns.misses import is_small

    small = is_small(np.array(low[:2]), np.array(high[:2]))
    if small:
        x = y = math.ceil(7 + max(map(abs, (*low[:2], *high[:2]))))
    else:
        x = 10 * math.ceil((25 + max(abs(low[0]), abs(high[0]))) / 10)
        y = 5 * math.ceil((8 + max(abs(low[1]), abs(high[1]))) / 5)
    side = (high[1] - low[1]) / 2
    length = high[0] - low[0]
    middle_m = (low[0] + high[0]) / 2
    ground_m = 0.0 if low[2] > -SUNK_M else low[2]
    floor_m = round(ground_m, 2)
    top_m = floor_m + max(math.ceil(high[2] - floor_m), 2 if small else 4)
    height = high[2] - low[2]
    bumper_m = max(low[2], 0) + 0.4, max(low[2], 0) + 0.8
    if small:
        bumper_m = low[2] + 0.4 * height, low[2] + 0.8 * height
    aside_m = 1 if small else 3
    boxes = {
        "low": (-x, -y, floor_m),
        "high": (x, y, top_m),
        "roof_low": (middle_m - length / 8, low[1] + side + side / 4, high[2] + 0.1),
        "roof_high": (middle_m + length / 8, low[1] + side + side / 2, high[2] + 0.4),
        "front_low": (high[0] + 0.05, -side * 0.7, bumper_m[0]),
        "front_high": (high[0] + 0.05, side * 0.7, bumper_m[1]),
        "rear_low": (low[0] - 0.05, -side * 0.7, bumper_m[0]),
        "rear_high": (low[0] - 0.05, side * 0.7, bumper_m[1]),
        "top_low": (middle_m - length / 8, low[1] + side / 2, (low[2] + high[2]) / 2),
        "top_high": (middle_m + length / 8, high[1] - side / 2, high[2] + 0.1),
        "ahead_low": (0, -aside_m, floor_m),
        "ahead_high": (x, aside_m, floor_m + 2),
        "ahead_top": (x, aside_m, floor_m + (2 if small else 3)),
    }
    return {
        "small": small,
        "cuboid": [0.5, 0.25, 0.1] if small else [1, 0.5, 0.2],
        **{key: [round(value, 2) for value in corner] for key, corner in boxes.items()},
    }
