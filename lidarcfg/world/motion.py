"""Motion: where a thing that moves stands at each time, by a constant velocity, an arc, or timed poses."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config import Model, Vec3, fault, load
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, rotation, transform
from lidarcfg.units import SECOND_NS

TUM = ".tum"  # text lines of time_s x y z qx qy qz qw, as the TUM RGB-D benchmark defined and evo reads them
STEP_NS = 1_000_000  # over which a velocity is taken
LIMIT = 1e8

Speed = Annotated[float, Field(ge=-1e5, le=1e5)]
Metres = Annotated[float, Field(ge=-LIMIT, le=LIMIT)]


class Arc(Model):
    """A constant speed along a circle, turning left for a positive rate."""

    speed_m_s: Speed
    yaw_rate_deg_s: Annotated[float, Field(ge=-1e5, le=1e5)]
    heading_deg: float = 0.0  # at time 0; 0 is along x


class TimedPose(Model):
    """Where it stands at a time."""

    time_s: Annotated[float, Field(ge=-1e9, le=1e9)]
    position_m: tuple[Metres, Metres, Metres]
    rpy_deg: Vec3 | None = None
    quaternion_xyzw: tuple[float, float, float, float] | None = None

    @model_validator(mode="after")
    def _check(self) -> "TimedPose":
        if self.rpy_deg is not None and self.quaternion_xyzw is not None:
            raise fault("stands beside rpy_deg; give one of them", "quaternion_xyzw")
        length = np.linalg.norm(self.quaternion_xyzw or (1,))
        if not abs(length - 1) <= 0.01:
            raise fault(f"is of length {length:g}; allowed: 1", "quaternion_xyzw")
        return self


class Motion(Model):
    """One of the three; the frame is the one in which the thing stands at time 0, times are seconds since the start.

    Between timed poses the position moves in a straight line and the attitude turns about one axis, both evenly.
    """

    velocity_m_s: tuple[Speed, Speed, Speed] | None = None
    arc: Arc | None = None
    poses: Annotated[tuple[TimedPose, ...], Field(min_length=2)] | None = None

    @model_validator(mode="after")
    def _check(self) -> "Motion":
        given = [key for key in ("velocity_m_s", "arc", "poses") if getattr(self, key) is not None]
        if len(given) != 1:
            what = f"stands beside {given[0]}" if given else "missing"
            raise fault(f"{what}; give one of velocity_m_s, arc, poses", *given[1:2])
        for i, (before, after) in enumerate(zip(self.poses or (), (self.poses or ())[1:], strict=False), 1):
            if not after.time_s > before.time_s:
                raise fault(f"{after.time_s:g} is not after {before.time_s:g}", "poses", i, "time_s")
        return self


STANDING = Motion(velocity_m_s=(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Path3:
    """A motion made ready: rotations and positions at any times."""

    motion: Motion
    times_s: Array  # (K,) of the timed poses; empty for the other kinds
    positions_m: Array  # (K, 3)
    rotations: Array  # (K, 3, 3)
    turns_rad: Array  # (K - 1, 3) from each pose to the next, as rotation vectors

    def at(self, seconds: Array) -> tuple[Array, Array]:
        """R (n, 3, 3) and t (n, 3) at the times (n,), with 1 for n where it does not turn, or not move.

        Raises ConfigError outside the timed poses.
        """
        if self.stands:
            return np.eye(3)[None], np.zeros((1, 3))
        if self.motion.velocity_m_s is not None:
            return np.eye(3)[None], seconds[:, None] * np.array(self.motion.velocity_m_s)
        from lidarcfg.world import kernels as ray_kernels

        if self.motion.arc is not None:
            arc = self.motion.arc
            turn_rad_s, heading_rad = math.radians(arc.yaw_rate_deg_s), math.radians(arc.heading_deg)
            R, t = ray_kernels.arced(np.asarray(seconds, np.float64), arc.speed_m_s, turn_rad_s, heading_rad)
            return R, t
        if not len(seconds):
            return np.empty((0, 3, 3)), np.empty((0, 3))
        self.check_span(float(seconds.min()), float(seconds.max()))
        R, t = ray_kernels.posed(
            np.asarray(seconds, np.float64), self.times_s, self.positions_m, self.rotations, self.turns_rad
        )
        return R, t

    @property
    def stands(self) -> bool:
        """Whether it never moves: it is the same at all times."""
        return self.motion == STANDING

    def check_span(self, first_s: float, last_s: float) -> None:
        """Raises ConfigError unless the timed poses, if that is what they are, cover these times."""
        if len(self.times_s) and not self.times_s[0] <= first_s <= last_s <= self.times_s[-1]:
            span = f"{self.times_s[0]:g} to {self.times_s[-1]:g} s"
            raise ConfigError(f"a pose is needed at {first_s:g} to {last_s:g} s; the timed poses cover {span}")

    @property
    def speed_max_m_s(self) -> float:
        """No point of the path is left faster than this."""
        if self.motion.velocity_m_s is not None:
            return float(np.linalg.norm(self.motion.velocity_m_s))
        if self.motion.arc is not None:
            return abs(self.motion.arc.speed_m_s)
        return float((np.linalg.norm(np.diff(self.positions_m, axis=0), axis=1) / np.diff(self.times_s)).max())

    @property
    def turn_max_rad_s(self) -> float:
        """It never turns faster than this."""
        if self.motion.arc is not None:
            return abs(math.radians(self.motion.arc.yaw_rate_deg_s))
        if self.motion.velocity_m_s is not None:
            return 0.0
        return float((np.linalg.norm(self.turns_rad, axis=1) / np.diff(self.times_s)).max())


def prepared(motion: Motion) -> Path3:
    """The motion, ready to be asked."""
    poses = motion.poses or ()
    rotations, turns_rad = np.zeros((len(poses), 3, 3)), np.zeros((0, 3))
    if poses:
        from scipy.spatial.transform import Rotation

        for i, one in enumerate(poses):
            if one.quaternion_xyzw:
                rotations[i] = Rotation.from_quat(one.quaternion_xyzw).as_matrix()
            else:
                rotations[i] = rotation(np.radians(one.rpy_deg or (0.0, 0.0, 0.0)))
        turns = Rotation.from_matrix(rotations)
        turns_rad = (turns[:-1].inv() * turns[1:]).as_rotvec()
    return Path3(
        motion=motion,
        times_s=np.array([pose.time_s for pose in poses]),
        positions_m=np.array([pose.position_m for pose in poses]).reshape(-1, 3),
        rotations=rotations,
        turns_rad=turns_rad,
    )


@dataclass(frozen=True)
class Trajectory:
    """Where the vehicle is in the world at each time."""

    T_world_start: Array  # (4, 4) the frame in which the motion is told
    path: Path3
    zero_ns: int  # the motion's time 0

    def world(self, points: Array, time_ns: NDArray[np.int64]) -> Array:
        """Points (n, 3) of the vehicle frame, each seen at its time (n,), in the world: the motion taken out.

        Raises ConfigError outside the timed poses.
        """
        R, t = self.motion(time_ns)
        return transform(self.T_world_start, rotated(R, points) + t)

    def motion(self, time_ns: NDArray[np.int64]) -> tuple[Array, Array]:
        """R (n or 1, 3, 3) and t (n or 1, 3) from the vehicle's frame into the one where it started."""
        return self.path.at(np.empty(0) if self.path.stands else (time_ns - self.zero_ns) / SECOND_NS)

    def pose(self, time_ns: int) -> Array:
        """T_world_vehicle (4, 4) at one time."""
        R, t = self.motion(np.array([time_ns]))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R[0], t[0]
        return np.asarray(self.T_world_start @ T)

    def velocity_m_s(self, time_ns: NDArray[np.int64]) -> Array:
        """(n, 3) in the world: over the millisecond around the times (n,), or what of it the poses cover."""
        if self.path.stands:
            return np.zeros((len(time_ns), 3))
        ends = np.stack([time_ns - STEP_NS // 2, time_ns + STEP_NS // 2])
        if len(self.path.times_s):
            ends = np.clip(ends, *(self.zero_ns + np.round(self.path.times_s[[0, -1]] * SECOND_NS).astype(np.int64)))
        before, after = (self.motion(end)[1] @ self.T_world_start[:3, :3].T for end in ends)
        return np.asarray((after - before) * (SECOND_NS / np.diff(ends, axis=0).T))


def standing(T_world_vehicle: Array) -> Trajectory:
    """A vehicle that does not move."""
    return Trajectory(T_world_vehicle, prepared(STANDING), 0)


def rotated(R: Array, vectors: Array) -> Array:
    """Vectors (n, 3) turned by R, one each (n, 3, 3) or one for all (1, 3, 3)."""
    turned: Array = vectors @ R[0].T if len(R) == 1 else np.einsum("nij,nj->ni", R, vectors)
    return turned


def load_motion(path: str | Path) -> Motion:
    """The motion in a YAML file, or the timed poses in a .tum file. Raises ConfigError."""
    path = Path(path)
    return _load_tum(path) if path.suffix == TUM else load(path, Motion)


def _load_tum(path: Path) -> Motion:
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text in UTF-8"
        raise ConfigError(f"{path}: {(reason or str(error)).lower()}") from None
    poses: list[TimedPose] = []
    for number, line in enumerate(lines, 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                time_s, x, y, z, qx, qy, qz, qw = map(float, line.split())
                poses.append(TimedPose(time_s=time_s, position_m=(x, y, z), quaternion_xyzw=(qx, qy, qz, qw)))
            except ValueError:
                what = f"{line.strip()[:60]!r} is not a pose; allowed: time_s x y z qx qy qz qw, of a unit quaternion"
                raise ConfigError(f"{path}:{number}:1: {what}") from None
            if len(poses) > 1 and not poses[-1].time_s > poses[-2].time_s:
                raise ConfigError(f"{path}:{number}:1: {poses[-1].time_s:g} is not after {poses[-2].time_s:g}")
    if len(poses) < 2:
        raise ConfigError(f"{path}: {len(poses)} poses; allowed: at least 2")
    return Motion(poses=tuple(poses))
