"""Make the vehicles of data/vehicles/: a saloon, a delivery truck, a low shuttle and a bus, each one closed mesh.

Usage: .venv/bin/python tools/make_vehicles.py [FOLDER]      (needs the extra `vehicles`)

The vehicle frame is on the ground under the middle, x forward, y left, z up, in metres. Lofts through rings of points
are joined and cut by manifold3d, whose results are closed; the same input gives the same bytes.
"""

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from manifold3d import Manifold, Mesh64
from numpy.typing import ArrayLike, NDArray
from page import argument
from plyfile import PlyData, PlyElement
from scipy.interpolate import PchipInterpolator

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent.parent / "data/vehicles"
RING = 36  # points around a loft
TOLERANCE_M = 0.003  # by which a surface may move where that saves triangles
GRID_M = 2.0**-12  # of the coordinates: a quarter of a millimetre, exact in float32


def ring(across: Callable[[Array, Array], tuple[ArrayLike, ArrayLike, ArrayLike]], power: float) -> Array:
    """RING points of a rounded rectangle, the superellipse of a power, as `across` puts its (-1 to 1)² into space."""
    angle = (np.arange(RING) + 0.5) * (2 * math.pi / RING)
    u, v = (np.sign(part) * np.abs(part) ** (2 / power) for part in (np.cos(angle), np.sin(angle)))
    return np.stack(np.broadcast_arrays(*across(u, v)), axis=1).astype(np.float64)


def loft(rings: Iterable[Array]) -> Manifold:
    """The solid through rings of equally many points, closed by fans at both ends."""
    stack = np.stack(list(rings))
    count, around = stack.shape[:2]
    vertices = np.concatenate([stack.reshape(-1, 3), stack[0].mean(axis=0)[None], stack[-1].mean(axis=0)[None]])
    index = np.arange(count * around).reshape(count, around)
    a, b = index[:-1].ravel(), np.roll(index, -1, axis=1)[:-1].ravel()
    c, d = np.roll(index, -1, axis=1)[1:].ravel(), index[1:].ravel()
    first = index[0]
    last = index[-1]
    step = np.roll(np.arange(around), -1)
    triangles = np.concatenate(
        [
            np.stack([a, b, c], axis=1),
            np.stack([a, c, d], axis=1),
            np.stack([np.full(around, count * around), first[step], first], axis=1),
            np.stack([np.full(around, count * around + 1), last, last[step]], axis=1),
        ]
    )
    solid = Manifold(Mesh64(vertices, triangles.astype(np.uint64)))
    if solid.volume() < 0:
        solid = Manifold(Mesh64(vertices, triangles[:, ::-1].astype(np.uint64).copy()))
    return solid


def along_x(table: ArrayLike, power: float, stations: int) -> Manifold:
    """A solid of rows x, half width, bottom, top; rounded rectangles across, a smooth curve between the rows."""
    rows = np.array(table)
    curve = PchipInterpolator(np.arange(len(rows)), rows)
    return loft(
        ring(lambda u, v, r=row: (r[0], r[1] * u, (r[2] + r[3]) / 2 + (r[3] - r[2]) / 2 * v), power)
        for row in curve(np.linspace(0, len(rows) - 1, stations))
    )


def along_z(table: ArrayLike, power: float, inset_m: float = 0.0) -> Manifold:
    """A solid of rows z, rear, front, half width: rounded rectangles from above, smaller by the inset on all sides."""
    return loft(
        ring(lambda u, v, r=row: ((r[1] + r[2]) / 2 + (r[2] - r[1]) / 2 * u, r[3] * v, r[0]), power)
        for row in np.array(table) + np.array([0, inset_m, -inset_m, -inset_m])
    )


def box(low: ArrayLike, high: ArrayLike) -> Manifold:
    """The box between two corners."""
    size = np.subtract(high, low)
    return Manifold.cube(size.tolist()).translate(list(low))


def prism(outline: ArrayLike, low: float, high: float, axis: str) -> Manifold:
    """A convex polygon in the plane across an axis, from `low` to `high` along it."""
    flat = np.array(outline, np.float64)
    ends = [np.insert(flat, "xyz".index(axis), value, axis=1) for value in (low, high)]
    return Manifold.hull_points(np.concatenate(ends))


def wheel(x: float, y: float, radius: float, width: float, facets: int = 32) -> Manifold:
    """A wheel on the ground whose middle is at x, y: a tyre with rounded shoulders and a hollow rim on both sides."""
    half = width / 2
    edge = 0.12 * width
    rim = 0.62 * radius
    profile = [
        (0.3 * rim, half - 0.02), (rim * 0.9, half - 0.05), (rim, half - 0.005), (radius - edge, half),
        (radius, half - edge), (radius, edge - half), (radius - edge, -half), (rim, 0.005 - half),
        (rim * 0.9, 0.05 - half), (0.3 * rim, 0.02 - half),
    ]  # fmt: skip
    angle = (np.arange(facets) + 0.5) * (2 * math.pi / facets)
    rings = [np.stack([r * np.sin(angle), np.full(facets, h), r * np.cos(angle)], axis=1) for r, h in profile]
    return loft(rings).translate([x, y, radius * math.cos(math.pi / facets)])


