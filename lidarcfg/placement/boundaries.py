"""Where straight lines enter and leave what LiDARs see, and where they pass through bodies.

A line enters or leaves what a LiDAR sees only at

- an obstacle's surface;
- the plane through the LiDAR and a silhouette edge: one whose two triangles lie on one side of that plane, or that has
  not just two triangles; behind a sphere the cone that touches it; behind an upright cylinder the cones over its rims
  and the planes that touch its side;
- a sphere around the LiDAR with its least or greatest range as radius;
- a half-plane from its axis where its field of view ends.

Where a line crosses one of these is known in closed form, and so is the normal there. Between two such places a LiDAR
sees all of the line or nothing, and one ray says which. So what is no bound after all, as the shadow of an edge that is
in shadow itself, does no harm.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import analytic as core
from lidarcfg.geometry import Array
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.region import Region
from lidarcfg.placement.visibility import Visibility
from lidarcfg.world.scene_file import Cylinder, Sphere
from lidarcfg.world.solids import connected_components, unique_vertices
from lidarcfg.world.tracer import CYLINDER, SPHERE, TRIANGLE, Obstacles
from lidarcfg.world.vehicle import Vehicle, object_mesh

WIDER = 1e-9  # rad, by which directions are widened before sorting
CHUNK = 8192  # lines
BINS = core.DIRECTION_BINS
FULL = 2.0 * np.pi
FLAT = 1e-12  # of the lengths that span a tetrahedron: with less volume it may have either sign

Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Outline(NamedTuple):
    """The shapes that may cast shadows."""

    triangles: Array  # (T, 3, 3)
    edges: Array  # (E, 2, 3) of the triangles
    beside: Array  # (E, 2, 3) the third corners of the two triangles at each; NaN where they are not two
    rounds: Array  # (R, 5) spheres and upright cylinders: centre or base, radius, height (NaN: a sphere)
    ground_m: float  # its height; inf: none


class Quadrics(NamedTuple):
    """Surfaces xᵀ M x + 2 b·x + c = 0, and a sphere around all of each that matters."""

    m: Array  # (Q, 3, 3)
    b: Array  # (Q, 3)
    c: Array  # (Q,)
    centre: Array  # (Q, 3)
    radius: Array  # (Q,) inf: anywhere


def outline(obstacles: Obstacles) -> Outline:
    """The outline of obstacles. Corners are one if their coordinates are equal to the last bit."""
    tree = obstacles.tree
    origin_m = obstacles.origin_m
    shapes = tree.shapes.reshape(-1, 9)
    triangles = shapes[tree.kind == TRIANGLE].reshape(-1, 3, 3) + origin_m
    found, number = unique_vertices(triangles.reshape(-1, 3) + 0.0)
    order = np.lexsort(found.T[::-1])
    corners = found[order]
    number = np.argsort(order)[number].reshape(-1, 3)
    ends = np.sort(number[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    third = number[:, [2, 0, 1]].ravel()
    order = np.argsort(ends[:, 1] * len(corners) + ends[:, 0], kind="stable")
    ends = ends[order]
    third = third[order]
    new = np.ones(len(ends), np.bool_)
    new[1:] = (ends[1:] != ends[:-1]).any(axis=1)
    first = np.flatnonzero(new)
    beside = np.full((len(first), 2, 3), np.nan)
    two = np.diff(np.append(first, len(ends))) == 2
    beside[two] = corners[third[first[two][:, None] + [0, 1]]]
    rounds = shapes[:, :5] + np.append(origin_m, (0.0, 0.0))
    rounds[tree.kind == SPHERE, 4] = np.nan
    return Outline(
        triangles,
        corners[ends[first]],
        beside,
        rounds[(tree.kind == SPHERE) | (tree.kind == CYLINDER)],
        obstacles.ground_m,
    )


def silhouette(shape: Outline, position_m: Array) -> Array:
    """(E, 2, 3) the edges, relative to a LiDAR, behind which its sight may begin or end."""
    edges = shape.edges - position_m
    beside = shape.beside - position_m
    normal = np.cross(edges[:, 0], edges[:, 1])
    volume = np.einsum("ej,eij->ei", normal, beside)
    flat = FLAT * np.linalg.norm(normal, axis=1)[:, None] * np.linalg.norm(beside, axis=2)
    through = (volume[:, 0] > flat[:, 0]) & (volume[:, 1] < -flat[:, 1])
    through |= (volume[:, 0] < -flat[:, 0]) & (volume[:, 1] > flat[:, 1])
    return np.concatenate([edges[~through], _tangents(shape.rounds, position_m)])


def _tangents(rounds: Array, position_m: Array) -> Array:
    """(E, 2, 3) the lines on the sides of cylinders that a LiDAR sees edge on, relative to it."""
    out = []
    for x, y, z, radius, height in rounds[rounds[:, 4] >= 0.0] - np.append(position_m, (0.0, 0.0)):
        distance = maths.hypot(x, y)
        if distance > radius:
            away = maths.atan2(y, x)
            turn = maths.asin(radius / distance)
            length = np.sqrt((distance - radius) * (distance + radius))
            for angle in (away - turn, away + turn):
                u, v = length * maths.cos(angle), length * maths.sin(angle)
                out.append([[u, v, z], [u, v, z + height]])
    return np.array(out).reshape(-1, 2, 3)


def quadrics(shape: Outline, lidar: Lidar, visibility: Visibility) -> Quadrics:
    """The quadrics that may bound a LiDAR's sight, relative to it."""
    nothing = np.zeros(3)
    flat = np.zeros((3, 3))
    upright = np.array((0.0, 0.0, 0.5))
    limits = visibility.limits([lidar])[0]
    rows: list[tuple[Array, Array, float, Array, float]] = []
    rows += [(np.eye(3), nothing, -square, nothing, np.inf) for square in limits[:2] if 0.0 < square < np.inf]
    rows += [(flat, normal, 0.0, nothing, np.inf) for normal in limits[2:8].reshape(2, 3) if normal.any()]
    if np.isfinite(shape.ground_m):
        rows.append((flat, upright, lidar.position_m[2] - shape.ground_m, nothing, np.inf))
    for x, y, z, radius, height in shape.rounds - np.append(lidar.position_m, (0.0, 0.0)):
        centre = np.array((x, y, z))
        square = float(np.square(centre).sum()) - radius**2
        if np.isnan(height):
            if square > 0.0:
                rows.append((np.outer(centre, centre) - square * np.eye(3), nothing, 0.0, centre, radius))
            continue
        for rim in (centre, np.array((x, y, z + height))):
            m, b = (_over_rim(rim, radius), nothing) if rim[2] != 0.0 else (flat, upright)  # a rim seen edge on
            rows.append((m, b, 0.0, rim, radius))
    columns = [np.array([row[i] for row in rows], np.float64) for i in range(5)]
    shapes = [(-1, 3, 3), (-1, 3), (-1,), (-1, 3), (-1,)]
    return Quadrics(*(column.reshape(shape) for column, shape in zip(columns, shapes, strict=True)))


