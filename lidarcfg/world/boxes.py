"""The boxes of a scene's dynamic objects, and of objects whose category has boxes in data sets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, product, rotated, rotation
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import MotionPath, build_path
from lidarcfg.world.scene import Scene
from lidarcfg.world.scene_file import DATASET_NAMES, Box, Cylinder, Ground, Plane, SceneObject, Sphere


@dataclass(frozen=True)
class BoxedObject:
    """An object with a box that moves and rotates with it."""

    index: int  # of the scene's objects
    name: str
    category: str | None
    path: MotionPath | None  # None: it is static
    place_m: Array  # (3,) about which it rotates
    center_m: Array  # (3,) of the box at rest
    size_m: Array  # (3,) along its own axes
    R: Array  # (3, 3) at rest

    def pose(self, seconds: float) -> Array:
        """T_world_box (4, 4) at a time since the scene's time 0. Raises ConfigError outside timed poses."""
        T = np.eye(4)
        T[:3, :3] = self.R
        T[:3, 3] = self.center_m
        if self.path:
            R, t = (values[0] for values in self.path.at(np.array([seconds])))
            T[:3, :3] = product(R, self.R)
            T[:3, 3] = self.place_m + t + rotated(R, (self.center_m - self.place_m)[None])[0]
        return T


@dataclass(frozen=True)
class Boxes:
    """The boxes of N objects, each at the mean time of its returns in a scan, so that it encloses its points."""

    objects: tuple[BoxedObject, ...]
    time_ns: NDArray[np.int64]  # (N,)
    T_world_box: Array  # (N, 4, 4)
    returns: NDArray[np.int64]  # (N,) in the scan

    def with_returns(self) -> "Boxes":
        """The boxes of objects that were hit."""
        hit = np.flatnonzero(self.returns)
        return Boxes(tuple(self.objects[i] for i in hit), self.time_ns[hit], self.T_world_box[hit], self.returns[hit])


def boxed_objects(scene: Scene) -> tuple[BoxedObject, ...]:
    """The objects with boxes, in the scene's order."""
    found = []
    for index, item in enumerate(scene.items):
        if isinstance(item, Ground):
            continue
        if item.motion is None and (item.category is None or not DATASET_NAMES[item.category].kitti):
            continue
        path = build_path(item.motion) if item.motion else None
        shape = _box_of(item, scene, index)
        found.append(BoxedObject(index, item.name, item.category, path, scene.places_m[index], *shape))
    return tuple(found)


def lack_of_categories(scene: Scene) -> str | None:
    """What to say where a scene's ground truth is asked for and no object with a box has a category."""
    if any(one.category for one in boxed_objects(scene)):
        return None
    names = ", ".join(str(name) for name, one in DATASET_NAMES.items() if name and one.kitti)
    return (
        f"{scene.file.name}: no object has a category, so data sets know no cars and no people; write "
        f"`category: car` into an object of the scene's file (allowed for boxes: {names})"
    )


def _box_of(item: SceneObject, scene: Scene, index: int) -> tuple[Array, Array, Array]:
    """Centre, size and rotation of an object's box at rest: along the object's own axes."""
    if isinstance(item, Box):
        return np.array(item.center_m), np.array(item.size_m), rotation((0.0, 0.0, np.radians(item.yaw_deg)))
    if isinstance(item, Sphere):
        return np.array(item.center_m), np.full(3, 2 * item.radius_m), np.eye(3)
    if isinstance(item, Cylinder):
        size_m = np.array([2 * item.radius_m, 2 * item.radius_m, item.height_m])
        return item.base_m + np.array([0, 0, item.height_m / 2]), size_m, np.eye(3)
    R = rotation(np.radians(getattr(item, "rpy_deg", (0.0, 0.0, 0.0))))
    if isinstance(item, Plane):
        return np.array(item.center_m), np.array([*item.size_m, 0.0]), R
    corners = scene.vertices_m[np.unique(scene.triangles[scene.triangle_object == index])]
    own = rotated(R.T, corners - scene.places_m[index])
    low = own.min(axis=0)
    high = own.max(axis=0)
    return scene.places_m[index] + rotated(R, (low + high)[None] / 2)[0], high - low, R


Hits = tuple[NDArray[np.int32], NDArray[np.int64]]  # of a scan's points (P,): the objects, and the times


def boxes_at(objects: tuple[BoxedObject, ...], scans: Sequence[Hits], zero_ns: int, stamp_ns: int) -> Boxes:
    """The boxes in scans of one moment: each at the mean time of its returns in the first scan that has some.

    An object that was not hit is where it was at the stamp. Raises ConfigError outside timed poses.
    """
    times_ns = np.full(len(objects), stamp_ns, np.int64)
    returns = np.zeros(len(objects), np.int64)
    for k, one in enumerate(objects):
        mine = [time_ns[hit == one.index] for hit, time_ns in scans]
        returns[k] = sum(map(len, mine))
        some = next((some for some in mine if len(some)), None)
        if some is not None:
            times_ns[k] += round(float((some - stamp_ns).mean()))
    poses = [one.pose((at - zero_ns) / SECOND_NS) for one, at in zip(objects, times_ns.tolist(), strict=True)]
    return Boxes(objects, times_ns, np.array(poses).reshape(-1, 4, 4), returns)