def drum(x: float, z: float, radius: float, inner: float, outer: float, facets: int = 40) -> Manifold:
    """A cylinder across the vehicle, on both of its sides: the space of a wheel arch."""
    one = Manifold.cylinder(outer - inner, radius, radius, facets).rotate([-90, 0, 0]).translate([x, inner, z])
    return one + one.mirror([0, 1, 0])


def both(solid: Manifold) -> Manifold:
    """A solid and its mirror image on the right."""
    return solid + solid.mirror([0, 1, 0])


def glazed(solid: Manifold, windows: Manifold, inner: Manifold) -> Manifold:
    """A solid whose windows are set back to the surface of an inner one."""
    return (solid - windows) + (solid ^ inner)


def axle(x: float, z: float, half: float, radius: float = 0.05) -> Manifold:
    """What joins two wheels."""
    return Manifold.cylinder(2 * half, radius, radius, 12).rotate([-90, 0, 0]).translate([x, -half, z])


def sedan() -> Manifold:
    """A saloon, 4.8 m × 1.9 m × 1.5 m; mirrors to 1.03 m."""
    hull = along_x(
        [
            # x, half width, bottom, top
            (-2.400, 0.66, 0.36, 0.80),
            (-2.375, 0.78, 0.29, 0.90),
            (-2.280, 0.865, 0.24, 0.985),
            (-2.000, 0.925, 0.20, 1.015),
            (-1.500, 0.950, 0.17, 1.010),
            (-0.600, 0.950, 0.16, 0.960),
            (0.400, 0.950, 0.16, 0.945),
            (1.100, 0.948, 0.17, 0.930),
            (1.600, 0.935, 0.18, 0.880),
            (2.050, 0.900, 0.20, 0.790),
            (2.290, 0.820, 0.24, 0.700),
            (2.380, 0.720, 0.29, 0.630),
            (2.400, 0.600, 0.34, 0.560),
        ],
        5.5,
        31,
    )

    cabin = [
        # z, rear, front, half width
        (0.80, -2.06, 1.38, 0.900),
        (0.95, -1.86, 1.10, 0.865),
        (1.10, -1.645, 0.82, 0.815),
        (1.25, -1.43, 0.54, 0.760),
        (1.38, -1.235, 0.30, 0.705),
        (1.435, -1.120, 0.17, 0.660),
        (1.470, -0.980, 0.03, 0.590),
        (1.490, -0.780, -0.15, 0.460),
        (1.500, -0.550, -0.35, 0.250),
    ]

    side = [
        prism([(0.70, 0.975), (-0.33, 0.975), (-0.33, 1.365), (0.16, 1.365)], 0.5, 1.2, "y"),
        prism([(-0.41, 0.975), (-1.36, 0.985), (-1.13, 1.365), (-0.41, 1.365)], 0.5, 1.2, "y"),
    ]
    screen = prism([(-0.70, 0.96), (0.70, 0.96), (0.56, 1.385), (-0.56, 1.385)], 0.3, 1.4, "x")
    rear = prism([(-0.66, 1.05), (0.66, 1.05), (0.54, 1.37), (-0.54, 1.37)], -2.0, -1.1, "x")
    body = hull + glazed(along_z(cabin, 6.0), both(side[0] + side[1]) + screen + rear, along_z(cabin, 6.0, 0.03))
    head_lamp = [(2.345, 0.40), (2.5, 0.40), (2.5, 0.84), (2.19, 0.84)]
    tail_lamp = [(-2.5, 0.45), (-2.365, 0.45), (-2.28, 0.86), (-2.5, 0.86)]
    body -= both(prism(head_lamp, 0.555, 0.645, "z") + prism(tail_lamp, 0.72, 0.84, "z"))
    body -= box([2.365, -0.45, 0.36], [2.45, 0.45, 0.50])  # grille
    body -= box([-2.45, -0.27, 0.52], [-2.385, 0.27, 0.64])  # plate
    for x in (-1.40, 1.42):
        body -= drum(x, 0.34, 0.385, 0.64, 1.1)
        body += axle(x, 0.33, 0.8) + both(wheel(x, 0.815, 0.335, 0.225))
    mirror = along_z(
        [(0.955, 0.66, 0.74, 0.07), (0.985, 0.64, 0.79, 0.105), (1.065, 0.64, 0.78, 0.105), (1.09, 0.66, 0.74, 0.08)], 3
    ).translate([0, 0.925, 0])
    return body + both(mirror + box([0.67, 0.78, 0.96], [0.75, 0.88, 1.0]))