def _over_rim(rim: Array, radius: float) -> Array:
    """(3, 3) the cone from the origin over a horizontal circle at height h: |h (x, y) − z (cx, cy)|² = (z R)²."""
    x, y, h = rim.tolist()
    return np.array([[h * h, 0.0, -h * x], [0.0, h * h, -h * y], [-h * x, -h * y, x * x + y * y - radius * radius]])


class Lattice(NamedTuple):
    """The lines along one axis: all by that axis first, then the other two in cyclic order."""

    axis: int
    low: Array  # (3,) the region's corner
    edge: Array  # (3,) of a cuboid
    shape: tuple[int, int, int]  # cuboids

    @property
    def lines(self) -> int:
        """How many there are."""
        return core.LINES_PER_EDGE**2 * self.shape[1] * self.shape[2]


class Crossings(NamedTuple):
    """What lines cross, one line after the other."""

    first: Counts  # (L + 1,) the first crossing of each line
    at: Array  # (C,) ascending on each line
    weight: Array  # (C,) |n·e|, n the normal of the surface crossed, e the line's direction


class Flipped(NamedTuple):
    """Where a state changes along lines."""

    start: Flags  # (L,) the state that each line starts with
    crossed: Crossings  # where it changes


class Flips(NamedTuple):
    """Where R states change along L lines: what each LiDAR sees of them; last, what of them no body fills."""

    start: Flags  # (R, L) the state at the region's lower wall
    first: Counts  # (R L + 1,) the first flip of each state and line
    at: Array  # (F,) ascending for each
    weight: Array  # (F,) |n·e|, n the normal of the surface crossed there


