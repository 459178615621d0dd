"""Traces rays in a scene: what they hit first, and at which range, in float64.

Ground, spheres and cylinders are hit in closed form, everything else by its triangles.

All static objects share one bounding volume hierarchy, built once. Each dynamic object has one in its own frame; a ray
is transformed into that frame at its own time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS
from lidarcfg.world.bvh import CYLINDER, EMPTY, NO_TREE, SPHERE, TRIANGLE, Tree, build, corners
from lidarcfg.world.motion import MotionPath, packed, prepared
from lidarcfg.world.ray_kernels import NONE, new_packet
from lidarcfg.world.scene import Cylinder, Scene, Sphere
from lidarcfg.world.tracer_kernels import blocked
from lidarcfg.world.world_kernels import NOTHING, Dynamics, Found, World, cast, resolve


class Hits(NamedTuple):
    """The first hits of N rays."""

    range_m: Array  # (N,) inf: nothing
    object: NDArray[np.int32]  # (N,) -1: nothing
    triangle: NDArray[np.int32]  # (N,) the scene's; -1: nothing, the ground, a sphere or a cylinder
    normal: Array  # (N, 3) of the surface, towards either side; 0: nothing


@dataclass(frozen=True)
class Dynamic:
    """A dynamic object."""

    object: int
    path: MotionPath


class Tracer:
    """Traces rays in a scene; fastest near `origin_m` (3,) of the world. `zero_ns` is time 0 of its motions."""

    def __init__(self, scene: Scene, origin_m: Array, zero_ns: int = 0) -> None:
        self.scene, self.zero_ns = scene, zero_ns
        self.origin_m = np.array(origin_m, np.float64)
        self.dynamic = tuple(Dynamic(i, prepared(motion)) for i, motion in enumerate(scene.motions) if motion)
        moving = np.zeros(len(scene.names), np.bool_)
        moving[[one.object for one in self.dynamic]] = True
        ground = scene.file.ground
        self.world = World(
            ground_m=ground.z_m - float(self.origin_m[2]) if ground else np.inf,
            static=tree(scene, ~moving, self.origin_m),
            dynamic=_dynamics(scene, self.dynamic, self.origin_m),
        )

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
        found = Found(np.full(count, np.inf), np.full(count, NONE, np.int32), np.zeros((count, 3)), np.empty(0))
        if count:
            seconds = np.zeros(count) if time_ns is None else (time_ns - self.zero_ns) / SECOND_NS
            self.check_span(float(seconds.min()), float(seconds.max()))
            starts, along = (np.ascontiguousarray(rows.T) for rows in (origins_m - self.origin_m, directions))
            cast(self.world, starts, along, seconds, limit_m, found)
        objects, triangles = np.empty(count, np.int32), np.empty(count, np.int32)
        resolve(self.world, found.slot, objects, triangles)
        return Hits(found.range_m, objects, triangles, found.normal)

    def blocked(self, origins_m: Array, targets_m: Array) -> NDArray[np.bool_]:
        """(N,) whether any static object but the ground is between pairs of points (N, 3), ends excluded."""
        origins = np.broadcast_to(origins_m, targets_m.shape).T
        starts = np.ascontiguousarray(origins - self.origin_m[:, None])
        out = np.empty(len(targets_m), np.bool_)
        blocked(self.world.static, new_packet(0), starts, np.ascontiguousarray(targets_m.T - origins), len(out), out)
        return out

    def check_span(self, first_s: float, last_s: float) -> None:
        """Raises ConfigError unless all dynamic objects have a pose at these times."""
        for one in self.dynamic:
            one.path.check_span(first_s, last_s, f"{self.scene.names[one.object]}: ")


def tree(scene: Scene, which: NDArray[np.bool_], origin_m: Array) -> Tree:
    """The tree over some of a scene's objects (objects,), relative to a point (3,)."""
    return build(*shapes_of(scene, which, origin_m))


def shapes_of(
    scene: Scene, which: NDArray[np.bool_], origin_m: Array
) -> tuple[Array, NDArray[np.uint8], NDArray[np.int32], NDArray[np.int32]]:
    """The shapes of some of a scene's objects, relative to a point (3,): see Tree for the four columns."""
    triangles = np.flatnonzero(which[scene.triangle_object]).astype(np.int32)
    rounds = [(i, item) for i, item in scene.rounds if which[i]]
    shapes = np.zeros(9 * (len(triangles) + len(rounds)))
    corners(scene.vertices_m, scene.triangles, triangles, np.asarray(origin_m), shapes)
    kind = np.full(len(triangles) + len(rounds), TRIANGLE, np.uint8)
    for s, (_, item) in enumerate(rounds, len(triangles)):
        kind[s] = SPHERE if isinstance(item, Sphere) else CYLINDER
        shapes[9 * s : 9 * s + 5] = _round(item, origin_m)
    number = np.concatenate([triangles, np.full(len(rounds), NOTHING, np.int32)])
    objects = np.concatenate([scene.triangle_object[triangles], np.array([i for i, _ in rounds], np.int32)])
    return shapes, kind, number, objects


def _round(item: Sphere | Cylinder, origin_m: Array) -> Array:
    """(5,) place, radius, and a cylinder's height."""
    if isinstance(item, Sphere):
        return np.array([*(item.center_m - origin_m), item.radius_m, 0.0])
    return np.array([*(item.base_m - origin_m), item.radius_m, item.height_m])


def _dynamics(scene: Scene, dynamic: Sequence[Dynamic], origin_m: Array) -> Dynamics:
    """All trees of dynamic objects in one table."""
    trees, roots, first, node = [NO_TREE], [], 0, 0
    which = np.zeros(len(scene.names), np.bool_)
    for one in dynamic:
        which[:] = False
        which[one.object] = True
        part = tree(scene, which, scene.places_m[one.object])
        codes = np.append(part.children, part.root)
        codes = np.where(codes < 0, codes - 4 * first, codes + node).astype(np.int32)
        roots.append(codes[-1])
        trees.append(part._replace(children=codes[:-1]))
        first, node = first + len(part.kind), node + len(part.children) // 2
    columns = [np.concatenate(parts) for parts in zip(*(part[1:] for part in trees), strict=True)]
    paths = [one.path for one in dynamic]
    return Dynamics(
        trees=Tree(EMPTY, *columns),
        owner=np.repeat(np.arange(len(dynamic), dtype=np.int32), [len(part.kind) for part in trees[1:]]),
        roots=np.array(roots, np.int32),
        places_m=np.array([scene.places_m[one.object] - origin_m for one in dynamic]).reshape(-1, 3),
        radius_m=np.array([_radius_m(part) for part in trees[1:]]),
        speed_m_s=np.array([path.speed_max_m_s for path in paths]),
        paths=packed(paths),
    )


def _radius_m(part: Tree) -> float:
    """The radius of a tree's bounding sphere around the origin."""
    shapes = part.shapes.reshape(-1, 9)
    flat, heights = shapes[part.kind == TRIANGLE].reshape(-1, 3), shapes[part.kind == CYLINDER]
    far = [
        np.linalg.norm(flat, axis=1),
        np.linalg.norm(shapes[part.kind == SPHERE][:, :3], axis=1) + shapes[part.kind == SPHERE][:, 3],
    ]
    far.append(np.hypot(np.hypot(heights[:, 0], heights[:, 1]) + heights[:, 3], abs(heights[:, 2]) + heights[:, 4]))
    return float(np.concatenate(far).max(initial=0.0))
