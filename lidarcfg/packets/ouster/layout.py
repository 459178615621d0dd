"""The layout of an Ouster's packets, as in ouster-sdk's parsing.cpp: little endian, bits from the lowest."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.geometry import Bytes, Flags, Times

PACKET_COLUMNS = 16
TICKS = 90112  # of the encoder in a revolution, which LEGACY columns say
LEGACY_VALID = 0xFFFFFFFF
ALERTS = 0x90  # as two recordings of firmware 3.2 have it in normal operation
CONSTANT = bytes.fromhex("dec00000efbeadde")  # what firmware 2.3 and 2.5 write where the CRC stands later
Footer = Literal["crc", "constant", "zero"]


@dataclass(frozen=True)
class Field:
    """A field in a pixel's bits. The lowest `dropped` bits of its value are not sent."""

    bit: int
    bits: int
    dropped: int = 0

    @property
    def most(self) -> int:
        """The largest value of the bits."""
        return (1 << self.bits) - 1


@dataclass(frozen=True)
class Profile:
    """A layout of the lidar packet. Fields of the second return end in 2."""

    pixel: int  # bytes
    fields: dict[str, Field]
    fusa: bool = False  # whether packets usually have the header of functional safety

    @property
    def returns(self) -> int:
        """The number of returns in a pixel."""
        return 1 + ("range2" in self.fields)


def _fields(**places: tuple[int, ...]) -> dict[str, Field]:
    return {name: Field(*place) for name, place in places.items()}


_LOW = _fields(range=(0, 15, 3), flags=(15, 1), reflectivity=(16, 8))
_LOW_NEAR_IR = _LOW | _fields(near_ir=(24, 8, 4))
_LOW_DUAL = _LOW_NEAR_IR | _fields(range2=(32, 15, 3), flags2=(47, 1), reflectivity2=(48, 8), window=(56, 8))
_SINGLE = _fields(range=(0, 19), flags=(19, 5), reflectivity=(32, 8), signal=(48, 16), near_ir=(64, 16))
_DUAL = _fields(
    range=(0, 19),
    flags=(19, 5),
    reflectivity=(24, 8),
    range2=(32, 19),
    flags2=(51, 5),
    reflectivity2=(56, 8),
    signal=(64, 16),
    signal2=(80, 16),
)
# `window` says how much a pixel's window is blocked, `zones` which zones its point is in (a bit each); red, green and
# blue are half floats.
PROFILES = {
    "LEGACY": Profile(
        12, _fields(range=(0, 20), flags=(28, 4), reflectivity=(32, 8), signal=(48, 16), near_ir=(64, 16))
    ),
    "RNG19_RFL8_SIG16_NIR16": Profile(12, _SINGLE | _fields(window=(88, 8))),
    "RNG19_RFL8_SIG16_NIR16_DUAL": Profile(16, _DUAL | _fields(near_ir=(96, 16), window=(120, 8))),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": Profile(12, _SINGLE | _fields(window=(40, 8), zones=(80, 16))),
    "RNG19_RFL8_SIG16_ZONE16_DUAL": Profile(16, _DUAL | _fields(zones=(96, 16), window=(120, 8))),
    "RNG19_RFL8_SIG16_NIR16_RGB16": Profile(
        16,
        _fields(
            range=(0, 19),
            flags=(19, 5),
            reflectivity=(24, 8),
            signal=(32, 16),
            near_ir=(48, 16),
            red=(64, 16),
            green=(80, 16),
            blue=(96, 16),
        ),
    ),
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": Profile(
        20, _DUAL | _fields(near_ir=(96, 16), red=(112, 16), green=(128, 16), blue=(144, 16))
    ),
    "RNG15_RFL8_NIR8": Profile(4, _LOW_NEAR_IR),
    "RNG15_RFL8_WIN8": Profile(4, _LOW | _fields(window=(24, 8))),
    "RNG15_RFL8_NIR8_ZONE16": Profile(8, _LOW_NEAR_IR | _fields(zones=(32, 16), window=(48, 8))),
    "RNG15_RFL8_NIR8_DUAL": Profile(8, _LOW_DUAL),
    "FUSA_RNG15_RFL8_NIR8_DUAL": Profile(8, _LOW_DUAL, fusa=True),
}


@dataclass(frozen=True)
class PacketHeaders:
    """The headers of P packets."""

    frame: Times  # (P,) revolutions, as far as the packet counts them
    init: int
    serial: int
    alerts: int = 0
    thermal_countdown: int = 0
    shot_countdown: int = 0
    thermal: int = 0
    shot: int = 0