class Bounds(NamedTuple):
    """What may bound what a LiDAR sees, as lines along one axis meet it; all relative to the LiDAR.

    Beyond an edge lies part of the plane through the LiDAR and the edge. Quadrics are xᵀ M x + 2 b·x + c = 0.
    """

    foot: Array  # (3,) the LiDAR
    edges: Array  # (E, 7) ends, and |n·e| of the plane
    quadrics: Array  # (Q, 10) M by its rows from the diagonal on, b, c
    first: Counts  # (BINS + 1,) the first item in each bin of directions across the lines
    item: Counts  # (I,) edges, and E + quadrics


def bounds(edges: Array, surfaces: Quadrics, position_m: Array, axis: int) -> Bounds:
    """What may bound a LiDAR's sight, by lines along an axis; edges (E, 2, 3) and surfaces relative to the LiDAR."""
    order = axes_from(axis)
    edges = edges[:, :, order]
    m = surfaces.m[:, order][:, :, order]
    centre = surfaces.centre[:, order]
    normal = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normal, axis=1)
    edges = edges[length > 0.0]
    normal = normal[length > 0.0] / length[length > 0.0, None]
    rows = np.concatenate([edges.reshape(-1, 6), abs(normal[:, :1])], axis=1)
    upper = m[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    table = np.concatenate([upper, surfaces.b[:, order], surfaces.c[:, None]], axis=1)
    middle, half = np.concatenate([_edge_spans(edges), _round_spans(centre, surfaces.radius)], axis=1)
    first, item = _binned(middle, half)
    return Bounds(position_m[order], np.ascontiguousarray(rows), np.ascontiguousarray(table), first, item)


def axes_from(axis: int) -> list[int]:
    """An axis and the two others in cyclic order."""
    return [axis, (axis + 1) % 3, (axis + 2) % 3]


def _edge_spans(edges: Array) -> Array:
    """(2, E) middle and half of the angles that edges span around the origin, as seen along the first axis."""
    angle = maths.atan2(edges[:, :, 2], edges[:, :, 1])
    half = ((angle[:, 1] - angle[:, 0] + np.pi) % FULL - np.pi) / 2
    over = (edges[:, :, 1:] == 0.0).all(axis=2).any(axis=1) | (abs(half) > np.pi / 2 - WIDER)
    return np.stack([angle[:, 0] + half, np.where(over, np.pi, abs(half))])


def _round_spans(centre: Array, radius: Array) -> Array:
    """(2, Q) the same for spheres."""
    distance = maths.hypot(centre[:, 1], centre[:, 2])
    sine = np.divide(radius, distance, out=np.ones(len(radius)), where=distance > radius)
    return np.stack([maths.atan2(centre[:, 2], centre[:, 1]), np.where(sine < 1.0, maths.asin(sine), np.pi)])


def _binned(middle: Array, half: Array) -> tuple[Counts, Counts]:
    """Items by bins of direction: the first in each, and the items."""
    low, high = (
        np.floor((middle + side * (half + WIDER) + np.pi) * (BINS / FULL)).astype(np.int64) for side in (-1, 1)
    )
    count = np.minimum(high - low + 1, BINS)
    item = np.repeat(np.arange(len(count)), count)
    where = (np.repeat(low - np.cumsum(count) + count, count) + np.arange(len(item))) % BINS
    order = np.argsort(where, kind="stable")
    return np.searchsorted(where[order], np.arange(BINS + 1)), item[order]


class Surfaces(NamedTuple):
    """What lines may pass through."""

    triangles: Array  # (T, 3, 3)
    rounds: Array  # (R, 5) see Outline
    part: Counts  # (T + R,) the closed part that each belongs to

    def crossings(self, lattice: Lattice) -> tuple[Crossings, Counts]:
        """Where the lines along an axis cross the surfaces, and the closed part that each crossing belongs to."""
        order = axes_from(lattice.axis)
        triangles = np.ascontiguousarray(self.triangles[:, :, order])
        rounds = np.ascontiguousarray(self.rounds[:, [*order, 3, 4]])
        flat = core.cross_triangles(lattice, triangles)
        curved = core.cross_rounds(lattice, rounds)
        curved[:, 3] += len(triangles)
        found = np.concatenate([flat, curved])
        found = found[np.lexsort((found[:, 1], found[:, 0]))]
        first = np.searchsorted(found[:, 0], np.arange(lattice.lines + 1))
        at = np.ascontiguousarray(found[:, 1])
        weight = np.ascontiguousarray(found[:, 2])
        return Crossings(first, at, weight), self.part[found[:, 3].astype(np.int64)]


def solids(bodies: Vehicle) -> Surfaces:
    """The surfaces of the bodies whose insides are no part of a region, by their closed parts."""
    scene = bodies.scene
    triangles = [np.empty((0, 3, 3))]
    rounds = []
    rows = dict(scene.rounds)
    for index in (scene.names.index(name) for name in bodies.excluded):
        if index in rows:
            rounds.append(_round(rows[index]))
        else:
            triangles += [vertices[corners] for vertices, corners in connected_components(object_mesh(scene, index))]
    numbers = np.repeat(np.arange(len(triangles)), [len(part) for part in triangles])
    part = np.concatenate([numbers, len(triangles) + np.arange(len(rounds))])
    return Surfaces(np.concatenate(triangles), np.array(rounds).reshape(-1, 5), part)


def _round(item: Sphere | Cylinder) -> list[float]:
    if isinstance(item, Sphere):
        return [*item.center_m, item.radius_m, np.nan]
    return [*item.base_m, item.radius_m, item.height_m]


class Boundaries:
    """What bounds the sight of LiDARs, and the region; along whichever axis is asked for."""

    def __init__(self, region: Region, lidars: Sequence[Lidar], visibility: Visibility | None) -> None:
        self.lidars = lidars
        self.visibility = visibility
        self.solids = solids(region.cut.bodies) if region.cut else None
        if visibility:
            shape = outline(visibility.obstacles)
            self.surfaces = Surfaces(
                shape.triangles, shape.rounds, np.zeros(len(shape.triangles) + len(shape.rounds), np.int64)
            )
            self.edges = [silhouette(shape, one.position_m) for one in lidars]
            self.quadrics = [quadrics(shape, one, visibility) for one in lidars]

    def flips(self, lattice: Lattice, pool: ThreadPoolExecutor) -> Flips:
        """Where what LiDARs see of the lines along an axis changes, and where the lines enter and leave bodies."""
        count = lattice.lines
        chunks = [(begin, min(begin + CHUNK, count)) for begin in range(0, count, CHUNK)]
        always = Flipped(np.ones(count, np.bool_), Crossings(np.zeros(count + 1, np.int64), np.empty(0), np.empty(0)))
        rows = [always] * len(self.lidars)
        if visibility := self.visibility:
            surfaces, _ = self.surfaces.crossings(lattice)
            jobs = [
                (lattice, lines, bounds(edges, surface, one.position_m, lattice.axis), surfaces, one, visibility)
                for edges, surface, one in zip(self.edges, self.quadrics, self.lidars, strict=True)
                for lines in chunks
            ]
            rows = list(pool.map(lambda job: _changes(*job), jobs))
        if self.solids:
            surfaces, part = self.solids.crossings(lattice)
            start = np.empty(count, np.bool_)
            found = core.find_solid_flips(lattice, surfaces, part, int(part.max(initial=-1)) + 1, start)
            rows.append(Flipped(start, Crossings(*found)))
        else:
            rows.append(always)
        first = np.cumsum(np.concatenate([[0], *(np.diff(row.crossed.first) for row in rows)]))
        at, weight = (np.concatenate([getattr(row.crossed, name) for row in rows]) for name in ("at", "weight"))
        return Flips(np.concatenate([row.start for row in rows]).reshape(-1, count), first, at, weight)


def _changes(
    lattice: Lattice, lines: tuple[int, int], limits: Bounds, surfaces: Crossings, lidar: Lidar, visibility: Visibility
) -> Flipped:
    """Where it changes whether a LiDAR sees lines [lines[0], lines[1])."""
    found = Crossings(*core.find_candidates(lattice, lines, limits, surfaces))
    seen = visibility.seen_points(core.find_middles(lattice, lines, found), lidar)
    start = np.empty(lines[1] - lines[0], np.bool_)
    return Flipped(start, Crossings(*core.find_flips(found, seen, start)))
