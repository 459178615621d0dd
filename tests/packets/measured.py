"""What the lasers of a recording measured, by the fields of its packets: also where nothing came back.

Decoding leaves these firings out; encoding takes them all, and gives the recorded packets again.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidarcfg.capture.pcap import read_batches
from lidarcfg.capture.source_finder import SourceFinder
from lidarcfg.geometry import Array, Bytes, Times
from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.families import codec
from lidarcfg.packets.hesai import Hesai
from lidarcfg.packets.hesai import layout as hesai_layout
from lidarcfg.packets.ouster import Ouster, telemetry
from lidarcfg.packets.ouster import layout as ouster_layout
from lidarcfg.packets.robosense import Robosense
from lidarcfg.packets.robosense import decode as robosense_decode
from lidarcfg.packets.robosense import layout as robosense_layout
from lidarcfg.packets.robosense.model import byte_offsets
from lidarcfg.packets.velodyne import Velodyne
from lidarcfg.packets.velodyne import layout as velodyne_layout
from lidarcfg.packets.velodyne import model as velodyne_model
from lidarcfg.packets.velodyne.decode import returned
from lidarcfg.sensors.firing import Firings
from lidarcfg.sensors.sensor import Sensor


class Recording(NamedTuple):
    """All packets of one flow, in the order of the capture."""

    name: str  # host:port
    source: PacketSource
    sensor: Sensor
    packets: Bytes  # (P, size)
    host_ns: Times  # (P,)


def recordings(path: Path, model: str | None = None) -> list[Recording]:
    """The flows of a capture, each with all of its packets in memory, as they were captured."""
    finder = SourceFinder(path, lambda warning: None, model=model)
    parts = {}
    for batch in read_batches(path, lambda warning: None):
        found, numbers = finder.lidar(batch)
        for flow, mine in finder.by_flow(numbers):
            parts.setdefault(flow, []).append(found[mine])
    out = []
    for flow, batches in parts.items():
        packets = np.concatenate([batch.payloads(flow.size) for batch in batches])
        host_ns = np.concatenate([batch.time_ns for batch in batches])
        out.append(Recording(flow.name, finder.source(flow), finder.sensor(flow, packets[:16]), packets, host_ns))
    return out


class Measured(NamedTuple):
    """N firings, in the order in which packets are encoded, and R returns of each."""

    firings: Firings
    range_m: Array  # (N, R) inf: none
    reflectivity: Bytes  # (N, R)


def measured(one: Recording) -> Measured:
    """Of a source's packets in the return mode that most of them are of."""
    maker = codec(one.sensor)
    match maker:
        case Velodyne():
            packets = velodyne_layout.packets_of(one.packets)
            usual = usual_mode(velodyne_model.is_dual(maker.unit.packet, packets) * 256 + packets["return_mode"])
            return velodyne(maker.unit, packets[usual], one.host_ns[usual])
        case Hesai():
            packets = maker.unit.packets_of(one.packets)
            return hesai(maker.unit, packets[usual_mode(packets["tail"]["return_mode"])])
        case Robosense():
            return robosense(maker.unit, one.packets)
        case Ouster():
            return ouster(telemetry.find_metadata(one.source, one.packets).layout, one.packets)
    raise ValueError(f"{one.sensor.name}: its packets say points, not firings")


def usual_mode(modes: np.ndarray) -> np.ndarray:
    """(P,): which packets are of the return mode that most are of."""
    values, counts = np.unique(modes, return_counts=True)
    return modes == values[counts.argmax()]


def velodyne(unit: velodyne_model.VelodyneUnit, packets: np.ndarray, host_ns: Times) -> Measured:
    """The head turns evenly from each block's azimuth to the next one's. Packets (P,) are of one mode."""
    dual = bool(velodyne_model.is_dual(unit.packet, packets)[0])
    schedule = unit.firing_schedule(dual)
    group = np.arange(schedule.sequences) // schedule.per_azimuth
    span = unit.span(dual)
    azimuth = packets["blocks"]["azimuth"][:, : span * (group[-1] + 1) : span].astype(np.float64)
    step = np.diff(azimuth.ravel(), append=np.nan).reshape(azimuth.shape) % velodyne_layout.REVOLUTION
    usual = np.nanmedian(step)
    step = np.where(step < 1.5 * usual, step, usual)  # a longer one leads over packets that are not there
    group_ns = schedule.per_azimuth * schedule.sequence_ns
    fraction = (schedule.offsets_ns - unit.head_offset_ns) / group_ns - group[:, None]
    head = (azimuth[:, group, None] + step[:, group, None] * fraction) * velodyne_layout.RADIANS
    time_ns = velodyne_layout.device_time_ns(packets["stamp_us"], host_ns)[:, None, None] + schedule.offsets_ns
    laser = np.broadcast_to(np.arange(unit.count, dtype=np.uint8), time_ns.shape).ravel()
    distance, reflectivity = returned(unit, "dual" if dual else "strongest", packets)
    range_m = distance * unit.resolution_m + unit.distance_offset_m[laser][:, None]
    range_m[distance == 0] = np.inf
    return Measured(Firings(time_ns.ravel(), laser, head.ravel()), range_m, reflectivity)


