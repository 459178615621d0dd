"""Where a vehicle was, as the simulator that moves it says: a pose with each batch of rays."""

from bisect import bisect_right

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.inertial import STEP_NS
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory

FIX_S = 1.0  # from one fix of a GPS receiver to the next, at most
BACK_S = FIX_S + 0.1  # how far back packets ask where the vehicle was


class PoseLog:
    """Poses T_world_vehicle (4, 4), each that of the middle of a batch. Times are seconds since `start_ns`.

    Before the first and after the last the vehicle moves on as between the two next to it; long before, it stands.
    """

    def __init__(self, start_ns: int, begin_s: float) -> None:
        self._start_ns = start_ns
        self._begin_s = max(begin_s - FIX_S, 0.0)
        self._times_s: list[float] = []
        self._poses: list[Array] = []

    def add(self, begin_s: float, end_s: float, pose: Array) -> None:
        """Add the pose of a batch, which comes after those before."""
        self._times_s.append((begin_s + end_s) / 2)
        self._poses.append(pose)
        if len(self._poses) == 2:
            begins_s = sorted({0.0, self._begin_s})
            self._poses[:0] = [self._beyond(self._begin_s)] * len(begins_s)
            self._times_s[:0] = begins_s

    @property
    def settled_s(self) -> float:
        """What is measured until then does not depend on later poses."""
        return self._times_s[-1] - STEP_NS / SECOND_NS if len(self._poses) > 1 else 0

    def recent(self, since_s: float) -> Trajectory:
        """The motion through the poses on which depends what is measured from `since_s` on."""
        first = max(bisect_right(self._times_s, since_s - BACK_S) - 1, 0)
        return Trajectory.from_poses(np.array(self._times_s[first:]), np.array(self._poses[first:]), self._start_ns)

    def whole(self, end_s: float) -> Trajectory:
        """The motion through all poses until then."""
        if len(self._poses) == 1:  # it stands
            return Trajectory.from_poses(np.array([0.0, end_s]), np.array(2 * self._poses), self._start_ns)
        times_s = np.array([*self._times_s, end_s])
        return Trajectory.from_poses(times_s, np.array([*self._poses, self._beyond(end_s)]), self._start_ns)

    def _beyond(self, at_s: float) -> Array:
        """The pose (4, 4) before or after the last two."""
        two = Trajectory.from_poses(np.array(self._times_s[-2:]), np.array(self._poses[-2:]), self._start_ns)
        R, t = two.path.compiled.at(np.array([at_s]))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R[0], t[0]
        return T
