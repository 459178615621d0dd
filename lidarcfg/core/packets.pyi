from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]

class Returns(Protocol):
    """Columns of returns, to be written; those that are not asked for are empty."""

    @property
    def xyz_m(self) -> Array: ...
    @property
    def range_m(self) -> Array: ...
    @property
    def azimuth_rad(self) -> Array: ...
    @property
    def time_ns(self) -> Times: ...
    @property
    def laser(self) -> Bytes: ...
    @property
    def ring(self) -> Bytes: ...
    @property
    def intensity(self) -> Bytes: ...
    @property
    def return_type(self) -> Bytes: ...

class Lasers(Protocol):
    """The lasers of a sensor whose packets are blocks."""

    @property
    def elevation(self) -> Array: ...
    @property
    def azimuth_offset(self) -> Array: ...
    @property
    def forward(self) -> Array: ...
    @property
    def left(self) -> Array: ...
    @property
    def up(self) -> Array: ...
    @property
    def distance_offset(self) -> Array: ...
    @property
    def ring(self) -> Bytes: ...
    @property
    def near_offset(self) -> Array: ...
    @property
    def focal(self) -> Array: ...

class Slots(Protocol):
    """The slots of a packet's groups of blocks."""

    @property
    def laser(self) -> Times: ...
    @property
    def fraction(self) -> Array: ...
    @property
    def offset_ns(self) -> Times: ...
    @property
    def kind(self) -> Bytes: ...
    @property
    def other(self) -> Times: ...

class NearLasers(Protocol):
    """The lasers of a sensor whose distances near by have offsets of their own."""

    @property
    def elevation(self) -> Array: ...
    @property
    def azimuth_offset(self) -> Array: ...
    @property
    def left(self) -> Array: ...
    @property
    def distance_offset(self) -> Array: ...
    @property
    def near_offset(self) -> Array: ...

class HesaiLasers(Protocol):
    """The lasers of a Hesai sensor, and when they fire."""

    @property
    def cos_elevation(self) -> Array: ...
    @property
    def sin_elevation(self) -> Array: ...
    @property
    def cos_offset(self) -> Array: ...
    @property
    def sin_offset(self) -> Array: ...
    @property
    def ring(self) -> Bytes: ...
    @property
    def offset_ns(self) -> Times: ...
    @property
    def near_ns(self) -> Times: ...
    @property
    def lag_ns(self) -> Times: ...

class PacketFields(Protocol):
    """What Hesai packets say beside their blocks."""

    @property
    def unit_mm(self) -> Bytes: ...
    @property
    def start_ns(self) -> Times: ...
    @property
    def loop(self) -> Bytes: ...
    @property
    def dual(self) -> Flags: ...
    @property
    def near(self) -> Bytes: ...
    @property
    def far(self) -> Bytes: ...
    @property
    def turn(self) -> Array: ...

class VelodyneDecoder:
    """Decodes data packets (P, 1206) of one sensor."""

    def __init__(self, slots: Slots, lasers: Lasers, period_ns: int, group_ns: int, unit_m: float) -> None:
        """Copies the tables. From packet to packet it is period_ns, from group to group of blocks group_ns."""

    def count(self, packets: Bytes, wanted: Flags) -> int:
        """How many returns the packets that are wanted (P,) hold at most."""

    def decode(self, packets: Bytes, wanted: Flags, stamp_ns: Times, gap_ns: Times, kind: Bytes, out: Returns) -> int:
        """Fill in an entry for each return of the packets that are wanted (P,); returns how many.

        Stamps, the times to the next ones (0 for the last) and the types of single returns are (P,).
        """

class RobosenseDecoder:
    """The same of MSOP packets (P, 1248)."""

    def __init__(self, slots: Slots, lasers: Lasers, period_ns: int, group_ns: int, unit_m: float) -> None: ...
    def count(self, packets: Bytes, wanted: Flags) -> int: ...
    def decode(
        self, packets: Bytes, wanted: Flags, stamp_ns: Times, gap_ns: Times, kind: Bytes, out: Returns
    ) -> int: ...

class AiryDecoder:
    """The same of an Airy's packets (P, 1248)."""

    def __init__(self, slots: Slots, lasers: Lasers, period_ns: int, group_ns: int, unit_m: float) -> None: ...
    def count(self, packets: Bytes, wanted: Flags) -> int: ...
    def decode(
        self, packets: Bytes, wanted: Flags, stamp_ns: Times, gap_ns: Times, kind: Bytes, out: Returns
    ) -> int: ...

class HesaiDecoder:
    """Decodes packets (P, size) of one sensor."""

    def __init__(self, lasers: HesaiLasers, blocks: int, return_bytes: int, near_m: float, least: int) -> None:
        """Copies the tables. Distances of less than `least` units are no returns, those below `near_m` have near_ns."""

    def count(self, packets: Bytes, wanted: Flags) -> int:
        """How many returns the packets that are wanted (P,) hold at most."""

    def decode(self, packets: Bytes, wanted: Flags, fields: PacketFields, out: Returns) -> int:
        """Fill in an entry for each return of the packets that are wanted (P,); returns how many."""

def write_velodyne_returns(
    range_m: Array, reflectivity: Bytes, number: Times, offset_m: Array, limits: Sequence[float], packets: Bytes
) -> None:
    """Write into packets (P, 1206): slot s holds return number[s] of range_m and reflectivity (P, N).

    Limits are the least and greatest range, the unit, and how many units there may be.
    """

def write_robosense_returns(
    range_m: Array, reflectivity: Bytes, number: Times, offset_m: Array, limits: Sequence[float], packets: Bytes
) -> None:
    """The same of packets (P, 1248)."""

def write_airy_returns(
    range_m: Array, reflectivity: Bytes, number: Times, offset_m: Array, limits: Sequence[float], packets: Bytes
) -> None:
    """The same of an Airy's packets."""

def write_velodyne_near_returns(
    range_m: Array,
    reflectivity: Bytes,
    azimuth: Array,
    number: Times,
    laser: Times,
    lasers: NearLasers,
    limits: Sequence[float],
    packets: Bytes,
) -> None:
    """Write those returns again whose distances are corrected for x and y apart: at azimuth (P, N or N / 2)."""

def uncorrect_velodyne_intensities(laser: Times, focal: Array, packets: Bytes) -> None:
    """Write intensities again: those that the corrections (L, 4) make what they are, or come nearest."""

def write_hesai_returns(
    range_m: Array,
    reflectivity: Bytes,
    laser: Bytes,
    column: Times,
    inside: Flags,
    limits: Sequence[float],
    lasers: int,
    return_bytes: int,
    packets: Bytes,
) -> None:
    """Write into packets (P, size): block b holds column[b] of range_m and reflectivity (P, G F, R).

    Those are of laser (P, G F), if the group of blocks is inside (P, G).
    """

def crc32_mpeg2(packets: Bytes, first: int, end: int) -> NDArray[np.uint32]:
    """The CRC (P,) of each packet's bytes from first until end."""

def fire(
    revolutions: Array,
    stamp_ns: Times,
    offset_ns: Times,
    revolutions_per_ns: float,
    time_ns: Times,
    encoder_rad: Array,
) -> None:
    """Write times and azimuths (P, N) of firings that come at offsets (N,) after stamps (P,)."""
