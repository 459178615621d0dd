"""A tree of frames: each has its pose in its parent, and so in any other frame above or beside it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lidarcfg.config.models import Vec3
from lidarcfg.errors import ConversionError
from lidarcfg.geometry import Array, angles, inverse, pose

BASE_LINK = "base_link"  # REP-105's name for the vehicle frame
UNIT = 1e-3  # the length of a quaternion differs by at most that from 1
NAMED = 12  # frames that an error names, at most


@dataclass(frozen=True)
class Pose:
    """Where a frame is in another one."""

    position_m: Vec3
    rpy_rad: Vec3  # R = Rz(yaw) Ry(pitch) Rx(roll)

    @classmethod
    def of(cls, T: Array) -> "Pose":
        """The pose of a rigid motion (4, 4)."""
        x, y, z = T[:3, 3].tolist()
        roll, pitch, yaw = (angles(T[:3, :3]) + 0.0).tolist()  # no minus zeros
        return cls((x, y, z), (roll, pitch, yaw))

    @property
    def matrix(self) -> Array:
        """(4, 4)."""
        return pose(self.position_m, self.rpy_rad)

    def moved(self, by_m: Vec3) -> "Pose":
        """The pose of a frame that is moved along its own axes."""
        x, y, z = (self.matrix @ (*by_m, 1.0))[:3].tolist()
        return Pose((x, y, z), self.rpy_rad)


@dataclass(frozen=True)
class Joint:
    """A frame's parent, and its pose in that."""

    parent: str
    pose: Pose


class FrameTree:
    """Frames below one root or several, by the joints of their children."""

    def __init__(self, where: str, joints: Mapping[str, Joint]) -> None:
        """Raises ConversionError for frames in a circle; `where` begins its message."""
        self._where = where
        self.joints = joints
        self.frames = tuple(dict.fromkeys([*(joint.parent for joint in joints.values()), *joints]))
        self._above = {name: self._path(name) for name in self.frames}

    def _path(self, name: str) -> tuple[str, ...]:
        path = [name]
        while joint := self.joints.get(path[-1]):
            if joint.parent in path:
                raise ConversionError(f"{self._where}: {joint.parent} is above itself: {' in '.join(path)}")
            path.append(joint.parent)
        return tuple(path)

    @property
    def roots(self) -> tuple[str, ...]:
        """The frames without a parent."""
        return tuple(name for name in self.frames if name not in self.joints)

    def above(self, name: str) -> tuple[str, ...]:
        """The ancestors of a frame, nearest first, root last."""
        return self._above.get(name, (name,))[1:]

    def base(self) -> str:
        """The vehicle's frame: base_link, or the only root. Raises ConversionError if there are several roots."""
        if BASE_LINK in self.frames:
            return BASE_LINK
        if len(self.roots) != 1:
            found = listed(self.roots)
            raise ConversionError(f"{self._where}: has no {BASE_LINK} and {len(self.roots)} roots: {found}")
        return self.roots[0]

    def reaches(self, name: str, base: str) -> bool:
        """Whether a path leads from a frame to the base."""
        return (name, *self.above(name))[-1] == (base, *self.above(base))[-1]

    def pose(self, name: str, base: str) -> Pose:
        """The pose of a frame in the base; as its joint has it, to the last bit, if the base is its parent."""
        joint = self.joints.get(name)
        if joint and joint.parent == base:
            return joint.pose
        return Pose.of(inverse(self._from_root(base)) @ self._from_root(name))

    def _from_root(self, name: str) -> Array:
        """T_root_frame (4, 4)."""
        T = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)).matrix
        for one in (name, *self.above(name)):
            if one in self.joints:
                T = self.joints[one].pose.matrix @ T
        return T


def listed(names: tuple[str, ...]) -> str:
    """Some names, separated by commas, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def pose_of_quaternion(where: str, position_m: Sequence[float], wxyz: Sequence[float]) -> Pose:
    """The pose of a position (3,) and a unit quaternion w, x, y, z. Raises ConversionError; `where` begins it."""
    if not all(map(math.isfinite, (*position_m, *wxyz))):
        raise ConversionError(f"{where}: is not finite")
    length = math.hypot(*wxyz)
    if abs(length - 1) > UNIT:
        raise ConversionError(f"{where}: its quaternion has the length {length:.4g}; a rotation has 1")
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    w, x, y, z = wxyz
    T[:3, :3] = Rotation.from_quat((x, y, z, w)).as_matrix()
    T[:3, 3] = position_m
    return Pose.of(T)
