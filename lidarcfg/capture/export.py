"""The packets of a rig's sensors on a vehicle that stands or drives in a scene."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.ethernet import EthernetFrames, mount_frames
from lidarcfg.capture.ground_truth import RECORD, records
from lidarcfg.capture.wire import over_wire
from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec, first_packet
from lidarcfg.sensors.firing import FiringBatch
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.simulate.drive import checked_timing
from lidarcfg.simulate.echoes import Echoes
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.simulate.sensor_runs import (
    ChunkRunner,
    OnFault,
    SensorRun,
    SimulationOptions,
    check_duration,
    fired_fraction,
    map_chunks,
    sensor_runs,
)
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.geodesy import GeoOrigin
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene
from lidarcfg.world.vehicle import Vehicle

DRIFT_NS = 10_000_000  # in which a clock's drift counts as none in other packets than those of returns
OnTruth = Callable[[NDArray[np.void]], None]


def simulated_packets(
    rig: Rig,
    scene: Scene,
    at: Array | Trajectory,
    duration_ns: int,
    start_ns: int = START_NS,
    on_truth: OnTruth | None = None,
    vehicle: Vehicle | None = None,
    options: SimulationOptions | None = None,
) -> list[Iterator[EthernetFrames]]:
    """The frames that each sensor of the rig sends, in time order. `in_time_order` merges the streams.

    `at` is where the vehicle stands, T_world_vehicle (4, 4), or its trajectory; dynamic objects start at `start_ns`.
    The vehicle's bodies, if given, travel along and block beams; as objects they follow those of the scene.
    Sensor i of n starts i/n of a packet after the first, so that packets interleave. Packets have the rig's faults.
    `on_truth` is called with the records of `ground_truth`; like the functions of `options`, in the reader's thread.
    Raises ConfigError.
    """
    options = options or SimulationOptions()
    trajectory = at if isinstance(at, Trajectory) else Trajectory.static(at)
    check_all(rig.mounts, duration_ns)
    runs = sensor_runs(SceneDrive(rig, scene, trajectory, vehicle, start_ns, duration_ns), options.chunk_ns)
    runner = ChunkRunner.of(options, len(runs))
    origin = scene.file.geo_origin

    def sent(run: SensorRun) -> Iterator[EthernetFrames]:
        for number, packets in run.faults.costs(run.timing.pace(run.mount).period_ns).items():
            options.on_fault(number, packets)
        for session in run.sessions:
            data = _data_stream(session, runner, trajectory, on_truth, options.on_fault)
            yield from in_time_order([data, _housekeeping_stream(session, trajectory, origin)])

    streams = [sent(run) for run in runs]
    return [
        over_wire(stream, rig.faults_of(run.mount.name), start_ns, options.on_fault)
        for run, stream in zip(runs, streams, strict=True)
    ]


def save_sidecar_files(path: Path, mounts: Sequence[Mount]) -> list[Path]:
    """Write the files that readers need beside the capture at `path`, and return them."""
    written = []
    for mount in mounts:
        infix = f"-{mount.name}" if len(mounts) > 1 else ""
        for suffix, content in codec(mount.sensor).sidecar_files(mount).items():
            written.append(path.with_name(f"{path.stem}{infix}{suffix}"))
            with replacing(written[-1], "wb") as file:
                file.write(content)
    return written


def data_bytes(drive: SceneDrive) -> int:
    """About how many bytes of a capture the sensors' data packets take, as Ethernet frames. Raises ConfigError."""
    check_all(drive.rig.mounts, drive.duration_ns)
    total = 0.0
    for mount in drive.rig.mounts:
        maker = codec(mount.sensor)
        packet = first_packet(mount, drive.start_ns)
        pace = maker.pace(mount)
        packets = drive.duration_ns // pace.period_ns * fired_fraction(mount) * pace.share
        total += packets * sum(map(len, mount_frames(mount, packet).records))
    return round(total)


def check_all(mounts: Sequence[Mount], duration_ns: int) -> None:
    """Raises ConfigError unless all mounts can be exported: a capture of some would look like that of the whole rig."""
    for mount in mounts:
        try:
            check_exportable(mount, duration_ns)
        except ConfigError as error:
            without = [one.name for one in mounts if not one.sensor.codec]
            if mount.sensor.codec or len(without) == len(mounts):
                raise
            others = f"for packets of the other sensors, export a rig without {', '.join(without)}"
            raise ConfigError(f"{error}; {others}") from None


