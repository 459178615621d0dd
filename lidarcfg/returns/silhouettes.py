"""Silhouettes: the bodies' outlines as each sensor sees them, and where in their shadows an object may be hidden.

From each sensor, bodies throw shadows on level planes through an object's foot, middle and top. All sensors' shadows
cut a plane into parts; in a part, the same sensors are hidden everywhere. A grid may miss a narrow part, such as an
antenna's shadow, or where the shadows of two sensors cross. So places in the middle of narrow parts are looked at, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from lidarcfg.core import world
from lidarcfg.geometry import Array
from lidarcfg.returns.places import SPREAD
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.meshes import Mesh, cylinder_mesh, join_meshes, sphere_mesh
from lidarcfg.world.scene_file import Cylinder, Sphere
from lidarcfg.world.solids import merge_vertices
from lidarcfg.world.tracer import CYLINDER, SPHERE, TRIANGLE, Obstacles

ROUND_M = 1e-4  # tolerance of the facets that stand for spheres and cylinders
GRID_M = 1e-4  # to which shadows are rounded, so that lines meet, and last places of arcs do not count
CORE = 0.9  # of an object's width and height, that must be hidden: few beams hit its edges
HORIZON = (
    1e-5  # of the height between a plane and a sensor: what is no farther from the sensor's throws endless shadows
)
LEVEL_M = 0.01  # below a sensor is the plane that shows what hides its level beams
SHORT_M = 0.5  # a line of an outline; those of a fine mesh that are surely within its shadow are left out
BESIDE_M = 1e-3  # points on both sides of such a line
THIN_M = 1e-3  # narrower parts are due to rounding
SAME_M = 2e-3  # places that are nearer to each other are looked at once
WIDE_STEPS = 2  # of the grid: wider parts have places of the grid
MOST = 5000  # places, in the parts that are hidden from the most sensors

Bounds = tuple[float, float, float, float]  # from x, from y, to x, to y
Faces = NDArray[np.object_]  # polygons


@dataclass(frozen=True)
class Core:
    """An upright cylinder in an object, at any heading."""

    radius_m: float
    low_m: float  # heights of its ends in the vehicle frame
    high_m: float

    @classmethod
    def of(cls, width_m: float, height_m: float, ground_m: float) -> "Core":
        """That of an object with a least width and a height, on the ground."""
        margin_m = 0.5 * (1 - CORE) * height_m
        return cls(0.5 * CORE * width_m, ground_m + margin_m, ground_m + height_m - margin_m)

    def planes_m(self, sensor_m: float) -> tuple[float, float, float]:
        """The heights of foot, middle and top for a sensor at a height, which is not among them."""
        level_m = sensor_m - LEVEL_M
        middle_m = level_m if self.low_m < sensor_m < self.high_m else 0.5 * (self.low_m + self.high_m)
        low_m, high_m = (level_m if abs(end_m - sensor_m) < LEVEL_M else end_m for end_m in (self.low_m, self.high_m))
        return low_m, middle_m, high_m


def centres_of(mounts: Sequence[Mount]) -> Array:
    """(mounts, 3) the points from which the sensors' beams come, on average."""
    T = np.array([mount.T_vehicle_sensor for mount in mounts])
    up_m = np.array([mount.sensor.vertical_offset_m.mean() for mount in mounts])
    return np.asarray(T[:, :3, 3] + up_m[:, None] * T[:, :3, 2])


