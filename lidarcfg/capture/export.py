"""What a rig's sensors send while the vehicle stands or moves in a scene."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from heapq import merge
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.firing import firing_chunks, firing_facts, packet_period_ns, packet_stamps_ns
from lidarcfg.capture.observe import Observer, Stage
from lidarcfg.capture.pcap import TIME_END_NS, Datagram
from lidarcfg.capture.raycast import Raycaster
from lidarcfg.capture.reach import balls
from lidarcfg.capture.scene import COORDINATE_MAX_M, Scene
from lidarcfg.capture.trajectory import Trajectory, standing
from lidarcfg.capture.truth import records
from lidarcfg.capture.velodyne import encode, position_packet, wire_distance
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.rig import Mount, Rig

START_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00:00 UTC: a fixed default, so that an export repeats
CHUNK_NS = 100_000_000
SECOND_NS = 10**9
POSITIONS = 1024  # position packets at a time
SLOWEST_M_S = 0.1  # a vehicle that is slower has its heading for a course

OnTruth = Callable[[NDArray[np.void]], None]


def export(
    rig: Rig,
    scene: Scene,
    way: Array | Trajectory,
    duration_ns: int,
    start_ns: int = START_NS,
    on_progress: Callable[[int], None] = lambda done_ns: None,
    chunk_ns: int = CHUNK_NS,
    on_truth: OnTruth | None = None,
    on_rays: Callable[[int, int], None] = lambda rays, cast: None,
    skip: bool = True,
) -> list[Iterator[Datagram]]:
    """What each sensor of the rig sends, in the order of time. `in_time_order` merges them.

    `way` is where the vehicle stands, T_world_vehicle (4, 4), or how it moves; objects that move start at `start_ns`.
    Sensor i of n starts i/n of a packet later than the first, so that the packets interleave.
    `on_progress` is told the simulated time that is done, of `duration_ns`; `on_truth` the records of `truth.py`;
    `on_rays` how many rays there were and how many were cast. With `skip`, rays that cannot meet anything in range
    are not cast, which changes nothing in what is sent. Raises ConfigError.
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
    if start_ns < 0 or _microseconds(end_ns) >= TIME_END_NS:
        raise ConfigError("start and duration leave the time that a pcap can say, 1970 to 2106-02-07T06:28:16 UTC")
    caster = Raycaster(scene, _checked_start(trajectory, start_ns, end_ns), start_ns)
    for mover in caster.movers:
        try:
            mover.path.check_span(0, (end_ns - start_ns) / SECOND_NS)
        except ConfigError as error:
            raise ConfigError(f"{scene.names[mover.object]}: {error}") from None
    stage = Stage(caster, trajectory, balls(caster) if skip else None, on_rays)
    streams = []
    for i, (mount, first_ns) in enumerate(zip(rig.mounts, starts_ns, strict=True)):
        data = data_stream(i, mount, stage, first_ns, duration_ns, progress(i), chunk_ns, on_truth)
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


def in_time_order(streams: Iterable[Iterator[Datagram]]) -> Iterator[Datagram]:
    """Streams that are each in the order of time, as one."""
    return merge(*streams, key=attrgetter("time_ns"))


def check_exportable(mount: Mount, duration_ns: int) -> None:
    """Raises ConfigError unless the mount's sensor can be exported for this long."""
    sensor = mount.sensor
    try:
        firing_facts(sensor)
    except ConfigError as error:
        raise ConfigError(f"{mount.name}: {error}") from None
    for key in ("rotation", "range"):
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


def data_stream(
    index: int,
    mount: Mount,
    stage: Stage,
    start_ns: int,
    duration_ns: int,
    on_progress: Callable[[int], None],
    chunk_ns: int,
    on_truth: OnTruth | None,
) -> Iterator[Datagram]:
    """The data packets that are complete within the duration, each sent when it is complete."""
    sensor, dual, observer = mount.sensor, mount.return_mode == "dual", Observer(index, mount, stage)
    period_ns = packet_period_ns(sensor, dual)
    total, chunk = duration_ns // period_ns, max(chunk_ns // period_ns, 1)
    chunks = firing_chunks(sensor, mount.rpm, start_ns, total, chunk, dual, mount.phase_deg, mount.sector_deg)
    for number, fired in enumerate(chunks, 1):
        if len(fired.time_ns):
            found = observer.report(fired)
            measured_m = (found.range_m + found.noise_m).reshape(*fired.time_ns.shape, -1)
            reflectivity = found.reflectivity.reshape(measured_m.shape)
            told = (measured_m, reflectivity) if dual else (measured_m[..., 0], reflectivity[..., 0])
            packets = encode(sensor, mount.return_mode, fired, *told)
            if on_truth:
                distance = [wire_distance(sensor, one_m).ravel() for one_m in np.moveaxis(measured_m, -1, 0)]
                on_truth(records(index, mount.return_mode, fired.time_ns, found, np.stack(distance, axis=1)))
            for end_ns, packet in zip(packet_stamps_ns(sensor, fired)[1].tolist(), packets, strict=True):
                yield Datagram(
                    time_ns=_microseconds(end_ns),
                    host=mount.host,
                    source_port=mount.data_port,
                    port=mount.data_port,
                    payload=packet.tobytes(),
                )
        on_progress(number * chunk * period_ns if number * chunk < total else duration_ns)


def position_stream(
    mount: Mount, scene: Scene, trajectory: Trajectory, start_ns: int, duration_ns: int
) -> Iterator[Datagram]:
    """The position packets of a sensor that has them, evenly spaced."""
    if mount.sensor.position_packet is None:
        return
    period_ns = SECOND_NS / Fraction(mount.sensor.position_packet.rate_hz)
    total = math.ceil(duration_ns / period_ns)
    for first in range(0, total, POSITIONS):
        numbers = range(first, min(first + POSITIONS, total))
        times_ns = start_ns + np.array([int(number * period_ns) for number in numbers], np.int64)
        place_m = trajectory.world(np.zeros((len(numbers), 3)), times_ns)
        ahead_m = trajectory.world(np.tile([1.0, 0.0, 0.0], (len(numbers), 1)), times_ns) - place_m
        velocity_m_s = trajectory.velocity_m_s(times_ns)
        speed_m_s = np.hypot(*velocity_m_s[:, :2].T)
        ahead = np.where(speed_m_s[:, None] >= SLOWEST_M_S, velocity_m_s, ahead_m)
        course_rad = np.arctan2(ahead[:, 1], ahead[:, 0])
        columns = (values.tolist() for values in (times_ns, place_m, course_rad, speed_m_s))
        for time_ns, (east, north, _), course, speed in zip(*columns, strict=True):
            yield Datagram(
                time_ns=_microseconds(time_ns),
                host=mount.host,
                source_port=mount.telemetry_port,
                port=mount.telemetry_port,
                payload=position_packet(time_ns, scene.file.geo_origin, (east, north), course, speed),
                counted=True,
            )


def _microseconds(time_ns: int) -> int:
    """Rounded to whole microseconds, as the host's clock has it."""
    return (time_ns + 500) // 1000 * 1000
