"""Obstacles, and rays traced in a scene: what they hit first, and at which range, in float64.

Ground, spheres and cylinders are hit in closed form, everything else by its triangles.

All static objects share one bounding volume hierarchy, built once. Each dynamic object has one in its own frame; a ray
is transformed into that frame at its own time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import world
from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import MotionPath, build_path
from lidarcfg.world.scene import Scene
from lidarcfg.world.scene_file import Cylinder, Sphere

_NO_INDEX = np.empty(0, np.int32)
TRIANGLE, SPHERE, CYLINDER = range(3)  # kinds of shapes
NO_SLOT = -2
NO_OBJECT = -1  # nothing; the ground is object 0
Shapes = tuple[Array, NDArray[np.uint8], NDArray[np.int32], NDArray[np.int32]]  # and kinds, numbers, objects
NO_SHAPES: Shapes = np.empty((0, 9)), np.empty(0, np.uint8), np.empty(0, np.int32), np.empty(0, np.int32)


Obstacles = world.Obstacles  # what blocks beams, relative to a point


def obstacles_of(tree: world.Bvh, origin_m: Array, ground_m: float = np.inf) -> Obstacles:
    """The shapes of a hierarchy that is relative to a point (3,) of the vehicle frame, and the ground; inf: none."""
    return Obstacles(tree=tree, boxes=world.boxes_of(tree), origin_m=origin_m, ground_m=ground_m)


NO_OBSTACLES = obstacles_of(world.Bvh(*NO_SHAPES), np.zeros(3))


class Hits(NamedTuple):
    """The first hits of N rays."""

    range_m: Array  # (N,) inf: nothing
    object: NDArray[np.int32]  # (N,) -1: nothing
    triangle: NDArray[np.int32]  # (N,) the scene's; -1: nothing, the ground, a sphere or a cylinder
    normal: Array  # (N, 3) of the surface, towards either side; 0: nothing


@dataclass(frozen=True)
class Dynamic:
    """An object that moves: its index in the scene, and its path."""

    object: int
    path: MotionPath


class Tracer:
    """Traces rays in a scene; fastest near `origin_m` (3,) of the world. `zero_ns` is time 0 of its motions."""

    def __init__(self, scene: Scene, origin_m: Array, zero_ns: int = 0) -> None:
        self.scene = scene
        self.zero_ns = zero_ns
        self.origin_m = np.array(origin_m, np.float64)
        self.dynamic = tuple(Dynamic(i, build_path(motion)) for i, motion in enumerate(scene.motions) if motion)
        moving = np.zeros(len(scene.names), np.bool_)
        moving[[one.object for one in self.dynamic]] = True
        ground = scene.file.ground
        objects = [one.object for one in self.dynamic]
        self.world = world.World(
            ground_m=ground.z_m - float(self.origin_m[2]) if ground else np.inf,
            fixed=build_bvh(scene, ~moving, self.origin_m),
            moving=[build_bvh(scene, np.arange(len(moving)) == i, scene.places_m[i]) for i in objects],
            places_m=np.array([scene.places_m[i] - self.origin_m for i in objects]).reshape(-1, 3),
            speeds_m_s=self._speeds_m_s(),
            paths=[one.path.compiled for one in self.dynamic],
        )

    def __reduce__(self) -> tuple[type["Tracer"], tuple[Scene, Array, int]]:
        return Tracer, (self.scene, self.origin_m, self.zero_ns)

    def along(self, paths: Mapping[int, MotionPath], zero_ns: int) -> "Tracer":
        """This tracer where dynamic objects, by their indices, follow other paths, and time 0 is another.

        Hierarchies are shared, so it costs next to nothing.
        """
        moved = object.__new__(Tracer)  # `copy` would build hierarchies, as unpickling does
        vars(moved).update(vars(self))
        moved.zero_ns = zero_ns
        moved.dynamic = tuple(Dynamic(one.object, paths.get(one.object, one.path)) for one in self.dynamic)
        moved.world = self.world.along(moved._speeds_m_s(), [one.path.compiled for one in moved.dynamic])
        return moved

    def _speeds_m_s(self) -> Array:
        return np.array([one.path.speed_max_m_s for one in self.dynamic], np.float64)

    def cast(
        self,
        origins_m: Array,
        directions: Array,
        time_ns: NDArray[np.int64] | None = None,
        limit_m: float = np.inf,
    ) -> Hits:
        """The first hits, within a limit, of rays from points (N, 3) of the world along unit vectors at times (N,).

        Without times, all objects are where they are at time 0. Raises ConfigError outside timed poses.
        """
        count = len(directions)
        found = world.Found(
            range_m=np.full(count, np.inf),
            slot=np.full(count, NO_SLOT, np.int32),
            normal=np.zeros((count, 3)),
            cosine=np.empty(0),
        )
        if count:
            seconds = np.zeros(count) if time_ns is None else (time_ns - self.zero_ns) / SECOND_NS
            self.check_span(float(seconds.min()), float(seconds.max()))
            starts, along = (np.ascontiguousarray(rows.T) for rows in (origins_m - self.origin_m, directions))
            self.world.cast(starts, along, seconds, limit_m, found)
        objects, triangles = self.world.resolve(found.slot)
        return Hits(found.range_m, objects, triangles, found.normal)

    def blocked(self, origins_m: Array, targets_m: Array) -> NDArray[np.bool_]:
        """(N,) whether any static object but the ground is between pairs of points (N, 3), ends excluded."""
        origins = np.broadcast_to(origins_m, targets_m.shape).T
        starts = np.ascontiguousarray(origins - self.origin_m[:, None])
        out = np.empty(len(targets_m), np.bool_)
        world.any_hits(self.world.fixed, starts, np.ascontiguousarray(targets_m.T - origins), out)
        return out

    def check_span(self, first_s: float, last_s: float) -> None:
        """Raises ConfigError unless all dynamic objects have a pose at these times."""
        for one in self.dynamic:
            one.path.check_span(first_s, last_s, f"{self.scene.names[one.object]}: ")


def build_bvh(scene: Scene, which: NDArray[np.bool_], origin_m: Array) -> world.Bvh:
    """The hierarchy over some of a scene's objects (objects,), relative to a point (3,)."""
    return world.Bvh(*shapes_of(scene, which, origin_m))


