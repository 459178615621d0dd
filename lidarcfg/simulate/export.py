"""The packets of a rig's sensors on a vehicle that stands or drives in a scene."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.frames import Frames, frames
from lidarcfg.capture.pcap import TIME_END_NS
from lidarcfg.config import COORDINATE_MAX_M
from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Batch, codec
from lidarcfg.rig import Mount, Rig
from lidarcfg.simulate.ground_truth import RECORD, records
from lidarcfg.simulate.simulator import Counts, Simulator
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory, standing
from lidarcfg.world.scene import GeoOrigin, Scene
from lidarcfg.world.tracer import Tracer
from lidarcfg.world.vehicle import Vehicle, check_outside

START_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00:00 UTC: a fixed default, so that an export is repeatable
CHUNK_NS, CHUNK_RAYS = 1_000_000_000, 196_608  # at most, traced at a time: each chunk has a fixed cost
AHEAD = 1  # chunks of a sensor that are traced while others are written

OnTruth = Callable[[NDArray[np.void]], None]
OnRays = Callable[[Counts], None]


@dataclass(frozen=True)
class Run:
    """How an export runs, and who follows it. Nothing of it changes a byte."""

    on_progress: Callable[[int], None] = lambda done_ns: None  # the simulated time so far, of the duration
    on_rays: OnRays = lambda counts: None  # the numbers of rays of each chunk
    chunk_ns: int = CHUNK_NS  # traced at a time, at most
    threads: int | None = None  # none: as many as cores


def export(
    rig: Rig,
    scene: Scene,
    at: Array | Trajectory,
    duration_ns: int,
    start_ns: int = START_NS,
    on_truth: OnTruth | None = None,
    vehicle: Vehicle | None = None,
    run: Run | None = None,
) -> list[Iterator[Frames]]:
    """What each sensor of the rig sends, in time order. `in_time_order` merges the streams.

    `at` is where the vehicle stands, T_world_vehicle (4, 4), or its trajectory; dynamic objects start at `start_ns`.
    The vehicle's bodies, if given, travel along and block beams; as objects they follow those of the scene.
    Sensor i of n starts i/n of a packet after the first, so that packets interleave.
    `on_truth` gets the records of `ground_truth`, in the thread that reads, as do the functions of `run`.
    Raises ConfigError.
    """
    run = run or Run()
    trajectory = at if isinstance(at, Trajectory) else standing(at)
    for mount in rig.mounts:
        check_exportable(mount, duration_ns)
        check_place(mount.name, mount.position_m)
    if vehicle:
        check_outside(vehicle, rig.mounts)
    starts_ns = [
        start_ns + i * codec(mount.sensor).pace(mount).period_ns // len(rig.mounts)
        for i, mount in enumerate(rig.mounts)
    ]
    end_ns = max(starts_ns) + duration_ns
    if start_ns < 0 or (end_ns + 500) // 1000 * 1000 >= TIME_END_NS:
        raise ConfigError("start and duration leave the time that a pcap can say, 1970 to 2106-02-07T06:28:16 UTC")
    tracer = Tracer(scene, _checked_start(trajectory, start_ns, end_ns), start_ns)
    tracer.check_span(0, (end_ns - start_ns) / SECOND_NS)
    bodies = Tracer(vehicle.scene, np.zeros(3)) if vehicle else None
    workers = _Workers(run.threads or os.cpu_count() or 1)
    progress = _Progress(len(rig.mounts), run.on_progress)
    streams = []
    for i, (mount, first_ns) in enumerate(zip(rig.mounts, starts_ns, strict=True)):
        simulator = Simulator(i, mount, tracer, trajectory, bodies)
        task = _Task(i, mount, simulator, first_ns, duration_ns, run.chunk_ns, on_truth is not None)
        data = _data_stream(task, workers, progress, on_truth, run.on_rays)
        housekeeping = _housekeeping_stream(task, trajectory, scene.file.geo_origin)
        streams.append(in_time_order([data, housekeeping]))
    return streams


def object_names(scene: Scene, vehicle: Vehicle | None) -> tuple[str, ...]:
    """What the ground truth calls the objects: those of the scene, and behind `vehicle/` those of the vehicle."""
    return scene.names + (tuple(f"vehicle/{name}" for name in vehicle.scene.names) if vehicle else ())


def save_companions(path: Path, mounts: Sequence[Mount]) -> list[Path]:
    """Write the files that readers need beside the capture at `path`, and return them."""
    written = []
    for mount in mounts:
        infix = f"-{mount.name}" if len(mounts) > 1 else ""
        for suffix, content in codec(mount.sensor).companions(mount).items():
            written.append(path.with_name(f"{path.stem}{infix}{suffix}"))
            with replacing(written[-1], "wb") as file:
                file.write(content)
    return written


def check_exportable(mount: Mount, duration_ns: int) -> None:
    """Raises ConfigError unless the mount's sensor can be exported for this long."""
    sensor = mount.sensor
    try:
        maker = codec(sensor)
        maker.check(mount)
    except ConfigError as error:
        raise ConfigError(f"{mount.name}: {error}") from None
    for key in ("rotation", "range"):
        if getattr(sensor, key) is None:
            raise ConfigError(f"{mount.name}: sensor {sensor.name!r} is for placement only: it has no {key} facts")
    period_ns = maker.pace(mount).period_ns
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


