"""Simulated scans without packets: the points of each sensor's revolutions, and the object of each point."""

import heapq
import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.clouds.cloud import PointCloud, concatenate
from lidarcfg.geometry import Array, Bytes, Times
from lidarcfg.inputs import check_memory
from lidarcfg.packets.families import timing
from lidarcfg.sensors.firing import NO_ELEVATIONS, RETURN_TYPES, FiringBatch, Firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.simulate.echoes import Echoes
from lidarcfg.simulate.scene_drive import SceneDrive, object_names
from lidarcfg.simulate.sensor_runs import (
    CHUNK_RAYS,
    ChunkRunner,
    SensorRun,
    SimulationOptions,
    map_chunks,
    most_returns_per_ns,
    sensor_runs,
)
from lidarcfg.units import MINUTE_NS

RETURN_BYTES = 60  # of a scan that waits for those of other sensors; measured on a street, where 5 of 6 rays return
ROUNDING = 1e-9  # of revolutions
LAST = 1  # a type of return
SECOND_STRONGEST = 2  # another
STRONGEST_AT = {"dual": 0, "first-strongest": 1}  # of two returns, where the other may be the strongest instead


def simulated_scans(drive: SceneDrive, options: SimulationOptions | None = None) -> Iterator[PointCloud]:
    """The points of each sensor's revolutions in its own frame, in the order in which they end.

    A revolution begins where the head passes azimuth 0, or the start of a narrower field of view; of a scan pattern
    it is a frame. Ranges are not rounded as in packets; they are exact, except for the noise that the rig asks for.
    Raises ConfigError.
    """
    options = options or SimulationOptions()
    runs = sensor_runs(drive, options.chunk_ns)
    names = object_names(drive.scene, drive.vehicle)
    _check_memory(runs)
    runner = ChunkRunner.of(options, len(runs))
    streams = [_sensor_scans(run, runner, names) for run in runs]
    return heapq.merge(*streams, key=lambda scan: int(scan.time_ns[-1]))


def most_returns(drive: SceneDrive) -> int:
    """The number of points in a drive if each ray returns. Raises ConfigError."""
    rates = [most_returns_per_ns(mount, timing(mount.sensor).pace(mount)) for mount in drive.rig.mounts]
    return round(sum(rates) * drive.duration_ns)


def _check_memory(runs: Sequence[SensorRun]) -> None:
    """Raises LidarcfgError if memory does not hold a revolution of each sensor: it waits for those of the others."""
    held = 0
    for run in runs:
        rate = most_returns_per_ns(run.mount, run.timing.pace(run.mount))
        held += round(min(run.mount.frame_ns * rate + 2 * CHUNK_RAYS, run.duration_ns * rate))
    what = f"a revolution of each sensor, {len(runs):,} in all, and what is traced ahead,"
    check_memory(what, RETURN_BYTES * held, "export fewer sensors at a time")


@dataclass(frozen=True)
class _TracedPoints:
    """Points in the order of firing, and the number of each one's revolution."""

    cloud: PointCloud
    number: Times


def _sensor_scans(run: SensorRun, runner: ChunkRunner, object_names: tuple[str, ...]) -> Iterator[PointCloud]:
    """The scans of one sensor: a cloud for each revolution, in the sensor's frame."""
    mount = run.mount
    ring = mount.sensor.ring.astype(np.uint8)
    counter = _FrameCounter(run.start_ns, mount.frame_ns) if mount.sensor.scan_pattern else _RevolutionCounter.of(run)

    def make(batch: FiringBatch, found: Echoes) -> _TracedPoints:
        firing, cloud = _points(mount, batch.firings, found)
        number = counter.number(batch.firings.time_ns[firing], batch.firings.encoder_rad[firing])
        return _TracedPoints(replace(cloud, ring=ring[batch.firings.laser[firing]], object_names=object_names), number)

    begun: list[PointCloud] = []  # of many sensors one waits for the others: what it holds then is little else
    current = 0
    for number, cloud in chain.from_iterable(map(_split_revolutions, map_chunks(run, runner, make))):
        if begun and number != current:
            yield _merge_and_clear(begun)
        current = number
        begun.append(cloud)
        del cloud
    if begun:
        yield _merge_and_clear(begun)


def _split_revolutions(chunk: _TracedPoints) -> Iterator[tuple[int, PointCloud]]:
    """The points of each revolution in a chunk."""
    order = np.argsort(chunk.number, kind="stable")  # lasers that fire before their packet's time
    numbers, counts = np.unique(chunk.number, return_counts=True)
    rows = np.split(order, np.cumsum(counts)[:-1])
    parts = deque((number, chunk.cloud.rows(some)) for number, some in zip(numbers.tolist(), rows, strict=False))
    del chunk
    while parts:
        yield parts.popleft()


def _merge_and_clear(clouds: list[PointCloud]) -> PointCloud:
    """The clouds as one, which the list no longer holds."""
    whole = concatenate(clouds)
    clouds.clear()
    return whole