def truck() -> Manifold:
    """A delivery truck, 7.2 m × 2.3 m × 3.2 m: cab over engine, box body; mirrors to 1.36 m."""

    cab = [
        (0.45, 1.78, 3.54, 1.02),
        (0.55, 1.75, 3.585, 1.06),
        (1.10, 1.75, 3.60, 1.075),
        (1.45, 1.75, 3.585, 1.075),
        (2.25, 1.75, 3.30, 1.02),
        (2.42, 1.77, 3.18, 0.97),
        (2.50, 1.83, 3.02, 0.87),
        (2.53, 2.05, 2.75, 0.60),
    ]

    screen = prism([(-0.93, 1.42), (0.93, 1.42), (0.86, 2.28), (-0.86, 2.28)], 3.0, 3.8, "x")
    side = prism([(3.36, 1.45), (2.15, 1.45), (2.15, 2.22), (3.14, 2.22)], 0.7, 1.3, "y")
    body = glazed(along_z(cab, 9.0), screen + both(side), along_z(cab, 9.0, 0.04))
    body -= box([3.55, -0.70, 0.80], [3.70, 0.70, 1.10])  # grille
    body -= both(box([3.50, 0.72, 0.66], [3.70, 0.98, 0.82]))  # head lamps
    body -= drum(2.75, 0.45, 0.52, 0.62, 1.3)
    body += box([-3.45, -0.43, 0.58], [2.0, 0.43, 0.80])  # frame
    body += along_x(
        [
            (-3.60, 1.135, 0.86, 3.185), (-3.585, 1.15, 0.85, 3.20), (-1.2, 1.15, 0.85, 3.20),
            (1.585, 1.15, 0.85, 3.20), (1.60, 1.135, 0.86, 3.185),
        ],
        60,
        9,
    )  # fmt: skip
    body -= box([-3.65, -1.02, 1.0], [-3.58, -0.01, 3.05]) + box([-3.65, 0.01, 1.0], [-3.58, 1.02, 3.05])  # doors
    body += box([-3.55, -0.95, 0.42], [-3.45, 0.95, 0.54])  # underrun bar
    body += both(box([-3.53, 0.30, 0.50], [-3.35, 0.40, 0.70]))
    body += both(box([-0.9, 0.72, 0.42], [1.2, 0.76, 0.86]))  # side guards
    body += box([0.3, -0.80, 0.45], [1.3, -0.40, 0.86]) + box([0.5, 0.40, 0.45], [1.1, 0.80, 0.86])  # tanks
    body += both(box([1.55, 0.30, 0.60], [1.85, 0.40, 1.10]))  # what carries the cab
    body += axle(2.75, 0.45, 0.9, 0.08) + both(wheel(2.75, 0.90, 0.45, 0.26))
    body += axle(-2.05, 0.45, 0.9, 0.08) + both(wheel(-2.05, 0.96, 0.45, 0.24) + wheel(-2.05, 0.69, 0.45, 0.24))
    body += both(box([-2.15, 0.2, 0.40], [-1.95, 0.45, 0.90]))
    mirror = along_z(
        [(1.62, 3.30, 3.38, 0.10), (1.66, 3.26, 3.42, 0.125), (2.06, 3.26, 3.40, 0.125), (2.10, 3.30, 3.36, 0.10)], 4
    ).translate([0, 1.235, 0])
    return body + both(mirror + box([3.28, 0.85, 1.72], [3.32, 1.2, 1.76]) + box([3.26, 0.85, 1.98], [3.30, 1.2, 2.02]))


