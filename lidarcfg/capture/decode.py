"""A capture's points: pcap → packets → returns → cloud.

`CaptureReader` finds the LiDARs' packets in a pcap and gives them chunk by chunk: `Packets` are successive ones of one
sensor, in the order of its clock. `Packets.decode` asks the sensor's codec for their `DecodedReturns`, in the sensor's
frame, and `to_cloud` moves these into the vehicle's: a `PointCloud`. Chunks are decoded on all cores.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from lidarcfg.capture.manifest import load_manifest, rig_file
from lidarcfg.capture.reader import CHUNK_PACKETS, CaptureReader
from lidarcfg.capture.selection import ALL, Selection
from lidarcfg.capture.stream import Packets, SourceStats
from lidarcfg.clouds.cloud import PointCloud, concatenate, gather
from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.files import checked_path
from lidarcfg.futures import ordered_results
from lidarcfg.geometry import transform
from lidarcfg.packets.codec import DecodedReturns
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.units import START_NS
from lidarcfg.world.motion import Trajectory, load_path

POINT_BYTES = 3  # that a return takes at least in a capture: distance and intensity
POINTS_AT_FIRST = 1 << 26  # for which a cloud has room, however large its capture
ROWS = 1 << 14  # points transformed at a time: for more, BLAS starts threads of its own


def decode(
    path: str | Path,
    rig: Rig | Given | None = None,
    on_warning: Callable[[str], None] = print,
    deskew: bool = False,
    driver_view: bool = False,
    sidecars: Sequence[str | Path] = (),
    *,
    model: str | Path | None = None,
    from_s: float = 0.0,
    to_s: float = math.inf,
    sensors: Sequence[str] = (),
    trajectory: str | Path | Trajectory | None = None,
    truth: str | Path | None = None,
    on_stats: Callable[[SourceStats], None] | None = None,
) -> PointCloud:
    """All points of a capture as one cloud: in the rig's vehicle frame, or deskewed in the world frame.

    rig: a file, a dict with its keys or loaded; by default that of the capture's manifest. Without one, or with "none",
        each point is in its sensor's own frame.
    deskew: by the manifest, which names the motion; trajectory: by this one, a `Trajectory` or the file of a motion
        that starts at the origin when simulated time begins, START_NS.
    from_s, to_s: a part of the capture, in seconds after its first packet; sensors: those of these names, or host:port.
    model: of all sensors, whatever the packets say: a name of the catalogue, or a YAML file.
    sidecars: files of the sensors, of any name, that are read instead of those beside the capture: an Ouster's
        metadata, a Hesai's angles.
    driver_view: whether angles and times are as the makers' drivers compute them: Hesai's SDK with its firing time
        file, rs_driver.
    truth: the .npz of ground truth that was exported with the capture; the cloud then has `object`.
    on_stats: is told of each sensor's packets at the end: model, speed, losses.

    Raises LidarcfgError: PacketError, also for a capture without points; ConfigError; CloudError for the truth.
    """
    path = checked_path(path, "capture")
    if deskew and trajectory is not None:
        raise ConfigError("deskew is by the manifest, and a trajectory is given; allowed: one of them")
    motion = load_manifest(path).motion() if deskew else _motion(trajectory)
    if not isinstance(rig, Rig):
        given = rig if isinstance(rig, Mapping) else rig_file(path, None if rig is None else checked_path(rig, "rig"))
        rig = load_rig(given) if given else None
    if motion and not rig:
        raise ConfigError(f"{path}: deskewing needs the rig, which says where the sensors are on the vehicle")
    if truth is not None and not rig:
        raise ConfigError(f"{path}: truth needs the rig, which says which sensor is which")
    size = path.stat().st_size if path.is_file() else 0
    clouds = decode_pcap(
        path,
        on_warning,
        rig,
        None if model is None else str(model),
        on_stats=on_stats,
        selection=Selection(from_s, to_s, (sensors,) if isinstance(sensors, str) else tuple(sensors)),
        driver_view=driver_view,
        sidecars=sidecars,
    )
    cloud = gather(clouds, min(size // POINT_BYTES, POINTS_AT_FIRST))
    if truth is not None and rig:
        from lidarcfg.capture.ground_truth import with_objects  # with all that it needs of scenes

        cloud = with_objects(checked_path(truth, "truth"), cloud, rig)
    return replace(cloud, xyz=motion.world(cloud.xyz, cloud.time_ns)) if motion else cloud


def _motion(given: str | Path | Trajectory | None) -> Trajectory | None:
    """A trajectory, also of a file, from the origin."""
    if given is None or isinstance(given, Trajectory):
        return given
    return Trajectory(np.eye(4), load_path(checked_path(given, "trajectory")), START_NS)


def decode_pcap(
    path: str | Path,
    on_warning: Callable[[str], None],
    rig: Rig | None = None,
    model: str | None = None,
    chunk_packets: int = CHUNK_PACKETS,
    on_stats: Callable[[SourceStats], None] | None = None,
    selection: Selection = ALL,
    driver_view: bool = False,
    sidecars: Sequence[str | Path] = (),
) -> Iterator[PointCloud]:
    """The capture's points in clouds of at most about `chunk_packets` packets; memory does not grow with its length.

    With a rig the points are in the vehicle frame and the sensors are its mounts. Without one the points of each source
    (called host:port) are in its sensor's frame, and `sensor_names` grows as sources appear. `model` overrides what the
    packets say. `on_warning` gets a line if the file is cut off, `on_stats` the figures of each source at the end. A
    selected part decodes exactly as it does within the whole capture. `driver_view` and `sidecars` are those of
    `decode`. Raises PacketError and ConfigError.
    """
    reader = CaptureReader(path, on_warning, rig, model, selection, driver_view, sidecars)
    yield from decode_chunks(reader.chunks(chunk_packets))
    if on_stats:
        for stats in reader.stats():
            on_stats(stats)


def decode_chunks(chunks: Iterator[list[Packets]], driver: bool = False) -> Iterator[PointCloud]:
    """The points of each chunk of packets, in their order, decoded on all cores.

    With `driver`, clouds also have the columns that the makers' ROS drivers publish. Raises PacketError, ConfigError.
    """
    threads = os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        yield from ordered_results(_jobs(pool, chunks, driver), threads)


def _jobs(pool: ThreadPoolExecutor, chunks: Iterator[list[Packets]], driver: bool) -> Iterator[Future[PointCloud]]:
    """A job for each chunk. If reading fails, the last job fails, after the points that were read before."""
    try:
        for chunk in chunks:
            yield pool.submit(_decode_chunk, chunk, driver)
    except LidarcfgError as error:
        yield _failed(error)


def _failed(error: LidarcfgError) -> Future[PointCloud]:
    job: Future[PointCloud] = Future()
    job.set_exception(error)
    return job


def _decode_chunk(chunk: list[Packets], driver: bool) -> PointCloud:
    """The points of the packets of all sensors, as one cloud. Raises PacketError for invalid packets."""
    clouds = [to_cloud(packets, packets.decode(), driver) for packets in chunk]
    return clouds[0] if len(clouds) == 1 else concatenate(clouds)


def to_cloud(packets: Packets, returns: DecodedReturns, driver: bool = False) -> PointCloud:
    """The returns of packets as points of the vehicle's frame; without a rig, of the sensor's. Moves them in place."""
    sensor = packets.sensor
    xyz = returns.xyz_m
    if sensor.T_vehicle_sensor is not None:
        for first in range(0, len(xyz), ROWS):
            rows = xyz[first : first + ROWS]
            rows[:] = transform(sensor.T_vehicle_sensor, rows)
    return PointCloud(
        xyz=xyz,
        intensity=returns.intensity,
        ring=returns.ring,
        time_ns=returns.time_ns,
        sensor=np.full(len(xyz), sensor.index, np.uint16),
        sensor_names=packets.sensor_names,
        return_type=returns.return_type,
        driver=packets.decoder.driver_columns(packets.data, packets.wanted) if driver else {},
    )