@dataclass(frozen=True)
class ColumnHeaders:
    """The headers of the C columns in each of P packets."""

    time_ns: Times  # (P, C)
    measurement: Times  # (P, C)
    valid: Flags  # (P, C)


@dataclass(frozen=True)
class Layout:
    """The layout of the packets in one mode of a sensor."""

    name: str  # the profile's
    pixels: int  # of a column: the sensor's beams
    columns_per_frame: int
    columns_per_packet: int = PACKET_COLUMNS
    fusa: bool = False  # whether packets have the header of functional safety

    @cached_property
    def profile(self) -> Profile:
        """Of the pixels."""
        return PROFILES[self.name]

    @cached_property
    def legacy(self) -> bool:
        """Whether packets have no header, and frame numbers stand in the columns."""
        return self.name == "LEGACY"

    @cached_property
    def head(self) -> int:
        """Bytes before the columns."""
        return 0 if self.legacy else 32

    @cached_property
    def column_head(self) -> int:
        """Bytes before a column's pixels."""
        return 16 if self.legacy else 12

    @cached_property
    def column(self) -> int:
        """Bytes of a column."""
        return self.column_head + self.pixels * self.profile.pixel + 4 * self.legacy

    @cached_property
    def pixel(self) -> int:
        """Bytes of a pixel."""
        return self.profile.pixel

    @cached_property
    def size(self) -> int:
        """Bytes of a packet."""
        return self.head + self.columns_per_packet * self.column + (0 if self.legacy else 32)

    @cached_property
    def frames(self) -> int:
        """The number of frames after which the frame counter wraps."""
        return 1 << 32 if self.fusa else 1 << 16

    @cached_property
    def packets_per_frame(self) -> int:
        """Without an azimuth window."""
        return self.columns_per_frame // self.columns_per_packet

    @cached_property
    def core(self) -> core.OusterLayout:
        """Where the core finds columns and pixels."""
        return core.OusterLayout(
            head=self.head,
            columns_per_packet=self.columns_per_packet,
            column=self.column,
            column_head=self.column_head,
            pixels=self.pixels,
            pixel=self.pixel,
        )

    @cached_property
    def bits(self) -> NDArray[np.int64]:
        """(F, 3) of the profile's fields: the pixel's 32-bit word, shift in it, mask."""
        return self.bits_of(list(self.profile.fields))

    def bits_of(self, names: Sequence[str]) -> NDArray[np.int64]:
        """(F, 3) `bits` of some fields; those that the profile does not have get mask 0."""
        none = Field(0, 0)
        found = [self.profile.fields.get(name, none) for name in names]
        return np.array([(field.bit // 32, field.bit % 32, field.most) for field in found], np.int64)


def values(packets: Bytes, dtype: str, at: int) -> NDArray[Any]:
    """(P,) the numbers at a byte of each packet; a view."""
    return np.ndarray((len(packets),), np.dtype(dtype), packets, at, packets.strides[:1])


def column_values(layout: Layout, packets: Bytes, dtype: str, at: int) -> NDArray[Any]:
    """(P, C) the numbers at a byte of each column; a view."""
    if not len(packets):
        return np.empty((0, layout.columns_per_packet), np.dtype(dtype))
    shape = (len(packets), layout.columns_per_packet)
    strides = (packets.strides[0], layout.column)
    return np.ndarray(shape, np.dtype(dtype), packets, layout.head + at, strides)


def column_headers(layout: Layout, packets: Bytes) -> ColumnHeaders:
    """The headers of the columns in packets (P, size)."""
    if layout.legacy:
        valid = column_values(layout, packets, "<u4", layout.column - 4) == LEGACY_VALID
    else:
        valid = (column_values(layout, packets, "<u2", 10) & 1).astype(np.bool_)
    measurement = column_values(layout, packets, "<u2", 8).astype(np.int64)
    return ColumnHeaders(
        time_ns=column_values(layout, packets, "<u8", 0).astype(np.int64),
        measurement=measurement,
        valid=np.asarray(valid & (measurement < layout.columns_per_frame)),
    )


def packet_headers(layout: Layout, packets: Bytes) -> PacketHeaders:
    """The headers of packets (P, size); serial number, states and countdowns are the first packet's."""
    if layout.legacy:
        return PacketHeaders(values(packets, "<u2", 10).astype(np.int64), 0, 0)
    fusa = layout.fusa
    first = packets[0].tobytes()
    init, alerts, serial = (1, 8, 11) if fusa else (4, 12, 7)
    return PacketHeaders(
        frame=values(packets, "<u4" if fusa else "<u2", 4 if fusa else 2).astype(np.int64),
        init=int.from_bytes(first[init : init + 3], "little"),
        serial=int.from_bytes(first[serial : serial + 5], "little"),
        alerts=first[alerts],
        thermal_countdown=first[16],
        shot_countdown=first[17],
        thermal=first[18] & 15,
        shot=first[19] & 15,
    )


def write_packet_headers(layout: Layout, packets: Bytes, headers: PacketHeaders) -> None:
    """Write the headers of packets (P, size). LEGACY columns hold the frame's number."""
    if layout.legacy:
        column_values(layout, packets, "<u2", 10)[:] = headers.frame[:, None] % layout.frames
        return
    fusa = layout.fusa
    values(packets, "u1", 0)[:] = 1  # a lidar packet
    values(packets, "<u4" if fusa else "<u2", 4 if fusa else 2)[:] = headers.frame % layout.frames
    init, alerts, serial = (1, 8, 11) if fusa else (4, 12, 7)
    packets[:, init : init + 3] = np.frombuffer(headers.init.to_bytes(3, "little"), np.uint8)
    packets[:, serial : serial + 5] = np.frombuffer(headers.serial.to_bytes(5, "little"), np.uint8)
    packets[:, alerts] = headers.alerts
    packets[:, 16:20] = headers.thermal_countdown, headers.shot_countdown, headers.thermal, headers.shot


def add_frames(layout: Layout, packets: Bytes, count: int) -> None:
    """Add to the frame's number of packets (P, size), of the lidar or framed ones of the inertial unit."""
    if layout.legacy:
        column_values(layout, packets, "<u2", 10)[:] += np.uint16(count % layout.frames)
    elif layout.fusa:
        values(packets, "<u4", 4)[:] += np.uint32(count % layout.frames)
    else:
        values(packets, "<u2", 2)[:] += np.uint16(count % layout.frames)


def write_column_headers(layout: Layout, packets: Bytes, headers: ColumnHeaders) -> None:
    """Write the stamps, numbers and states of the columns in packets (P, size)."""
    column_values(layout, packets, "<u8", 0)[:] = headers.time_ns
    column_values(layout, packets, "<u2", 8)[:] = headers.measurement
    if layout.legacy:
        column_values(layout, packets, "<u4", 12)[:] = headers.measurement * (TICKS // layout.columns_per_frame)
        column_values(layout, packets, "<u4", layout.column - 4)[:] = np.where(headers.valid, LEGACY_VALID, 0)
    else:
        column_values(layout, packets, "<u2", 10)[:] = headers.valid


def unpack(layout: Layout, packets: Bytes) -> dict[str, NDArray[np.uint32]]:
    """(P, C, pixels) by the names of the profile's fields. Ranges are in millimetres."""
    shape = len(packets), layout.columns_per_packet, layout.pixels
    raw = np.empty((len(layout.profile.fields), len(packets) * layout.columns_per_packet * layout.pixels), np.uint32)
    core.unpack_ouster_fields(np.ascontiguousarray(packets), layout.bits, layout.core, raw)
    return {
        name: raw[i].reshape(shape) << np.uint32(field.dropped)
        for i, (name, field) in enumerate(layout.profile.fields.items())
    }


def assemble(
    layout: Layout,
    headers: PacketHeaders,
    columns: ColumnHeaders,
    raw: NDArray[np.uint32],
    bits: NDArray[np.int64],
    footer: Footer,
) -> Bytes:
    """(P, size) the packets with these raw fields (F, N), whose bits are as `Layout.bits_of` says."""
    packets = np.zeros((len(columns.time_ns), layout.size), np.uint8)
    write_packet_headers(layout, packets, headers)
    write_column_headers(layout, packets, columns)
    core.pack_ouster_fields(raw, bits, layout.core, packets)
    if not layout.legacy:
        if footer == "crc":
            values(packets, "<u8", layout.size - 8)[:] = crc64(packets)
        elif footer == "constant":
            packets[:, -8:] = np.frombuffer(CONSTANT, np.uint8)
    return packets


def crc64(data: Bytes) -> NDArray[np.uint64]:
    """(P,) CRC-64/XZ of rows (P, n), n being a multiple of four, but for its last eight bytes."""
    return core.crc64(np.ascontiguousarray(data), data.shape[1] - 8)
