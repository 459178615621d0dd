"""The work of a simulation: each sensor of a rig is traced chunk by chunk, on threads that all sensors share."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.errors import ConfigError
from lidarcfg.futures import ordered_results
from lidarcfg.geometry import Array
from lidarcfg.sensors.firing import RETURN_TYPES, FiringBatch, PacketPace, Timing, spans
from lidarcfg.sensors.pattern_timing import in_view
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.drive import FiredPackets, SensorTimeline, timelines
from lidarcfg.simulate.echoes import Echoes
from lidarcfg.simulate.faults import SensorFaults
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.simulate.simulator import RayCounts, Simulator
from lidarcfg.units import SECOND_NS, TIME_END_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.tracer import Tracer
from lidarcfg.world.vehicle import check_outside

CHUNK_NS = 1_000_000_000  # traced at a time, at most: each chunk has a fixed cost
CHUNK_RAYS = 196_608  # the same in rays
AHEAD = 1  # chunks of a sensor that are traced while others are written

OnRays = Callable[[RayCounts], None]
OnFault = Callable[[int, int], None]  # the number of a fault in the rig, and how many more packets it has hit
T = TypeVar("T")


@dataclass(frozen=True)
class SimulationOptions:
    """How a simulation runs, and what it calls meanwhile. None of this changes its results."""

    on_progress: Callable[[int], None] = lambda done_ns: None  # the simulated time so far, of the duration
    on_rays: OnRays = lambda counts: None  # the numbers of rays of each chunk
    on_fault: OnFault = lambda number, packets: None  # for each chunk
    chunk_ns: int = CHUNK_NS  # traced at a time, at most
    threads: int | None = None  # none: as many as cores


@dataclass(frozen=True)
class SensorRun(SensorTimeline):
    """The simulation of one sensor."""

    simulator: Simulator
    duration_ns: int
    chunk_ns: int
    faults: SensorFaults
    before_ns: int = 0  # since the sensor's start: it was unplugged since
    first: int = 0  # the number of its first firing, by which random numbers are drawn

    @property
    def sessions(self) -> list["SensorRun"]:
        """The same from each time that it is plugged in, to when it is unplugged."""
        period_ns = self.timing.pace(self.mount).period_ns
        found: list[SensorRun] = []
        for begin_ns, end_ns in self.faults.plugged(self.start_ns):
            before_ns = begin_ns - self.start_ns
            session = replace(
                self,
                start_ns=begin_ns,
                duration_ns=min(end_ns - begin_ns, self.duration_ns - before_ns),
                faults=self.faults.restarted(begin_ns, len(found)) if found else self.faults,
                before_ns=before_ns,
                first=before_ns // period_ns * self.timing.pace(self.mount).firings,
            )
            found.append(session)
        return found


def sensor_runs(drive: SceneDrive, chunk_ns: int) -> list[SensorRun]:
    """The work of each sensor; sensor i of n starts i/n of a packet after the first. Raises ConfigError."""
    trajectory = drive.trajectory
    start_ns = drive.start_ns
    sensors = timelines(drive.rig, start_ns)
    for sensor in sensors:
        check_duration(sensor.mount, sensor.timing, drive.duration_ns)
        check_place(sensor.mount.name, sensor.mount.position_m)
    if drive.vehicle:
        check_outside(drive.vehicle, drive.rig.mounts)
    end_ns = max(sensor.start_ns for sensor in sensors) + drive.duration_ns
    if start_ns < 0 or (end_ns + 500) // 1000 * 1000 >= TIME_END_NS:
        raise ConfigError("start and duration exceed the times of a pcap, 1970 to 2106-02-07T06:28:16 UTC")
    tracer = Tracer(drive.scene, _checked_start(trajectory, start_ns, end_ns), start_ns)
    tracer.check_span(0, (end_ns - start_ns) / SECOND_NS)
    bodies = Tracer(drive.vehicle.scene, np.zeros(3)) if drive.vehicle else None
    return [
        SensorRun(
            **vars(sensor),
            simulator=Simulator(sensor.index, sensor.mount, tracer, trajectory, bodies),
            duration_ns=drive.duration_ns,
            chunk_ns=chunk_ns,
            faults=SensorFaults.of(
                sensor.mount,
                drive.rig.faults_of(sensor.mount.name),
                sensor.timing,
                start_ns,
                sensor.start_ns + drive.duration_ns,
            ),
        )
        for sensor in sensors
    ]


def fired_fraction(mount: Mount) -> float:
    """The fraction of a revolution, or of a scan pattern's firings, in which the mount's lasers fire."""
    if mount.sensor.scan_pattern:
        return float(in_view(mount, mount.sensor.pattern.azimuth_rad).mean())
    low, high = mount.azimuth_fov_deg or (0.0, 360.0)
    return ((high - low) % 360.0 or 360.0) / 360.0


def most_returns_per_ns(mount: Mount, pace: PacketPace) -> float:
    """The rate of a mount's returns if each ray returns."""
    fired = pace.firings * fired_fraction(mount) * pace.share
    return fired * len(RETURN_TYPES[mount.return_mode]) / pace.period_ns


def check_duration(mount: Mount, timing: Timing, duration_ns: int) -> None:
    """Raises ConfigError unless the mount's sensor sends a packet in this time."""
    period_ns = timing.pace(mount).period_ns
    if duration_ns < period_ns:
        raise ConfigError(
            f"a duration of {duration_ns / SECOND_NS:g} s holds no packet of {mount.name}; "
            f"allowed: at least {period_ns / SECOND_NS:g} s"
        )


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
class ChunkRunner:
    """What traces the chunks of all sensors: their threads and their callbacks."""

    threads: SharedThreadPool
    progress: Progress
    on_rays: OnRays

    @classmethod
    def of(cls, options: SimulationOptions, sensors: int) -> "ChunkRunner":
        """A runner with threads and progress shared by this many sensors."""
        threads = SharedThreadPool(options.threads or os.cpu_count() or 1)
        return cls(threads, Progress(sensors, options.on_progress), options.on_rays)


def map_chunks(run: SensorRun, runner: ChunkRunner, make: Callable[[FiringBatch, Echoes], T]) -> Iterator[T]:
    """The results of `make` for the firings and echoes of each non-empty chunk, in the order of time, on threads."""
    simulator = run.simulator
    pace = run.timing.pace(run.mount)
    total = run.duration_ns // pace.period_ns
    packets = max(min(run.chunk_ns // pace.period_ns, CHUNK_RAYS // (pace.firings * simulator.width)), 1)

    def work(fired: FiredPackets) -> tuple[T, RayCounts] | None:
        batch = run.faults.fired(fired.batch)
        if not len(batch.sent_ns):
            return None
        first = run.first + fired.first
        found, counts = simulator.echoes(batch.firings, first)
        return make(batch, run.faults.seen(found, batch, first)), counts

    with runner.threads.pool() as pool:
        jobs = (pool.submit(work, fired) for fired in run.fired(spans(total, packets)))
        for number, chunk in enumerate(ordered_results(jobs, AHEAD), 1):
            if chunk:
                made = [chunk[0]]
                runner.on_rays(chunk[1])
                del chunk  # it would stay in memory while others are waited for
                yield made.pop()
            done_ns = number * packets * pace.period_ns
            runner.progress.set(run.index, run.before_ns + (done_ns if number * packets < total else run.duration_ns))