def check_exportable(mount: Mount, duration_ns: int) -> None:
    """Raises ConfigError unless the mount's sensor has packets and can be exported for this long."""
    sensor = mount.sensor
    try:
        codec(sensor)
    except ConfigError as error:
        hint = "" if sensor.codec else "; write points instead: .ply, .pcd, .npz, .mcap or a folder"
        raise error if error.at else ConfigError(f"{mount.name}: {error}{hint}") from None
    for key in ("range",) if sensor.scan_pattern else ("rotation", "range"):
        if getattr(sensor, key) is None:
            raise ConfigError(f"{mount.name}: sensor {sensor.name!r} is for placement only: it has no {key} facts")
    check_duration(mount, checked_timing(mount), duration_ns)


def in_time_order(streams: Iterable[Iterator[EthernetFrames]]) -> Iterator[EthernetFrames]:
    """Merge streams that are each in time order; at equal times, in the order of the streams."""
    sources = list(streams)
    heads: dict[int, EthernetFrames] = {}
    while True:
        for i, source in enumerate(sources):
            if i not in heads and (some := next(source, None)):
                heads[i] = some
        if not heads:
            return
        until_ns, last = min((int(head.time_ns[-1]), i) for i, head in heads.items())
        times_ns = []
        records = []
        for i, head in sorted(heads.items()):
            count = int(np.searchsorted(head.time_ns, until_ns, "right" if i <= last else "left"))
            times_ns.append(head.time_ns[:count])
            records += head.records[:count]
            if count < len(head.records):
                heads[i] = EthernetFrames(head.time_ns[count:], head.records[count:])
            else:
                del heads[i]
        together_ns = np.concatenate(times_ns)
        order = np.argsort(together_ns, kind="stable")
        yield EthernetFrames(together_ns[order], [records[k] for k in order.tolist()])


@dataclass(frozen=True)
class _TracedFrames:
    """A traced chunk."""

    frames: EthernetFrames
    truth: NDArray[np.void]  # empty if not wanted
    hits: Mapping[int, int]  # packets, by the fault of the sensor that hits them


def _data_stream(
    run: SensorRun, runner: ChunkRunner, trajectory: Trajectory, on_truth: OnTruth | None, on_fault: OnFault
) -> Iterator[EthernetFrames]:
    """The data packets completed within the duration, each sent when complete."""
    maker = codec(run.mount.sensor)
    mount = run.mount

    def make(fired: FiringBatch, found: Echoes) -> _TracedFrames:
        batch = run.faults.stamped(fired)
        range_m = found.range_m + found.noise_m
        encoded = maker.encode(mount, batch, range_m, found.reflectivity)
        payloads = maker.with_inertial(mount, trajectory, encoded)
        truth = np.empty(0, RECORD)
        if on_truth:
            types = maker.return_types(mount, range_m, found.reflectivity)
            sent = maker.sent(mount, batch, payloads)
            fired_ns = maker.fired_ns(mount, batch, range_m)
            truth = records(run.index, types, batch.firings, fired_ns, found, sent)
        return _TracedFrames(_frames(run, payloads), truth, run.faults.hits(batch.sent_ns))

    for chunk in map_chunks(run, runner, make):
        if on_truth:
            on_truth(chunk.truth)
        for number, packets in chunk.hits.items():
            on_fault(number, packets)
        yield chunk.frames


def _housekeeping_stream(run: SensorRun, trajectory: Trajectory, origin: GeoOrigin) -> Iterator[EthernetFrames]:
    """The sensor's other packets, a second at a time."""
    maker = codec(run.mount.sensor)
    for begin_ns in range(0, run.duration_ns, SECOND_NS):
        second_ns = range(begin_ns, min(begin_ns + SECOND_NS, run.duration_ns))
        for due_ns, ahead_ns in run.faults.steps(second_ns, run.start_ns, DRIFT_NS):
            motion = replace(trajectory, zero_ns=trajectory.zero_ns + ahead_ns)  # by the sensor's clock
            kinds = maker.housekeeping(run.mount, motion, origin, run.start_ns + ahead_ns, due_ns)
            if run.faults.of_sensor:
                kinds = chain(kinds, maker.states(run.mount, run.start_ns + ahead_ns, due_ns))
            sent = [replace(some, time_ns=some.time_ns - ahead_ns) for some in kinds if len(some.time_ns)]
            yield from in_time_order([iter([_frames(run, some)]) for some in sent])


def _frames(run: SensorRun, payloads: Payloads) -> EthernetFrames:
    """The frames of a sensor's packets, in which it reports what is wrong with it."""
    if run.faults.of_sensor:
        mount = run.mount
        payloads = codec(mount.sensor).report(mount, payloads, run.faults.condition(payloads.time_ns))
    return mount_frames(run.mount, payloads)
