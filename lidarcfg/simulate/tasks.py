"""The work of a simulation: each sensor of a rig is traced chunk by chunk, on threads that all sensors share."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.errors import ConfigError
from lidarcfg.futures import ordered_results
from lidarcfg.geometry import Array
from lidarcfg.packets.families import timing
from lidarcfg.sensors.firing import RETURN_TYPES, FiringBatch, PacketPace, Timing, spans
from lidarcfg.sensors.pattern_timing import in_view
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Range
from lidarcfg.simulate.drive import Drive
from lidarcfg.simulate.echoes import Echoes
from lidarcfg.simulate.simulator import RayCounts, Simulator
from lidarcfg.units import SECOND_NS, TIME_END_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.tracer import Tracer
from lidarcfg.world.vehicle import check_outside

CHUNK_NS = 1_000_000_000  # traced at a time, at most: each chunk has a fixed cost
CHUNK_RAYS = 196_608  # the same in rays
AHEAD = 1  # chunks of a sensor that are traced while others are written

OnRays = Callable[[RayCounts], None]
T = TypeVar("T")


@dataclass(frozen=True)
class SimulationOptions:
    """How a simulation runs, and what it calls meanwhile. None of this changes its results."""

    on_progress: Callable[[int], None] = lambda done_ns: None  # the simulated time so far, of the duration
    on_rays: OnRays = lambda counts: None  # the numbers of rays of each chunk
    chunk_ns: int = CHUNK_NS  # traced at a time, at most
    threads: int | None = None  # none: as many as cores


@dataclass(frozen=True)
class Task:
    """The simulation of one sensor."""

    index: int
    mount: Mount
    timing: Timing
    simulator: Simulator
    start_ns: int
    duration_ns: int
    chunk_ns: int


def build_tasks(drive: Drive, chunk_ns: int) -> list[Task]:
    """The work of each sensor; sensor i of n starts i/n of a packet after the first. Raises ConfigError."""
    mounts = [_with_range(mount) for mount in drive.rig.mounts]
    trajectory = drive.trajectory
    start_ns = drive.start_ns
    timings = [checked_timing(mount, drive.duration_ns) for mount in mounts]
    for mount in mounts:
        check_place(mount.name, mount.position_m)
    if drive.vehicle:
        check_outside(drive.vehicle, mounts)
    starts_ns = [
        start_ns + i * one.pace(mount).period_ns // len(mounts)
        for i, (mount, one) in enumerate(zip(mounts, timings, strict=True))
    ]
    end_ns = max(starts_ns) + drive.duration_ns
    if start_ns < 0 or (end_ns + 500) // 1000 * 1000 >= TIME_END_NS:
        raise ConfigError("start and duration exceed the times of a pcap, 1970 to 2106-02-07T06:28:16 UTC")
    tracer = Tracer(drive.scene, _checked_start(trajectory, start_ns, end_ns), start_ns)
    tracer.check_span(0, (end_ns - start_ns) / SECOND_NS)
    bodies = Tracer(drive.vehicle.scene, np.zeros(3)) if drive.vehicle else None
    return [
        Task(i, mount, one, Simulator(i, mount, tracer, trajectory, bodies), first_ns, drive.duration_ns, chunk_ns)
        for i, (mount, one, first_ns) in enumerate(zip(mounts, timings, starts_ns, strict=True))
    ]


def _with_range(mount: Mount) -> Mount:
    """The mount; if its sensor's range is not known, with the range given by the rig."""
    if mount.sensor.range or not mount.range_m:
        return mount
    known = Range(source="the rig", min_m=mount.range_m[0], max_m=mount.range_m[1])
    return replace(mount, sensor=mount.sensor.model_copy(update={"range": known}))


def fired_fraction(mount: Mount) -> float:
    """The fraction of a revolution, or of a scan pattern's firings, in which the mount's lasers fire."""
    if mount.sensor.scan_pattern:
        return float(in_view(mount, mount.sensor.pattern.azimuth_rad).mean())
    low, high = mount.azimuth_fov_deg or (0.0, 360.0)
    return ((high - low) % 360.0 or 360.0) / 360.0


def most_returns_per_ns(mount: Mount, pace: PacketPace) -> float:
    """The rate of a mount's returns if each ray returns."""
    return pace.firings * fired_fraction(mount) * len(RETURN_TYPES[mount.return_mode]) / pace.period_ns


def checked_timing(mount: Mount, duration_ns: int) -> Timing:
    """When the mount's lasers fire. Raises ConfigError unless the sensor can be simulated for this long."""
    sensor = mount.sensor
    try:
        found = timing(sensor)
        found.check(mount)
    except ConfigError as error:
        raise error.of(mount.name) from None
    if sensor.range is None:
        what = f"sensor {sensor.name!r} has no range; add range: {{max_m: ...}} to its file, or range_m to the rig"
        raise ConfigError(f"{mount.name}: {what}")
    period_ns = found.pace(mount).period_ns
    if duration_ns < period_ns:
        raise ConfigError(
            f"a duration of {duration_ns / SECOND_NS:g} s holds no packet of {mount.name}; "
            f"allowed: at least {period_ns / SECOND_NS:g} s"
        )
    return found


