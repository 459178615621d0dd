"""The path of a vehicle or an object that follows poses as they come."""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory

GLIDE_NS = SECOND_NS // 5  # at most, from one pose to the next
SPEED_MAX_M_S = 150.0  # what would be faster is placed at once


class PoseStream:
    """A path through poses that come one after another, at times since a start.

    To each it moves as `Motion` does between timed poses, in as much time as passed between this pose and the one
    before. The first pose, and one that is too far away, holds at once. Of the past, `kept_ns` are known.
    """

    def __init__(self, kept_ns: int) -> None:
        self._kept_ns = kept_ns
        self._knots: list[tuple[int, Array]] = []
        self._came_ns = 0

    def give(self, T: Array, now_ns: int, least_ns: int) -> None:
        """Move to a pose (4, 4) from now on, in no less than the least time."""
        due_ns = now_ns + min(max(now_ns - self._came_ns, least_ns), GLIDE_NS)
        self._came_ns = now_ns
        if self._knots:
            here = dict(self._knots).get(now_ns)
            here = self.trajectory(now_ns).pose(now_ns) if here is None else here
            if np.linalg.norm(T[:3, 3] - here[:3, 3]) <= SPEED_MAX_M_S * (due_ns - now_ns) / SECOND_NS:
                past = [knot for knot in self._knots if knot[0] < now_ns]
                self._knots = [*past, (now_ns, here), (due_ns, T)]
                return
        self._knots = [(now_ns - self._kept_ns, T)]

    def trajectory(self, end_ns: int) -> Trajectory:
        """The path from a while ago to this time or later; where it has no later pose, it stands."""
        while len(self._knots) > 1 and self._knots[1][0] <= end_ns - self._kept_ns:
            del self._knots[0]
        last_ns, last = self._knots[-1]
        knots = self._knots if last_ns >= end_ns and len(self._knots) > 1 else [*self._knots, (end_ns, last)]
        times_ns, poses = zip(*knots, strict=True)
        return Trajectory.from_poses(np.array(times_ns) / SECOND_NS, np.array(poses), 0)
