"""Writes what the rays of a drive hit, in whoever's scene: packets to a capture or to a host, points to a cloud.

`Drive.firings` has the rays. `lidarcfg.capture.export` sends the same packets from our own scenes.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from lidarcfg.capture.ethernet import mount_frames
from lidarcfg.capture.export import save_sidecar_files
from lidarcfg.capture.manifest import DriveInputs, manifest_path
from lidarcfg.capture.manifest_writer import ManifestInputs
from lidarcfg.capture.pcap import FILE_HEADER
from lidarcfg.capture.pose_log import PoseLog
from lidarcfg.capture.sender import UDP, PacedSender, Receiver, SendQueue
from lidarcfg.clouds.cloud import SUFFIXES, PointCloud, save_clouds
from lidarcfg.errors import LidarcfgError, PacketError
from lidarcfg.files import check_replaceable, remove_outdated, replacing
from lidarcfg.geometry import Array, Bytes, Times, transform
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.sensors.firing import RETURN_TYPES
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.drive import Drive, FiredPackets, RayBatch, SensorTimeline
from lidarcfg.simulate.echoes import EXACT, Echoes, SensorErrors
from lidarcfg.simulate.scans import reported
from lidarcfg.units import SECOND_NS, TIME_END_NS
from lidarcfg.world.motion import Trajectory, are_poses


class Sent(NamedTuple):
    """Payloads of a sensor."""

    stream: int  # by which those of one time are ordered
    mount: Mount
    payloads: Payloads


class Writer:
    """Writes what the rays of a drive hit to one or more outputs, from entering to leaving it.

    An output is a capture (.pcap), a host to which each packet is sent at its time, or later (udp://HOST or
    udp://HOST:PORT, IPv4), or a cloud (.ply, .pcd, .npz), which is held in memory: in the frame of the rays, or in the
    world where the vehicle's poses are given. Files are written whole, or not at all if the block ends with an error.
    With `noise`, the errors that the rig's `realism` has are added. Raises LidarcfgError.
    """

    def __init__(
        self, drive: Drive, *outputs: str | Path, noise: bool = True, on_warning: Callable[[str], None] = print
    ) -> None:
        names = [str(one) for one in outputs]
        if not names or len(set(names)) < len(names):
            what = f"{', '.join(names)}: one is given twice" if names else "no output"
            raise LidarcfgError(f"{what}; allowed: each a .pcap, {UDP}HOST[:PORT], or a cloud")
        if drive.rig.faults:
            raise LidarcfgError(f"rig {drive.rig.name!r} has faults, which only export makes; give it without")
        self._drive = drive
        self._written = [0] * len(drive.sensors)  # firings of each sensor
        self._end_s: float | None = None  # None: nothing is written
        self._poses: PoseLog | None = None  # of a vehicle that the drive does not move
        self._encoded: list[Sent] = []  # data packets that do not hold yet what an IMU measures
        self._told_ns = 0  # since the start: the packets that are no data are sent until then
        self._errors = [_errors(sensor, noise, on_warning) for sensor in drive.sensors]
        targets = [name for name in names if name.startswith(UDP)]
        paths = [Path(name) for name in names if not name.startswith(UDP)]
        self._captures = [_Capture(path, on_warning) for path in paths if path.suffix.lower() == ".pcap"]
        self._clouds = [_Cloud(path) for path in paths if path.suffix.lower() != ".pcap"]
        self._streams: list[_Capture | _Hosts] = [*self._captures, *([_Hosts(targets)] if targets else [])]
        self._telling_ns = 0 if targets else SECOND_NS  # from one time to the next, at least: it has a fixed cost
        self._codecs = []
        if self._streams:
            self._codecs = [codec(sensor.mount.sensor) for sensor in drive.sensors]
        self._open: ExitStack | None = None

    def __enter__(self) -> "Writer":
        with ExitStack() as opened:
            for one in self._streams:
                opened.enter_context(one.open())
            self._open = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        opened, self._open = self._open, None
        assert opened
        if error:
            opened.__exit__(kind, error, trace)  # captures stay as they were
            return
        with opened:
            if self._end_s is None:
                raise LidarcfgError("no rays were written")
            duration_ns = round(self._end_s * SECOND_NS)
            drive = self._followed(duration_ns)
            rest: list[Sent] = []
            if self._streams:
                rest = self._measured(drive.trajectory) + self._housekeeping(drive.trajectory, duration_ns)
            for stream in self._streams:
                stream.send(rest, TIME_END_NS)
            for cloud in self._clouds:
                cloud.save()
        for capture in self._captures:  # which are in place now
            capture.save_companions(drive, duration_ns)

    def write(self, rays: RayBatch, ranges_m: Any, intensity: Any, pose: Any = None) -> None:
        """Write what a batch of N rays hit, the batches of the drive in their order.

        `ranges_m` is (N,), or (N, R) with up to as many returns as the rig's sensors report: those of the return mode,
        as `Codec.encode` has them; NaN or inf: none. `intensity` of the same shape is 0 to 100 for diffuse targets, in
        per cent, and above for retro-reflectors; or one number for all. Arrays are numpy's, or anything on the CPU with
        `__dlpack__` or `__array_interface__`. `pose` T_world_vehicle (4, 4) is for rays in the vehicle's frame: where
        these were cast from, taken as that of the middle of the batch. Raises LidarcfgError.
        """
        if not self._open:
            raise LidarcfgError("a writer writes from entering to leaving it: with Writer(…) as writer")
        range_m, bright = _returns(rays, ranges_m, intensity)
        self._check_order(rays)
        T_world_vehicle = self._follow(rays, pose)
        ends = np.cumsum([len(one.batch.firings.time_ns) for one in rays.packets])
        parts = [slice(end - len(one.batch.firings.time_ns), end) for end, one in zip(ends, rays.packets, strict=True)]
        seen = [self._reported(one, range_m[rows], bright[rows]) for one, rows in zip(rays.packets, parts, strict=True)]
        if self._codecs:
            self._send(rays, seen)
        for cloud in self._clouds:
            for one, rows, some in zip(rays.packets, parts, seen, strict=True):
                points = _points(self._drive.rig.mounts, one, rays, rows, *some)
                cloud.points.append(replace(points, xyz=transform(T_world_vehicle, points.xyz)))
        for one in rays.packets:
            self._written[one.sensor.index] = one.first + len(one.batch.firings.time_ns)
        self._end_s = rays.end_s

    def _check_order(self, rays: RayBatch) -> None:
        """Raises LidarcfgError unless these are the drive's next packets."""
        for one in rays.packets:
            if one.sensor is not self._drive.sensors[one.sensor.index]:
                raise LidarcfgError("the rays are of another drive")
            if self._end_s is not None and one.first != self._written[one.sensor.index]:
                what = "the rays do not follow those before"
                raise LidarcfgError(f"{what}; write each batch of the drive once, in its order")

    def _follow(self, rays: RayBatch, pose: Any) -> Array:
        """Take the vehicle's pose; returns it. Raises LidarcfgError where there can be none, or must be one."""
        first = self._end_s is None
        T = np.eye(4)
        if pose is None:
            if self._poses:
                raise LidarcfgError("no pose; allowed: one with each batch, or none at all")
        elif rays.trajectory or not self._drive.trajectory.path.is_static:
            where = "rays in the world" if rays.trajectory else "a drive that moves"
            raise LidarcfgError(f'pose is given for {where}; allowed: for frame="vehicle" of a drive that stands')
        elif not (first or self._poses):
            raise LidarcfgError("a pose is given, but none with the batches before; allowed: one with each, or none")
        else:
            T = _array("pose", pose).astype(np.float64)
            if T.shape != (4, 4) or not are_poses(T[None])[0]:
                raise LidarcfgError("pose is none; allowed: T_world_vehicle (4, 4), a rotation and a shift")
            self._poses = self._poses or PoseLog(self._drive.start_ns, rays.start_s)
            self._poses.add(rays.start_s, rays.end_s, T)
        if first:
            self._told_ns = round(rays.start_s * SECOND_NS)
        return T

    def _followed(self, duration_ns: int) -> Drive:
        """The drive, along the poses that were given."""
        drive = self._drive
        if not self._poses:
            return drive
        whole = self._poses.whole((duration_ns + drive.late_ns) / SECOND_NS)
        return Drive(drive.rig, whole, start_ns=drive.start_ns, origin=drive.origin)

    def _send(self, rays: RayBatch, seen: Sequence[tuple[Array, Bytes]]) -> None:
        """Send what the sensors report, and their other packets as far as the vehicle's motion is known."""
        for one, returns in zip(rays.packets, seen, strict=True):
            if len(one.batch.sent_ns):
                payloads = self._codecs[one.sensor.index].encode(one.sensor.mount, one.batch, *returns)
                self._encoded.append(Sent(2 * one.sensor.index, one.sensor.mount, payloads))
        sent = [] if self._poses else self._measured(self._drive.trajectory)
        end_ns = settled_ns = round(rays.end_s * SECOND_NS)
        if self._poses:
            settled_ns = round(self._poses.settled_s * SECOND_NS) - self._drive.late_ns
        if settled_ns - self._told_ns > self._telling_ns:
            trajectory = self._drive.trajectory
            if self._poses:
                waiting_ns = (int(one.payloads.time_ns[0]) - self._drive.start_ns for one in self._encoded)
                trajectory = self._poses.recent(min([self._told_ns, *waiting_ns]) / SECOND_NS)
                sent = self._measured(trajectory, self._drive.start_ns + settled_ns)
            sent += self._housekeeping(trajectory, settled_ns)
        known_ns = min(
            sensor.start_ns + min(sensor.packets(end_ns) * sensor.timing.pace(sensor.mount).period_ns, self._told_ns)
            for sensor in self._drive.sensors
        )
        known_ns = min([known_ns, *(int(one.payloads.time_ns[0]) for one in self._encoded)])
        for stream in self._streams:
            stream.send(sent, known_ns // 1000 * 1000)

    def _reported(self, one: FiredPackets, range_m: Array, intensity: Bytes) -> tuple[Array, Bytes]:
        """Ranges and intensities of returns (N, R) as a sensor's mode has them, which may be fewer or more."""
        mount = one.sensor.mount
        count = len(RETURN_TYPES[mount.return_mode])
        if np.isfinite(range_m[:, count:]).any():
            what = f"{range_m.shape[1]} returns of a ray of {mount.name}"
            raise LidarcfgError(f"{what}; allowed: {count}, as its return mode is {mount.return_mode}")
        range_m, intensity = range_m[:, :count], intensity[:, :count]
        if range_m.shape[1] < count:
            shape = len(range_m), count
            range_m, intensity = np.broadcast_to(range_m, shape), np.broadcast_to(intensity, shape)
        elif count == 2:  # a ray with one return has it twice
            alone = ~np.isfinite(range_m[:, ::-1])
            range_m = np.where(alone, range_m, range_m[:, ::-1])[:, ::-1]
            intensity = np.where(alone, intensity, intensity[:, ::-1])[:, ::-1]
        errors = self._errors[one.sensor.index]
        if errors is None:
            return range_m, intensity
        found = Echoes(
            range_m=np.array(range_m),
            noise_m=np.zeros(range_m.shape),
            reflectivity=np.array(intensity),
            object=np.empty(range_m.shape, np.int32),
            strongest_m=range_m[np.arange(len(range_m)), np.argmax(intensity, axis=1)],
        )
        errors.add(found, one.batch.firings.laser, one.first)
        return found.range_m + found.noise_m, found.reflectivity

    def _measured(self, trajectory: Trajectory, end_ns: int = TIME_END_NS) -> list[Sent]:
        """The encoded packets of all sensors until then, with what their IMU measures."""
        found = [one for one in self._encoded if one.payloads.time_ns[-1] < end_ns]
        self._encoded = [one for one in self._encoded if one.payloads.time_ns[-1] >= end_ns]
        return [
            one._replace(payloads=self._codecs[one.stream // 2].with_inertial(one.mount, trajectory, one.payloads))
            for one in found
        ]

    def _housekeeping(self, trajectory: Trajectory, end_ns: int) -> list[Sent]:
        """The other packets of all sensors until then."""
        due_ns = range(self._told_ns, end_ns)
        self._told_ns = end_ns
        if not due_ns:
            return []
        origin = self._drive.origin
        return [
            Sent(2 * sensor.index + 1, sensor.mount, some)
            for sensor, maker in zip(self._drive.sensors, self._codecs, strict=True)
            for some in maker.housekeeping(sensor.mount, trajectory, origin, sensor.start_ns, due_ns)
            if len(some.time_ns)
        ]


def _errors(sensor: SensorTimeline, noise: bool, on_warning: Callable[[str], None]) -> SensorErrors | None:
    realism = sensor.mount.realism
    if not noise or realism is None or realism.model_copy(update={"seed": 0}) == EXACT:
        return None
    if realism.divergence or realism.range_10_percent_m:
        on_warning(f"{sensor.mount.name}: divergence and range_10_percent_m need our own scenes; ranges are the beam's")
    return SensorErrors(sensor.index, sensor.mount)


def _returns(rays: RayBatch, ranges_m: Any, intensity: Any) -> tuple[Array, Bytes]:
    """Ranges (N, R), inf where there is none, and intensities (N, R). Raises LidarcfgError."""
    count = len(rays.time_ns)
    range_m = _array("ranges_m", ranges_m).astype(np.float64, copy=False)
    bright = _array("intensity", intensity)
    if range_m.shape[:1] != (count,) or range_m.ndim > 2 or (range_m.ndim == 2 and not 1 <= range_m.shape[1] <= 2):
        raise LidarcfgError(f"ranges_m is of shape {range_m.shape}; allowed: ({count},), ({count}, 1) and ({count}, 2)")
    if bright.ndim == 0:
        bright = np.broadcast_to(bright, range_m.shape)
    if bright.shape != range_m.shape:
        raise LidarcfgError(f"intensity is of shape {bright.shape}; allowed: a number, or {range_m.shape} as ranges_m")
    if range_m.ndim == 1:
        range_m, bright = range_m[:, None], bright[:, None]
    wrong = range_m < 0
    if wrong.any():
        raise LidarcfgError(f"ranges_m has {range_m[wrong][0]:g} for ray {np.nonzero(wrong)[0][0]}; allowed: from 0 on")
    if bright.dtype != np.uint8:
        there = np.isfinite(range_m)
        wrong = there & ~((bright >= 0) & (bright <= 255))
        if wrong.any():
            where = np.nonzero(wrong)[0][0]
            raise LidarcfgError(f"intensity has {bright[wrong][0]:g} for ray {where}; allowed: 0 to 255")
        bright = np.rint(np.where(there, bright, 0)).astype(np.uint8)
    return np.fmin(range_m, np.inf), bright  # inf for NaN


def _array(name: str, given: Any) -> np.ndarray[Any, Any]:
    """An array of numbers. Raises LidarcfgError."""
    try:
        exported = hasattr(given, "__dlpack__") and not isinstance(given, np.ndarray)
        made = np.from_dlpack(given) if exported else np.asarray(given)
        if made.dtype.kind not in "fiu":
            raise TypeError(f"its numbers are {made.dtype}")
    except (TypeError, ValueError, BufferError, RuntimeError) as error:
        raise LidarcfgError(f"{name} is no array of numbers on the CPU: {error}") from None
    return made


def _points(
    mounts: Sequence[Mount], one: FiredPackets, rays: RayBatch, rows: slice, range_m: Array, intensity: Bytes
) -> PointCloud:
    """The points of a sensor's rays, in their frame."""
    mount = one.sensor.mount
    firing, which, kind = reported(mount, range_m, intensity)
    along_m = range_m[firing, which, None] * rays.directions[rows][firing]
    return PointCloud(
        xyz=rays.origins_m[rows][firing] + along_m,
        intensity=intensity[firing, which],
        ring=mount.sensor.ring.astype(np.uint8)[one.batch.firings.laser[firing]],
        time_ns=one.batch.firings.time_ns[firing],
        sensor=np.full(len(firing), one.sensor.index, np.uint16),
        sensor_names=tuple(mount.name for mount in mounts),
        return_type=kind,
    )


def _check(path: Path) -> None:
    """Raises LidarcfgError unless the path can be written."""
    try:
        check_replaceable(path)
    except OSError as error:
        raise PacketError.from_os(path, error) from None


class _Records(NamedTuple):
    """N records of a capture that others may come before."""

    time_ns: Times  # (N,)
    stream: Times  # (N,)
    records: list[bytes]


class _Capture:
    """A capture, with the files that readers need and a manifest."""

    def __init__(self, path: Path, on_warning: Callable[[str], None]) -> None:
        _check(path)
        _check(manifest_path(path))
        self._path = path
        self._on_warning = on_warning
        self._waiting = _Records(np.empty(0, np.int64), np.empty(0, np.int64), [])

    @contextmanager
    def open(self) -> Iterator[None]:
        """Take packets; the file is in place when this ends without an error."""
        try:
            with replacing(self._path, "wb") as self._file:
                self._file.write(FILE_HEADER)
                yield
        except OSError as error:
            raise PacketError.from_os(self._path, error) from None

    def send(self, sent: Sequence[Sent], known_ns: int) -> None:
        """Write packets. All that leave before `known_ns` have come."""
        found = [self._waiting]
        for one in sent:
            made = mount_frames(one.mount, one.payloads)
            found.append(_Records(made.time_ns, np.full(len(made.records), one.stream), made.records))
        time_ns, stream = (np.concatenate(column) for column in list(zip(*found, strict=True))[:2])
        records = list(chain.from_iterable(one.records for one in found))
        order = np.lexsort((stream, time_ns))
        ready = int(np.searchsorted(time_ns[order], known_ns))
        self._file.write(b"".join([records[n] for n in order[:ready].tolist()]))
        later = order[ready:]
        self._waiting = _Records(time_ns[later], stream[later], [records[n] for n in later.tolist()])

    def save_companions(self, drive: Drive, duration_ns: int) -> None:
        """Write the files beside the capture, and remove those of an earlier one."""
        save_sidecar_files(self._path, drive.rig.mounts)
        inputs = ManifestInputs.of_rig(drive, duration_ns, self._path, DriveInputs())
        remove_outdated(inputs.outdated(self._path))
        inputs.save(self._path, self._on_warning)


class _Hosts:
    """Hosts on the network, to which each packet is sent when its time has come, or later."""

    def __init__(self, targets: Sequence[str]) -> None:
        self._sender = PacedSender([Receiver.parse(target) for target in targets])
        self._queue = SendQueue()

    @contextmanager
    def open(self) -> Iterator[None]:
        """Take packets."""
        with self._sender:
            yield

    def send(self, sent: Sequence[Sent], known_ns: int) -> None:
        """Send packets. All that leave before `known_ns` have come."""
        for one in sent:
            self._queue.add(one.stream, one.mount.host, one.payloads)
        for datagram in self._queue.ready(known_ns):
            self._sender.send(datagram)


class _Cloud:
    """A file of points."""

    def __init__(self, path: Path) -> None:
        if path.suffix.lower() not in SUFFIXES:
            allowed = f".pcap, {', '.join(SUFFIXES)}, {UDP}HOST[:PORT]"
            raise LidarcfgError(f"{path}: is no output; allowed: {allowed}")
        _check(path)
        self._path = path
        self.points: list[PointCloud] = []

    def save(self) -> None:
        """Write them."""
        save_clouds(self._path, self.points)
