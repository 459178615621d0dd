"""Make the suburb: data/scenes/suburb.yaml with its files in data/scenes/suburb/, and data/trajectories/suburb.tum.

Usage: .venv/bin/python tools/make_suburb.py [FOLDER]      (FOLDER in place of data/)

A road of 520 m with curves over land that is not level, and a drive of 60 s along it: rough ground as a height field,
kerbs, pavements and houses whose façades have depth as glTFs of many nodes, hedges as a map of points, cars, people,
cyclists and trees as meshes. Some of them move along the road for a minute. Every number is a guess at what a suburb
looks like; the same script writes the same files.
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
from suburb_road import LANE_M, Array, Road, drive, land_m, progress, road

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
HOUSE_CLEAR_M = 6.0  # from a house's middle to a car's
HEDGE_M = 6.6
HEDGE_WIDE_M = 0.8
HEDGE_HIGH_M = 1.2
HEDGE_POINTS_M2 = 22.0
HEDGE_RADIUS_M = 0.16
HEDGE_STEP_M = 0.01
HEDGE_AT_M = (200.0, 0.0, 0.0)  # int16 reaches 327 m from there
MATERIALS = {"brick": 32, "plaster": 55, "glass": 8, "wood": 25, "tiles": 22, "metal": 45, "concrete": 30, "paving": 26}
OBJECT = "../objects/{}.ply"
CATEGORY = {"cyclist": "bicycle", "child": "pedestrian"}  # where it is not what the object is called
MOVES_S = 60.0
STANDS_S = 3600.0
AHEAD_M = 25.0  # of the drive's start
WALKER_M_S = 1.3
CYCLIST_M_S = 4.5
CYCLISTS = ((42.0, -25.0), (140.0, -20.0), (330.0, 70.0))  # from where to where along the road
WALKERS = (  # and how far to its left: each lane of a pavement in one direction
    *((8.0, 70.0, 4.15), (48.0, 126.0, 4.15), (230.0, 308.0, 4.15), (360.0, 438.0, 4.15)),
    *((72.0, -6.0, 4.9), (105.0, 27.0, 4.9), (150.0, 72.0, 4.9), (215.0, 137.0, 4.9), (310.0, 232.0, 4.9)),
    *((-20.0, 58.0, -4.05), (40.0, 118.0, -4.05), (165.0, 243.0, -4.05), (250.0, 328.0, -4.05), (330.0, 408.0, -4.05)),
)
STANDING = ((25.0, -5.05), (62.0, -5.05), (130.0, -5.05), (280.0, -5.05))
CROSSING_M = 55.0
Plot = tuple[float, float, float, float]  # how far along the road and beside it, x and y
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # of z up, as glTF wants it


def main(data: Path) -> None:
    """Write all files."""
    path = road()
    rng = np.random.default_rng(SEED)
    (data / "scenes/suburb").mkdir(parents=True, exist_ok=True)
    (data / "trajectories").mkdir(exist_ok=True)
    plots = _plots(path)
    corner = _land(path, plots, rng, data / "scenes/suburb/land.png")
    _houses(path, plots, data / "scenes/suburb/houses.glb")
    _pavements(path, data / "scenes/suburb/pavements.glb")
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


def _land(path: Road, plots: Sequence[Plot], rng: np.random.Generator, file: Path) -> tuple[float, float, float]:
    """Write the height field: smooth below the road and its pavements, level below cars beside houses, rough elsewhere.

    Returns its position.
    """
    low = np.floor(path.points_m.min(axis=0) - MARGIN_M)
    count = np.ceil((path.points_m.max(axis=0) + MARGIN_M - low) / LAND_CELL_M).astype(int) + 1
    x, y = (low[axis] + np.arange(count[axis]) * LAND_CELL_M for axis in range(2))
    places = np.stack(np.meshgrid(x, y[::-1]), axis=-1)  # rows from the north
    far = np.clip((path.distance(places) - ROUGH_FROM_M) / 2, 0, 1)
    heights = land_m(places, path) + ROUGH_M * far * rng.normal(size=far.shape)
    for along, left, yaw_rad in _driveways(path, plots).values():
        x, y = path.beside(along, left)
        ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
        from_car = abs(np.stack([(places - (x, y)) @ ahead, (places - (x, y)) @ (-ahead[1], ahead[0])]))
        heights[(from_car[0] < 3.7) & (from_car[1] < 2.5)] = round(float(land_m(np.array([x, y]), path)), 2)
    lowest = math.floor(heights.min())
    Image.fromarray(np.rint((heights - lowest) / LAND_STEP_M).astype(np.uint16)).save(file, optimize=True)
    return float(low[0]), float(low[1]), float(lowest)


def _driveways(path: Road, plots: Sequence[Plot]) -> dict[int, tuple[float, float, float]]:
    """Where cars stand beside houses, by number: along the road, to its left, and how they are turned.

    Where the next house is too near there is none.
    """
    houses = np.array([plot[2:] for plot in plots])
    found = {}
    for n, (along, beside, _, _) in enumerate(plots[1::3], 1):
        left = math.copysign(9.8, beside)
        if np.linalg.norm(houses - path.beside(along + 8.6, left), axis=1).min() > HOUSE_CLEAR_M:
            found[n] = along + 8.6, left, float(path.heading(along)) + math.pi / 2
    return found


def _pavements(path: Road, file: Path) -> None:
    """Write the glTF of kerbs and pavements along the road."""
    scene = trimesh.Scene()
    for name, side in (("left", 1), ("right", -1)):
        for material, quads in _ribbon(path, side).items():
            _add(scene, f"{'kerb' if material == 'concrete' else 'pavement'}_{name}", {material: quads}, np.eye(4))
    file.write_bytes(scene.export(file_type="glb"))


def _houses(path: Road, plots: Sequence[Plot], file: Path) -> None:
    """Write the glTF of houses that face the road."""
    scene = trimesh.Scene()
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
    reflected = {name: value for name, value in MATERIALS.items() if name not in ("brick", "concrete", "paving")}
    walked = {"materials": {"concrete": MATERIALS["concrete"]}, "reflectivity": MATERIALS["paving"]}
    land = {"file": "suburb/land.png", "scale": LAND_STEP_M, "cell_m": LAND_CELL_M, "position_m": list(corner)}
    town = {"file": "suburb/houses.glb", **here, "reflectivity": MATERIALS["brick"], "materials": reflected}
    hedges = {"file": "suburb/hedges.npz", "scale": HEDGE_STEP_M, "radius_m": HEDGE_RADIUS_M}
    lines = [
        "# A suburb with a road of 520 m, made by tools/make_suburb.py; data/trajectories/suburb.tum drives along it.",
        "# Rough land, kerbs, pavements, houses whose façades have depth, hedges, parked cars, trees; people,",
        "# cyclists and a car that drives ahead. What moves stands at the end of its way, for the rest of an hour.",
        "name: suburb",
        *("height_fields:", _item("land", category="ground", **land, reflectivity=14)),
        *("models:", _item("town", category="building", **town)),
        _item("beside", category="sidewalk", file="suburb/pavements.glb", **here, **walked),
        *("surfels:", _item("hedges", category="vegetation", **hedges, position_m=list(HEDGE_AT_M), reflectivity=30)),
        *("meshes:", *_cars(layout, rng), *_trees(layout, rng), *_moving(layout), *_standing(layout)),
        *("cylinders:", *_lamps(layout)),
        *("boxes:", *_bins(layout)),
    ]
    return "\n".join(lines) + "\n"


def _cars(layout: Layout, rng: np.random.Generator) -> Iterator[str]:
    """Cars along the left kerb, and beside houses."""
    for n, along in enumerate(np.arange(14.0, layout.path.length_m - 8, 27.0), 1):
        place = along + float(rng.uniform(-4, 4))
        yaw_deg = layout.yaw_deg(place, float(rng.choice([0, 180])) + float(rng.uniform(-2, 2)))
        yield _car(f"parked_{n}", layout.at(place, 2.55), yaw_deg, _paint(rng))
    driveways = _driveways(layout.path, layout.plots)
    for n in range(1, max(driveways) + 1):
        reflectivity = _paint(rng)  # also where no car is: what is drawn after it stays
        if n in driveways:
            along, left, yaw_rad = driveways[n]
            yield _car(f"driveway_{n}", layout.at(along, left), math.degrees(yaw_rad), reflectivity)


def _paint(rng: np.random.Generator) -> int:
    return int(rng.integers(10, 70))


def _car(name: str, position_m: list[float], yaw_deg: float, reflectivity: int) -> str:
    placed = {"file": OBJECT.format("car"), "position_m": position_m, "rpy_deg": [0, 0, round(yaw_deg, 1)]}
    return _item(name, category="car", **placed, reflectivity=reflectivity)


def _moving(layout: Layout) -> Iterator[str]:
    """A car ahead of the drive; cyclists that come towards it in the middle; people on both pavements; one crosses."""
    yield _on_its_way(layout, "car_ahead", "car", *progress(layout.path, AHEAD_M), LANE_M, 0.0, 38)
    for n, (first, last) in enumerate(CYCLISTS, 1):
        ends = np.array([0.0, abs(last - first) / CYCLIST_M_S]), np.array([first, last])
        yield _on_its_way(layout, f"cyclist_{n}", "cyclist", *ends, 0.55, 0.0, 35 + n)
    for n, (first, last, left) in enumerate(WALKERS, 1):
        ends = np.array([0.0, abs(last - first) / WALKER_M_S]), np.array([first, last])
        yield _on_its_way(layout, f"walker_{n}", "pedestrian", *ends, left, HIGH_M, 25 + 3 * n)
    child = np.array([0.0, 62 / WALKER_M_S]), np.array([9.0, 71.0])
    yield _on_its_way(layout, "child_1", "child", *child, 4.15, HIGH_M, 50)
    left = np.array([4.9, KERB_M + 0.3, KERB_M, -KERB_M, -KERB_M - 0.3, -5.05])
    high = np.array([HIGH_M, HIGH_M, 0, 0, HIGH_M, HIGH_M])
    places = np.array([layout.at(CROSSING_M, *place) for place in zip(left, high, strict=True)])
    yaws = np.full(len(left), layout.yaw_deg(CROSSING_M, -90.0))
    yield _item_of("crossing", "pedestrian", (left[0] - left) / WALKER_M_S, places, yaws, 45)


def _standing(layout: Layout) -> Iterator[str]:
    """People at the hedges."""
    for n, (along, left) in enumerate(STANDING, 1):
        placed = {"position_m": layout.at(along, left, HIGH_M), "rpy_deg": [0, 0, layout.yaw_deg(along, 70.0)]}
        yield _item(f"standing_{n}", category="pedestrian", file=OBJECT.format("pedestrian"), **placed, reflectivity=40)


def _on_its_way(
    layout: Layout,
    name: str,
    what: str,
    times_s: Array,
    along_m: Array,
    left_m: float,
    high_m: float,
    reflectivity: int,
) -> str:
    """An object that is so far along the road at these times, beside it and above it."""
    times = np.append(np.arange(0.0, min(times_s[-1], MOVES_S), 0.1), min(times_s[-1], MOVES_S))
    along = np.interp(times, times_s, along_m)
    x, y = layout.path.beside(along, left_m).T
    places = np.column_stack([x, y, land_m(np.column_stack([x, y]), layout.path) + high_m])
    turned = 0.0 if along[-1] > along[0] else 180.0
    kept = _kept(np.column_stack([places, np.degrees(layout.path.heading(along)) / 40]))  # 1 degree counts as 25 mm
    yaws = np.degrees(layout.path.heading(along[kept])) + turned
    return _item_of(name, what, times[kept], places[kept], yaws, reflectivity)


def _kept(rows: Array) -> list[int]:
    """The fewest rows, one after the other, between which the others lie on straight lines, to 2 cm."""
    kept = [0]
    for i in range(2, len(rows)):
        share = np.linspace(0, 1, i - kept[-1] + 1)[:, None]
        line = (1 - share) * rows[kept[-1]] + share * rows[i]
        if np.linalg.norm(rows[kept[-1] : i + 1] - line, axis=1).max() > 0.02:
            kept.append(i - 1)
    return [*kept, len(rows) - 1]


def _item_of(name: str, what: str, times_s: Array, places_m: Array, yaw_deg: Array, reflectivity: int) -> str:
    """A moving object; after the last time it stands."""
    times, places, yaws = ([*values, values[-1]] for values in (times_s, places_m, yaw_deg))
    times[-1] = STANDS_S
    poses = [
        f"{{time_s: {round(float(time), 2)}, position_m: {np.round(place - places[0], 2).tolist()}, "
        f"rpy_deg: [0, 0, {round(float(yaw - yaws[0]), 1)}]}}"
        for time, place, yaw in zip(times, places, yaws, strict=True)
    ]
    placed = {"position_m": np.round(places[0], 2).tolist(), "rpy_deg": [0, 0, round(float(yaws[0]), 1)]}
    category = CATEGORY.get(what, what)
    head = _item(name, category=category, file=OBJECT.format(what), **placed, reflectivity=reflectivity)
    return f"{head[:-1]},\n     motion: {{poses: [{', '.join(poses)}]}}}}"


def _trees(layout: Layout, rng: np.random.Generator) -> Iterator[str]:
    """Trees in front of houses."""
    for n, (along, beside, _, _) in enumerate(layout.plots[::2], 1):
        place = along + float(rng.uniform(-9, -7))
        placed = {"position_m": layout.at(place, math.copysign(float(rng.uniform(8, 10)), beside), -0.05)}
        placed["rpy_deg"] = [0, 0, round(float(rng.uniform(0, 360)), 1)]
        size = round(float(rng.uniform(0.7, 1.15)), 2)
        yield _item(f"tree_{n}", category="vegetation", file="meshes/tree.ply", **placed, scale=size, reflectivity=30)


def _lamps(layout: Layout) -> Iterator[str]:
    """Lamp posts on the right pavement."""
    for n, along in enumerate(np.arange(-15.0, layout.path.length_m - 5, 32.0), 1):
        placed = {"base_m": layout.at(along, -5.0, HIGH_M - 0.1), "radius_m": 0.08, "height_m": 6.1}
        yield _item(f"lamp_{n}", category="pole", **placed, reflectivity=28)


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
