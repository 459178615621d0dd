"""Houses whose façades have depth: windows and doors set back, bays that stand out, roofs that hang over."""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FOOT_M = -1.2  # walls go on into the ground, which is not level
EAVES_M = 0.4  # by which a roof hangs over
WINDOW_M = 1.3  # the height of a window


class Relief(NamedTuple):
    """A rectangle of a façade that stands out of it or is set back."""

    x_m: tuple[float, float]  # along the façade
    z_m: tuple[float, float]
    out_m: float  # negative: set back
    material: str


class House(NamedTuple):
    """The measures of a house."""

    width_m: float
    depth_m: float
    eaves_m: float  # height of its walls
    ridge_m: float
    wall: str  # material
    front: tuple[Relief, ...]
    back: tuple[Relief, ...]
    side: tuple[Relief, ...]


Quads = dict[str, list[Array]]  # by material, corners (4, 3)


def windows(xs: Iterable[float], zs: Iterable[float], width_m: float = 1.2) -> list[Relief]:
    """Windows of one height whose lower left corners are at all of these."""
    zs = tuple(zs)
    return [Relief((x, x + width_m), (z, z + WINDOW_M), -0.22, "glass") for x in xs for z in zs]


def designs() -> tuple[House, ...]:
    """The houses that stand along the road again and again."""
    door = Relief((5.2, 6.3), (0.1, 2.2), -0.5, "wood")
    bay = Relief((1.0, 3.6), (FOOT_M, 2.7), 0.9, "brick")
    pane = Relief((1.4, 3.2), (0.9, 2.3), 0.75, "glass")
    garage = Relief((7.4, 10.2), (0.05, 2.2), -0.35, "metal")
    cottage = House(
        *(9.0, 8.0, 3.1, 6.6, "plaster"),
        (*windows((1.0, 7.0), (0.9,)), Relief((3.8, 4.9), (0.1, 2.2), -0.6, "wood")),
        (*windows((1.2, 6.4), (0.9,)), Relief((3.4, 5.6), (0.1, 2.3), -0.25, "glass")),
        tuple(windows((2.0, 5.0), (0.9,))),
    )
    villa = House(
        *(11.0, 9.0, 5.8, 9.2, "brick"),
        (bay, pane, door, *windows((1.6, 5.2, 8.2), (3.6,)), *windows((8.2,), (0.9,))),
        tuple(windows((1.5, 5.0, 8.5), (0.9, 3.6))),
        tuple(windows((2.0, 6.0), (0.9, 3.6))),
    )
    garaged = House(
        *(11.5, 8.5, 5.6, 8.4, "plaster"),
        (garage, door, *windows((1.2,), (0.9, 3.5), 1.8), *windows((5.2, 8.2), (3.5,))),
        (*windows((1.2, 5.0, 8.6), (3.5,)), Relief((2.0, 5.2), (0.1, 2.4), -0.3, "glass")),
        tuple(windows((3.4,), (0.9, 3.5))),
    )
    row = House(
        *(14.0, 8.0, 5.4, 7.6, "brick"),
        (
            *windows((0.9, 4.4, 8.0, 11.6), (0.9, 3.4), 1.4),
            Relief((2.8, 3.8), (0.1, 2.2), -0.45, "wood"),
            Relief((10.0, 11.0), (0.1, 2.2), -0.45, "wood"),
            Relief((6.3, 7.5), (FOOT_M, 5.4), 0.35, "plaster"),
        ),
        tuple(windows((1.0, 4.6, 8.2, 11.8), (0.9, 3.4))),
        (),
    )
    return cottage, villa, garaged, row


def quads_of(house: House) -> Quads:
    """The surfaces of a house; its front looks along -y, the origin is under its middle."""
    out: Quads = {}
    sides = (house.width_m, house.depth_m, house.front), (house.depth_m, house.width_m, house.side)
    sides += (house.width_m, house.depth_m, house.back), (house.depth_m, house.width_m, house.side)
    for quarter, (width, depth, reliefs) in enumerate(sides):
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        for material, corners in facade(width, house.eaves_m, reliefs, house.wall):
            out.setdefault(material, []).append((corners - (width / 2, depth / 2, 0)) @ R.T)
    for material, corners in roof(house):
        out.setdefault(material, []).append(corners)
    return out


def facade(width_m: float, height_m: float, reliefs: Iterable[Relief], wall: str) -> Iterable[tuple[str, Array]]:
    """Material and corners of a façade's rectangles, and of what joins those that are not equally far out."""
    reliefs = tuple(reliefs)
    xs = sorted({0.0, width_m, *(x for relief in reliefs for x in relief.x_m)})
    zs = sorted({FOOT_M, height_m, *(z for relief in reliefs for z in relief.z_m)})
    cells = [[_cell((a + b) / 2, (c + d) / 2, reliefs, wall) for c, d in pairwise(zs)] for a, b in pairwise(xs)]
    for i, (a, b) in enumerate(pairwise(xs)):
        for k, (c, d) in enumerate(pairwise(zs)):
            y = -cells[i][k][0]
            material = cells[i][k][1]
            yield material, np.array([[a, y, c], [b, y, c], [b, y, d], [a, y, d]])
            if i and cells[i - 1][k][0] != -y:
                y0 = -cells[i - 1][k][0]
                yield wall, np.array([[a, y0, c], [a, y, c], [a, y, d], [a, y0, d]])
            if k and cells[i][k - 1][0] != -y:
                y0 = -cells[i][k - 1][0]
                yield wall, np.array([[a, y0, c], [b, y0, c], [b, y, c], [a, y, c]])


def _cell(x: float, z: float, reliefs: Iterable[Relief], wall: str) -> tuple[float, str]:
    """How far out a façade is at a place, and of what: the last relief there counts."""
    found = [r for r in reliefs if r.x_m[0] < x < r.x_m[1] and r.z_m[0] < z < r.z_m[1]]
    return (found[-1].out_m, found[-1].material) if found else (0.0, wall)


def roof(house: House) -> Iterable[tuple[str, Array]]:
    """Two slopes with eaves, and the gables below them (triangles, with a corner twice)."""
    x = house.width_m / 2
    y = house.depth_m / 2
    high = house.ridge_m
    fall = EAVES_M * (high - house.eaves_m) / y
    for side in (-1.0, 1.0):
        edge = side * (y + EAVES_M), house.eaves_m - fall
        yield (
            "tiles",
            np.array([[-x - EAVES_M, *edge], [x + EAVES_M, *edge], [x + EAVES_M, 0, high], [-x - EAVES_M, 0, high]]),
        )
        gable = [[side * x, -y, house.eaves_m], [side * x, y, house.eaves_m], [side * x, 0, high], [side * x, 0, high]]
        yield house.wall, np.array(gable)


def triangles_of(quads: list[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and triangles of quads; those without area are omitted."""
    vertices, index = np.unique(np.round(np.concatenate(quads), 3), axis=0, return_inverse=True)
    corners = index.reshape(-1, 4)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return vertices, triangles[(triangles[:, 1] != triangles[:, 2]) & (triangles[:, 0] != triangles[:, 2])]
