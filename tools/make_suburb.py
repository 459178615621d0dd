"""Make the suburb: data/scenes/suburb.yaml with its files in data/scenes/suburb/, and data/trajectories/suburb.tum.

Usage: .venv/bin/python tools/make_suburb.py [FOLDER]      (FOLDER in place of data/)

A road of 520 m with curves over land that is not level, and a drive of 60 s along it: rough ground as a height field,
kerbs, pavements and houses whose façades have depth as a glTF of many nodes, hedges as a map of points, parked cars and
trees as meshes. Every number is a guess at what a suburb looks like; the same script writes the same files.
"""

import json
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from page import argument
from PIL import Image
from suburb_houses import Quads, designs, quads_of, triangles_of
from suburb_road import Array, Road, drive, land_m, road

DATA = Path(__file__).parent.parent / "data"
SEED = 7
KERB_M = 3.6
PAVEMENT_M = 5.4
HIGH_M = 0.12  # from the middle of the road: its edge, the outer edge of the pavement; height
LAND_CELL_M = 1.0
LAND_STEP_M = 0.01
MARGIN_M = 45.0
ROUGH_M = 0.05
ROUGH_FROM_M = 6.0  # of gardens, as a standard deviation; and how far from the road they begin
HOUSE_M = 14.5
PLOT_M = 19.0
APART_M = 13.0  # a house's middle from the road; between plots; between houses at least
HEDGE_M = 6.6
HEDGE_WIDE_M = 0.8
HEDGE_HIGH_M = 1.2
HEDGE_POINTS_M2 = 22.0
HEDGE_RADIUS_M = 0.16
HEDGE_STEP_M = 0.01
HEDGE_AT_M = (200.0, 0.0, 0.0)  # int16 reaches 327 m from there
MATERIALS = {"brick": 32, "plaster": 55, "glass": 8, "wood": 25, "tiles": 22, "metal": 45, "concrete": 30, "paving": 26}
Plot = tuple[float, float, float, float]  # how far along the road and beside it, x and y
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # of z up, as glTF wants it


def main(data: Path) -> None:
    """Write all files."""
    path = road()
    rng = np.random.default_rng(SEED)
    (data / "scenes/suburb").mkdir(parents=True, exist_ok=True)
    (data / "trajectories").mkdir(exist_ok=True)
    plots = _plots(path)
    corner = _land(path, rng, data / "scenes/suburb/land.png")
    _model(path, plots, data / "scenes/suburb/houses.glb")
    _hedges(path, plots, rng, data / "scenes/suburb/hedges.npz")
    (data / "scenes/suburb.yaml").write_text(_scene(Layout(path, plots), corner, rng), "utf-8")
    rows = (" ".join(f"{value:.5f}".rstrip("0").rstrip(".") or "0" for value in row) for row in drive(path))
    head = "# time_s x y z qx qy qz qw: a car along the road of data/scenes/suburb.yaml, by tools/make_suburb.py\n"
    (data / "trajectories/suburb.tum").write_text(head + "\n".join(rows) + "\n", "utf-8")


def _plots(path: Road) -> list[Plot]:
    """Where houses stand: along the road, beside it, x and y; none on another's plot or too near to the road."""
    found: list[Plot] = []
    for along, side in product(np.arange(-20.0, path.length_m, PLOT_M), (1, -1)):
        shift = 5.0 if side > 0 else 0.0
        x, y = path.beside(along + shift, side * HOUSE_M)
        near = [math.hypot(x - a, y - b) for _, _, a, b in found]
        if path.distance(np.array([x, y])) > HOUSE_M - 1.5 and min(near, default=math.inf) > APART_M:
            found.append((along + shift, side * HOUSE_M, float(x), float(y)))
    return found


def _land(path: Road, rng: np.random.Generator, file: Path) -> tuple[float, float, float]:
    """Write the height field: smooth below the road and its pavements, rough elsewhere. Returns its position."""
    low = np.floor(path.points_m.min(axis=0) - MARGIN_M)
    count = np.ceil((path.points_m.max(axis=0) + MARGIN_M - low) / LAND_CELL_M).astype(int) + 1
    x, y = (low[axis] + np.arange(count[axis]) * LAND_CELL_M for axis in range(2))
    places = np.stack(np.meshgrid(x, y[::-1]), axis=-1)  # rows from the north
    far = np.clip((path.distance(places) - ROUGH_FROM_M) / 2, 0, 1)
    heights = land_m(places, path) + ROUGH_M * far * rng.normal(size=far.shape)
    lowest = math.floor(heights.min())
    Image.fromarray(np.rint((heights - lowest) / LAND_STEP_M).astype(np.uint16)).save(file, optimize=True)
    return float(low[0]), float(low[1]), float(lowest)


