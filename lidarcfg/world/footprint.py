"""Footprints, that is projections on the ground: of a vehicle's bodies and of objects, and distances between them."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.world.meshes import Mesh

GRID_M = 1e-6  # to which corners are rounded, so that neighbouring triangles join
FLAT_M2 = 1e-12  # a triangle that is smaller from above is upright
MANY_TRIANGLES = 20_000  # more are joined by their outlines only: some 10 times as fast, within 2 GRID_M
PLACE = np.dtype((np.void, 16))  # the bits of two int64


@dataclass(frozen=True)
class Footprint:
    """The union of a mesh's projections on the ground; concave outlines are kept, holes are filled."""

    shape: BaseGeometry  # polygons; lines or points where nothing has an area from above

    @classmethod
    def of(cls, mesh: Mesh) -> "Footprint":
        """The footprint of vertices (V, 3) and triangles (T, 3)."""
        corners = mesh[0][mesh[1]][:, :, :2]
        first = corners[:, 1] - corners[:, 0]
        second = corners[:, 2] - corners[:, 0]
        area_m2 = 0.5 * abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        solid = corners[area_m2 > FLAT_M2]
        if not len(solid):
            return cls(shapely.MultiPoint(corners.reshape(-1, 2)).convex_hull)
        if len(solid) > MANY_TRIANGLES:
            return cls(_filled(_bounding_edges(solid)))
        joined = shapely.union_all(shapely.polygons(solid), grid_size=GRID_M)
        outer = [shapely.Polygon(part.exterior) for part in shapely.get_parts(joined)]
        return cls(shapely.unary_union(outer))

    @cached_property
    def outlines_m(self) -> tuple[Array, ...]:
        """The corners (n, 2) of each part's outline; the first is repeated at the end."""
        return tuple(shapely.get_coordinates(part) for part in shapely.get_parts(self.shape))

    @cached_property
    def radius_m(self) -> float:
        """The greatest distance of a corner from the origin."""
        return float(np.linalg.norm(shapely.get_coordinates(self.shape), axis=1).max())

    @cached_property
    def inner_radius_m(self) -> float:
        """The greatest radius of a circle about the origin that it holds; 0 if it has none."""
        origin = shapely.Point(0.0, 0.0)
        holds = self.shape.area > 0 and self.shape.contains(origin)
        return float(shapely.distance(self.shape.boundary, origin)) if holds else 0.0

    @cached_property
    def bounds_m(self) -> tuple[Array, Array]:
        """(2,) each: the lower and the upper corner of the bounding box."""
        low_high = np.array(self.shape.bounds)
        return low_high[:2], low_high[2:]

    @property
    def middle_m(self) -> Array:
        """(2,) the middle of the bounding box."""
        low, high = self.bounds_m
        return np.asarray((low + high) / 2)

    def to_points_m(self, points_m: Array) -> Array:
        """(P,) distances of points (P, 2); 0 inside."""
        return np.asarray(shapely.distance(self.shape, shapely.points(points_m)))

    def to_objects_m(self, footprint: "Footprint", places: Array) -> Array:
        """(P,) distances of an object's footprint at places (P, 4): x, y, z, heading in radians; 0 where they meet."""
        return np.asarray(np.linalg.norm(self.ways_to_objects_m(footprint, places), axis=1))

    def ways_to_objects_m(self, footprint: "Footprint", places: Array) -> Array:
        """(P, 2) the shortest ways from it to an object's footprint at places (P, 4); 0 where they meet."""
        shortest = np.full((len(places), 2), np.inf)
        for parts in footprint._standing(places):
            ends = shapely.get_coordinates(shapely.shortest_line(self.shape, parts)).reshape(-1, 2, 2)
            way = ends[:, 1] - ends[:, 0]
            nearer = np.linalg.norm(way, axis=1) < np.linalg.norm(shortest, axis=1)
            shortest[nearer] = way[nearer]
        return shortest

    def are_beside(self, least_m: float, most_m: float, footprint: "Footprint", places: Array) -> NDArray[np.bool_]:
        """(P,) whether an object's footprint at places (P, 4) is farther than `least_m` and no farther than `most_m`.

        It takes a tenth of the time of the distances.
        """
        near = np.zeros(len(places), np.bool_)
        within = np.zeros(len(places), np.bool_)
        shapely.prepare(self._prepared)
        for parts in footprint._standing(places):
            near |= shapely.dwithin(self._prepared, parts, least_m)
            within |= shapely.dwithin(self._prepared, parts, most_m)
        return within & ~near

    @cached_property
    def _prepared(self) -> BaseGeometry:
        """A copy of the shape, as what is prepared has other last places of distances."""
        return shapely.from_wkb(shapely.to_wkb(self.shape))

    def _standing(self, places: Array) -> Iterator[NDArray[np.object_]]:
        """For each part of the shape, (P,) what it is at places (P, 4)."""
        if not len(places):
            return
        cos, sin = maths.cos(places[:, 3:]), maths.sin(places[:, 3:])  # (P, 1)
        for outline in self.outlines_m:
            x, y = outline.T
            corners = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + places[:, None, :2]
            made = shapely.polygons(corners) if len(outline) > 3 else shapely.linestrings(corners)
            yield np.asarray(made)


def _bounding_edges(corners: Array) -> Array:
    """(E, 2, 2) the edges of triangles (T, 3, 2) that may bound their union: no triangle lies on one side of them."""
    places = np.rint(corners.reshape(-1, 2) / GRID_M).astype(np.int64)
    number = np.unique(places.view(PLACE)[:, 0], return_inverse=True)[1].reshape(-1, 3)
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    left = first[:, 0] * second[:, 1] > first[:, 1] * second[:, 0]
    start, end = number, np.roll(number, -1, axis=1)
    edge = (np.minimum(start, end) * (number.max() + 1) + np.maximum(start, end)).ravel()
    side = (left[:, None] == (start < end)).ravel()
    one_sided = np.setxor1d(edge[side], edge[~side])
    edges, at = np.unique(edge, return_index=True)
    triangle, corner = np.divmod(at[np.searchsorted(edges, one_sided)], 3)
    return np.stack([corners[triangle, corner], corners[triangle, (corner + 1) % 3]], axis=1)


def _filled(edges: Array) -> BaseGeometry:
    """What edges (E, 2, 2) enclose: all that cannot be reached from outside without crossing one."""
    lines = shapely.union_all(shapely.linestrings(edges), grid_size=GRID_M)
    frame = shapely.box(*lines.bounds).buffer(1.0, join_style="mitre")
    faces = shapely.get_parts(shapely.polygonize([lines, frame.exterior]))
    outside = max(faces, key=lambda face: shapely.Polygon(face.exterior).area)
    return shapely.unary_union([shapely.Polygon(ring) for ring in outside.interiors])
