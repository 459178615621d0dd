"""The trees of numba's loops that are not ported yet. To be deleted with the last of them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.world.bvh import EMPTY, NO_TREE, Tree, build
from lidarcfg.world.motion import MotionPath
from lidarcfg.world.motion_kernels import ARC, POSES, STANDING, VELOCITY, Paths
from lidarcfg.world.scene import Scene
from lidarcfg.world.tracer import CYLINDER, SPHERE, TRIANGLE, Dynamic, Tracer, shapes_of
from lidarcfg.world.world_kernels import Dynamics, World


def numba_world(tracer: Tracer) -> World:
    """What rays of a tracer may hit."""
    if "_numba_world" not in tracer.__dict__:
        scene, moving = tracer.scene, np.zeros(len(tracer.scene.names), np.bool_)
        moving[[one.object for one in tracer.dynamic]] = True
        ground = scene.file.ground
        tracer.__dict__["_numba_world"] = World(
            ground_m=ground.z_m - float(tracer.origin_m[2]) if ground else np.inf,
            static=tree(scene, ~moving, tracer.origin_m),
            dynamic=_dynamics(scene, tracer.dynamic, tracer.origin_m),
        )
    world: World = tracer.__dict__["_numba_world"]
    return world


def obstacles(scenes: Sequence[Scene], origin_m: Array) -> Tree:
    """The tree over the static objects of scenes, relative to a point (3,)."""
    if not scenes:
        return NO_TREE
    columns = []
    for scene in scenes:
        static = np.array([motion is None for motion in scene.motions])
        columns.append(shapes_of(scene, static, origin_m))
    shapes, kind, number, objects = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    return build(shapes.ravel(), kind, number, objects)


def tree(scene: Scene, which: NDArray[np.bool_], origin_m: Array) -> Tree:
    """The tree over some of a scene's objects (objects,), relative to a point (3,)."""
    shapes, kind, number, objects = shapes_of(scene, which, origin_m)
    return build(shapes.ravel(), kind, number, objects)


def packed(paths: Sequence[MotionPath]) -> Paths:
    """Motions as one table."""
    kinds, values = [], np.zeros((len(paths), 3))
    for i, path in enumerate(paths):
        motion = path.motion
        if motion.arc:
            kinds.append(ARC)
            values[i] = motion.arc.speed_m_s, *np.radians([motion.arc.yaw_rate_deg_s, motion.arc.heading_deg])
        elif motion.velocity_m_s is not None:
            kinds.append(STANDING if path.is_static else VELOCITY)
            values[i] = motion.velocity_m_s
        else:
            kinds.append(POSES)
    return Paths(
        kind=np.array(kinds, np.uint8),
        values=values,
        first=np.cumsum([0, *(len(path.times_s) for path in paths)], dtype=np.int64),
        times_s=np.concatenate([np.empty(0), *(path.times_s for path in paths)]),
        positions_m=np.concatenate([np.empty((0, 3)), *(path.positions_m for path in paths)]),
        rotations=np.concatenate([np.empty((0, 3, 3)), *(path.rotations for path in paths)]),
        rotation_vectors_rad=np.concatenate([np.empty((0, 3)), *(path.rotation_vectors_rad for path in paths)]),
    )


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