class Silhouettes:
    """The bodies among obstacles, and their silhouettes from any point."""

    def __init__(self, obstacles: Obstacles) -> None:
        self._obstacles = obstacles
        self._vertices, self._triangles = merge_vertices(_mesh_of(obstacles))
        a, b, c = (self._vertices[corner] for corner in self._triangles.T)
        self._normals = np.cross(b - a, c - a)
        ends = self._triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        self._ways = np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0)  # (3 T,) in which triangles run along their edges
        ends = np.sort(ends, axis=1)
        keys = ends[:, 0] * len(self._vertices) + ends[:, 1]
        _, first, number = np.unique(keys, return_index=True, return_inverse=True)
        self._edge_of = number.reshape(-1, 3)  # (T, 3) the edges of triangles
        self._edges = self._vertices[ends[first]]  # (E, 2, 3)

    def places(self, centres_m: Array, core: Core, area: BaseGeometry, step_m: float) -> Array:
        """(n, 2) places in an area where sensors at centres (S, 3) may see little of an object.

        They are in the middle of narrow parts of shadows, about a step apart along these.
        """
        if not len(self._triangles):
            return np.empty((0, 2))
        shadows = [[self.shadow(one, z_m, area.bounds) for z_m in core.planes_m(one[2])] for one in centres_m]
        layers = [*zip(*shadows, strict=True), [shapely.intersection_all(planes) for planes in shadows]]
        found = []
        for layer in layers:
            for radius_m in (0.0, core.radius_m):  # where the axis is hidden; where the whole width is
                parts, depths = _parts(shapely.buffer(layer, -radius_m, quad_segs=2), area)
                middles_m, of_part = _middles(parts, step_m)
                found.append(np.column_stack([middles_m, depths[of_part]]))
        x, y, depth = np.concatenate(found).T
        _, some = np.unique(np.rint(np.stack([-depth, x / SAME_M, y / SAME_M])), axis=1, return_index=True)
        some = some[np.lexsort(((SPREAD[0] * x[some] + SPREAD[1] * y[some]) / step_m % 1, -depth[some]))]
        return np.stack([x[some[:MOST]], y[some[:MOST]]], axis=1)

    def shadow(self, origin_m: Array, z_m: float, bounds: Bounds) -> BaseGeometry:
        """What bodies hide of a level plane from a point (3,), within bounds.

        The outlines' lines cut the plane into faces; a ray says whether one is hidden.
        """
        lines = self._outlines(origin_m, z_m)
        lines = lines[((lines.max(axis=1) >= bounds[:2]) & (lines.min(axis=1) <= bounds[2:])).all(axis=1)]
        lines = lines[(lines[:, 0] != lines[:, 1]).any(axis=1)]
        lines = lines[~self._are_within(lines, origin_m, z_m)]
        cut = shapely.clip_by_rect(shapely.linestrings(lines), *bounds)
        faces = _faces([*cut[~shapely.is_empty(cut)], shapely.box(*bounds).exterior])
        at_m = shapely.get_coordinates(shapely.point_on_surface(faces))
        return shapely.coverage_union_all(faces[self._hides(at_m, origin_m, z_m)])

    def _outlines(self, origin_m: Array, z_m: float) -> Array:
        """(n, 2, 2) lines on a level plane that bound the shadows of the bodies between it and a point (3,)."""
        facing = np.sign(((origin_m - self._vertices[self._triangles[:, 0]]) * self._normals).sum(axis=1))
        # Neighbours that both face the point, or both do not, run along their edge in opposite ways.
        net = np.bincount(self._edge_of.ravel(), self._ways * np.repeat(facing, 3), len(self._edges))
        way_m = z_m - origin_m[2]
        lines = _beyond(self._edges[net != 0], z_m, -way_m)
        lines = np.concatenate([_beyond(lines, origin_m[2] + HORIZON * way_m, way_m), self._section(z_m)])
        return np.asarray(origin_m[:2] + way_m / (lines[..., 2:] - origin_m[2]) * (lines[..., :2] - origin_m[:2]))

    def _section(self, z_m: float) -> Array:
        """(n, 2, 3) where a level plane cuts triangles."""
        height_m = self._edges[..., 2] - z_m
        crosses = (height_m[:, 0] > 0) != (height_m[:, 1] > 0)
        cut = self._edge_of[crosses[self._edge_of]]  # two edges of each triangle that is cut
        share = height_m[cut, 0] / (height_m[cut, 0] - height_m[cut, 1])
        a, b = self._edges[cut].swapaxes(0, 1)
        at_m = a + share[:, None] * (b - a)
        return np.asarray(at_m.reshape(-1, 2, 3))

    def _are_within(self, lines: Array, origin_m: Array, z_m: float) -> NDArray[np.bool_]:
        """(n,) which lines are short, and all around them is hidden."""
        way_m = lines[:, 1] - lines[:, 0]
        length_m = np.linalg.norm(way_m, axis=1)
        short = np.flatnonzero(length_m < SHORT_M)
        middle_m = lines[short].mean(axis=1)
        ahead_m = way_m[short]
        aside_m = np.stack([-ahead_m[:, 1], ahead_m[:, 0]], axis=1)
        beside_m = aside_m * (BESIDE_M / length_m[short])[:, None]
        around_m = np.stack([middle_m + off_m for one in (ahead_m, aside_m, beside_m) for off_m in (one, -one)])
        hidden = self._hides(around_m.reshape(-1, 2), origin_m, z_m).reshape(len(around_m), -1)
        within = np.zeros(len(lines), np.bool_)
        within[short] = hidden.all(axis=0)
        return within

    def _hides(self, at_m: Array, origin_m: Array, z_m: float) -> NDArray[np.bool_]:
        """(n,) whether bodies hide points (n, 2) of a level plane from a point (3,)."""
        ways_m = np.stack([*at_m.T, np.full(len(at_m), z_m)]) - origin_m[:, None]
        starts_m = np.ascontiguousarray(np.broadcast_to((origin_m - self._obstacles.origin_m)[:, None], ways_m.shape))
        hidden = np.empty(len(at_m), np.bool_)
        world.any_hits(self._obstacles.tree, starts_m, ways_m, hidden)
        return hidden