def _model(path: Road, plots: Sequence[Plot], file: Path) -> None:
    """Write the glTF: kerbs and pavements along the road, and houses that face it."""
    scene = trimesh.Scene()
    for name, side in (("left", 1), ("right", -1)):
        for material, quads in _ribbon(path, side).items():
            _add(scene, f"{'kerb' if material == 'concrete' else 'pavement'}_{name}", {material: quads}, np.eye(4))
    shapes = [quads_of(house) for house in designs()]
    for n, (along, beside, x, y) in enumerate(plots, 1):
        T = np.eye(4)
        yaw = float(path.heading(along)) + (0 if beside > 0 else math.pi)  # the front looks to the road
        T[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
        T[:3, 3] = x, y, land_m(np.array([x, y]), path)
        _add(scene, f"house_{n:02}", shapes[(n * 7 + n // 3) % len(shapes)], np.round(T, 4))
    file.write_bytes(scene.export(file_type="glb"))


def _add(scene: trimesh.Scene, node: str, shape: Quads, T: Array) -> None:
    """A node with a mesh of each material; the materials' are below the node, and called as both."""
    for material, quads in sorted(shape.items()):
        vertices, triangles = triangles_of(quads)
        mesh = trimesh.Trimesh(vertices @ Y_UP[:3, :3].T, triangles, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(name=material))
        name = f"{node}_{material}" if len(shape) > 1 else node
        scene.add_geometry(mesh, node_name=name, geom_name=name, transform=Y_UP @ T @ Y_UP.T)


def _ribbon(path: Road, side: int) -> Quads:
    """A kerb and the pavement behind it, along the road."""
    along = np.arange(-28.0, path.length_m, 2.0)

    def rail(left_m: float, high_m: float) -> Array:
        places = path.beside(along, side * left_m)
        return np.column_stack([places, land_m(places, path) + high_m])

    profile = [(KERB_M, -0.05), (KERB_M, HIGH_M), (KERB_M + 0.15, HIGH_M), (PAVEMENT_M, HIGH_M), (PAVEMENT_M, -0.15)]
    rails = [rail(*one) for one in profile]
    strips = [np.stack([a[:-1], a[1:], b[1:], b[:-1]], axis=1) for a, b in pairwise(rails)]
    return {"concrete": list(np.concatenate(strips[:2])), "paving": list(np.concatenate(strips[2:]))}


def _hedges(path: Road, plots: Sequence[Plot], rng: np.random.Generator, file: Path) -> None:
    """Write the points of the hedges, in whole centimetres: before every other house, two with a gate between."""
    points = []
    for along, beside, _, _ in plots[::2]:
        for first, last in ((along - 7.5, along - 1.2), (along + 1.2, along + 7.5)):
            girth = 2 * HEDGE_HIGH_M + HEDGE_WIDE_M
            count = round((last - first) * girth * HEDGE_POINTS_M2)
            s = rng.uniform(first, last, count)
            around = girth * rng.uniform(0, 1, count)  # up one side, over the top, down the other
            left = np.clip(around - HEDGE_HIGH_M, 0, HEDGE_WIDE_M) - HEDGE_WIDE_M / 2
            high = np.minimum(np.minimum(around, girth - around), HEDGE_HIGH_M)
            places = path.beside(s, math.copysign(HEDGE_M, beside) + left + rng.normal(0, 0.05, len(s)))
            points.append(np.column_stack([places, land_m(places, path) + high + rng.normal(0, 0.04, len(s))]))
    with file.open("wb") as out:
        np.savez(out, xyz=np.rint((np.concatenate(points) - HEDGE_AT_M) / HEDGE_STEP_M).astype("<i2"))


class Layout(NamedTuple):
    """Where things stand."""

    path: Road
    plots: Sequence[Plot]

    def at(self, along: float, left: float, high: float = 0.0) -> list[float]:
        """A place so far along the road and beside it, so high above the land."""
        x, y = self.path.beside(along, left)
        return [round(float(x), 2), round(float(y), 2), round(float(land_m(np.array([x, y]), self.path)) + high, 2)]

    def yaw_deg(self, along: float, turned_deg: float = 0.0) -> float:
        """The direction of the road, and from there to the left."""
        return round(math.degrees(float(self.path.heading(along))) + turned_deg, 1)


def _scene(layout: Layout, corner: tuple[float, ...], rng: np.random.Generator) -> str:
    """The YAML of the scene."""
    here = {"position_m": [0, 0, 0]}
    reflected = {name: value for name, value in MATERIALS.items() if name != "brick"}
    land = {"file": "suburb/land.png", "scale": LAND_STEP_M, "cell_m": LAND_CELL_M, "position_m": list(corner)}
    town = {"file": "suburb/houses.glb", **here, "reflectivity": MATERIALS["brick"], "materials": reflected}
    hedges = {"file": "suburb/hedges.npz", "scale": HEDGE_STEP_M, "radius_m": HEDGE_RADIUS_M}
    lines = [
        "# A suburb with a road of 520 m, made by tools/make_suburb.py; data/trajectories/suburb.tum drives along it.",
        "# Rough land, kerbs, pavements, houses whose façades have depth, hedges, parked cars, trees.",
        "name: suburb",
        *("height_fields:", _item("land", **land, reflectivity=14)),
        *("models:", _item("town", **town)),
        *("surfels:", _item("hedges", **hedges, position_m=list(HEDGE_AT_M), reflectivity=30)),
        *("meshes:", *_cars(layout, rng), *_trees(layout, rng)),
        *("cylinders:", *_lamps(layout)),
        *("boxes:", *_bins(layout)),
    ]
    return "\n".join(lines) + "\n"


def _cars(layout: Layout, rng: np.random.Generator) -> Iterator[str]:
    """Cars along the left kerb, and beside houses."""
    for n, along in enumerate(np.arange(14.0, layout.path.length_m - 8, 27.0), 1):
        place = along + float(rng.uniform(-4, 4))
        yaw_deg = layout.yaw_deg(place, float(rng.choice([0, 180])) + float(rng.uniform(-2, 2)))
        yield _car(f"parked_{n}", layout.at(place, 2.55), yaw_deg, rng)
    for n, (along, beside, _, _) in enumerate(layout.plots[1::3], 1):
        place = layout.at(along + 8.6, math.copysign(9.8, beside))
        yield _car(f"driveway_{n}", place, layout.yaw_deg(along, 90.0), rng)


def _car(name: str, position_m: list[float], yaw_deg: float, rng: np.random.Generator) -> str:
    placed = {"file": "../objects/car.ply", "position_m": position_m, "rpy_deg": [0, 0, round(yaw_deg, 1)]}
    return _item(name, **placed, reflectivity=int(rng.integers(10, 70)))


def _trees(layout: Layout, rng: np.random.Generator) -> Iterator[str]:
    """Trees in front of houses."""
    for n, (along, beside, _, _) in enumerate(layout.plots[::2], 1):
        place = along + float(rng.uniform(-9, -7))
        placed = {"position_m": layout.at(place, math.copysign(float(rng.uniform(8, 10)), beside), -0.05)}
        placed["rpy_deg"] = [0, 0, round(float(rng.uniform(0, 360)), 1)]
        size = round(float(rng.uniform(0.7, 1.15)), 2)
        yield _item(f"tree_{n}", file="meshes/tree.ply", **placed, scale=size, reflectivity=30)


def _lamps(layout: Layout) -> Iterator[str]:
    """Lamp posts on the right pavement."""
    for n, along in enumerate(np.arange(-15.0, layout.path.length_m - 5, 32.0), 1):
        yield _item(
            f"lamp_{n}", base_m=layout.at(along, -5.0, HIGH_M - 0.1), radius_m=0.08, height_m=6.1, reflectivity=28
        )


def _bins(layout: Layout) -> Iterator[str]:
    """Dustbins at gates."""
    for n, (along, beside, _, _) in enumerate(layout.plots[::3], 1):
        placed = {"center_m": layout.at(along + 1.9, math.copysign(5.8, beside), 0.5), "yaw_deg": layout.yaw_deg(along)}
        yield _item(f"bin_{n}", size_m=[0.55, 0.5, 1.1], **placed, reflectivity=20)


def _item(name: str, **keys: Any) -> str:
    """An object in one line of YAML."""
    return "  - {" + ", ".join(f"{key}: {_plain(value)}" for key, value in {"name": name, **keys}.items()) + "}"


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {one}" for key, one in value.items()) + "}"
    return value if isinstance(value, str) else json.dumps(value)


if __name__ == "__main__":
    main(argument(__doc__, Path, DATA))
