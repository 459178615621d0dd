"""The motion of an object or a vehicle: a constant velocity, an arc, or timed poses."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config.models import Model, Vec3, load, validation_error
from lidarcfg.core import world
from lidarcfg.errors import ConfigError
from lidarcfg.files import example
from lidarcfg.geometry import Array, product, rotated, rotation, rotation_vectors, transform
from lidarcfg.inputs import read_regular
from lidarcfg.units import SECOND_NS, START_NS

TUM = ".tum"  # text lines of time_s x y z qx qy qz qw, as the TUM RGB-D benchmark defined and evo reads them
TUM_ROW = ("time_s", "x", "y", "z", "qx", "qy", "qz", "qw")
TUM_MAX = 500_000_000  # bytes
TUM_LINES_MAX = 2_000_000
STEP_NS = 1_000_000  # over which a velocity is taken
EDGE_S = 1e-3  # before the first and after the last of timed poses
LIMIT = 1e8
TIME_LIMIT_S = 1e9
UNIT = 0.01  # by which the length of a quaternion may differ from 1

Speed = Annotated[float, Field(ge=-1e5, le=1e5)]
Metres = Annotated[float, Field(ge=-LIMIT, le=LIMIT)]


class Arc(Model):
    """A constant speed along a circle, turning left for a positive rate."""

    speed_m_s: Speed
    yaw_rate_deg_s: Annotated[float, Field(ge=-1e5, le=1e5)]
    heading_deg: float = 0.0  # at time 0; 0 is along x


class TimedPose(Model):
    """The pose of an object at a time."""

    time_s: Annotated[float, Field(ge=-TIME_LIMIT_S, le=TIME_LIMIT_S)]
    position_m: tuple[Metres, Metres, Metres]
    rpy_deg: Vec3 | None = None
    quaternion_xyzw: tuple[float, float, float, float] | None = None

    @model_validator(mode="after")
    def _check(self) -> "TimedPose":
        if self.rpy_deg is not None and self.quaternion_xyzw is not None:
            raise validation_error("conflicts with rpy_deg; give only one of them", "quaternion_xyzw")
        length = np.linalg.norm(self.quaternion_xyzw or (1,))
        if not abs(length - 1) <= UNIT:
            raise validation_error(f"is of length {length:g}; allowed: 1", "quaternion_xyzw")
        return self


class Motion(Model):
    """A motion, of one of three kinds, in the object's frame at time 0; times are seconds since the start.

    Between timed poses the position moves along a straight line and the attitude rotates about one axis, both at a
    constant rate.
    """

    kind: ClassVar[str] = "trajectory"
    velocity_m_s: tuple[Speed, Speed, Speed] | None = None
    arc: Arc | None = None
    poses: Annotated[tuple[TimedPose, ...], Field(min_length=2)] | None = None

    @model_validator(mode="after")
    def _check(self) -> "Motion":
        given = [key for key in ("velocity_m_s", "arc", "poses") if getattr(self, key) is not None]
        if len(given) != 1:
            what = f"conflicts with {given[0]}" if given else "missing"
            raise validation_error(f"{what}; give one of velocity_m_s, arc, poses", *given[1:2])
        for i, (before, after) in enumerate(zip(self.poses or (), (self.poses or ())[1:], strict=False), 1):
            if not after.time_s > before.time_s:
                raise validation_error(f"{after.time_s:g} is not after {before.time_s:g}", "poses", i, "time_s")
        return self


STATIC = Motion(velocity_m_s=(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class MotionPath:
    """The poses of a motion at any time."""

    motion: Motion
    times_s: Array  # (K,) of the timed poses; empty for the other kinds
    positions_m: Array  # (K, 3)
    rotations: Array  # (K, 3, 3)
    rotation_vectors_rad: Array  # (K, 3) from each pose to the next; 0 for the last

    def at(self, seconds: Array) -> tuple[Array, Array]:
        """R (n, 3, 3) and t (n, 3) at the times (n,); R is (1, 3, 3) if the rotation is constant, t likewise.

        Raises ConfigError outside the timed poses.
        """
        if self.is_static:
            return np.eye(3)[None], np.zeros((1, 3))
        seconds = np.asarray(seconds, np.float64)
        if len(seconds):
            self.check_span(float(seconds.min()), float(seconds.max()))
        R, t = self.compiled.at(seconds)
        upright = self.motion.velocity_m_s is not None
        return np.eye(3)[None] if upright else R, t

    @cached_property
    def compiled(self) -> world.Path:
        """The path as the core takes it."""
        if self.motion.velocity_m_s is not None:
            return world.path_of_velocity(self.motion.velocity_m_s)
        if self.motion.arc is not None:
            rate_rad_s, heading_rad = np.radians([self.motion.arc.yaw_rate_deg_s, self.motion.arc.heading_deg])
            return world.path_of_arc(self.motion.arc.speed_m_s, rate_rad_s, heading_rad)
        return world.path_of_poses(self.times_s, self.positions_m, self.rotations, self.rotation_vectors_rad)

    @property
    def is_static(self) -> bool:
        """Whether the object stands: its velocity is zero."""
        return self.motion == STATIC

    def check_span(self, first_s: float, last_s: float, prefix: str = "") -> None:
        """Raises ConfigError if the motion is timed poses and they do not cover these times.

        The first and the last segment are extended by EDGE_S: a sensor may fire shortly before its packet's time.
        """
        if len(self.times_s) and not self.times_s[0] - EDGE_S <= first_s <= last_s <= self.times_s[-1] + EDGE_S:
            span = f"{self.times_s[0]:g} to {self.times_s[-1]:g} s"
            raise ConfigError(f"{prefix}a pose is needed at {first_s:g} to {last_s:g} s; the timed poses cover {span}")

    def held(self) -> "MotionPath":
        """This path; if it is timed poses, it stands after the last."""
        if not len(self.times_s):
            return self
        times_s = np.append(self.times_s, self.times_s[-1] + TIME_LIMIT_S)
        rows = np.append(np.arange(len(self.times_s)), -1)
        return _path(self.motion, times_s, self.positions_m[rows], self.rotations[rows])

    @property
    def speed_max_m_s(self) -> float:
        """An upper bound of the speed along the path."""
        if self.motion.velocity_m_s is not None:
            return math.hypot(*self.motion.velocity_m_s)
        if self.motion.arc is not None:
            return abs(self.motion.arc.speed_m_s)
        return float((np.linalg.norm(np.diff(self.positions_m, axis=0), axis=1) / np.diff(self.times_s)).max())


def build_path(motion: Motion) -> MotionPath:
    """The path of a motion: timed poses as arrays, quaternions and angles as matrices."""
    poses = motion.poses or ()
    rotations = np.zeros((len(poses), 3, 3))
    turned = [i for i, one in enumerate(poses) if one.quaternion_xyzw]
    if turned:
        rotations[turned] = matrices(np.array([poses[i].quaternion_xyzw for i in turned]))
    for i, one in enumerate(poses):
        if not one.quaternion_xyzw:
            rotations[i] = rotation(np.radians(one.rpy_deg or (0.0, 0.0, 0.0)))
    positions_m = np.array([pose.position_m for pose in poses]).reshape(-1, 3)
    return _path(motion, np.array([pose.time_s for pose in poses]), positions_m, rotations)


def matrices(quaternions_xyzw: Array) -> Array:
    """Rotations (n, 3, 3) of quaternions (n, 4) of any length but 0."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quaternions_xyzw).as_matrix())