def check_place(name: str, position_m: Sequence[float] | Array) -> None:
    """Raises ConfigError if the position of what is called `name` is beyond the largest coordinate."""
    for axis, value in zip("xyz", position_m, strict=True):
        if not abs(value) <= COORDINATE_MAX_M:
            allowed = f"{-COORDINATE_MAX_M:g} to {COORDINATE_MAX_M:g}"
            raise ConfigError(f"{name} stands at {axis} = {value:g} m; allowed: {allowed}")


def _checked_start(trajectory: Trajectory, start_ns: int, end_ns: int) -> Array:
    """(3,): where the vehicle starts. Raises ConfigError if its trajectory is too short or leaves the world."""
    path = trajectory.path
    check_place("the vehicle", trajectory.T_world_start[:3, 3])
    path.check_span((start_ns - trajectory.zero_ns) / SECOND_NS, (end_ns - trajectory.zero_ns) / SECOND_NS)
    start_m: Array = trajectory.pose(start_ns)[:3, 3]
    far_m = path.speed_max_m_s * (end_ns - start_ns) / SECOND_NS
    check_place("the vehicle", start_m)
    if np.abs(start_m).max() + far_m > COORDINATE_MAX_M:
        raise ConfigError(f"the vehicle may get {far_m:g} m from its start; allowed: to {COORDINATE_MAX_M:g} m")
    return start_m


class SharedThreadPool:
    """Threads that the streams share, started when the first is read and stopped after the last."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._readers = 0
        self._pool: ThreadPoolExecutor | None = None

    @contextmanager
    def pool(self) -> Iterator[Executor]:
        """The threads; they stop after the last reader ends, for whatever reason."""
        self._pool = self._pool or ThreadPoolExecutor(self._threads)
        self._readers += 1
        try:
            yield self._pool
        finally:
            self._readers -= 1
            if not self._readers:
                self._pool.shutdown(cancel_futures=True)
                self._pool = None


class Progress:
    """The progress of all streams taken together."""

    def __init__(self, streams: int, on_progress: Callable[[int], None]) -> None:
        self._done_ns = [0] * streams
        self._on_progress = on_progress

    def set(self, stream: int, done_ns: int) -> None:
        """Record how far a stream has come."""
        self._done_ns[stream] = done_ns
        self._on_progress(sum(self._done_ns) // len(self._done_ns))


@dataclass(frozen=True)
class TaskRunner:
    """Runs the tasks of all sensors: their threads and their callbacks."""

    threads: SharedThreadPool
    progress: Progress
    on_rays: OnRays

    @classmethod
    def of(cls, options: SimulationOptions, sensors: int) -> "TaskRunner":
        """A runner with threads and progress shared by this many sensors."""
        threads = SharedThreadPool(options.threads or os.cpu_count() or 1)
        return cls(threads, Progress(sensors, options.on_progress), options.on_rays)


def map_chunks(task: Task, runner: TaskRunner, make: Callable[[FiringBatch, Echoes], T]) -> Iterator[T]:
    """The results of `make` for the firings and echoes of each non-empty chunk, in the order of time, on threads."""
    timing = task.timing
    mount = task.mount
    simulator = task.simulator
    pace = timing.pace(mount)
    total = task.duration_ns // pace.period_ns
    packets = max(min(task.chunk_ns // pace.period_ns, CHUNK_RAYS // (pace.firings * simulator.width)), 1)

    def work(batch: FiringBatch, first: int) -> tuple[T, RayCounts] | None:
        if not len(batch.sent_ns):
            return None
        found, counts = simulator.echoes(batch.firings, first)
        return make(batch, found), counts

    with runner.threads.pool() as pool:
        batches = timing.schedule(mount, task.start_ns, spans(total, packets))
        jobs = (pool.submit(work, batch, first) for batch, first in _numbered(batches))
        for number, chunk in enumerate(ordered_results(jobs, AHEAD), 1):
            if chunk:
                made = [chunk[0]]
                runner.on_rays(chunk[1])
                del chunk  # it would stay in memory while others are waited for
                yield made.pop()
            done_ns = number * packets * pace.period_ns
            runner.progress.set(task.index, done_ns if number * packets < total else task.duration_ns)


def _numbered(batches: Iterable[FiringBatch]) -> Iterator[tuple[FiringBatch, int]]:
    """Each batch with the number of its first firing."""
    first = 0
    for batch in batches:
        yield batch, first
        first += len(batch.firings.time_ns)
