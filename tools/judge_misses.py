"""How often does a rig miss an object? An outside judge: Open3D's rays, its own objects, its own places and firings.

Usage: .venv/bin/python tools/judge_misses.py RIG.yaml ... [--vehicle data/vehicles/sedan.ply] [--places 1500]

Of lidarcfg it takes files alone: the poses of rigs and the tables of sensors. Each of six objects, its own or with
`--objects data/objects` those of lidarcfg, stands at random places, uniform in area, and headings around the vehicle.
Every firing of one revolution, with all heads at zero when it begins, or of a scan pattern's first frame is a ray that
ends at the vehicle or at the object, whichever is first, within the range. An object with fewer returns than
`--returns` from all sensors together is a miss, as lidarcfg's measure of misses has it. The intervals are of 95 %:
Wilson's for an object, that of a mean of independent binomials for the mean. The same arguments give the same table.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import yaml
from numpy.typing import NDArray
from page import ROOT, machine, table

Array = NDArray[np.float64]
Mesh = o3d.geometry.TriangleMesh
NEAREST_M = 0.1  # between the footprints of an object and the vehicle
RPM = 600.0  # of rigs that say none
OUSTER_COLUMNS = 1024  # of a revolution, where the rig says nothing
Z_95 = 1.959964  # of the normal distribution, for intervals of 95 %
FLAT_M2 = 1e-9  # a triangle that is smaller from above is upright


@dataclass(frozen=True)
class Rays:
    """The N rays of a sensor in one revolution, in the vehicle frame."""

    start_m: Array  # (N, 3)
    direction: Array  # (N, 3) of length 1
    range_m: tuple[float, float]  # least, greatest

    @cached_property
    def start_along_m(self) -> Array:
        """(N,) of the starts along the directions."""
        return np.einsum("ij,ij->i", self.start_m, self.direction)

    @cached_property
    def start_m2(self) -> Array:
        """(N,) squares of the starts' distances from the origin."""
        return np.einsum("ij,ij->i", self.start_m, self.start_m)


def rotation(roll: float, pitch: float, yaw: float) -> Array:
    """(3, 3) Rz(yaw) Ry(pitch) Rx(roll), of radians."""
    Rx = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    Ry = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    Rz = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    return np.asarray(Rz @ Ry @ Rx)


def firings(sensor: Mapping[str, Any], mount: Mapping[str, Any]) -> tuple[NDArray[np.int64], Array]:
    """(N,) the laser and (N,) the head's angle in radians of every firing of one revolution, clockwise from ahead."""
    lasers = np.arange(len(sensor["beams"]["elevation_deg"]))
    codec = sensor.get("codec")
    own = sensor.get(codec or "", {})
    firing = own.get("firing") or sensor.get("firing") or {}
    nanoseconds = 60e9 / float(mount.get("rpm", RPM))  # of a revolution
    if codec == "ouster":
        count = int(mount.get("ouster", {}).get("columns", OUSTER_COLUMNS))
        head = np.repeat(np.arange(count) * (2 * math.pi / count), len(lasers))
        return np.tile(lasers, count), head
    if "loops" in firing:
        loops = [np.array([math.nan if value is None else value for value in loop]) for loop in firing["loops"]]
        cycle_ns = float(firing["period_ns"]) * len(loops)
        fired = [loop + i * float(firing["period_ns"]) for i, loop in enumerate(loops)]
    elif "sequence_ns" in firing:
        cycle_ns = float(firing["sequence_ns"])
        fired = [np.array(firing.get("offset_ns", np.zeros(len(lasers))), np.float64)]
    elif "step_deg" in firing:
        cycle_ns = nanoseconds * float(firing["step_deg"]) / 360
        fired = [np.zeros(len(lasers))]
    else:
        raise SystemExit(f"{sensor['name']}: its file does not say when its lasers fire")
    since_ns = np.concatenate(fired)
    laser = np.tile(lasers, len(fired))[np.isfinite(since_ns)]
    since_ns = since_ns[np.isfinite(since_ns)]
    cycles = math.ceil(nanoseconds / cycle_ns - 1e-9)
    turned = (np.arange(cycles)[:, None] * cycle_ns + (since_ns - since_ns.min())) / nanoseconds
    return np.tile(laser, cycles), 2 * math.pi * turned.ravel()


