"""The frames that the page steps through, and where the vehicle and dynamic objects are in each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, quaternions
from lidarcfg.units import SECOND_NS
from lidarcfg.viewer.scenery import Part, parts
from lidarcfg.viewer.stage import Stage

FRAME_NS = 100_000_000  # one revolution at 600 rpm
FRAMES_MAX = 36_000  # where there are no points: an hour of them; frames of a longer motion are longer
SHOWN_S = 10.0  # of a motion without an end, where there are no points


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


def timeline(stage: Stage) -> Timeline | None:
    """The frames of a stage: of its points, or else of its motion; None if nothing has a time."""
    length_ns = round(6e10 / min(mount.rpm for mount in stage.rigs[0].mounts)) if stage.rigs else FRAME_NS
    time_ns = stage.cloud.time_ns
    if len(time_ns):
        start_ns = int(time_ns.min())
        end_ns = int(time_ns.max())
        unit_ns = max(1000, -(-(end_ns - start_ns + 1) // 2**32))
        frame = max(round(length_ns / unit_ns), 1)
        frames = np.unique((time_ns - start_ns) // unit_ns // frame)
        return Timeline(start_ns, unit_ns, (end_ns - start_ns) // unit_ns, frame, frames)
    path = stage.trajectory.path
    if path.is_static and not any(motion for scene in stage.scenes for motion in scene.motions):
        return None
    first_s, last_s = path.times_s[[0, -1]] if len(path.times_s) else (0.0, SHOWN_S)
    end = round((last_s - first_s) * 1e6)
    frame = max(length_ns // 1000, -(-end // FRAMES_MAX))
    start_ns = stage.trajectory.zero_ns + round(first_s * SECOND_NS)
    return Timeline(start_ns, 1000, end, frame, np.arange(max(-(-end // frame), 1)))


def tracks(stage: Stage, line: Timeline) -> Array:
    """(1 + dynamic objects, frames, 7): x, y, z and quaternion x, y, z, w on the page: the vehicle's, then theirs."""
    zero_ns = stage.zero_ns
    seconds = (line.middle_ns - zero_ns) / SECOND_NS
    T = stage.T_vehicle_world
    start = T @ stage.trajectory.T_world_start
    path = stage.trajectory.path
    vehicle = Part((np.empty((0, 3)), np.empty((0, 3), np.int64)), np.zeros(3), path)
    found = [_track(start, *vehicle.poses(seconds), len(seconds))]
    for scene in stage.scenes:
        found += [_track(T, *part.poses(seconds), len(seconds)) for part in parts(scene) if part.path]
    return np.stack(found)


def _track(T: Array, R: Array, t: Array, count: int) -> Array:
    """(count, 7) of the poses R (count or 1, 3, 3), t (count or 1, 3) in a frame T (4, 4)."""
    turned = quaternions(T[:3, :3] @ R)
    return np.concatenate(
        [np.broadcast_to(part, (count, part.shape[1])) for part in (t @ T[:3, :3].T + T[:3, 3], turned)], axis=1
    )