@dataclass(frozen=True)
class _FrameCounter:
    """The frames of a scan pattern, one after the other."""

    start_ns: int
    frame_ns: int

    def number(self, time_ns: Times, _encoder_rad: Array) -> Times:
        """(N,): the frames of firings."""
        return np.asarray((time_ns - self.start_ns) // self.frame_ns)


@dataclass(frozen=True)
class _RevolutionCounter:
    """How far the head has turned: a whole number of revolutions where one begins."""

    rate: float  # revolutions in a nanosecond
    zero_ns: int
    zero: float  # revolutions at that time
    begin_rad: float  # where revolutions begin
    last: int  # the number of the last one: lasers that fire a little after the duration's end are of it

    @classmethod
    def of(cls, run: SensorRun) -> "_RevolutionCounter":
        """The counter of a run's sensor, which starts with its first firing."""
        mount = run.mount
        begin_rad = math.radians(mount.azimuth_fov_deg[0]) if mount.azimuth_fov_deg else 0.0
        everywhere = replace(mount, azimuth_fov_deg=None)
        first = next(iter(run.timing.schedule(everywhere, run.start_ns, [range(1)]))).firings
        ahead = (first.encoder_rad[0] - begin_rad) % (2 * math.pi) / (2 * math.pi)
        rate = mount.rpm / MINUTE_NS
        zero_ns = int(first.time_ns[0])
        turned = ahead + (run.start_ns + run.duration_ns - zero_ns) * rate
        return cls(rate, zero_ns, float(ahead), begin_rad, math.ceil(turned - ROUNDING) - 1)

    def number(self, time_ns: Times, encoder_rad: Array) -> Times:
        """(N,): the revolutions of firings."""
        part = (encoder_rad - self.begin_rad) % (2 * math.pi) / (2 * math.pi)
        number = np.rint(self.zero + (time_ns - self.zero_ns) * self.rate - part).astype(np.int64)
        return np.minimum(number, self.last)


def _points(mount: Mount, fired: Firings, found: Echoes) -> tuple[Times, PointCloud]:
    """The points of N firings, and which firing each is of."""
    sensor = mount.sensor
    range_m = found.range_m + found.noise_m
    firing, which, kind = reported(mount, range_m, found.reflectivity)
    cloud = PointCloud(
        xyz=firing_ends(sensor, fired[firing], range_m[firing, which]),
        intensity=found.reflectivity[firing, which],
        ring=np.empty(0, np.uint8),
        time_ns=fired.time_ns[firing],
        sensor=np.zeros(len(firing), np.uint16),
        sensor_names=(mount.name,),
        return_type=kind,
        object=found.object[firing, which],
    )
    return firing, cloud


def reported(mount: Mount, range_m: Array, reflectivity: Bytes) -> tuple[Times, Times, Bytes]:
    """Which echoes (N, R) of firings a sensor reports: firing (M,), which of its R echoes, and the type of return."""
    assert mount.sensor.range
    least_m, most_m = mount.sensor.range.reported_m
    there = (range_m >= least_m) & (range_m <= most_m)
    kinds = np.broadcast_to(np.array(RETURN_TYPES[mount.return_mode], np.uint8), range_m.shape).copy()
    if mount.dual:
        bright = reflectivity
        alike = there.all(axis=1) & (range_m[:, 0] == range_m[:, 1]) & (bright[:, 0] == bright[:, 1])
        there[:, 1] &= ~alike
        if mount.return_mode in STRONGEST_AT:
            at = STRONGEST_AT[mount.return_mode]
            kinds[there.all(axis=1) & (bright[:, at] < bright[:, 1 - at]), at] = SECOND_STRONGEST
    firing, which = np.nonzero(there)
    return firing, which, kinds[firing, which]


def firing_ends(sensor: Sensor, fired: Firings, range_m: Array) -> Array:
    """(N, 3) the ends of the beams of firings in the sensor's frame."""
    ends_m = beam_ends(sensor, fired.laser, fired.encoder_rad, range_m, fired.elevation_rad)
    return ends_m + fired.start_m if len(fired.start_m) else ends_m


def beam_ends(
    sensor: Sensor,
    laser: NDArray[np.integer[Any]],
    encoder_rad: Array,
    range_m: Array,
    elevation_rad: Array = NO_ELEVATIONS,
) -> Array:
    """(N, 3) the ends of beams in the sensor's frame; those of a scan pattern have elevations."""
    azimuth_rad = encoder_rad + sensor.azimuth_offset_rad[laser]
    if not len(elevation_rad):
        elevation_rad = sensor.elevation_rad[laser]
    forward_m = sensor.forward_offset_m[laser]
    left_m = sensor.lateral_offset_m[laser]
    flat_m = range_m * maths.cos(elevation_rad)
    c = maths.cos(azimuth_rad)
    s = maths.sin(azimuth_rad)
    return np.stack(
        [
            flat_m * c + left_m * s + forward_m * maths.cos(encoder_rad),
            -flat_m * s + left_m * c - forward_m * maths.sin(encoder_rad),
            range_m * maths.sin(elevation_rad) + sensor.vertical_offset_m[laser],
        ],
        axis=1,
    )
