"""A rig that stands or drives: when its lasers fire, and where their beams start and point. It knows no scene.

Whoever has one casts the rays of `Drive.firings`, and gives what they hit to `lidarcfg.capture.writer`.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.files import loaded
from lidarcfg.geometry import Array, Bytes, Times, checked_pose
from lidarcfg.packets.families import timing
from lidarcfg.sensors.firing import FiringBatch, Timing
from lidarcfg.sensors.rig import Mount, Rig, load_rig
from lidarcfg.sensors.sensor import Range
from lidarcfg.simulate.aim import aim
from lidarcfg.units import SECOND_NS, START_NS, TIME_END_NS
from lidarcfg.world.geodesy import GeoOrigin
from lidarcfg.world.motion import EDGE_S, Trajectory, load_path

ANYWHERE = GeoOrigin()
STEP_S = 0.1
EDGE = 1e-9  # of a step, by which sums of steps may miss the end


@dataclass(frozen=True)
class SensorTimeline:
    """When the lasers of one of a rig's sensors fire, from its start on."""

    index: int  # of the sensor in the rig
    mount: Mount
    timing: Timing
    start_ns: int

    def packets(self, after_ns: int) -> int:
        """The number of packets that are complete so long after the start."""
        return max(after_ns, 0) // self.timing.pace(self.mount).period_ns

    def fired(self, packets: Iterable[range], first: int = 0) -> Iterator["FiredPackets"]:
        """The firings of successive spans of packets, before which so many firings come."""
        for batch in self.timing.schedule(self.mount, self.start_ns, packets):
            yield FiredPackets(self, batch, first)
            first += len(batch.firings.time_ns)

    def fired_before(self, packet: int) -> Times:
        """(L,) how often each laser fires before the packet with this number."""
        return self.timing.fired_before(self.mount, self.start_ns, packet)


@dataclass(frozen=True)
class FiredPackets:
    """The firings of successive packets of one sensor."""

    sensor: SensorTimeline
    batch: FiringBatch
    first: int  # the number of the first firing, by which random numbers are drawn


