"""What a rig's sensors send while the vehicle stands or moves in a scene."""

import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.pcap import TIME_END_NS, Frames, Sender
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.packets.firing import (
    Times,
    firing_chunks,
    packet_offsets_ns,
    packet_period_ns,
    packet_stamps_ns,
)
from lidarcfg.packets.velodyne.layout import check_encodable, encode, gprmc, position_packets, sent_returns
from lidarcfg.rig import Mount, Rig
from lidarcfg.simulate.ground_truth import RECORD, records
from lidarcfg.simulate.reach import Still
from lidarcfg.simulate.simulator import Counts, Observer, Plan, Stage
from lidarcfg.units import SECOND_NS
from lidarcfg.world.geodesy import geographic
from lidarcfg.world.motion import Trajectory, standing
from lidarcfg.world.raycast import Raycaster
from lidarcfg.world.scene import COORDINATE_MAX_M, Scene

START_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00:00 UTC: a fixed default, so that an export repeats
YEAR_2000_NS = 946_684_800 * 10**9
CHUNK_NS, CHUNK_RAYS = 1_000_000_000, 196_608  # cast at a time, at most: what is done once a chunk is not nothing
CHUNK_M = 3.0  # how far a vehicle gets meanwhile: beyond that little is sure of what its beams may meet
AHEAD = 1  # chunks of a sensor that are cast while others are written
POSITIONS = 1024  # position packets at a time
SLOWEST_M_S = 0.1  # a vehicle that is slower has its heading for a course

A = TypeVar("A")
B = TypeVar("B")
OnTruth = Callable[[NDArray[np.void]], None]
OnRays = Callable[[Counts], None]


