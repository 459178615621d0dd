"""Time: the frames that the page steps through, the parts of scenes that move as one, and their tracks."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, quaternions
from lidarcfg.units import SECOND_NS
from lidarcfg.viewer.contents import Contents
from lidarcfg.world.meshes import Mesh, join_meshes
from lidarcfg.world.motion import MotionPath, build_path, rotate
from lidarcfg.world.scene import NO_MESH, Scene

FRAME_NS = 100_000_000  # one revolution at 600 rpm
FRAMES_MAX = 36_000  # where there are no points: an hour of them; frames of a longer motion are longer
SHOWN_S = 10.0  # of a motion without an end, where there are no points


@dataclass(frozen=True)
class RigidPart:
    """A rigid part of a scene: all that is static, or one dynamic object."""

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


def parts(scene: Scene) -> list[RigidPart]:
    """The static part, then each dynamic object; without the ground."""
    file = scene.file
    moves = np.array([motion is not None for motion in scene.motions])
    rest = {"spheres": _static(file.spheres), "cylinders": _static(file.cylinders)}
    of_rest = scene.triangles[~moves[scene.triangle_object]]
    static = replace(scene, file=file.model_copy(update=rest), triangles=of_rest).mesh()
    found = [RigidPart(_compact(static), np.zeros(3))] if len(static[1]) else []
    rounds = dict(scene.rounds)
    for i in np.flatnonzero(moves).tolist():
        item = rounds.get(i)
        motion = scene.motions[i]
        alone = {"spheres": (), "cylinders": ()} | ({f"{type(item).__name__.lower()}s": (item,)} if item else {})
        one = replace(scene, file=file.model_copy(update=alone), triangles=scene.triangles[scene.triangle_object == i])
        vertices, triangles = _compact(one.mesh())
        assert motion
        found.append(RigidPart((vertices - scene.places_m[i], triangles), scene.places_m[i], build_path(motion)))
    return found


def mesh_at(scene: Scene, since_ns: int) -> Mesh:
    """All objects but the ground, in the world, where they are `since_ns` after the scene's start."""
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


@dataclass(frozen=True)
class Timeline:
    """Frames of equal length, without those that hold no point."""

    start_ns: int
    unit_ns: int  # of the points' times
    end: int  # the last point's, in units
    frame: int  # units in one
    frames: NDArray[np.int64]  # (n,) how many are before each

    @property
    def middle_ns(self) -> NDArray[np.int64]:
        """(n,) the midpoint of each frame, as far as there are points."""
        middle = self.frames * self.frame + self.frame // 2
        return np.asarray(self.start_ns + np.minimum(middle, self.end) * self.unit_ns)


def timeline(contents: Contents) -> Timeline | None:
    """The frames: of the points, or else of the motion; None if nothing has a time."""
    length_ns = max(mount.frame_ns for mount in contents.rigs[0].mounts) if contents.rigs else FRAME_NS
    time_ns = contents.cloud.time_ns
    if len(time_ns):
        start_ns = int(time_ns.min())
        end_ns = int(time_ns.max())
        unit_ns = max(1000, -(-(end_ns - start_ns + 1) // 2**32))
        frame = max(round(length_ns / unit_ns), 1)
        frames = np.unique((time_ns - start_ns) // unit_ns // frame)
        return Timeline(start_ns, unit_ns, (end_ns - start_ns) // unit_ns, frame, frames)
    path = contents.trajectory.path
    if path.is_static and not any(motion for scene in contents.scenes for motion in scene.motions):
        return None
    first_s, last_s = path.times_s[[0, -1]] if len(path.times_s) else (0.0, SHOWN_S)
    end = round((last_s - first_s) * 1e6)
    frame = max(length_ns // 1000, -(-end // FRAMES_MAX))
    start_ns = contents.trajectory.zero_ns + round(first_s * SECOND_NS)
    return Timeline(start_ns, 1000, end, frame, np.arange(max(-(-end // frame), 1)))


def tracks(contents: Contents, line: Timeline) -> Array:
    """(1 + dynamic objects, frames, 7): x, y, z and quaternion x, y, z, w on the page: the vehicle's, then theirs."""
    zero_ns = contents.zero_ns
    seconds = (line.middle_ns - zero_ns) / SECOND_NS
    T = contents.T_vehicle_world
    start = T @ contents.trajectory.T_world_start
    path = contents.trajectory.path
    vehicle = RigidPart((np.empty((0, 3)), np.empty((0, 3), np.int64)), np.zeros(3), path)
    found = [_track(start, *vehicle.poses(seconds), len(seconds))]
    for scene in contents.scenes:
        found += [_track(T, *part.poses(seconds), len(seconds)) for part in parts(scene) if part.path]
    return np.stack(found)


def _track(T: Array, R: Array, t: Array, count: int) -> Array:
    """(count, 7) of the poses R (count or 1, 3, 3), t (count or 1, 3) in a frame T (4, 4)."""
    turned = quaternions(T[:3, :3] @ R)
    return np.concatenate(
        [np.broadcast_to(part, (count, part.shape[1])) for part in (t @ T[:3, :3].T + T[:3, 3], turned)], axis=1
    )
