"""Decodes MSOP packets into points."""

import math
from dataclasses import dataclass

import numpy as np

from lidarcfg import maths
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics
from lidarcfg.packets.emx.layout import (
    MODES,
    MSOP_ID,
    PITCH,
    PITCH_OFFSET,
    ROWS,
    SURFACES,
    YAW,
    Packets,
    packets_of,
    read_time_ns,
)
from lidarcfg.packets.emx.model import EmxUnit
from lidarcfg.packets.loss import PacketLossCounter, missing_numbers
from lidarcfg.sensors.firing import RETURN_TYPES

NAMES = {code: name for name, code in MODES.items()}


@dataclass(frozen=True)
class EmxTables:
    """What packets do not say themselves."""

    unit: EmxUnit
    pitch: Times  # (192,)
    return_mode: str

    @property
    def parts(self) -> int:
        """The packets of a column: each return of a pair has its place."""
        return len(RETURN_TYPES[self.return_mode])

    @property
    def numbers(self) -> int:
        """The packets of a frame."""
        return self.unit.columns * self.parts


class EmxDecoder(Decoder):
    """Decodes the packets of one EMX."""

    def __init__(self, where: str, tables: EmxTables) -> None:
        self._where = where
        self._tables = tables
        self._losses = PacketLossCounter()
        self.period_ns = tables.unit.pace(tables.parts == 2).period_ns

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        return read_time_ns(packets_of(packets))

    def heading_rad(self, packets: Bytes) -> Array:
        """(P,) the phase in a frame."""
        number = packets_of(packets)["number"].astype(np.float64) - 1
        return np.asarray(np.mod(number * (2 * math.pi / self._tables.numbers), 2 * math.pi))

    def check(self, packets: Bytes) -> None:
        check(self._where, packets_of(packets), self._tables.return_mode)

    def sound(self, packets: Bytes) -> Flags:
        found = packets_of(packets)
        return np.asarray(sound(found) & (found["return_mode"] == MODES[self._tables.return_mode]))

    def count(self, packets: Bytes, wanted: Flags) -> None:
        number: Times = packets_of(packets)["number"].astype(np.int64)
        numbers = self._tables.numbers
        self._losses.add(missing_numbers(number, numbers, numbers // 2), wanted)

    def statistics(self) -> DecodeStatistics:
        names = (self._tables.unit.name,), (self._tables.return_mode,)
        return DecodeStatistics(*names, self._losses.lost, math.nan)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        return decode(self._tables, packets_of(packets if wanted.all() else packets[wanted]))


def decode(tables: EmxTables, packets: Packets) -> DecodedReturns:
    """The returns in packets (P,); of a pair of equal ones, only the first."""
    points = packets["points"]
    there = points["distance"] != 0
    if tables.parts == 2:
        there[:, 1::2] &= points["distance"][:, ::2] != points["distance"][:, 1::2]
    packet, place = np.nonzero(there)
    row = place // tables.parts + ((packets["number"].astype(np.int64) - 1) % tables.parts * (ROWS // 2))[packet]
    range_m = points["distance"][there] * tables.unit.resolution_m
    lower_rad = np.radians(packets["pitch_offset"] / PITCH_OFFSET)
    yaw_rad = np.radians(packets["yaw"] / YAW)
    pitch_rad = np.radians(tables.pitch / PITCH)
    if lower_rad.any():
        elevation_rad = pitch_rad[row] - lower_rad[packet]
        flat_m = range_m * maths.cos(elevation_rad)
        up_m = range_m * maths.sin(elevation_rad)
    else:
        flat_m = range_m * maths.cos(pitch_rad)[row]
        up_m = range_m * maths.sin(pitch_rad)[row]
    kinds = np.array(RETURN_TYPES[tables.return_mode], np.uint8)
    return DecodedReturns(
        xyz_m=np.stack([flat_m * maths.cos(yaw_rad)[packet], flat_m * maths.sin(yaw_rad)[packet], up_m], axis=1),
        range_m=np.empty(0),
        azimuth_rad=np.empty(0),
        time_ns=read_time_ns(packets)[packet],
        laser=row.astype(np.uint8),
        ring=row.astype(np.uint8),
        intensity=points["intensity"][there],
        return_type=kinds[place % tables.parts],
    )


def sound(packets: Packets) -> Flags:
    """(P,) whether each is an MSOP packet."""
    right = (packets["id"] == MSOP_ID) & (packets["surface"] < SURFACES) & (packets["number"] > 0)
    return np.asarray(right & np.isin(packets["return_mode"], list(NAMES)))


def check(where: str, packets: Packets, return_mode: str) -> None:
    """Raises PacketError unless all of these packets (P,) are MSOP packets of one return mode."""
    wrong = packets["return_mode"] != MODES[return_mode]
    if wrong.any():
        found = packets["return_mode"][wrong][0]
        raise PacketError(
            f"{where} sends the return modes 0x{MODES[return_mode]:02X} and 0x{found:02X}; one is allowed"
        )
    if not sound(packets).all():
        raise PacketError(f"{where} sends packets whose beginning, number or surface is wrong")


def return_mode_of(where: str, packets: Packets) -> str:
    """The return mode that most of these packets (P,) say. Raises PacketError."""
    codes, counts = np.unique(packets["return_mode"], return_counts=True)
    code = int(codes[counts.argmax()])
    if code not in NAMES:
        known = ", ".join(f"0x{one:02X} {name}" for name, one in MODES.items())
        raise PacketError(f"{where} sends the return mode 0x{code:02X}; known: {known}")
    return NAMES[code]
