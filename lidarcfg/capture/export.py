"""What a rig's sensors send while the vehicle stands in a scene."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from heapq import merge
from operator import attrgetter

from lidarcfg.capture.firing import firing_facts, firings, packet_period_ns, rays
from lidarcfg.capture.pcap import TIME_END_NS, Datagram
from lidarcfg.capture.raycast import Raycaster
from lidarcfg.capture.scene import COORDINATE_MAX_M, Scene
from lidarcfg.capture.velodyne import encode, position_packet
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, transform
from lidarcfg.rig import Mount, Rig

START_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00:00 UTC: a fixed default, so that an export repeats
CHUNK_NS = 100_000_000
SECOND_NS = 10**9


def export(
    rig: Rig,
    scene: Scene,
    T_world_vehicle: Array,
    duration_ns: int,
    start_ns: int = START_NS,
    on_progress: Callable[[int], None] = lambda done_ns: None,
    chunk_ns: int = CHUNK_NS,
) -> list[Iterator[Datagram]]:
    """What each sensor of the rig sends, in the order of time. `in_time_order` merges them.

    Sensor i of n starts i/n of a packet later than the first, so that the packets interleave.
    `on_progress` is told the simulated time that is done, of `duration_ns`. Raises ConfigError.
    """
    done = [0] * len(rig.mounts)

    def progress(index: int) -> Callable[[int], None]:
        def tell(done_ns: int) -> None:
            done[index] = done_ns
            on_progress(sum(done) // len(done))

        return tell

    for mount in rig.mounts:
        check_exportable(mount, duration_ns)
        check_place(mount.name, mount.position_m)
    check_place("the vehicle", T_world_vehicle[:3, 3])
    starts_ns = [start_ns + i * packet_period_ns(m.sensor) // len(rig.mounts) for i, m in enumerate(rig.mounts)]
    if start_ns < 0 or _microseconds(max(starts_ns) + duration_ns) >= TIME_END_NS:
        raise ConfigError("start and duration leave the time that a pcap can say, 1970 to 2106-02-07T06:28:16 UTC")
    raycaster = Raycaster(scene, T_world_vehicle[:3, 3])
    streams = []
    for i, (mount, first_ns) in enumerate(zip(rig.mounts, starts_ns, strict=True)):
        data = data_stream(mount, raycaster, T_world_vehicle, first_ns, duration_ns, progress(i), chunk_ns)
        position = position_stream(mount, scene, T_world_vehicle, first_ns, duration_ns)
        streams.append(in_time_order([data, position]))
    return streams


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
    mount: Mount,
    raycaster: Raycaster,
    T_world_vehicle: Array,
    start_ns: int,
    duration_ns: int,
    on_progress: Callable[[int], None],
    chunk_ns: int,
) -> Iterator[Datagram]:
    """The data packets that are complete within the duration, each sent when it is complete."""
    sensor, period_ns = mount.sensor, packet_period_ns(mount.sensor)
    T_world_sensor = T_world_vehicle @ mount.T_vehicle_sensor
    total, chunk = duration_ns // period_ns, max(chunk_ns // period_ns, 1)
    for first in range(0, total, chunk):
        numbers = range(first, min(first + chunk, total))
        fired = firings(sensor, mount.rpm, start_ns, numbers)
        origins, directions = rays(sensor, fired)
        range_m, reflectivity, _ = raycaster.cast(
            transform(T_world_sensor, origins.reshape(-1, 3)),
            directions.reshape(-1, 3) @ T_world_sensor[:3, :3].T,
        )
        shape = fired.time_ns.shape
        packets = encode(sensor, mount.return_mode, fired, range_m.reshape(shape), reflectivity.reshape(shape))
        for number, packet in zip(numbers, packets, strict=True):
            yield Datagram(
                time_ns=_microseconds(start_ns + (number + 1) * period_ns),
                host=mount.host,
                source_port=mount.data_port,
                port=mount.data_port,
                payload=packet.tobytes(),
            )
        on_progress(duration_ns if numbers.stop == total else numbers.stop * period_ns)


def position_stream(
    mount: Mount, scene: Scene, T_world_vehicle: Array, start_ns: int, duration_ns: int
) -> Iterator[Datagram]:
    """The position packets of a sensor that has them, evenly spaced."""
    if mount.sensor.position_packet is None:
        return
    period_ns = SECOND_NS / Fraction(mount.sensor.position_packet.rate_hz)
    east, north = map(float, T_world_vehicle[:2, 3])
    yaw_rad = math.atan2(T_world_vehicle[1, 0], T_world_vehicle[0, 0])
    for number in range(math.ceil(duration_ns / period_ns)):
        time_ns = start_ns + int(number * period_ns)
        yield Datagram(
            time_ns=_microseconds(time_ns),
            host=mount.host,
            source_port=mount.telemetry_port,
            port=mount.telemetry_port,
            payload=position_packet(time_ns, scene.file.geo_origin, (east, north), yaw_rad),
            counted=True,
        )


def _microseconds(time_ns: int) -> int:
    """Rounded to whole microseconds, as the host's clock has it."""
    return (time_ns + 500) // 1000 * 1000
