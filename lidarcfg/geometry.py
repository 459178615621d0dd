"""Rigid motions as 4×4 arrays, and the frames (ROS REP-103: x forward, y left, z up; metres).

The only place that knows the order of the angles: R = Rz(yaw) Ry(pitch) Rx(roll), proper and orthonormal.
(The paper prints two signs wrong in its matrix; this is the one it means.)
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarcfg import maths
from lidarcfg.errors import ConfigError, a_thing

Array = NDArray[np.float64]
Times = NDArray[np.int64]  # nanoseconds, and other whole numbers
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
CHUNK = 4096  # vectors, which stay in the processor's cache
UPRIGHT = 1e-9  # horizontal part of the x axis, below which a frame has no yaw of its own
RIGID = 1e-5  # by which R Rᵀ may differ from 1: what float32 leaves of a rotation
EXACT = 1e-12  # by which it may differ and be taken as it is
SHIFT_MAX_M = 1e8


def rotation(rpy_rad: Sequence[float] | Array) -> Array:
    """R (3, 3) = Rz(yaw) Ry(pitch) Rx(roll) from roll, pitch, yaw in radians."""
    roll, pitch, yaw = (float(angle) for angle in rpy_rad)
    cr = maths.cos(roll)
    sr = maths.sin(roll)
    cp = maths.cos(pitch)
    sp = maths.sin(pitch)
    cy = maths.cos(yaw)
    sy = maths.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def level(rpy_rad: ArrayLike) -> Array:
    """(…, 3, 2) the x and y axes of a frame with roll, pitch, yaw (…, 3): the first two columns of R."""
    roll, pitch, yaw = np.moveaxis(np.asarray(rpy_rad, np.float64), -1, 0)
    cr = maths.cos(roll)
    sr = maths.sin(roll)
    sp = maths.sin(pitch)
    cp = maths.cos(pitch)
    cy = maths.cos(yaw)
    sy = maths.sin(yaw)
    x = [cy * cp, sy * cp, -sp]
    y = [cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr]
    return np.stack([np.stack(x, axis=-1), np.stack(y, axis=-1)], axis=-1)


def up(rpy_rad: ArrayLike) -> Array:
    """(…, 3) the z axis of a frame with roll, pitch, yaw (…, 3): the last column of R."""
    roll, pitch, yaw = np.moveaxis(np.asarray(rpy_rad, np.float64), -1, 0)
    cr = maths.cos(roll)
    sr = maths.sin(roll)
    cp = maths.cos(pitch)
    sp = maths.sin(pitch)
    cy = maths.cos(yaw)
    sy = maths.sin(yaw)
    return np.stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr], axis=-1)


def rotations(rpy_rad: ArrayLike) -> Array:
    """(…, 3, 3) R as in `rotation`, of frames with roll, pitch, yaw (…, 3)."""
    return np.concatenate([level(rpy_rad), up(rpy_rad)[..., None]], axis=-1)


def leaning(axis: Array, yaw_rad: Array) -> Array:
    """(…, 3) roll, pitch, yaw of frames rotated by yaw (…), then by the shortest rotation of their z to axis (…, 3)."""
    x, y, z = np.moveaxis(axis, -1, 0)
    c = maths.cos(yaw_rad)
    s = maths.sin(yaw_rad)
    k = 1 / np.maximum(1 + z, 1e-12)
    x_z = -(c * x + s * y)  # how high x and y of the frames point
    y_z = s * x - c * y
    y_x = k * x * y_z - s
    y_y = k * y * y_z + c
    roll = maths.atan2(y_z, z)
    cr = maths.cos(roll)
    sr = maths.sin(roll)
    pitch = maths.atan2(-x_z, maths.hypot(y_z, z))
    yaw = maths.atan2(x * sr - y_x * cr, y_y * cr - y * sr)
    return np.stack([roll, pitch, yaw], axis=-1)


def turned(rpy_rad: ArrayLike, by_rad: ArrayLike) -> Array:
    """(…, 3, 3) R(rpy) R(by): frames with roll, pitch, yaw (…, 3), rotated further about their own axes."""
    return product(rotations(rpy_rad), rotations(by_rad))


def angles(R: Array) -> Array:
    """(…, 3) the roll, pitch and yaw of R (…, 3, 3); roll is 0 where x points straight up or down."""
    flat = maths.hypot(R[..., 0, 0], R[..., 1, 0])
    upright = flat < UPRIGHT
    roll = np.where(upright, 0.0, maths.atan2(R[..., 2, 1], R[..., 2, 2]))
    yaw = np.where(upright, maths.atan2(-R[..., 0, 1], R[..., 1, 1]), maths.atan2(R[..., 1, 0], R[..., 0, 0]))
    return np.stack([roll, maths.atan2(-R[..., 2, 0], flat), yaw], axis=-1)


def quaternions(R: Array) -> Array:
    """(…, 4) the unit quaternions x, y, z, w of R (…, 3, 3), from whichever of the four is largest (Shepperd 1978)."""
    x = R[..., 0, 0]
    y = R[..., 1, 1]
    z = R[..., 2, 2]
    xy = R[..., 0, 1] + R[..., 1, 0]
    xz = R[..., 0, 2] + R[..., 2, 0]
    yz = R[..., 1, 2] + R[..., 2, 1]
    xw = R[..., 2, 1] - R[..., 1, 2]
    yw = R[..., 0, 2] - R[..., 2, 0]
    zw = R[..., 1, 0] - R[..., 0, 1]
    times_x = [1 + x - y - z, xy, xz, xw]  # four times each product
    times_y = [xy, 1 - x + y - z, yz, yw]
    times_z = [xz, yz, 1 - x - y + z, zw]
    times_w = [xw, yw, zw, 1 + x + y + z]
    products = np.stack([np.stack(row, axis=-1) for row in (times_x, times_y, times_z, times_w)], axis=-2)
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    found = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    unit: Array = found / np.linalg.norm(found, axis=-1, keepdims=True)
    return unit


def rotation_vectors(R: Array) -> Array:
    """(N, 3) the axes of rotations R (N, 3, 3), each as long as its angle in radians, at most half a turn."""
    found = quaternions(R)
    found *= np.where(found[:, 3:] < 0, -1.0, 1.0)
    sine = np.linalg.norm(found[:, :3], axis=1)
    angle_rad = 2 * maths.atan2(sine, found[:, 3])
    scale = np.divide(angle_rad, sine, out=np.full(len(sine), 2.0), where=sine > 0)
    return np.asarray(found[:, :3] * scale[:, None])


def pose(position_m: Sequence[float] | Array, rpy_rad: Sequence[float] | Array) -> Array:
    """T_parent_child (4, 4): child → parent, from the child's position in metres and roll, pitch, yaw in radians."""
    T = np.eye(4)
    T[:3, :3] = rotation(rpy_rad)
    T[:3, 3] = position_m
    return T


