"""Poses from positions and quaternions."""

import math
from collections.abc import Sequence

import numpy as np

from lidarcfg.errors import ConversionError
from lidarcfg.io.kits.frames import Pose

UNIT = 1e-3  # the length of a quaternion differs by at most that from 1


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
