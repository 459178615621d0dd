"""Commented files to start from."""

import math
import os
from collections.abc import Callable
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from lidarcfg.config.document import inline
from lidarcfg.config.models import Vec3
from lidarcfg.errors import ConfigError, SceneError
from lidarcfg.files import example, replacing, shipped

KINDS = ("study", "rig", "scene", "sensor")
CAR = (-2.4, -0.95, 0.0), (2.4, 0.95, 1.5)  # the bounds of a vehicle without a mesh
SUNK_M = 0.05  # how far a body on the ground may be below it, by its mesh
AS_IS: Vec3 = (0.0, 0.0, 0.0)


def vehicles() -> dict[str, Path]:
    """The bodies that come with the package, by name."""
    return {path.stem: path for path in sorted(shipped("data").glob("vehicles/*.ply"))}


def write_template(kind: str, path: Path, vehicle: str | None = None) -> list[Path]:
    """Write one of the `KINDS` of files to start from. Returns what was written.

    A study is made around a vehicle: one of `vehicles`, whose mesh is copied beside the study, or a mesh file. Raises
    ConfigError if a file exists already, or if the vehicle is unknown or cannot be read.
    """
    known = vehicles()
    body = None if vehicle is None else known.get(vehicle, Path(vehicle))
    if body and vehicle not in known and not body.suffix:
        raise ConfigError(f"no vehicle is called {vehicle!r}; allowed: {', '.join(known)}, or a mesh file")
    copied = path.parent / f"{vehicle}.ply" if vehicle in known else None
    low, high, scale, rpy_deg, position_m, closed = _bounds(body) if body else (*CAR, 1.0, AS_IS, AS_IS, True)
    template = Environment(undefined=StrictUndefined, keep_trailing_newline=True).from_string(
        (shipped("data") / "templates" / f"{kind}.yaml.j2").read_text("utf-8")
    )
    name = None if body is None else copied.name if copied else os.path.relpath(body, path.parent)
    text = template.render(
        file=path,
        body=name and inline(name),
        closed=closed,
        **_frame_keys(scale, rpy_deg, position_m),
        **_study(low, high),
    )
    _check_new(path)
    if copied and copied.exists() and body and copied.read_bytes() != body.read_bytes():
        _check_new(copied)
    if copied and body and not copied.exists():
        with replacing(copied, "wb") as mesh:
            mesh.write(body.read_bytes())
    with replacing(path) as out:
        out.write(text)
    return [path, copied] if copied else [path]


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


def _bounds(body: Path) -> tuple[tuple[float, ...], tuple[float, ...], float, Vec3, Vec3, bool]:
    """The bounds of a mesh in the vehicle frame; scale, rotation and shift that bring it there; whether it is closed.

    What brings it there is guessed by its looks.
    """
    import numpy as np

    from lidarcfg.geometry import pose, transform
    from lidarcfg.world.mesh_frame import likely_position_m, likely_rpy_deg, likely_scale
    from lidarcfg.world.meshes import read_mesh
    from lidarcfg.world.solids import merge_vertices, open_edges

    try:
        mesh = read_mesh(body)
    except SceneError as error:
        raise ConfigError(str(error)) from None
    scale, rpy_deg = likely_scale(np.ptp(mesh[0], axis=0)), likely_rpy_deg(mesh)
    vertices_m = transform(pose((0, 0, 0), np.radians(rpy_deg)), scale * mesh[0])
    position_m = likely_position_m((vertices_m, mesh[1]))
    vertices_m += position_m
    low, high = (tuple(corner.tolist()) for corner in (vertices_m.min(axis=0), vertices_m.max(axis=0)))
    return low, high, scale, rpy_deg, position_m, not len(open_edges(merge_vertices(mesh)))


def _frame_keys(scale: float, rpy_deg: Vec3, position_m: Vec3) -> dict[str, str]:
    """The keys that bring a mesh into the vehicle frame, and what is said of them."""
    from lidarcfg.world.mesh_frame import TURNS, UNITS

    keys, looks = [], []
    if scale != 1:
        keys.append(f"scale: {scale}, ")
        looks.append(f"its file's unit is the {UNITS[scale]}")
    if rpy_deg in TURNS:
        keys.append(f"rpy_deg: [{', '.join(f'{angle:g}' for angle in rpy_deg)}], ")
        looks.append(f"in its file {TURNS[rpy_deg]}")
    if position_m != AS_IS:
        keys.append(f"position_m: [{', '.join(f'{value:g}' for value in position_m)}], ")
        looks.append(f"in its file {math.hypot(*position_m):.0f} m away")
    return {"frame_keys": "".join(keys), "looks": " and ".join(looks)}


def _study(low: tuple[float, ...], high: tuple[float, ...]) -> dict[str, list[float]]:
    """A study's region and the bounds of its sensors, around a vehicle's bounds."""
    x = 10 * math.ceil((25 + max(abs(low[0]), abs(high[0]))) / 10)
    y = 5 * math.ceil((8 + max(abs(low[1]), abs(high[1]))) / 5)
    side = (high[1] - low[1]) / 2
    length = high[0] - low[0]
    middle_m = (low[0] + high[0]) / 2
    floor_m = min(math.floor(low[2] + SUNK_M), 0)
    top_m = max(math.ceil(high[2]), 4)
    boxes = {
        "low": (-x, -y, floor_m),
        "high": (x, y, top_m),
        "roof_low": (middle_m - length / 8, low[1] + side + side / 4, high[2] + 0.1),
        "roof_high": (middle_m + length / 8, low[1] + side + side / 2, high[2] + 0.4),
        "front_low": (high[0] + 0.05, -side * 0.7, max(low[2], 0) + 0.4),
        "front_high": (high[0] + 0.05, side * 0.7, max(low[2], 0) + 0.8),
        "rear_low": (low[0] - 0.05, -side * 0.7, max(low[2], 0) + 0.4),
        "rear_high": (low[0] - 0.05, side * 0.7, max(low[2], 0) + 0.8),
        "top_low": (middle_m - length / 8, low[1] + side / 2, (low[2] + high[2]) / 2),
        "top_high": (middle_m + length / 8, high[1] - side / 2, high[2] + 0.1),
        "ahead_low": (0, -3, floor_m),
        "ahead_high": (x, 3, floor_m + 2),
        "ahead_top": (x, 3, floor_m + 3),
    }
    return {key: [round(value, 2) for value in corner] for key, corner in boxes.items()}