def _mesh_of(obstacles: Obstacles) -> Mesh:
    """The obstacles' triangles, and facets for their spheres and cylinders, in the vehicle frame."""
    tree = obstacles.tree
    corners = tree.shapes[tree.kind == TRIANGLE].reshape(-1, 3)
    meshes = [(corners, np.arange(len(corners)).reshape(-1, 3))]
    for shape in tree.shapes[tree.kind == SPHERE]:
        sphere = Sphere(name="sphere", reflectivity=0, center_m=tuple(shape[:3]), radius_m=shape[3])
        meshes.append(sphere_mesh(sphere, ROUND_M))
    for shape in tree.shapes[tree.kind == CYLINDER]:
        base_m = tuple(shape[:3])
        cylinder = Cylinder(name="cylinder", reflectivity=0, base_m=base_m, radius_m=shape[3], height_m=shape[4])
        meshes.append(cylinder_mesh(cylinder, ROUND_M))
    vertices, triangles = join_meshes(meshes)
    return vertices + obstacles.origin_m, triangles


def _beyond(lines: Array, z_m: float, way: float) -> Array:
    """(n, 2, 3) the parts of lines that are above a level plane, or below it if `way` is below 0."""
    height_m = (lines[..., 2] - z_m) * np.sign(way)
    some = (height_m > 0).any(axis=1)
    lines = lines[some].copy()
    height_m = height_m[some]
    beneath = height_m < 0
    cut = beneath.any(axis=1)
    share = height_m[cut, 0] / (height_m[cut, 0] - height_m[cut, 1])
    a, b = lines[cut].swapaxes(0, 1)
    lines[beneath] = a + share[:, None] * (b - a)
    return lines


def _faces(lines: Sequence[BaseGeometry]) -> Faces:
    """The faces between lines."""
    noded = shapely.union_all(lines, grid_size=GRID_M)
    return np.asarray(shapely.get_parts(shapely.polygonize(shapely.get_parts(noded))))


def _parts(regions: Faces, area: BaseGeometry) -> tuple[Faces, NDArray[np.intp]]:
    """The parts into which regions cut what they cover of an area, and in how many of them each is."""
    regions = regions[~shapely.is_empty(regions)]
    faces = _faces([*shapely.boundary(regions), area.boundary])
    x, y = shapely.get_coordinates(shapely.point_on_surface(faces)).T
    shapely.prepare(regions)
    depths = np.zeros(len(faces), np.intp)
    for region in regions:
        depths += shapely.contains_xy(region, x, y)
    some = (depths > 0) & shapely.contains_xy(area, x, y)
    return faces[some], depths[some]


def _middles(parts: Faces, step_m: float) -> tuple[Array, NDArray[np.intp]]:
    """(n, 2) the middles of parts' narrow cross-sections, about a step apart, and (n,) the numbers of the parts.

    Sections are along y of parts that are longer along x, and along x of the others.
    """
    low, high = shapely.bounds(parts).reshape(-1, 2, 2).swapaxes(0, 1)
    size = high - low
    along = size.argmax(axis=1)
    counts = np.maximum(np.ceil(size.max(axis=1, initial=0) / step_m), 1).astype(np.intp)
    part = np.repeat(np.arange(len(parts)), counts)
    number = np.arange(len(part)) - np.repeat(np.cumsum(counts) - counts, counts)
    ends = np.stack([low[part] - step_m, high[part] + step_m], axis=1)
    rows = np.arange(len(part))
    axis = along[part]
    ends[rows, :, axis] = (low[part, axis] + (number + 0.5) / counts[part] * size[part, axis])[:, None]
    sections, row = shapely.get_parts(shapely.intersection(parts[part], shapely.linestrings(ends)), return_index=True)
    width_m = shapely.length(sections)
    narrow = (width_m > THIN_M) & (width_m < WIDE_STEPS * step_m)
    middles_m = shapely.get_coordinates(shapely.line_interpolate_point(sections[narrow], 0.5, normalized=True))
    return middles_m, part[row[narrow]]
