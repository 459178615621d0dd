"""Points of an Ouster's packets, by the metadata beside them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Decoder, Flags, Octets, Returns, Tally, Times
from lidarcfg.packets.ouster import decode_kernels as kernels
from lidarcfg.packets.ouster.layout import LEGACY_VALID, Layout, columns, heads
from lidarcfg.packets.ouster.metadata import Metadata
from lidarcfg.packets.ouster.pixels import fields, place, words_of
from lidarcfg.units import MINUTE_NS

STRONGEST, LAST, SECOND = 0, 1, 2


class OusterDecoder(Decoder):
    """Packets of one source."""

    def __init__(self, where: str, metadata: Metadata, model: str) -> None:
        self._where, self._metadata, self._model = where, metadata, model
        self._layout = layout = metadata.layout
        self.period_ns = 100_000_000 * layout.columns_per_packet // layout.columns_per_frame  # as at 10 Hz
        self._pixels, self._beams = _pixels(layout), _beams(metadata)
        self._in_frame = _packets_in_window(metadata)
        self._before: tuple[int, int, int] | None = None  # in the sequence of packets, of columns; device time
        self._lost = self._columns = self._time_ns = 0

    def time_ns(self, packets: Octets, host_ns: Times) -> Times:
        """See `Decoder`: the first column's. Columns outside a window may say 0."""
        said = columns(self._layout, packets).time_ns
        return np.asarray(np.where(said == 0, np.iinfo(np.int64).max, said).min(axis=1))

    def heading_rad(self, packets: Octets) -> Array:
        """See `Decoder`; 0 where revolutions begin, which is the sensor's back."""
        measurement = columns(self._layout, packets).measurement[:, :1].max(axis=1, initial=0)
        return np.asarray(measurement * (2 * np.pi / self._layout.columns_per_frame) % (2 * np.pi))

    def check(self, packets: Octets) -> None:
        """See `Decoder`."""
        serial = self._metadata.serial
        if not len(packets) or self._layout.legacy or not serial:
            return
        found = heads(self._layout, packets)
        if found.serial != serial:
            what = f"packets are of sensor {found.serial}, its metadata {self._metadata.name} of {serial}"
            raise PacketError(f"{self._where}: {what}")

    def count(self, packets: Octets, wanted: Flags) -> None:
        """See `Decoder`."""
        if not wanted.any():
            return
        packets, layout = packets[wanted], self._layout
        frame, column = heads(layout, packets).frame, columns(layout, packets).measurement[:, 0]
        inside = np.searchsorted(self._in_frame, column // layout.columns_per_packet).clip(max=len(self._in_frame) - 1)
        place = frame * len(self._in_frame) + inside
        times_ns = self.time_ns(packets, np.empty(0, np.int64))
        turned = frame * layout.columns_per_frame + column
        cycle = layout.frames * len(self._in_frame)
        for at in zip(place.tolist(), turned.tolist(), times_ns.tolist(), strict=True):
            if self._before:
                step = (at[0] - self._before[0]) % cycle
                if 0 < step < cycle // 2 and at[2] > self._before[2]:
                    self._lost += step - 1
                    self._columns += (at[1] - self._before[1]) % (layout.frames * layout.columns_per_frame)
                    self._time_ns += at[2] - self._before[2]
            self._before = at

    def tally(self) -> Tally:
        """See `Decoder`."""
        revolutions = self._columns / self._layout.columns_per_frame
        rpm = revolutions * MINUTE_NS / self._time_ns if self._time_ns else float("nan")
        modes = ("strongest",) if self._layout.profile.returns == 1 else ("dual",)
        return Tally((self._model,), modes, self._lost, rpm)

    def decode(self, packets: Octets, host_ns: Times, wanted: Flags) -> Returns:
        """See `Decoder`."""
        if not wanted.all():
            packets = packets[wanted]
        layout, words = self._layout, words_of(packets)
        slots = len(packets) * layout.columns_per_packet * layout.pixels
        returns = Returns.room(slots * layout.profile.returns)
        xyz, (time_ns, _, ring, intensity, kind) = returns.xyz_m.reshape(-1), returns[3:]
        out = kernels.Returned(xyz, time_ns, ring, intensity, kind)
        count = kernels.points(words, self._pixels, self._beams, self._beams.axes[:, 0].copy(), out)
        returns = returns._replace(laser=np.empty(0, np.uint8))
        return returns.first(count)

    def driver_columns(self, packets: Octets, wanted: Flags) -> dict[str, NDArray[Any]]:
        """See `Decoder`. What the profile does not have is 0, as with ouster-ros."""
        layout, packets = self._layout, np.ascontiguousarray(packets[wanted])
        found, ends = fields(layout, packets), ("", "2")[: layout.profile.returns]
        ranges = np.stack([found[f"range{end}"] for end in ends], axis=-1)
        there = (ranges > 0) & columns(layout, packets).valid[:, :, None, None]
        none = np.zeros(ranges.shape[:3], np.uint32)
        signal = np.stack([found.get(f"signal{end}", none) for end in ends], axis=-1)
        return {
            "range_mm": ranges[there],
            "signal": signal[there],
            "near_ir": np.broadcast_to(found["near_ir"][..., None], ranges.shape)[there],
            "row": np.broadcast_to(np.arange(layout.pixels)[:, None], ranges.shape)[there],
        }


def _pixels(layout: Layout) -> kernels.Pixels:
    names, ends = list(layout.profile.fields), ("", "2")[: layout.profile.returns]
    ranges, bright = (layout.bits[[names.index(f"{name}{end}") for end in ends]] for name in ("range", "reflectivity"))
    first, column, width = place(layout)
    head = layout.head // 4
    valid = (layout.column // 4 - 1, LEGACY_VALID) if layout.legacy else (2, 1 << 16)
    return kernels.Pixels(head, first - head, column, layout.columns_per_packet, valid, width, ranges, bright)


def _beams(metadata: Metadata) -> kernels.Beams:
    """All pixels of a column, in the sensor's frame."""
    flat, azimuth, T = np.cos(metadata.elevation_rad), metadata.azimuth_rad, metadata.T_sensor_lidar
    directions = np.stack([flat * np.cos(azimuth), -flat * np.sin(azimuth), np.sin(metadata.elevation_rad)], axis=1)
    ahead_m, up_m = metadata.start_m
    start = _turning(np.array([ahead_m, 0.0, up_m]), T[:3, :3])
    start[0] += T[:3, 3]
    kinds = STRONGEST, LAST if metadata.nearest_first else SECOND
    axes = np.ascontiguousarray(_turning(directions, T[:3, :3]).transpose(2, 0, 1))
    columns = metadata.layout.columns_per_frame
    angles = [2 * math.pi * (1 - column / columns) for column in range(columns)]
    return kernels.Beams(
        axes,
        2 if not axes[2, 1:].any() else 3,  # z does not, of a lidar that stands upright in its sensor
        np.array([(math.cos(angle), math.sin(angle)) for angle in angles]),
        start,
        math.hypot(ahead_m, up_m),
        np.argsort(np.argsort(metadata.elevation_rad, kind="stable")).astype(np.uint8),  # 0 is the lowest
        np.array(kinds[: metadata.layout.profile.returns], np.uint8),
    )


def _turning(vectors: Array, R: Array) -> Array:
    """(3, …) what is summed up, times 1, cosine and sine of an angle, to the vectors (…, 3) turned by it about z."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    none = np.zeros_like(x)
    return np.stack([np.stack(part, axis=-1) @ R.T for part in ((none, none, z), (x, y, none), (-y, x, none))])


def _packets_in_window(metadata: Metadata) -> Times:
    """The packets of a revolution, by number, that hold columns of the azimuth window."""
    layout, (first, last) = metadata.layout, metadata.window
    column = np.arange(layout.columns_per_frame)
    inside = (column - first) % layout.columns_per_frame <= (last - first) % layout.columns_per_frame
    return np.unique(column[inside] // layout.columns_per_packet)
