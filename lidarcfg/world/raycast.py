"""How far each ray gets: the ground in closed form, all else by its triangles, in a local frame.

Which triangle a ray meets, triangles.py says; how far away it is, is the triangle's plane's to say, in float64.
What stands still is built once. What moves is built once in a frame of its own, and rays are cast in that frame.
"""

from dataclasses import dataclass
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS
from lidarcfg.world.kernels import NOTHING, Nearest, Rays, bounds, ground, local_rays, of_objects
from lidarcfg.world.motion import Path3, prepared
from lidarcfg.world.scene import Scene
from lidarcfg.world.sights import Sights, settled
from lidarcfg.world.triangles import Triangles
from lidarcfg.world.turns import Turns

LOCAL_M = 1000.0  # at so much from a local origin a float32 steps by 0.06 mm
PARTS_MAX = 4  # local origins kept at a time, as a rig may stand across their borders

Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]


class Hits(NamedTuple):
    """What N rays meet first."""

    range_m: Array  # (N,) inf: nothing
    reflectivity: NDArray[np.uint8]  # (N,) 0: nothing
    object: NDArray[np.int32]  # (N,) -1: nothing
    normal: NDArray[np.float32]  # (N, 3) of the surface, towards either side; 0: nothing; (0, 3): not asked for
    settled: int  # so many were not cast at what stands still, as their lists told what they meet of it


class Listed(NamedTuple):
    """Which lists of triangles are those of N rays."""

    which: NDArray[np.int32]  # (N,)
    sights: Sights


@dataclass(frozen=True)
class Mover:
    """An object that moves: a ball around its place holds it whichever way it turns."""

    object: int
    path: Path3
    place_m: Array  # (3,) at time 0
    radius_m: float
    part: Triangles  # relative to the place


class Raycaster:
    """A scene to cast rays in, near `origin_m` (3,) of the world; what moves has its time 0 at `zero_ns`.

    Coordinates relative to a local origin, the nearest of a grid of `LOCAL_M` about that point, are taken in float64
    and only then rounded to float32.
    """

    def __init__(self, scene: Scene, origin_m: Array, zero_ns: int = 0) -> None:
        self.scene, self.turns = scene, Turns()
        self.movers = tuple(_mover(scene, index, self.turns) for index, motion in enumerate(scene.motion) if motion)
        self.zero_ns = zero_ns
        moving = np.isin(scene.triangle_object, [mover.object for mover in self.movers])
        self.still_triangles = scene.triangles[~moving]  # (T, 3) indices of the scene's vertices
        self._still_object = scene.triangle_object[~moving]
        self._origin_m = np.array(origin_m, np.float64)
        self._parts: dict[bytes, Triangles] = {}
        self._lock = Lock()

    def _cells(self, origins_m: Array, pick: Rows) -> list[tuple[Array, Rows]]:
        """The cells (3,) about local origins from which the rays `pick` (M,) of (N, 3) start, and which start there.

        Each ray has its own, so that what it meets does not depend on which are cast together.
        """
        low, high = np.rint((bounds(origins_m, pick) - self._origin_m) / LOCAL_M) + 0.0  # which makes 0 of -0
        if (low == high).all():
            return [(low, pick)]
        cells = np.rint((origins_m[pick] - self._origin_m) / LOCAL_M) + 0.0
        found, which = np.unique(cells, axis=0, return_inverse=True)
        return [(cell, pick[which.ravel() == i]) for i, cell in enumerate(found)]

    def _local(self, cell: Array) -> tuple[Array, Triangles]:
        """The local origin of a cell (3,), and what stands still, relative to it."""
        origin_m = self._origin_m + cell * LOCAL_M
        key = cell.tobytes()
        with self._lock:  # threads cast together
            if key not in self._parts:
                if len(self._parts) == PARTS_MAX:
                    del self._parts[next(iter(self._parts))]
                vertices_m = self.scene.vertices_m - origin_m
                self._parts[key] = Triangles(vertices_m, self.still_triangles, self._still_object, self.turns)
            return origin_m, self._parts[key]

    def cast(
        self,
        origins_m: Array,
        directions: Array,
        time_ns: NDArray[np.int64] | None = None,
        may_meet: Mask | None = None,
        normals: bool = False,
        at: Rows | None = None,
        total: int | None = None,
        listed: Listed | None = None,
    ) -> Hits:
        """Rays (N, 3) from points of the world along unit vectors at times (N,): what each meets first.

        Without times everything stands where it does at time 0. `may_meet` (2 + movers, N) says which rays can
        meet the ground, what stands still, and each mover; the others are not cast. Normals come only if asked for.
        With `at` (N,) these are some of `total` rays, the others of which meet nothing. Rays that are `listed` are
        not cast at what stands still if their list settles what they meet.
        Raises ConfigError outside timed poses.
        """
        count = len(directions)
        at, total = np.arange(count) if at is None else at, count if total is None else total
        nearest = Nearest(
            range_m=np.full(total, np.inf),
            object=np.full(total, NOTHING, np.int32),
            normal=np.zeros((total if normals else 0, 3), np.float32),
        )
        rays = Rays(origins_m, directions, at)
        masks = np.ones((2 + len(self.movers), count), np.bool_) if may_meet is None else may_meet
        if self.scene.file.ground:
            ground(rays, masks[0], self.scene.file.ground.z_m, nearest)
        still = np.flatnonzero(masks[1])
        few = 0
        for cell, some in self._cells(origins_m, still) if len(still) and len(self.still_triangles) else []:
            local_m, part = self._local(cell)
            left = settled(rays, some, *listed, local_m, part.facets, nearest) if listed else some
            few += len(some) - len(left)
            part.cast(rays, left, local_m, np.eye(3)[None], nearest)
        for mover, mask in zip(self.movers, masks[2:], strict=True):
            which = np.flatnonzero(mask)
            if len(which):
                seconds = np.zeros(len(which)) if time_ns is None else (time_ns[which] - self.zero_ns) / SECOND_NS
                R, t = mover.path.at(seconds)
                start_m, along = local_rays(origins_m, directions, which, R, mover.place_m + t)
                mover.part.cast(Rays(start_m, along, at[which]), np.arange(len(which)), np.zeros(3), R, nearest)
        reflectivity = of_objects(self.scene.reflectivity, nearest.object)
        return Hits(nearest.range_m, reflectivity, nearest.object, nearest.normal, few)


def _mover(scene: Scene, index: int, turns: Turns) -> Mover:
    motion, place_m = scene.motion[index], scene.place_m[index]
    assert motion is not None
    triangles = scene.triangles[scene.triangle_object == index]
    used, local = np.unique(triangles, return_inverse=True)
    vertices = scene.vertices_m[used] - place_m
    radius_m = float(np.linalg.norm(vertices, axis=1).max())
    part = Triangles(vertices, local.reshape(-1, 3), np.full(len(triangles), index, np.int32), turns)
    return Mover(index, prepared(motion), place_m, radius_m, part)
