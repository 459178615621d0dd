"""Points of an Ouster's packets, by the metadata beside them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Decoder, Flags, Octets, Returns, Tally, Times
from lidarcfg.packets.ouster import kernels
from lidarcfg.packets.ouster.layout import columns, heads
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
        layout, metadata = self._layout, self._metadata
        packets = np.ascontiguousarray(packets[wanted])
        said, words = columns(layout, packets), words_of(packets)
        names = list(layout.profile.fields)
        pairs = [("range", "reflectivity"), ("range2", "reflectivity2")][: layout.profile.returns]
        ranges, bright = (layout.bits[[names.index(pair[k]) for pair in pairs]] for k in range(2))
        count = kernels.count_returns(words, said.valid, ranges, *place(layout), layout.pixels)
        laser, ring, intensity, kind = (np.empty(count, np.uint8) for _ in range(4))
        xyz, time_ns = np.empty((count, 3)), np.empty(count, np.int64)
        kernels.points(
            words,
            said.valid,
            said.measurement,
            said.time_ns,
            ranges,
            bright,
            place(layout),
            (beams(metadata), rings(metadata)),
            (layout.columns_per_frame, metadata.start_m, metadata.T_sensor_lidar),
            np.array([STRONGEST, LAST if metadata.nearest_first else SECOND], np.uint8),
            (xyz, time_ns, laser, ring, intensity, kind),
        )
        return Returns(xyz, np.empty(0), np.empty(0), time_ns, laser, ring, intensity, kind)

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


def beams(metadata: Metadata) -> Array:
    """(3, L) where beams point at encoder angle 0, in the lidar frame."""
    flat, azimuth = np.cos(metadata.elevation_rad), metadata.azimuth_rad
    return np.stack([flat * np.cos(azimuth), -flat * np.sin(azimuth), np.sin(metadata.elevation_rad)])


def rings(metadata: Metadata) -> Octets:
    """(L,) 0 is the lowest beam."""
    return np.argsort(np.argsort(metadata.elevation_rad, kind="stable")).astype(np.uint8)


def _packets_in_window(metadata: Metadata) -> Times:
    """The packets of a revolution, by number, that hold columns of the azimuth window."""
    layout, (first, last) = metadata.layout, metadata.window
    column = np.arange(layout.columns_per_frame)
    inside = (column - first) % layout.columns_per_frame <= (last - first) % layout.columns_per_frame
    return np.unique(column[inside] // layout.columns_per_packet)
