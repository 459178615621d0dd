"""Writes what the rays of a drive hit, in whoever's scene: packets to a capture or to a host, points to a cloud.

`Drive.firings` has the rays. `lidarcfg.capture.export` sends the same packets from our own scenes.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from lidarcfg.capture.ethernet import mount_frames
from lidarcfg.capture.export import save_sidecar_files
from lidarcfg.capture.manifest import DriveInputs, manifest_path
from lidarcfg.capture.manifest_writer import ManifestInputs
from lidarcfg.capture.pcap import FILE_HEADER
from lidarcfg.capture.sender import UDP, PacedSender, Receiver, SendQueue
from lidarcfg.clouds.cloud import SUFFIXES, PointCloud, save_clouds
from lidarcfg.errors import LidarcfgError, PacketError
from lidarcfg.files import check_replaceable, remove_outdated, replacing
from lidarcfg.geometry import Array, Bytes
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.sensors.firing import RETURN_TYPES
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.drive import Drive, FiredPackets, RayBatch, SensorTimeline
from lidarcfg.simulate.echoes import EXACT, Echoes, SensorErrors
from lidarcfg.simulate.scans import reported
from lidarcfg.units import SECOND_NS, TIME_END_NS


class Sent(NamedTuple):
    """Payloads of a sensor."""

    stream: int  # by which those of one time are ordered
    mount: Mount
    payloads: Payloads


class Writer:
    """Writes what the rays of a drive hit to one or more outputs, from entering to leaving it.

    An output is a capture (.pcap), a host to which each packet is sent at its time, or later (udp://HOST or
    udp://HOST:PORT, IPv4), or a cloud (.ply, .pcd, .npz) in the frame of the rays, which is held in memory. Files are
    written whole, or not at all if the block ends with an error. With `noise`, the errors that the rig's `realism` has
    are added. Raises LidarcfgError.
    """

    def __init__(
        self, drive: Drive, *outputs: str | Path, noise: bool = True, on_warning: Callable[[str], None] = print
    ) -> None:
        names = [str(one) for one in outputs]
        if not names or len(set(names)) < len(names):
            what = f"{', '.join(names)}: one is given twice" if names else "no output"
            raise LidarcfgError(f"{what}; allowed: each a .pcap, {UDP}HOST[:PORT], or a cloud")
        self._drive = drive
        self._written = [0] * len(drive.sensors)  # firings of each sensor
        self._end_s: float | None = None  # None: nothing is written
        self._errors = [_errors(sensor, noise, on_warning) for sensor in drive.sensors]
        targets = [name for name in names if name.startswith(UDP)]
        paths = [Path(name) for name in names if not name.startswith(UDP)]
        self._captures = [_Capture(drive, path, on_warning) for path in paths if path.suffix.lower() == ".pcap"]
        self._clouds = [_Cloud(path) for path in paths if path.suffix.lower() != ".pcap"]
        self._streams: list[_Capture | _Hosts] = [*self._captures, *([_Hosts(targets)] if targets else [])]
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
            for stream in self._streams:
                stream.send((), TIME_END_NS)
            for cloud in self._clouds:
                cloud.save()
            duration_ns = round(self._end_s * SECOND_NS)
        for capture in self._captures:  # which are in place now
            capture.save_companions(duration_ns)

    def write(self, rays: RayBatch, ranges_m: Any, intensity: Any) -> None:
        """Write what a batch of N rays hit, the batches of the drive in their order.

        `ranges_m` is (N,), or (N, R) with up to as many returns as the rig's sensors report: those of the return mode,
        as `Codec.encode` has them; NaN or inf: none. `intensity` of the same shape is 0 to 100 for diffuse targets, in
        per cent, and above for retro-reflectors. Arrays are numpy's, or anything on the CPU with `__dlpack__` or
        `__array_interface__`. Raises LidarcfgError.
        """
        if not self._open:
            raise LidarcfgError("a writer writes from entering to leaving it: with Writer(…) as writer")
        range_m, bright = _returns(rays, ranges_m, intensity)
        self._check_order(rays)
        ends = np.cumsum([len(one.batch.firings.time_ns) for one in rays.packets])
        parts = [slice(end - len(one.batch.firings.time_ns), end) for end, one in zip(ends, rays.packets, strict=True)]
        seen = [self._reported(one, range_m[rows], bright[rows]) for one, rows in zip(rays.packets, parts, strict=True)]
        if self._codecs:
            self._send(rays, seen)
        for cloud in self._clouds:
            for one, rows, some in zip(rays.packets, parts, seen, strict=True):
                cloud.points.append(_points(self._drive.rig.mounts, one, rays, rows, *some))
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

    def _send(self, rays: RayBatch, seen: Sequence[tuple[Array, Bytes]]) -> None:
        """Send what the sensors report, and their other packets."""
        begin_ns, end_ns = (round(at_s * SECOND_NS) for at_s in (rays.start_s, rays.end_s))
        sent = []
        for one, returns in zip(rays.packets, seen, strict=True):
            if len(one.batch.sent_ns):
                mount = one.sensor.mount
                maker = self._codecs[one.sensor.index]
                encoded = maker.encode(mount, one.batch, *returns)
                payloads = maker.with_inertial(mount, self._drive.trajectory, encoded)
                sent.append(Sent(2 * one.sensor.index, mount, payloads))
        sent += self._housekeeping(range(begin_ns, end_ns))
        known_ns = min(
            sensor.start_ns + sensor.packets(end_ns) * sensor.timing.pace(sensor.mount).period_ns
            for sensor in self._drive.sensors
        )
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

    def _housekeeping(self, due_ns: range) -> Iterator[Sent]:
        """The other packets of all sensors."""
        for sensor, maker in zip(self._drive.sensors, self._codecs, strict=True):
            drive = self._drive
            for some in maker.housekeeping(sensor.mount, drive.trajectory, drive.origin, sensor.start_ns, due_ns):
                if len(some.time_ns):
                    yield Sent(2 * sensor.index + 1, sensor.mount, some)


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
    if bright.shape != range_m.shape:
        raise LidarcfgError(f"intensity is of shape {bright.shape}, not of that of ranges_m, {range_m.shape}")
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


class _Capture:
    """A capture, with the files that readers need and a manifest."""

    def __init__(self, drive: Drive, path: Path, on_warning: Callable[[str], None]) -> None:
        _check(path)
        _check(manifest_path(path))
        self._drive = drive
        self._path = path
        self._on_warning = on_warning
        self._waiting: list[tuple[int, int, bytes]] = []  # records that others may come before: time, stream

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
        for one in sent:
            made = mount_frames(one.mount, one.payloads)
            times = made.time_ns.tolist()
            self._waiting += zip(times, [one.stream] * len(times), made.records, strict=True)
        self._waiting.sort(key=lambda record: record[:2])
        ready = next((n for n, (at, *_) in enumerate(self._waiting) if at >= known_ns), len(self._waiting))
        self._file.write(b"".join(record for *_, record in self._waiting[:ready]))
        del self._waiting[:ready]

    def save_companions(self, duration_ns: int) -> None:
        """Write the files beside the capture, and remove those of an earlier one."""
        save_sidecar_files(self._path, self._drive.rig.mounts)
        inputs = ManifestInputs.of_rig(self._drive, duration_ns, self._path, DriveInputs())
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