def hesai(unit, packets: np.ndarray) -> Measured:
    """All lasers of a block point where its azimuth says. Packets (P,) are of one mode; dual: strongest and last."""
    dual = bool(hesai_layout.is_dual(packets)[0])
    each = 1 + dual
    azimuth = packets["blocks"]["azimuth"][:, ::each]
    loop = 1 - (packets["mode_flag"] & 1).astype(int) if len(unit.fires) > 1 else np.zeros(len(packets), int)
    start_ns = hesai_layout.device_time_ns(packets)[:, None, None] + unit.group_ns(dual)[None, :, None]
    time_ns = start_ns + unit.offset_ns[loop][:, None, :]
    laser = np.broadcast_to(np.arange(unit.count, dtype=np.uint8), time_ns.shape)
    encoder = np.broadcast_to(hesai_layout.encoder_rad(azimuth)[:, :, None], time_ns.shape)
    fires = np.broadcast_to(unit.fires[loop][:, None, :], time_ns.shape)
    returns = packets["blocks"]["returns"]
    order = (1, 0) if dual else (0,)  # the last in the even block
    distance, reflectivity = (
        np.stack([returns[:, at::each][key][fires] for at in order], axis=-1) for key in ("distance", "reflectivity")
    )
    range_m = np.where(distance > 0, distance * (packets["header"]["unit_mm"][0] / 1000), np.inf)
    return Measured(Firings(time_ns[fires], laser[fires], encoder[fires]), range_m, reflectivity)


def robosense(unit, data: Bytes) -> Measured:
    """All lasers of a block point where its azimuth says."""
    packets = robosense_layout.packets_of(data, unit.series)
    dual = robosense_decode.is_dual(unit, packets)
    schedule = unit.firing_schedule(dual)
    azimuth = packets["blocks"]["azimuth"]
    azimuth = azimuth[:, :: azimuth.shape[1] // (schedule.sequences // schedule.per_azimuth)] * robosense_layout.RADIANS
    shape = len(packets), schedule.sequences, unit.count
    head = np.broadcast_to(azimuth.repeat(schedule.per_azimuth, axis=1)[:, :, None], shape)
    time_ns = robosense_layout.read_time_ns(packets)[:, None, None] + schedule.offsets_ns
    laser = np.broadcast_to(np.arange(unit.count, dtype=np.uint8), shape)
    at = byte_offsets(unit, dual)
    high, low, reflectivity = (data[:, at + byte].reshape(-1, 1 + dual) for byte in range(3))
    distance = (high.astype(np.int64) << 8 | low) & unit.series.distance_max
    range_m = np.where(distance > 0, distance * unit.resolution_m, np.inf)
    return Measured(Firings(time_ns.ravel(), laser.ravel(), head.ravel()), range_m, reflectivity)


def ouster(layout: ouster_layout.Layout, packets: Bytes) -> Measured:
    """All pixels, in the order of columns."""
    found = ouster_layout.unpack(layout, packets)
    columns = ouster_layout.column_headers(layout, packets)
    ends = ("", "2")[: layout.profile.returns]
    millimetres, reflectivity = (
        np.stack([found[name + end].ravel() for end in ends], axis=-1) for name in ("range", "reflectivity")
    )
    angle = 2 * np.pi * columns.measurement / layout.columns_per_frame
    firings = Firings(
        time_ns=np.repeat(columns.time_ns.ravel(), layout.pixels),
        laser=np.tile(np.arange(layout.pixels, dtype=np.uint8), columns.time_ns.size),
        encoder_rad=np.repeat(angle.ravel(), layout.pixels),
    )
    return Measured(firings, np.where(millimetres > 0, millimetres / 1000, np.inf), reflectivity.astype(np.uint8))