def shuttle() -> Manifold:
    """A low shuttle that drives both ways, 4.4 m × 2.0 m × 2.5 m, its floor 0.2 m above the ground."""

    hull = [
        (0.20, -1.99, 1.99, 0.88),
        (0.25, -2.10, 2.10, 0.96),
        (0.45, -2.19, 2.19, 1.00),
        (0.80, -2.20, 2.20, 1.00),
        (1.20, -2.17, 2.17, 0.99),
        (2.10, -1.97, 1.97, 0.93),
        (2.32, -1.86, 1.86, 0.88),
        (2.42, -1.70, 1.70, 0.80),
        (2.475, -1.35, 1.35, 0.62),
        (2.50, -0.80, 0.80, 0.35),
    ]

    ends = prism([(-0.80, 1.02), (0.80, 1.02), (0.70, 2.16), (-0.70, 2.16)], 1.6, 2.4, "x")
    doors = [
        prism([(x0, 0.36), (x1, 0.36), (x1, 2.14), (x0, 2.14)], 0.6, 1.2, "y")
        for x0, x1 in ((-0.68, -0.02), (0.02, 0.68))
    ]
    panes = [
        prism([(x0, 1.02), (x1, 1.02), (x1 - 0.10, 2.12), (x0, 2.12)], 0.6, 1.2, "y") for x0, x1 in ((0.80, 1.72),)
    ]
    openings = ends + ends.mirror([1, 0, 0])
    for one in (*doors, *panes, *(pane.mirror([1, 0, 0]) for pane in panes)):
        openings += both(one)
    body = glazed(along_z(hull, 5.5), openings, along_z(hull, 5.5, 0.04))
    lamp = box([2.10, 0.55, 0.62], [2.3, 0.82, 0.72])
    body -= both(lamp + lamp.mirror([1, 0, 0]))
    for x in (-1.35, 1.35):
        body -= drum(x, 0.30, 0.37, 0.68, 1.2)
        body += axle(x, 0.30, 0.85) + both(wheel(x, 0.865, 0.31, 0.22))
    return body


def bus() -> Manifold:
    """A city bus with a low floor, 12.0 m × 2.55 m × 3.0 m, of flat panels; mirrors to 1.50 m."""
    half = 1.275
    side = [
        (-5.93, 0.30), (-6.0, 0.45), (-6.0, 2.75), (-5.85, 3.0),
        (5.70, 3.0), (5.88, 2.75), (6.0, 1.10), (6.0, 0.45), (5.93, 0.30),
    ]  # fmt: skip
    plan = [(-6.0, 1.14), (-5.88, half), (5.80, half), (6.0, 1.02)]
    across = [(half, 0.30), (half, 2.76), (1.20, 2.93), (1.06, 3.0)]
    body = prism([(x, z) for x, z in side], -half, half, "y")
    body ^= prism(plan + [(x, -y) for x, y in plan], 0.0, 3.1, "z")
    body ^= prism(across + [(-y, z) for y, z in across], -6.1, 6.1, "x")

    body -= box([5.2, -1.12, 1.15], [6.1, 1.12, 2.55]) - box([5.2, -1.2, 1.0], [5.86, 1.2, 2.6])  # windscreen
    body -= box([-6.1, -0.95, 1.50], [-5.95, 0.95, 2.40])  # rear window
    body -= both(box([-5.3, half - 0.03, 1.25], [4.3, 1.4, 2.45]))  # side windows
    for x in (-1.2, 1.6, 4.5):  # doors, on the right
        body -= box([x, -1.4, 0.36], [x + 1.15, 0.04 - half, 2.45])
    radius = 0.48 * math.cos(math.pi / 12)  # from the axle to the ground
    for x, width in ((-2.9, 0.58), (3.0, 0.29)):  # twin tyres behind
        body -= drum(x, radius, 0.56, half - 0.40, 1.4, 12)
        tyre = Manifold.cylinder(width, 0.48, 0.48, 12).rotate([-90, 15, 0])
        body += both(tyre.translate([x, half - 0.03 - width, radius])) + axle(x, radius, 1.0)
    arms = box([5.77, 1.20, 1.80], [5.83, 1.40, 1.86]) + box([5.77, 1.20, 2.04], [5.83, 1.40, 2.10])
    return body + both(box([5.74, 1.33, 1.75], [5.86, 1.50, 2.15]) + arms)


def triangles_of(solid: Manifold) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) on the grid of coordinates, and triangles (T, 3), with none left that the grid has flattened."""
    mesh = solid.simplify(TOLERANCE_M).to_mesh64()
    points = np.ascontiguousarray(np.round(mesh.vert_properties[:, :3] / GRID_M) * GRID_M)
    flat = Manifold(Mesh64(points, np.array(mesh.tri_verts, np.uint64))).simplify(GRID_M).to_mesh64()
    return np.asarray(flat.vert_properties[:, :3]), np.asarray(flat.tri_verts, np.int64)


def save(solid: Manifold, path: Path) -> int:
    """Write a binary PLY; how many triangles it has."""
    points, triangles = triangles_of(solid)
    vertex = np.empty(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    for axis, values in zip("xyz", points.T, strict=True):
        vertex[axis] = values
    face = np.empty(len(triangles), [("vertex_indices", "<i4", (3,))])
    face["vertex_indices"] = triangles
    elements = [PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")]
    PlyData(elements, byte_order="<").write(path)
    return len(triangles)


VEHICLES = {"sedan": sedan, "truck": truck, "shuttle": shuttle, "bus": bus}


def main(folder: Path) -> None:
    """Make all of them."""
    for name, make in VEHICLES.items():
        path = folder / f"{name}.ply"
        print(f"{path}: {save(make(), path):,} triangles, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(argument(__doc__, Path, FOLDER))