def _path(motion: Motion, times_s: Array, positions_m: Array, rotations: Array) -> MotionPath:
    vectors = np.zeros((len(rotations), 3))
    if len(rotations):
        vectors[:-1] = rotation_vectors(product(rotations[:-1].swapaxes(1, 2), rotations[1:]))
    return MotionPath(motion, times_s, positions_m, rotations, vectors)


@dataclass(frozen=True)
class Trajectory:
    """The poses of the vehicle in the world over time."""

    T_world_start: Array  # (4, 4) the frame in which the motion is described
    path: MotionPath
    zero_ns: int  # the motion's time 0

    @classmethod
    def static(cls, T_world_vehicle: Array) -> "Trajectory":
        """The trajectory of a vehicle that stands at T_world_vehicle (4, 4)."""
        return cls(T_world_vehicle, build_path(STATIC), 0)

    @classmethod
    def from_poses(cls, times_s: Array, T_world_vehicle: Array, zero_ns: int = START_NS) -> "Trajectory":
        """The trajectory through poses (K, 4, 4) at times (K,), in seconds since `zero_ns`, as a .tum file has it.

        Raises ConfigError for fewer than two, for times that do not ascend and for poses that are not rigid.
        """
        try:
            times = np.asarray(times_s, np.float64)
            T = np.asarray(T_world_vehicle, np.float64)
        except (TypeError, ValueError):
            raise ConfigError("times or poses are no numbers; allowed: (K,), (K, 4, 4), K > 1") from None
        if times.ndim != 1 or T.shape != (len(times), 4, 4) or len(times) < 2:
            raise ConfigError(
                f"times and poses are of shapes {times.shape} and {T.shape}; allowed: (K,), (K, 4, 4), K > 1"
            )
        if not (np.diff(times) > 0).all() or not abs(times).max() <= TIME_LIMIT_S:
            raise ConfigError(f"times must ascend and be within {TIME_LIMIT_S:g} s of the start")
        R = T[:, :3, :3]
        wrong = np.flatnonzero(~are_poses(T))
        if len(wrong):
            raise ConfigError(f"pose {wrong[0]} is no rotation and shift of up to {LIMIT:g} m")
        return cls(np.eye(4), _path(Motion.model_construct(poses=()), times, T[:, :3, 3].copy(), R.copy()), zero_ns)

    def world(self, points: Array, time_ns: NDArray[np.int64]) -> Array:
        """Points (n, 3) of the vehicle frame, each measured at its time (n,), in the world frame: deskewed.

        Raises ConfigError outside the timed poses.
        """
        R, t = self.motion(time_ns)
        return transform(self.T_world_start, rotate(R, points) + t)

    def motion(self, time_ns: NDArray[np.int64]) -> tuple[Array, Array]:
        """R (n or 1, 3, 3) and t (n or 1, 3) from the vehicle frame into the frame in which the motion is described."""
        return self.path.at(np.empty(0) if self.path.is_static else (time_ns - self.zero_ns) / SECOND_NS)

    def pose(self, time_ns: int) -> Array:
        """T_world_vehicle (4, 4) at one time."""
        R, t = self.motion(np.array([time_ns]))
        T = np.eye(4)
        T[:3, :3] = R[0]
        T[:3, 3] = t[0]
        return product(self.T_world_start, T)

    def velocity_m_s(self, time_ns: NDArray[np.int64]) -> Array:
        """(n, 3) in the world: the mean over the millisecond around each time (n,), as far as the poses cover it."""
        if self.path.is_static:
            return np.zeros((len(time_ns), 3))
        ends = np.stack([time_ns - STEP_NS // 2, time_ns + STEP_NS // 2])
        if len(self.path.times_s):
            ends = np.clip(ends, *(self.zero_ns + np.round(self.path.times_s[[0, -1]] * SECOND_NS).astype(np.int64)))
        before, after = (rotated(self.T_world_start[:3, :3], self.motion(end)[1]) for end in ends)
        return np.asarray((after - before) * (SECOND_NS / np.diff(ends, axis=0).T))


def are_poses(T: Array) -> NDArray[np.bool_]:
    """(n,) which of the matrices (n, 4, 4) are a rotation and a shift of up to LIMIT."""
    R = T[:, :3, :3]
    rigid = (abs(np.einsum("nij,nkj->nik", R, R) - np.eye(3)) <= UNIT).all(axis=(1, 2))
    rigid &= (np.cross(R[:, 0], R[:, 1]) * R[:, 2]).sum(axis=1) > 0  # no mirror
    return np.asarray(rigid & (abs(T[:, :3, 3]) <= LIMIT).all(axis=1))


def rotate(R: Array, vectors: Array) -> Array:
    """Vectors (n, 3) rotated by R: one matrix each (n, 3, 3), or one for all (1, 3, 3)."""
    out: Array = rotated(R[0], vectors) if len(R) == 1 else np.einsum("nij,nj->ni", R, vectors)
    return out


def load_path(path: str | Path | None) -> MotionPath:
    """The path of a motion in a YAML file, or of poses in a .tum file; None: one that stands. Raises ConfigError."""
    if path is None:
        return build_path(STATIC)
    path = example(path)
    if path.suffix != TUM:
        return build_path(load(path, Motion))
    rows = _read_tum(path)
    motion = Motion.model_construct(poses=())  # its poses are in the arrays
    return _path(motion, rows[:, 0].copy(), rows[:, 1:4].copy(), matrices(rows[:, 4:]))


def _read_tum(path: Path) -> Array:
    """(K, 8) the checked rows of a .tum file. Raises ConfigError with the first invalid line."""
    try:
        text = read_regular(path, TUM_MAX)
        if (count := text.count(b"\n")) > TUM_LINES_MAX:
            raise ConfigError(f"{path}: has {count:,} lines; allowed: at most {TUM_LINES_MAX:,}")
        lines = text.decode().splitlines()
    except OSError as error:
        raise ConfigError.from_os(path, error) from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not text in UTF-8") from None
    numbers = [n for n, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    if len(numbers) < 2:
        raise ConfigError(f"{path}: {len(numbers)} poses; allowed: at least 2")
    try:
        rows = np.loadtxt([lines[n] for n in numbers], comments=None, ndmin=2)
    except ValueError:  # one by one, to say which
        rows = np.array([_tum_row(path, n, lines[n]) for n in numbers])
    if rows.shape[1] != len(TUM_ROW):
        _tum_row(path, numbers[0], lines[numbers[0]])
    odd = np.flatnonzero(~_are_poses(rows))
    late = np.flatnonzero(~(np.diff(rows[:, 0]) > 0)) + 1
    if len(odd) and not (len(late) and late[0] < odd[0]):
        raise _no_pose(path, numbers[odd[0]], lines[numbers[odd[0]]])
    if len(late):
        before, after = rows[late[0] - 1 : late[0] + 1, 0]
        raise ConfigError(f"{path}:{numbers[late[0]] + 1}:1: {after:g} is not after {before:g}")
    return np.asarray(rows)


def _are_poses(rows: Array) -> NDArray[np.bool_]:
    """Which of the rows (K, 8) are poses, by the limits of `TimedPose`."""
    near = (np.abs(rows[:, :4]) <= (TIME_LIMIT_S, LIMIT, LIMIT, LIMIT)).all(axis=1)
    return np.asarray(near & (np.abs(np.linalg.norm(rows[:, 4:], axis=1) - 1) <= UNIT))


def _tum_row(path: Path, number: int, line: str) -> list[float]:
    try:
        row = [float(word) for word in line.split()]
    except ValueError:
        raise _no_pose(path, number, line) from None
    if len(row) != len(TUM_ROW):
        raise _no_pose(path, number, line)
    return row


def _no_pose(path: Path, number: int, line: str) -> ConfigError:
    allowed = f"allowed: {' '.join(TUM_ROW)}, of a unit quaternion"
    return ConfigError(f"{path}:{number + 1}:1: {line.strip()[:60]!r} is not a pose; {allowed}")