def export(
    rig: Rig,
    scene: Scene,
    way: Array | Trajectory,
    duration_ns: int,
    start_ns: int = START_NS,
    on_progress: Callable[[int], None] = lambda done_ns: None,
    chunk_ns: int = CHUNK_NS,
    on_truth: OnTruth | None = None,
    on_rays: OnRays = lambda counts: None,
    skip: bool = True,
    threads: int | None = None,
) -> list[Iterator[Frames]]:
    """What each sensor of the rig sends, in the order of time. `in_time_order` merges them.

    `way` is where the vehicle stands, T_world_vehicle (4, 4), or how it moves; objects that move start at `start_ns`.
    Sensor i of n starts i/n of a packet later than the first, so that the packets interleave.
    `on_progress` is told the simulated time that is done, of `duration_ns`; `on_truth` the records of `truth.py`;
    `on_rays` how many rays there were; all by the thread that reads. With `skip`, rays are not cast that cannot meet
    anything in range, or only a few triangles, one of which is clearly first. Neither that, nor chunks, nor threads
    (as many as there are cores) change anything in what is sent. Raises ConfigError.
    """
    done = [0] * len(rig.mounts)

    def progress(index: int) -> Callable[[int], None]:
        def tell(done_ns: int) -> None:
            done[index] = done_ns
            on_progress(sum(done) // len(done))

        return tell

    trajectory = way if isinstance(way, Trajectory) else standing(way)
    for mount in rig.mounts:
        check_exportable(mount, duration_ns)
        check_place(mount.name, mount.position_m)
    starts_ns = [
        start_ns + i * packet_period_ns(m.sensor, m.return_mode == "dual") // len(rig.mounts)
        for i, m in enumerate(rig.mounts)
    ]
    end_ns = max(starts_ns) + duration_ns
    if start_ns < 0 or (end_ns + 500) // 1000 * 1000 >= TIME_END_NS:
        raise ConfigError("start and duration leave the time that a pcap can say, 1970 to 2106-02-07T06:28:16 UTC")
    caster = Raycaster(scene, _checked_start(trajectory, start_ns, end_ns), start_ns)
    for mover in caster.movers:
        try:
            mover.path.check_span(0, (end_ns - start_ns) / SECOND_NS)
        except ConfigError as error:
            raise ConfigError(f"{scene.names[mover.object]}: {error}") from None
    stage = Stage(caster, trajectory, Still(caster) if skip else None)
    if trajectory.path.speed_max_m_s:
        chunk_ns = min(chunk_ns, int(CHUNK_M / trajectory.path.speed_max_m_s * SECOND_NS))
    pool = ThreadPoolExecutor(threads or os.cpu_count())
    streams = []
    for i, (mount, first_ns) in enumerate(zip(rig.mounts, starts_ns, strict=True)):
        told = Told(progress(i), on_truth, on_rays)
        data = data_stream(i, mount, stage, first_ns, duration_ns, chunk_ns, pool, told)
        streams.append(in_time_order([data, position_stream(mount, scene, trajectory, first_ns, duration_ns)]))
    return streams


def _checked_start(trajectory: Trajectory, start_ns: int, end_ns: int) -> Array:
    """(3,): where the vehicle starts. Raises ConfigError unless its way covers the time and stays in the world."""
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
    """Streams that are each in the order of time, as one; where times are the same, the first stream's come first."""
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


def ahead(pool: Executor, work: Callable[[A], B], plans: Iterable[A]) -> Iterator[B]:
    """What the work makes of each plan, in their order; the pool's threads are a few plans ahead."""
    waiting: deque[Future[B]] = deque()
    for plan in plans:
        waiting.append(pool.submit(work, plan))
        if len(waiting) > AHEAD:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def check_exportable(mount: Mount, duration_ns: int) -> None:
    """Raises ConfigError unless the mount's sensor can be exported for this long."""
    sensor = mount.sensor
    try:
        check_encodable(sensor, mount.return_mode)
    except ConfigError as error:
        raise ConfigError(f"{mount.name}: {error}") from None
    for key in ("rotation", "range", "headers"):
        if getattr(sensor, key) is None:
            raise ConfigError(f"{mount.name}: sensor {sensor.name!r} is for placement only: it has no {key} facts")
    if duration_ns < packet_period_ns(sensor):
        raise ConfigError(
            f"a duration of {duration_ns / SECOND_NS:g} s holds no packet of {mount.name}; "
            f"allowed: at least {packet_period_ns(sensor) / SECOND_NS:g} s"
        )


def check_place(name: str, position_m: Sequence[float] | Array) -> None:
    """Raises ConfigError unless what is called `name` stands where a scene can be."""
    for axis, value in zip("xyz", position_m, strict=True):
        if not abs(value) <= COORDINATE_MAX_M:
            allowed = f"{-COORDINATE_MAX_M:g} to {COORDINATE_MAX_M:g}"
            raise ConfigError(f"{name} stands at {axis} = {value:g} m; allowed: {allowed}")


@dataclass(frozen=True)
class Told:
    """Who is told what, as it is done."""

    progress: Callable[[int], None]
    truth: OnTruth | None
    rays: OnRays


@dataclass(frozen=True)
class Sent:
    """What is known of a chunk once it is cast."""

    frames: Frames
    truth: NDArray[np.void]  # none if nobody asks
    counts: Counts


def data_stream(
    index: int,
    mount: Mount,
    stage: Stage,
    start_ns: int,
    duration_ns: int,
    chunk_ns: int,
    pool: Executor,
    told: Told,
) -> Iterator[Frames]:
    """The data packets that are complete within the duration, each sent when it is complete."""
    sensor, dual, observer = mount.sensor, mount.return_mode == "dual", Observer(index, mount, stage)
    assert sensor.headers
    sender = Sender(sensor.headers, sensor.headers.data, mount.host, mount.data_port)
    period_ns = packet_period_ns(sensor, dual)
    total = duration_ns // period_ns
    chunk = max(min(chunk_ns // period_ns, CHUNK_RAYS // (packet_offsets_ns(sensor, dual).size * observer.width)), 1)

    def work(plan: Plan) -> Sent | None:
        fired = plan.fired
        if not len(fired.time_ns):
            return None
        with stage.caster.turns.together():
            found, counts = observer.report(plan)
            measured_m = (found.range_m + found.noise_m).reshape(*fired.time_ns.shape, -1)
            reflectivity = found.reflectivity.reshape(measured_m.shape)
            seen = (measured_m, reflectivity) if dual else (measured_m[..., 0], reflectivity[..., 0])
            packets = encode(sensor, mount.return_mode, fired, *seen, mount.pps)
            truth = np.empty(0, RECORD)
            if told.truth:
                sent = sent_returns(sensor, mount.return_mode, packets)
                truth = records(index, mount.return_mode, fired.time_ns, found, *sent)
            ends_ns = _microseconds(packet_stamps_ns(sensor, fired)[1])
            return Sent(sender.frames(ends_ns, packets.view(np.uint8).reshape(len(packets), -1)), truth, counts)

    chunks = firing_chunks(sensor, mount.rpm, start_ns, total, chunk, dual, mount.phase_deg, mount.sector_deg)
    for number, sent in enumerate(ahead(pool, work, map(observer.plan, chunks)), 1):
        if sent:
            if told.truth:
                told.truth(sent.truth)
            told.rays(sent.counts)
            yield sent.frames
        told.progress(number * chunk * period_ns if number * chunk < total else duration_ns)


def position_stream(
    mount: Mount, scene: Scene, trajectory: Trajectory, start_ns: int, duration_ns: int
) -> Iterator[Frames]:
    """The position packets of a sensor that has them, evenly spaced."""
    facts, headers = mount.sensor.position_packet, mount.sensor.headers
    if facts is None:
        return
    assert headers
    assert headers.position
    sender = Sender(headers, headers.position, mount.host, mount.telemetry_port)
    period_ns = SECOND_NS / Fraction(facts.rate_hz)
    total = math.ceil(duration_ns / period_ns)
    for first in range(0, total, POSITIONS):
        numbers = range(first, min(first + POSITIONS, total))
        times_ns = start_ns + np.array([int(number * period_ns) for number in numbers], np.int64)
        sentences = nmea(mount, scene, trajectory, start_ns, times_ns)
        packets = position_packets(times_ns, mount.pps, sentences)
        payloads = packets.view(np.uint8).reshape(len(packets), -1)
        yield sender.frames(_microseconds(times_ns), payloads, first)


def nmea(mount: Mount, scene: Scene, trajectory: Trajectory, start_ns: int, times_ns: Times) -> list[bytes]:
    """The sentences that the sensor has of its receiver at these times (n,): with a fix if its pulse is locked."""
    facts, origin = mount.sensor.position_packet, scene.file.geo_origin
    seconds = times_ns // SECOND_NS
    if mount.pps != "locked":
        if mount.pps == "absent":
            if facts is None or facts.sentence_without_gps == "none":
                return [b""] * len(times_ns)
            seconds = (times_ns - start_ns + YEAR_2000_NS) // SECOND_NS
        by_second = {s: gprmc(s * SECOND_NS, None) for s in np.unique(seconds).tolist()}
        return [by_second[second] for second in seconds.tolist()]
    place_m = trajectory.world(np.zeros((len(times_ns), 3)), times_ns)
    ahead_m = trajectory.world(np.tile([1.0, 0.0, 0.0], (len(times_ns), 1)), times_ns) - place_m
    velocity_m_s = trajectory.velocity_m_s(times_ns)
    speed_m_s = np.hypot(*velocity_m_s[:, :2].T)
    way = np.where(speed_m_s[:, None] >= SLOWEST_M_S, velocity_m_s, ahead_m)
    course_rad = np.arctan2(way[:, 1], way[:, 0])
    found: dict[tuple[int, tuple[float, ...]], bytes] = {}  # a vehicle that stands has one sentence a second
    keys = [tuple(row) for row in np.column_stack([geographic(origin, place_m), course_rad, speed_m_s]).tolist()]
    for key in zip(seconds.tolist(), keys, strict=True):
        if key not in found:
            second, (latitude, longitude, course, speed) = key
            found[key] = gprmc(second * SECOND_NS, (latitude, longitude), course, speed)
    return [found[key] for key in zip(seconds.tolist(), keys, strict=True)]


def _microseconds(time_ns: Times) -> Times:
    """Rounded to whole microseconds, as the host's clock has it."""
    return (time_ns + 500) // 1000 * 1000
