"""The unit and the axes of a vehicle's mesh, guessed from its size and its symmetry.

A vehicle is alike on its left and its right, and on no other two sides: where half of its surface lies tells its axes.
"""

import numpy as np

from lidarcfg.config.models import Vec3
from lidarcfg.geometry import Array
from lidarcfg.world.mesh_source import Mesh
from lidarcfg.world.scene_file import MeshFile

LEAST_M = 0.05  # the size of a vehicle's mesh: of a part of one
TYPICAL_M = 5.0  # of a car
MOST_M = 40.0  # of the longest bus
UNITS = {1.0: "metre", 0.001: "millimetre", 0.01: "centimetre", 0.0254: "inch"}  # by the scale that makes them metres
EVEN = 0.005  # of the size: how far the middle of a symmetric surface is from that of its bounds
UNEVEN = 0.01  # that of one that is not
X, Y, Z = range(3)
AS_IS: Vec3 = (0.0, 0.0, 0.0)
TURNS: dict[Vec3, str] = {  # by the rpy_deg that mends it
    (90.0, 0.0, 0.0): "y is up",
    (90.0, 0.0, 90.0): "y is up and z forward",
    (0.0, 0.0, -90.0): "y is forward",
}


def likely_scale(size: Array) -> float:
    """The likely scale of a vehicle's mesh of a size (3,): one of UNITS."""
    if LEAST_M <= size.max() <= MOST_M or size.max() == 0:
        return 1.0
    times = float(size.max()) / TYPICAL_M
    return min(UNITS, key=lambda one: max(times * one, 1 / (times * one)))


def likely_rpy_deg(mesh: Mesh) -> Vec3:
    """The likely rotation of a vehicle's mesh into the vehicle frame, x forward and z up: one of TURNS, or none."""
    off = _off_middle(mesh)
    size = np.ptp(mesh[0], axis=0)
    even = off < EVEN
    if off[Y] < UNEVEN or not (even[X] or even[Z]):
        return AS_IS
    if even[Z] and not (even[X] and size[Z] > size[X]):
        return 90.0, 0.0, 0.0
    return (90.0, 0.0, 90.0) if size[Z] > size[Y] else (0.0, 0.0, -90.0)


def gltf_rpy_deg(mesh: Mesh) -> Vec3:
    """The rotation of a glTF file's mesh into the vehicle frame: by its standard (2.0, section 3.4) y is up, z ahead.

    By its looks x may be ahead, or the file may not be as the standard has it.
    """
    if (looks := likely_rpy_deg(mesh)) != AS_IS:
        return looks
    off = _off_middle(mesh)
    if off[Y] < UNEVEN <= off[Z]:
        return AS_IS
    size = np.ptp(mesh[0], axis=0)
    return (90.0, 0.0, 0.0) if size[X] > size[Z] else (90.0, 0.0, 90.0)


def gltf_note(rpy_deg: Vec3) -> str:
    """What is said of a glTF file's mesh that was turned, or was not."""
    if rpy_deg not in TURNS or "y is up" not in TURNS[rpy_deg]:
        return "z is up by its looks, though a glTF file has y up; name it under meshes, with rpy_deg, if it has"
    angles = ", ".join(f"{angle:g}" for angle in rpy_deg)
    return f"{TURNS[rpy_deg]}, as in glTF files: turned, as by rpy_deg: [{angles}]"


def _off_middle(mesh: Mesh) -> Array:
    """(3,) how far the middle of a mesh's surface is from that of its bounds, over its size; inf without a size."""
    vertices, triangles = mesh
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    if not (area.sum() and size.all()):
        return np.full(3, np.inf)
    off: Array = abs(area @ corners.mean(axis=1) / area.sum() - (low + high) / 2) / size
    return off


def unit_warnings(item: MeshFile, mesh: Mesh) -> list[str]:
    """A warning if the size of a vehicle's mesh, in the vehicle frame, suggests another unit."""
    size_m = np.ptp(mesh[0], axis=0)
    if LEAST_M <= size_m.max() <= MOST_M or (scale := likely_scale(size_m / item.scale)) == item.scale:
        return []
    return [f"{_what(item, size_m)}; if its unit is the {UNITS[scale]}, set scale: {scale:g}"]


def axes_warnings(item: MeshFile, mesh: Mesh) -> list[str]:
    """A warning if a vehicle's only mesh, in the vehicle frame, looks as if other axes were up or forward."""
    rpy_deg = likely_rpy_deg(mesh)
    if rpy_deg == AS_IS:
        return []
    what = f"{_what(item, np.ptp(mesh[0], axis=0))} and not alike on its left and its right, as if {TURNS[rpy_deg]}"
    if item.rpy_deg != AS_IS:
        return [what]
    return [f"{what}; if so, set rpy_deg: [{', '.join(f'{angle:g}' for angle in rpy_deg)}]"]


def likely_position_m(mesh: Mesh) -> Vec3:
    """Where a vehicle's mesh, in metres, must be moved to stand at the origin; nowhere, unless it is far from there.

    It is far if it is farther away than it is large.
    """
    low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
    gap = np.maximum(np.maximum(low, -high), 0)
    if np.linalg.norm(gap) <= np.linalg.norm(high - low):
        return AS_IS
    x, y, z = (round(-value, 3) for value in (*((low + high)[:2] / 2).tolist(), float(low[2])))
    return x, y, z


def place_warnings(item: MeshFile, mesh: Mesh) -> list[str]:
    """A warning if a vehicle's only mesh, in the vehicle frame, is far from the origin."""
    moved = likely_position_m(mesh)
    if moved == AS_IS:
        return []
    away = f"{item.name!r} of {item.file} is {np.linalg.norm(moved):.0f} m away from the origin of the vehicle frame"
    there = ", ".join(f"{was + move:g}" for was, move in zip(item.position_m, moved, strict=True))
    return [f"{away}; to stand there, set position_m: [{there}]"]


def _what(item: MeshFile, size_m: Array) -> str:
    size = " × ".join(f"{value:.4g}" if value < 1e4 else f"{value:.0f}" for value in size_m)
    return f"{item.name!r} of {item.file} is {size} m large"
