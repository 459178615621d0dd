"""The parts of a scene that move as one: all that is static, and each dynamic object."""

from dataclasses import dataclass, replace

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS
from lidarcfg.world.meshes import Mesh, join_meshes
from lidarcfg.world.motion import MotionPath, build_path, rotate
from lidarcfg.world.scene import NO_MESH, Scene


@dataclass(frozen=True)
class Part:
    """What of a scene moves as one."""

    mesh: Mesh  # in the world's axes, about its place
    place_m: Array  # (3,) at time 0
    path: MotionPath | None = None  # None: static

    def poses(self, seconds: Array) -> tuple[Array, Array]:
        """R (n or 1, 3, 3) and t (n or 1, 3) in the world; before and after timed poses the nearest of them."""
        if self.path is None:
            return np.eye(3)[None], self.place_m[None]
        covered = np.clip(seconds, *self.path.times_s[[0, -1]]) if len(self.path.times_s) else seconds
        R, t = self.path.at(covered)
        return R, self.place_m + t


def parts(scene: Scene) -> list[Part]:
    """What is static, and then each dynamic object; the ground is none of them."""
    file = scene.file
    moves = np.array([motion is not None for motion in scene.motions])
    rest = {"spheres": _static(file.spheres), "cylinders": _static(file.cylinders)}
    of_rest = scene.triangles[~moves[scene.triangle_object]]
    static = replace(scene, file=file.model_copy(update=rest), triangles=of_rest).mesh()
    found = [Part(_compact(static), np.zeros(3))] if len(static[1]) else []
    rounds = dict(scene.rounds)
    for i in np.flatnonzero(moves).tolist():
        item = rounds.get(i)
        motion = scene.motions[i]
        alone = {"spheres": (), "cylinders": ()} | ({f"{type(item).__name__.lower()}s": (item,)} if item else {})
        one = replace(scene, file=file.model_copy(update=alone), triangles=scene.triangles[scene.triangle_object == i])
        vertices, triangles = _compact(one.mesh())
        assert motion
        found.append(Part((vertices - scene.places_m[i], triangles), scene.places_m[i], build_path(motion)))
    return found


def mesh_at(scene: Scene, since_ns: int) -> Mesh:
    """All objects but the ground, where they are so long after the scene's start, in the world."""
    seconds = np.array([since_ns / SECOND_NS])
    found = [NO_MESH]
    for part in parts(scene):
        R, t = part.poses(seconds)
        found.append((rotate(R[:1], part.mesh[0]) + t[0], part.mesh[1]))
    return join_meshes(found)


def _static(items: tuple) -> tuple:  # type: ignore[type-arg]  # of any kind of object
    return tuple(item for item in items if item.motion is None)


def _compact(mesh: Mesh) -> Mesh:
    """The mesh without the vertices that it does not use."""
    used, index = np.unique(mesh[1], return_inverse=True)
    return mesh[0][used], index.reshape(-1, 3)
