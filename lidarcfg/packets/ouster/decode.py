"""Decodes an Ouster's packets into points, by the metadata beside them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times, product, transform
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics
from lidarcfg.packets.loss import HeadSpeed, PacketLossCounter, missing_numbers
from lidarcfg.packets.ouster.layout import (
    LEGACY_VALID,
    Layout,
    column_headers,
    packet_headers,
    unpack,
)
from lidarcfg.packets.ouster.telemetry import Metadata
from lidarcfg.sensors.firing import LAST, SECOND, STRONGEST

ENDS = "", "2"  # of the names of the first and of the second return's fields


class OusterDecoder(Decoder):
    """Packets of one source."""

    def __init__(self, where: str, metadata: Metadata, model: str) -> None:
        layout = metadata.layout
        self._where = where
        self._metadata = metadata
        self._model = model
        self._layout = layout
        self.period_ns = 100_000_000 * layout.columns_per_packet // layout.columns_per_frame  # as at 10 Hz
        self._profile = _profile(layout)
        self._beams = _beams(metadata)
        self._T = None if _upright(metadata.T_sensor_lidar) else metadata.T_sensor_lidar
        self._in_frame = _packets_in_window(metadata)
        self._losses = PacketLossCounter()
        self._speed = HeadSpeed(layout.columns_per_frame)

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        """(P,) the first column's. Columns outside a window may say 0."""
        time_ns = column_headers(self._layout, packets).time_ns
        return np.asarray(np.where(time_ns == 0, np.iinfo(np.int64).max, time_ns).min(axis=1))

    def heading_rad(self, packets: Bytes) -> Array:
        """(P,) 0 where revolutions begin, which is the sensor's back."""
        measurement = column_headers(self._layout, packets).measurement[:, :1].max(axis=1, initial=0)
        return np.asarray(measurement * (2 * np.pi / self._layout.columns_per_frame) % (2 * np.pi))

    def check(self, packets: Bytes) -> None:
        serial = self._metadata.serial
        if not len(packets) or self._layout.legacy or not serial:
            return
        found = packet_headers(self._layout, packets)
        if found.serial != serial:
            what = f"packets are of sensor {found.serial}, its metadata {self._metadata.name} of {serial}"
            raise PacketError(f"{self._where}: {what}")

    def count(self, packets: Bytes, wanted: Flags) -> None:
        if not wanted.any():
            return
        layout = self._layout
        frame = packet_headers(layout, packets).frame
        column = column_headers(layout, packets).measurement[:, 0]
        inside = np.searchsorted(self._in_frame, column // layout.columns_per_packet).clip(max=len(self._in_frame) - 1)
        cycle = layout.frames * len(self._in_frame)
        number = frame * len(self._in_frame) + inside
        gap_ns = np.diff(self.time_ns(packets, np.empty(0, np.int64)))
        self._losses.add(missing_numbers(number, cycle, np.where(gap_ns > 0, cycle // 2, 0)), wanted)
        turned = np.diff(frame * layout.columns_per_frame + column) % (layout.frames * layout.columns_per_frame)
        step = np.diff(number) % cycle
        self._speed.add(turned, gap_ns, wanted[1:] & (step > 0) & (step <= cycle // 2) & (gap_ns > 0))

    def statistics(self) -> DecodeStatistics:
        modes = ("strongest",) if self._layout.profile.returns == 1 else ("dual",)
        return DecodeStatistics((self._model,), modes, self._losses.lost, self._speed.rpm)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        layout = self._layout
        packets = np.ascontiguousarray(_select(packets, wanted))
        pixels = len(packets) * layout.columns_per_packet * layout.pixels
        returns = DecodedReturns.allocate(pixels * layout.profile.returns)
        count = core.decode_ouster_points(
            packets,
            layout.core,
            self._profile,
            self._beams,
            returns.xyz_m,
            returns.time_ns,
            returns.ring,
            returns.intensity,
            returns.return_type,
        )
        returns = returns._replace(laser=np.empty(0, np.uint8)).first(count)
        if self._T is not None:
            returns.xyz_m[:] = transform(self._T, returns.xyz_m)
        return returns

    def driver_columns(self, packets: Bytes, wanted: Flags) -> dict[str, NDArray[Any]]:
        """Fields that the profile does not have are 0, as with ouster-ros."""
        layout = self._layout
        packets = np.ascontiguousarray(_select(packets, wanted))
        found = unpack(layout, packets)
        ends = ENDS[: layout.profile.returns]
        ranges = np.stack([found[f"range{end}"] for end in ends], axis=-1)
        there = (ranges > 0) & column_headers(layout, packets).valid[:, :, None, None]
        none = np.zeros(ranges.shape[:3], np.uint32)
        signal = np.stack([found.get(f"signal{end}", none) for end in ends], axis=-1)
        return {
            "range_mm": ranges[there],
            "signal": signal[there],
            "near_ir": np.broadcast_to(found.get("near_ir", none)[..., None], ranges.shape)[there],
            "row": np.broadcast_to(np.arange(layout.pixels)[:, None], ranges.shape)[there],
        }


def _select(packets: Bytes, wanted: Flags) -> Bytes:
    """The wanted packets; a view, if they are consecutive."""
    rows = np.flatnonzero(wanted)
    consecutive = len(rows) > 0 and rows[-1] - rows[0] < len(rows)
    return packets[rows[0] : rows[-1] + 1] if consecutive else packets[wanted]


def _profile(layout: Layout) -> core.OusterProfile:
    ends = ENDS[: layout.profile.returns]
    ranges, reflectivities = ([layout.profile.fields[name + end] for end in ends] for name in ("range", "reflectivity"))
    assert all(field.bit % 32 == 0 for field in ranges)
    assert all((field.bit % 8, field.bits) == (0, 8) for field in reflectivities)
    return core.OusterProfile(
        status=layout.column - 4 if layout.legacy else 8,
        status_mask=LEGACY_VALID if layout.legacy else 1 << 16,
        returns=np.array(
            [(one.bit // 32, *divmod(other.bit, 32)) for one, other in zip(ranges, reflectivities, strict=True)]
        ),
        range_mask=ranges[0].most,
        unit_m=0.001 * (1 << ranges[0].dropped),
    )


def _beams(metadata: Metadata) -> core.OusterBeams:
    """All pixels of a column: in the sensor's frame, if the lidar stands upright in it, or else in the lidar's."""
    T = metadata.T_sensor_lidar if _upright(metadata.T_sensor_lidar) else np.eye(4)
    flat = maths.cos(metadata.elevation_rad)
    ahead_m, up_m = metadata.start_m
    count = metadata.layout.columns_per_frame
    angle = 2 * math.pi * (1 - np.arange(count) / count)
    heading = product(np.stack([maths.cos(angle), maths.sin(angle)], axis=1), T[:2, :2].T)
    return_types = STRONGEST, LAST if metadata.nearest_first else SECOND
    x, y, z = T[:3, 3].tolist()
    return core.OusterBeams(
        ahead=flat * maths.cos(metadata.azimuth_rad),
        right=flat * maths.sin(metadata.azimuth_rad),
        up=maths.sin(metadata.elevation_rad),
        heading=heading,
        ahead_m=ahead_m,
        origin_m=math.hypot(ahead_m, up_m),
        shift_m=(x, y, z + up_m),
        ring=np.argsort(np.argsort(metadata.elevation_rad, kind="stable")).astype(np.uint8),  # 0 is the lowest
        return_type=np.array(return_types[: metadata.layout.profile.returns], np.uint8),
    )


def _upright(T: Array) -> bool:
    """Whether it only turns about z, besides shifting."""
    cos = T[0, 0]
    sin = T[1, 0]
    return np.array_equal(T[:3, :3], [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def _packets_in_window(metadata: Metadata) -> Times:
    """The packets of a revolution, by number, that hold columns of the azimuth window."""
    layout = metadata.layout
    first, last = metadata.window
    column = np.arange(layout.columns_per_frame)
    inside = (column - first) % layout.columns_per_frame <= (last - first) % layout.columns_per_frame
    return np.unique(column[inside] // layout.columns_per_packet)
