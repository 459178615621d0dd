from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Words = NDArray[np.uint32]

class Layout(Protocol):
    """Where columns and pixels are in a packet, in bytes."""

    @property
    def head(self) -> int: ...
    @property
    def columns_per_packet(self) -> int: ...
    @property
    def column(self) -> int: ...
    @property
    def column_head(self) -> int: ...
    @property
    def pixels(self) -> int: ...
    @property
    def pixel(self) -> int: ...

class Profile(Protocol):
    @property
    def status(self) -> int: ...
    @property
    def status_mask(self) -> int: ...
    @property
    def returns(self) -> Integers: ...
    @property
    def range_mask(self) -> int: ...
    @property
    def unit_m(self) -> float: ...

class Beams(Protocol):
    @property
    def ahead(self) -> Array: ...
    @property
    def right(self) -> Array: ...
    @property
    def up(self) -> Array: ...
    @property
    def heading(self) -> Array: ...
    @property
    def ahead_m(self) -> float: ...
    @property
    def origin_m(self) -> float: ...
    @property
    def shift_m(self) -> tuple[float, float, float]: ...
    @property
    def ring(self) -> Bytes: ...
    @property
    def return_type(self) -> Bytes: ...

class Limits(Protocol):
    @property
    def least_m(self) -> float: ...
    @property
    def most_m(self) -> float: ...
    @property
    def start_m(self) -> float: ...
    @property
    def unit_m(self) -> float: ...
    @property
    def most_units(self) -> float: ...

def decode_points(
    packets: Bytes,
    layout: Layout,
    profile: Profile,
    beams: Beams,
    xyz_m: Array,
    time_ns: Integers,
    ring: Bytes,
    intensity: Bytes,
    return_type: Bytes,
) -> int:
    """Write the returns in packets (P, size), column by column, to columns with room for all; returns how many."""

def quantize_returns(
    range_m: Array, reflectivity: Bytes, limits: Limits, photons: Array, strongest_first: bool, out: Words
) -> None:
    """Write range, reflectivity and signal of (N, R) as packets have them to out (3 R, N); photons (256,) at 1 m."""

def pack_fields(values: Words, bits: Integers, layout: Layout, packets: Bytes) -> None:
    """Write fields (F, N) at bits (F, 3: word, shift, mask) into the pixels of packets (P, size)."""

def unpack_fields(packets: Bytes, bits: Integers, layout: Layout, out: Words) -> None:
    """Read fields at bits (F, 3: word, shift, mask) from the pixels of packets (P, size) to out (F, N)."""

def crc64(packets: Bytes, size: int) -> NDArray[np.uint64]:
    """(P,) CRC-64/XZ of the first bytes, a multiple of four, of packets (P, n)."""