def in_time_order(streams: Iterable[Iterator[Frames]]) -> Iterator[Frames]:
    """Merge streams that are each in time order; at equal times, in the order of the streams."""
    sources = list(streams)
    heads: dict[int, Frames] = {}
    while True:
        for i, source in enumerate(sources):
            if i not in heads and (some := next(source, None)):
                heads[i] = some
        if not heads:
            return
        until_ns, last = min((int(head.time_ns[-1]), i) for i, head in heads.items())
        times_ns, records = [], []
        for i, head in sorted(heads.items()):
            count = int(np.searchsorted(head.time_ns, until_ns, "right" if i <= last else "left"))
            times_ns.append(head.time_ns[:count])
            records += head.records[:count]
            if count < len(head.records):
                heads[i] = Frames(head.time_ns[count:], head.records[count:])
            else:
                del heads[i]
        together_ns = np.concatenate(times_ns)
        order = np.argsort(together_ns, kind="stable")
        yield Frames(together_ns[order], [records[k] for k in order.tolist()])


class _Workers:
    """Threads that the streams share, started when the first is read and stopped after the last."""

    def __init__(self, threads: int) -> None:
        self._threads, self._readers = threads, 0
        self._pool: ThreadPoolExecutor | None = None

    @contextmanager
    def pool(self) -> Iterator[Executor]:
        """The threads; they stop once all readers are done, have stopped early or were interrupted."""
        self._pool = self._pool or ThreadPoolExecutor(self._threads)
        self._readers += 1
        try:
            yield self._pool
        finally:
            self._readers -= 1
            if not self._readers:
                self._pool.shutdown(cancel_futures=True)
                self._pool = None


class _Progress:
    """The progress of all streams together."""

    def __init__(self, streams: int, on_progress: Callable[[int], None]) -> None:
        self._done_ns, self._on_progress = [0] * streams, on_progress

    def set(self, stream: int, done_ns: int) -> None:
        """Record how far a stream has come."""
        self._done_ns[stream] = done_ns
        self._on_progress(sum(self._done_ns) // len(self._done_ns))


@dataclass(frozen=True)
class _Task:
    """The export of one sensor."""

    index: int
    mount: Mount
    simulator: Simulator
    start_ns: int
    duration_ns: int
    chunk_ns: int
    truth: bool  # whether records are wanted


@dataclass(frozen=True)
class _Chunk:
    """A traced chunk."""

    frames: Frames
    truth: NDArray[np.void]  # empty if not wanted
    counts: Counts


def _data_stream(
    task: _Task, workers: _Workers, progress: _Progress, on_truth: OnTruth | None, on_rays: OnRays
) -> Iterator[Frames]:
    """The data packets completed within the duration, each sent when complete."""
    maker, mount, duration_ns = codec(task.mount.sensor), task.mount, task.duration_ns
    simulator, pace = task.simulator, maker.pace(mount)
    total = duration_ns // pace.period_ns
    packets = max(min(task.chunk_ns // pace.period_ns, CHUNK_RAYS // (pace.firings * simulator.width)), 1)

    def work(batch: Batch, first: int) -> _Chunk | None:
        if not len(batch.sent_ns):
            return None
        found, counts = simulator.echoes(batch.firings, first)
        range_m = found.range_m + found.noise_m
        payloads = maker.encode(mount, batch, range_m, found.reflectivity)
        truth = np.empty(0, RECORD)
        if task.truth:
            types, sent = maker.return_types(mount, range_m, found.reflectivity), maker.sent(mount, batch, payloads)
            truth = records(task.index, types, batch.firings, found, sent)
        return _Chunk(frames(mount.host, payloads), truth, counts)

    with workers.pool() as pool:
        batches = maker.schedule(mount, task.start_ns, total, packets)
        jobs = (pool.submit(work, batch, first) for batch, first in _numbered(batches))
        for number, chunk in enumerate(_ahead(jobs), 1):
            if chunk:
                if on_truth:
                    on_truth(chunk.truth)
                on_rays(chunk.counts)
                yield chunk.frames
            done_ns = number * packets * pace.period_ns
            progress.set(task.index, done_ns if number * packets < total else duration_ns)


def _numbered(batches: Iterable[Batch]) -> Iterator[tuple[Batch, int]]:
    """Each with the number of its first firing."""
    first = 0
    for batch in batches:
        yield batch, first
        first += len(batch.firings.time_ns)


def _housekeeping_stream(task: _Task, trajectory: Trajectory, origin: GeoOrigin) -> Iterator[Frames]:
    """The sensor's other packets."""
    mount = task.mount
    payloads = codec(mount.sensor).housekeeping(mount, trajectory, origin, task.start_ns, task.duration_ns)
    for some in payloads:
        yield frames(mount.host, some)


def _ahead(jobs: Iterator[Future[_Chunk | None]]) -> Iterator[_Chunk | None]:
    """The results of jobs in order, while a few more run."""
    waiting: deque[Future[_Chunk | None]] = deque()
    for job in jobs:
        waiting.append(job)
        if len(waiting) > AHEAD:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