def shapes_of(scene: Scene, which: NDArray[np.bool_], origin_m: Array) -> Shapes:
    """Shapes (S, 9), kinds, numbers and objects of some of a scene's objects, relative to a point (3,), as Bvh has it.

    A triangle is three corners, a sphere centre and radius, an upright cylinder base, radius and height.
    """
    triangles = np.flatnonzero(which[scene.triangle_object]).astype(np.int32)
    rounds = [(i, item) for i, item in scene.rounds if which[i]]
    shapes = np.zeros((len(triangles) + len(rounds), 9))
    shapes[: len(triangles)] = (scene.vertices_m[scene.triangles[triangles]] - origin_m).reshape(-1, 9)
    kind = np.full(len(shapes), TRIANGLE, np.uint8)
    for s, (_, item) in enumerate(rounds, len(triangles)):
        kind[s] = SPHERE if isinstance(item, Sphere) else CYLINDER
        shapes[s, :5] = _round(item, origin_m)
    number = np.concatenate([triangles, np.full(len(rounds), NO_OBJECT, np.int32)])
    objects = np.concatenate([scene.triangle_object[triangles], np.array([i for i, _ in rounds], np.int32)])
    return shapes, kind, number, objects


def _round(item: Sphere | Cylinder, origin_m: Array) -> Array:
    """(5,) place, radius, and a cylinder's height."""
    if isinstance(item, Sphere):
        return np.array([*(item.center_m - origin_m), item.radius_m, 0.0])
    return np.array([*(item.base_m - origin_m), item.radius_m, item.height_m])