def checked_pose(what: str, T: ArrayLike) -> Array:
    """A pose (4, 4) that a user gives, in float64; of float32's precision it is made orthonormal.

    Raises ConfigError for another shape, what is not finite, a mirror, a scale, and a last row that is not 0 0 0 1.
    """
    allowed = "allowed: a pose (4, 4), a rotation and a shift in metres"
    try:
        out = np.array(T, np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{what} is {a_thing(T)}; {allowed}") from None
    if out.shape != (4, 4):
        raise ConfigError(f"{what} has the shape {out.shape}; {allowed}")
    if not np.isfinite(out).all():
        raise ConfigError(f"{what} has values that are not finite; {allowed}")
    if (out[3] != (0, 0, 0, 1)).any():
        raise ConfigError(f"{what} has the last row {' '.join(f'{one:g}' for one in out[3])}; allowed: 0 0 0 1")
    R = out[:3, :3]
    off = float(abs(product(R, R.T) - np.eye(3)).max())
    if off > RIGID:
        raise ConfigError(f"{what} is no rotation: R Rᵀ differs from 1 by {off:.2g}; {allowed}")
    if np.linalg.det(R) < 0:
        raise ConfigError(f"{what} is a mirror: the determinant of R is -1; {allowed}")
    if (abs(out[:3, 3]) > SHIFT_MAX_M).any():
        raise ConfigError(f"{what} is more than {SHIFT_MAX_M:g} m away")
    if off > EXACT:
        out[:3, :3] = rotation(angles(R))
    return out


def inverse(T: Array) -> Array:
    """The inverse of a rigid motion (4, 4)."""
    R = T[:3, :3]
    out = np.eye(4)
    out[:3, :3] = R.T
    out[:3, 3] = -rotated(R.T, T[None, :3, 3])[0]
    return out


def product(first: Array, second: Array) -> Array:
    """(…, i, k) the matrix product of (…, i, j) and (…, j, k), its terms added in order.

    How numpy's `@` adds them is left to BLAS, which does it differently from processor to processor.
    """
    out: Array = first[..., :, :1] * second[..., :1, :]
    for j in range(1, first.shape[-1]):
        out = out + first[..., :, j : j + 1] * second[..., j : j + 1, :]
    return out


def rotated(R: Array, vectors: Array) -> Array:
    """(N, 3) R (3, 3) times vectors (N, 3), as `product` has it."""
    out = np.empty(vectors.shape)
    for first in range(0, len(vectors), CHUNK):
        x, y, z = vectors[first : first + CHUNK].T
        for axis in range(3):
            out[first : first + CHUNK, axis] = R[axis, 0] * x + R[axis, 1] * y + R[axis, 2] * z
    return out


def transform(T: Array, points: ArrayLike) -> Array:
    """Points (N, 3) moved by T (4, 4), in float64."""
    return rotated(T[:3, :3], np.asarray(points, np.float64)) + T[:3, 3]


def directions(azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Array:
    """Unit vectors (N, 3) in the sensor frame; the maker's azimuth turns clockwise seen from above."""
    azimuth = np.asarray(azimuth_rad)
    elevation = np.asarray(elevation_rad)
    flat = maths.cos(elevation)
    return np.stack(
        [flat * maths.cos(azimuth), -flat * maths.sin(azimuth), maths.sin(elevation) + 0 * azimuth], axis=-1
    )


def quaternion_xyzw(T: Array) -> tuple[float, float, float, float]:
    """The rotation of T (4, 4) as a unit quaternion, w not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True).tolist()
    return x, y, z, w