def timelines(rig: Rig, start_ns: int) -> list[SensorTimeline]:
    """The sensors of a rig: sensor i of n starts i/n of a packet after the first. Raises ConfigError."""
    mounts = [_with_range(mount) for mount in rig.mounts]
    timings = [checked_timing(mount) for mount in mounts]
    return [
        SensorTimeline(i, mount, one, start_ns + i * one.pace(mount).period_ns // len(mounts))
        for i, (mount, one) in enumerate(zip(mounts, timings, strict=True))
    ]


def _with_range(mount: Mount) -> Mount:
    """The mount; if its sensor's range is not known, with the range given by the rig."""
    if mount.sensor.range or not mount.range_m:
        return mount
    known = Range(source="the rig", min_m=mount.range_m[0], max_m=mount.range_m[1])
    return replace(mount, sensor=mount.sensor.model_copy(update={"range": known}))


def checked_timing(mount: Mount) -> Timing:
    """When the mount's lasers fire. Raises ConfigError unless the sensor can be simulated."""
    sensor = mount.sensor
    try:
        found = timing(sensor)
        found.check(mount)
    except ConfigError as error:
        raise error.of(mount.name) from None
    if sensor.range is None:
        what = f"sensor {sensor.name!r} has no range; add range: {{max_m: ...}} to its file, or range_m to the rig"
        raise ConfigError(f"{mount.name}: {what}")
    return found


def trajectory_of(at: Array | Trajectory | None, path: str | Path | None, start_ns: int) -> Trajectory:
    """The trajectory of a vehicle that starts at T_world_vehicle (4, 4), by default the origin, and follows a file."""
    if isinstance(at, Trajectory):
        return at
    return Trajectory(np.eye(4) if at is None else at, load_path(path), start_ns)


@dataclass(frozen=True, eq=False)
class RayBatch:
    """N firings of a rig's sensors as rays: sensor by sensor, of each in the order of its packets.

    Its columns are computed when they are first asked for.
    """

    packets: tuple[FiredPackets, ...]  # of each sensor
    fired_before: tuple[Times, ...]  # by sensor: (L,) how often each channel has fired before the batch
    start_s: float  # since the drive's start
    end_s: float  # all packets that are complete by then are in this batch or in one before
    trajectory: Trajectory | None  # that places the rays in the world; None: they are in the vehicle's frame

    def __len__(self) -> int:
        return sum(len(one.batch.firings.time_ns) for one in self.packets)

    @property
    def origins_m(self) -> Array:
        """(N, 3)."""
        return self._beams[0]

    @property
    def directions(self) -> Array:
        """(N, 3) unit vectors."""
        return self._beams[1]

    @cached_property
    def time_ns(self) -> Times:
        """(N,) when each is fired."""
        return np.concatenate([one.batch.firings.time_ns for one in self.packets])

    @cached_property
    def sensor(self) -> NDArray[np.uint16]:
        """(N,) its number in the rig."""
        counts = [len(one.batch.firings.time_ns) for one in self.packets]
        return np.repeat(np.arange(len(counts), dtype=np.uint16), counts)

    @cached_property
    def channel(self) -> Bytes:
        """(N,) of the sensor, from 0."""
        return np.concatenate([one.batch.firings.laser for one in self.packets])

    @cached_property
    def column(self) -> Times:
        """(N,) how often this channel has fired before, since the drive's start."""
        pairs = zip(self.packets, self.fired_before, strict=True)
        return np.concatenate([_columns(one.batch.firings.laser, before) for one, before in pairs])

    @cached_property
    def head_rad(self) -> Array:
        """(N,) where the sensor's head points, 0 to 2π, clockwise; of a scan pattern, the beam's azimuth."""
        return np.concatenate([one.batch.firings.encoder_rad for one in self.packets])

    @cached_property
    def _beams(self) -> tuple[Array, Array]:
        moving = self.trajectory or Trajectory.static(np.eye(4))
        axes = [aim(one.sensor.mount, moving, one.batch.firings) for one in self.packets]
        origins_m, directions = (np.concatenate(column) for column in zip(*axes, strict=True))
        return origins_m, directions


class Drive:
    """The firings of a rig that stands at `at`, or moves along a trajectory. Raises LidarcfgError.

    `rig` is a file, a dict with its keys or a `Rig`; `at` is T_world_vehicle (4, 4), by default the origin;
    `trajectory` a file of the motion from there, or a `Trajectory`. The clock begins at `start_ns`.
    `origin` is the world's on Earth, for sensors that report where they are.
    """

    def __init__(
        self,
        rig: Rig | Given,
        trajectory: str | Path | Trajectory | None = None,
        *,
        at: Array | None = None,
        start_ns: int = START_NS,
        origin: GeoOrigin = ANYWHERE,
    ) -> None:
        self.rig = loaded(rig, load_rig, Rig)
        at = None if at is None else checked_pose("at", at)
        if not isinstance(trajectory, Trajectory):
            trajectory = trajectory_of(at, trajectory, start_ns)
        elif at is not None:
            raise LidarcfgError("at is given beside a trajectory that says where it starts; allowed: one of them")
        if not (isinstance(start_ns, int) and 0 <= start_ns < TIME_END_NS):
            raise LidarcfgError(f"start_ns is {start_ns}; allowed: whole, from 0 to below {TIME_END_NS}")
        self.trajectory = trajectory
        self.start_ns = start_ns
        self.origin = origin
        self.sensors = tuple(timelines(self.rig, start_ns))

    @property
    def span_s(self) -> tuple[float, float]:
        """From when to when there are poses; without timed ones, from 0 to inf."""
        poses_s = self.trajectory.path.times_s
        if not len(poses_s):
            return 0.0, math.inf
        first_s, last_s = (poses_s[[0, -1]] + (self.trajectory.zero_ns - self.start_ns) / SECOND_NS).tolist()
        return first_s, last_s - max(self.late_ns / SECOND_NS - EDGE_S, 0)

    @property
    def late_ns(self) -> int:
        """How long after the first the last sensor starts."""
        return max(sensor.start_ns for sensor in self.sensors) - self.start_ns

    def firings(
        self,
        start_s: float = 0.0,
        end_s: float = math.inf,
        step_s: float = STEP_S,
        frame: Literal["world", "vehicle"] = "world",
    ) -> Iterator[RayBatch]:
        """The firings of all packets that are complete within a time, a batch for each step.

        Without an end they go on as long as there are poses; for ever, if these have no times. Rays are in the frame
        of the world, from where the vehicle is at each firing; or in the vehicle's, which needs no poses.
        Raises LidarcfgError for times that are none, and outside `span_s`.
        """
        _check_times(start_s, end_s, step_s)
        if frame not in ("world", "vehicle"):
            raise LidarcfgError(f"frame is {frame!r}; allowed: world, vehicle")
        if frame == "world":
            first_s, last_s = self.span_s
            until_s = start_s if end_s == math.inf else end_s
            if not first_s - EDGE_S <= start_s <= until_s <= last_s + EDGE * step_s:
                what = f"firings from {start_s:g} to {end_s:g} s; allowed: from {first_s:g} to {last_s:g} s"
                raise LidarcfgError(f"{what}, as the trajectory has poses")
            end_s = min(end_s, last_s)
        trajectory = self.trajectory if frame == "world" else None
        streams = [_stream(sensor, start_s, end_s, step_s) for sensor in self.sensors]
        for (begin_s, until_s), *parts in zip(pairwise(_edges_s(start_s, end_s, step_s)), *streams, strict=False):
            packets, before = zip(*parts, strict=True)
            yield RayBatch(packets, before, begin_s, until_s, trajectory)


def _check_times(start_s: float, end_s: float, step_s: float) -> None:
    last_s = TIME_END_NS / SECOND_NS
    if not (0 <= start_s <= last_s and start_s <= end_s):
        raise LidarcfgError(f"firings from {start_s} to {end_s} s; allowed: from 0 on, to a later time")
    if not 1e-6 <= step_s <= last_s:
        raise LidarcfgError(f"step_s is {step_s}; allowed: from 1e-06 s on")


def _edges_s(start_s: float, end_s: float, step_s: float) -> Iterator[float]:
    """The start, the end and the times between them, a step apart."""
    for n in count():
        at_s = start_s + n * step_s
        if at_s >= end_s - EDGE * step_s:
            break
        yield at_s
    yield end_s


def _stream(
    sensor: SensorTimeline, start_s: float, end_s: float, step_s: float
) -> Iterator[tuple[FiredPackets, Times]]:
    """The firings of a sensor in each step, and (L,) how often each of its channels has fired before them."""
    counts = (sensor.packets(round(at_s * SECOND_NS)) for at_s in _edges_s(start_s, end_s, step_s))
    before = sensor.fired_before(sensor.packets(round(start_s * SECOND_NS)))
    steps = (range(first, end) for first, end in pairwise(counts))
    for fired in sensor.fired(steps, int(before.sum())):
        yield fired, before
        before = before + np.bincount(fired.batch.firings.laser, minlength=len(before))


def _columns(laser: Bytes, fired_before: Times) -> Times:
    """(N,) how often each laser has fired before, if it has fired so often (L,) before the first."""
    order = np.argsort(laser, kind="stable")
    counts = np.bincount(laser, minlength=len(fired_before))
    starts = np.cumsum(counts) - counts
    columns = np.empty(len(laser), np.int64)
    columns[order] = np.arange(len(laser)) + np.repeat(fired_before - starts, counts)
    return columns