def frame(scan: Mapping[str, Any], folder: Path) -> tuple[Array, Array]:
    """(N,) the azimuths, clockwise from ahead, and elevations in degrees of a scan pattern's first frame."""
    path = folder / scan["file"]
    columns: Mapping[str, Any]
    if path.suffix == ".csv":
        header, *lines = path.read_text().split()
        columns = dict(zip(header.split(","), np.loadtxt(lines, delimiter=",").T, strict=True))
    else:
        columns = np.load(path)
    if "rate_hz" in columns:  # channels, a row each, fire in turn; steps of hundredths of a degree since their last
        azimuth, elevation = (
            np.cumsum(columns[f"{key}_steps"], axis=1, dtype=np.int64).T.ravel() / 100
            for key in ("azimuth", "elevation")
        )
        time_ns = np.arange(len(azimuth)) * (1e9 / float(columns["rate_hz"]))
    else:
        time_ns, azimuth, elevation = (columns[key] for key in ("time_ns", "azimuth_deg", "elevation_deg"))
    first = np.rint(time_ns) < round(float(scan["frame_ms"]) * 1e6)
    return azimuth[first], elevation[first]


def rays_of(mount: Mapping[str, Any], folder: Path) -> Rays:
    """The rays of a mount in a rig's file in a folder."""
    model = mount["model"]
    path = ROOT / f"sensors/{model}.yaml"
    if not path.exists():
        path = folder / model
    sensor = yaml.safe_load(path.read_text())
    offsets_m = np.zeros((3, 1))  # forward, left, up: where a beam starts
    if scan := sensor.get("scan_pattern"):
        azimuth_deg, elevation_deg = frame(scan, path.parent)
        head = np.radians(azimuth_deg)
        azimuth = head
        elevation = np.radians(elevation_deg)
    else:
        beams = sensor["beams"]

        def column(key: str) -> Array:
            return np.array(beams.get(key) or np.zeros(len(beams["elevation_deg"])), np.float64)

        laser, head = firings(sensor, mount)
        azimuth = head + np.radians(column("azimuth_offset_deg"))[laser]
        elevation = np.radians(column("elevation_deg"))[laser]
        keys = "forward", "lateral", "vertical"
        offsets_m = np.stack([column(f"{key}_offset_mm")[laser] / 1000 for key in keys])
    inside = in_view(head, sensor, mount)
    flat = np.cos(elevation)
    direction = np.stack([flat * np.cos(azimuth), -flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    ahead, left, up = offsets_m
    x = ahead * np.cos(head) + left * np.sin(head)
    y = left * np.cos(head) - ahead * np.sin(head)
    if "rpy_rad" in mount:
        angles = [float(angle) for angle in mount["rpy_rad"]]
    else:
        angles = [math.radians(float(angle)) for angle in mount.get("rpy_deg", (0, 0, 0))]
    R = rotation(*angles)
    position = np.array(mount["position_m"], np.float64)
    limits = mount.get("range_m") or (sensor["range"].get("min_m", 0.0), sensor["range"]["max_m"])
    start = np.stack(np.broadcast_arrays(x, y, up), axis=1) @ R.T + position
    return Rays(
        np.asfortranarray(start[inside]),
        np.asfortranarray((direction @ R.T)[inside]),
        (float(limits[0]), float(limits[1])),
    )


def in_view(head: Array, sensor: Mapping[str, Any], mount: Mapping[str, Any]) -> NDArray[np.bool_]:
    """(N,) which of a head's angles, clockwise from ahead, are in the fields of view of a sensor and of its mount."""
    inside = np.ones(len(head), np.bool_)
    for fov_deg in (sensor.get("azimuth_fov_deg"), mount.get("azimuth_fov_deg")):
        if fov_deg:
            width = (fov_deg[1] - fov_deg[0]) % 360 or 360
            inside &= (np.degrees(head) - fov_deg[0]) % 360 <= width
    return inside


def box(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """The box between two corners, with a grid of vertices."""
    size = np.subtract(high, low)
    return Mesh.create_box(*size).translate(low).subdivide_midpoint(2)


def rod(start: Sequence[float], end: Sequence[float], radius_m: float) -> Mesh:
    """A round rod between two points."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    mesh = Mesh.create_cylinder(radius_m, length, 16, 4).translate([0, 0, length / 2])
    axis = np.cross([0, 0, 1], along / length)
    angle = math.atan2(float(np.linalg.norm(axis)), along[2] / length)
    if angle > 0:
        unit = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 0 else np.array([1.0, 0, 0])
        mesh.rotate(o3d.geometry.get_rotation_matrix_from_axis_angle(unit * angle), (0, 0, 0))
    return mesh.translate(start)


def ball(middle: Sequence[float], radius_m: float) -> Mesh:
    """A ball."""
    return Mesh.create_sphere(radius_m, 12).translate(middle)


def joined(parts: Sequence[Mesh]) -> Mesh:
    """Parts as one mesh; a ray's first hit does not mind that they overlap."""
    out = Mesh()
    for part in parts:
        out += part
    return out


def person(height_m: float) -> Mesh:
    """Someone who stands: two legs, a trunk with arms, a head. By tenths of the height."""
    u = height_m / 10
    legs = [rod([0, side * 0.55 * u, 0], [0, side * 0.5 * u, 4.8 * u], 0.38 * u) for side in (-1, 1)]
    arms = [rod([0, side * 1.2 * u, 8.0 * u], [0.2 * u, side * 1.35 * u, 4.6 * u], 0.25 * u) for side in (-1, 1)]
    trunk = box([-0.6 * u, -1.0 * u, 4.6 * u], [0.6 * u, 1.0 * u, 8.3 * u])
    return joined([*legs, *arms, trunk, ball([0.1 * u, 0, 9.25 * u], 0.75 * u)])


def cyclist() -> Mesh:
    """Someone on a bicycle, along x."""
    upright = o3d.geometry.get_rotation_matrix_from_xyz((math.pi / 2, 0, 0))
    parts = [
        Mesh.create_torus(0.32, 0.025, 24, 8).rotate(upright, (0, 0, 0)).translate([x, 0, 0.345]) for x in (-0.5, 0.5)
    ]
    frame = [((-0.5, 0.345), (-0.2, 0.9)), ((-0.2, 0.9), (0.35, 0.85)), ((0.35, 0.95), (0.5, 0.345))]
    frame += [((-0.08, 0.28), (-0.2, 0.9)), ((-0.08, 0.28), (0.35, 0.85)), ((-0.08, 0.28), (-0.5, 0.345))]
    parts += [rod([a[0], 0, a[1]], [b[0], 0, b[1]], 0.02) for a, b in frame]
    parts.append(rod([0.35, -0.26, 1.0], [0.35, 0.26, 1.0], 0.02))
    for side in (-0.11, 0.11):
        parts += [rod([-0.2, side, 0.95], [0.1, side, 0.65], 0.07), rod([0.1, side, 0.65], [-0.02, side, 0.22], 0.05)]
        parts.append(rod([0.0, 1.7 * side, 1.4], [0.33, 1.9 * side, 1.02], 0.045))
    parts += [rod([-0.2, 0, 0.95], [0.0, 0, 1.42], 0.16), ball([0.1, 0, 1.65], 0.12)]
    return joined(parts)


def dog() -> Mesh:
    """A dog of 0.6 m at the shoulder."""
    legs = [rod([x, y, 0], [x, y, 0.35], 0.035) for x in (-0.28, 0.28) for y in (-0.09, 0.09)]
    trunk = box([-0.36, -0.12, 0.33], [0.36, 0.12, 0.6])
    return joined([*legs, trunk, ball([0.45, 0, 0.68], 0.11), rod([-0.36, 0, 0.55], [-0.58, 0, 0.7], 0.025)])


def tyre() -> Mesh:
    """A tyre that lies on the road, 0.62 m across and 0.2 m high."""
    return Mesh.create_torus(0.21, 0.1, 32, 16).translate([0, 0, 0.1])


def post() -> Mesh:
    """A post of 0.1 m, 1.0 m high."""
    return rod([0, 0, 0], [0, 0, 1.0], 0.05)


OBJECTS: dict[str, Callable[[], Mesh]] = {
    "adult": lambda: person(1.78),
    "child": lambda: person(1.05),
    "tyre": tyre,
    "post": post,
    "cyclist": cyclist,
    "dog": dog,
}


def in_file(path: Path) -> Mesh:
    """A mesh of a file, its lowest point on the ground."""
    mesh = o3d.io.read_triangle_mesh(str(path))
    return mesh.translate([0, 0, -mesh.get_min_bound()[2]])


def things(folder: Path | None) -> dict[str, Mesh]:
    """The objects by name: its own, or of the same names in a folder, where the adult is a pedestrian."""
    if folder is None:
        return {name: make() for name, make in OBJECTS.items()}
    return {name: in_file(folder / f"{'pedestrian' if name == 'adult' else name}.ply") for name in OBJECTS}


def scene_of(vertices: NDArray[Any], triangles: NDArray[Any]) -> o3d.t.geometry.RaycastingScene:
    """What Open3D casts rays at."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.uint32))
    return scene


def hits_m(scene: o3d.t.geometry.RaycastingScene, start_m: Array, direction: Array) -> Array:
    """(N,) how far rays go to the first triangle; infinite without one."""
    rays = np.concatenate([start_m, direction], axis=1).astype(np.float32)
    return np.asarray(scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy(), np.float64)


def places(body: Mesh, thing: Mesh, within_m: float, rng: np.random.Generator) -> Iterator[Array]:
    """Endless x, y, heading of an object near a body, by the distance of their footprints, each drawn independently."""
    corners = np.asarray(body.vertices)
    triangles = np.asarray(body.triangles)
    flat = corners * [1, 1, 0]
    edges = np.diff(flat[triangles], axis=1)
    area_m2 = 0.5 * abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    footprint = scene_of(flat, triangles[area_m2 > FLAT_M2])
    outline = np.asarray(thing.vertices) * [1, 1, 0]
    reach_m = within_m + np.linalg.norm(outline, axis=1).max()
    low = corners.min(axis=0)[:2] - reach_m
    high = corners.max(axis=0)[:2] + reach_m
    while True:
        x, y = rng.uniform(low, high)
        heading = rng.uniform(0, 2 * math.pi)
        points = outline @ rotation(0, 0, heading).T + [x, y, 0]
        nearest_m = footprint.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy().min()
        if NEAREST_M <= nearest_m <= within_m:
            yield np.array([x, y, heading])


def returns(rays: Sequence[Rays], clear_m: Sequence[Array], thing: Mesh, place: Array) -> int:
    """The returns of all rays from an object at x, y, heading; `clear_m` is how far each ray goes to the vehicle."""
    vertices = np.asarray(thing.vertices)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius_m = np.linalg.norm(vertices - middle, axis=1).max()
    R = rotation(0, 0, place[2])
    at = np.array([place[0], place[1], 0.0])
    scene = scene_of(vertices @ R.T + at, np.asarray(thing.triangles))
    middle = R @ middle + at
    count = 0
    for one, free_m in zip(rays, clear_m, strict=True):
        along = one.direction @ middle - one.start_along_m
        beside2 = middle @ middle - 2 * (one.start_m @ middle) + one.start_m2 - along**2
        near = np.flatnonzero((beside2 < (1.001 * radius_m) ** 2) & (along > -radius_m))  # may touch its bounding ball
        if len(near):
            found = hits_m(scene, one.start_m[near], one.direction[near])
            low, high = one.range_m
            count += int(((found < free_m[near]) & (found >= low) & (found <= high)).sum())
    return count


def counts(
    rig: Path, body: Mesh, objects: Mapping[str, Mesh], number: int, within_m: float, seed: int
) -> dict[str, Array]:
    """By object, (number,) the returns of a rig from it at random places, which depend on the seed and the object."""
    values = yaml.safe_load(rig.read_text())
    rays = [rays_of(mount, rig.parent) for mount in values["sensors"]]
    bodies = scene_of(np.asarray(body.vertices), np.asarray(body.triangles))
    clear_m = [hits_m(bodies, one.start_m, one.direction) for one in rays]
    out = {}
    for name, thing in objects.items():
        drawn = places(body, thing, within_m, np.random.default_rng([seed, list(OBJECTS).index(name)]))
        out[name] = np.array([returns(rays, clear_m, thing, next(drawn)) for _ in range(number)])
    return out


def interval(misses: int, number: int) -> tuple[float, float]:
    """Wilson's interval of 95 % for a probability of which this many of `number` trials came true."""
    p = misses / number
    scale = 1 / (1 + Z_95**2 / number)
    middle = scale * (p + Z_95**2 / (2 * number))
    half = scale * Z_95 * math.sqrt(p * (1 - p) / number + Z_95**2 / (4 * number**2))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def rows(found: Mapping[str, Mapping[str, Array]], least: int) -> Iterator[list[str]]:
    """Of each object, then of their mean, the share of misses in per cent with its interval, a column a rig."""
    missed = {rig: {name: int((values < least).sum()) for name, values in by.items()} for rig, by in found.items()}
    number = {name: len(values) for by in found.values() for name, values in by.items()}
    for name, count in number.items():
        cells = []
        for by in missed.values():
            low, high = interval(by[name], count)
            cells.append(f"{by[name] / count:.1%} ({low:.1%} to {high:.1%})")
        yield [name, *cells]
    cells = []
    for by in missed.values():
        shares = [by[name] / count for name, count in number.items()]
        half = (
            Z_95 * math.sqrt(sum(p * (1 - p) / n for p, n in zip(shares, number.values(), strict=True))) / len(shares)
        )
        cells.append(f"**{np.mean(shares):.1%}** (± {half:.1%})")
    yield ["mean", *cells]


def main() -> None:
    """Print the table of misses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rigs", type=Path, nargs="+", metavar="RIG")
    parser.add_argument("--vehicle", type=Path, default=ROOT / "data/vehicles/sedan.ply", help="a mesh")
    parser.add_argument("--objects", type=Path, metavar="DIR", help="with their meshes; by default its own")
    parser.add_argument("--places", type=int, default=1500, help="of each object")
    parser.add_argument("--within", type=float, default=20.0, metavar="M", help="of the vehicle")
    parser.add_argument("--returns", type=int, default=3, help="with fewer, it is missed")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    body = o3d.io.read_triangle_mesh(str(given.vehicle))
    objects = things(given.objects)
    found = {str(rig): counts(rig, body, objects, given.places, given.within, given.seed) for rig in given.rigs}
    print(f"{machine()}; {given.places} places of each object within {given.within:g} m of {given.vehicle.name},")
    print(f"seed {given.seed}; a miss is fewer than {given.returns} returns\n")
    print("\n".join(table(["", *found], rows(found, given.returns))))


if __name__ == "__main__":
    main()
