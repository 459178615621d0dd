from collections.abc import Sequence
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray

class Returns:
    """
    Columns of returns, to be written; those that are not asked for are empty.
    """

    def __init__(
        self,
        xyz_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        range_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        azimuth_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        time_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        laser: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        ring: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        intensity: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        return_type: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
    ) -> None: ...
    @property
    def xyz_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 3))]: ...
    @property
    def range_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def azimuth_rad(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def time_ns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]: ...
    @property
    def laser(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def ring(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def intensity(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def return_type(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class BlockSlots:
    """The slots of a packet's groups of blocks."""

    def __init__(
        self,
        laser: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        fraction: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
        offset_ns: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
        kind: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        other: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    ) -> None: ...
    @property
    def laser(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]: ...
    @property
    def fraction(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]: ...
    @property
    def offset_ns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]: ...
    @property
    def kind(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def other(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class BlockLasers:
    """The lasers of a sensor whose packets are blocks."""

    def __init__(
        self,
        elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        azimuth_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        forward: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        left: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        up: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        distance_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        ring: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        near_offset: Annotated[NDArray[numpy.float64], dict(shape=(None, 2))],
        focal: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
    ) -> None: ...
    @property
    def elevation(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def azimuth_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def forward(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def left(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def up(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def distance_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def ring(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def near_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 2))]: ...
    @property
    def focal(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 4))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class NearLasers:
    """
    The lasers of a sensor whose distances near by have offsets of their own.
    """

    def __init__(
        self,
        elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        azimuth_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        left: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        distance_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        near_offset: Annotated[NDArray[numpy.float64], dict(shape=(None, 2))],
    ) -> None: ...
    @property
    def elevation(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def azimuth_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def left(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def distance_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def near_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 2))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class HesaiLasers:
    """The lasers of a Hesai sensor, and when they fire."""

    def __init__(
        self,
        cos_elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        sin_elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        cos_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        sin_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        ring: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        offset_ns: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
        near_ns: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
        lag_ns: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
    ) -> None: ...
    @property
    def cos_elevation(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def sin_elevation(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def cos_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def sin_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def ring(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def offset_ns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]: ...
    @property
    def near_ns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]: ...
    @property
    def lag_ns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class HesaiFields:
    """What Hesai packets say beside their blocks."""

    def __init__(
        self,
        unit_mm: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        start_ns: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
        loop: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
        dual: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
        near: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        far: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        turn: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    ) -> None: ...
    @property
    def unit_mm(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def start_ns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]: ...
    @property
    def loop(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]: ...
    @property
    def dual(self) -> Annotated[NDArray[numpy.bool_], dict(shape=(None,))]: ...
    @property
    def near(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def far(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def turn(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

def crc32_mpeg2(
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))], first: int, end: int
) -> Annotated[NDArray[numpy.uint32], dict(shape=(None,))]:
    """The CRC (P,) of each packet's bytes from first until end."""

def crc32c(
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))], first: int, end: int
) -> Annotated[NDArray[numpy.uint32], dict(shape=(None,))]:
    """
    The CRC-32C (P,) of each packet's bytes but those from first until end.
    """

class VelodyneDecoder:
    """Decodes data packets (P, size) of one sensor."""

    def __init__(self, slots: BlockSlots, lasers: BlockLasers, period_ns: int, group_ns: int, unit_m: float) -> None:
        """
        Copies the tables. From packet to packet it is period_ns, from group to group of blocks group_ns.
        """

    def count(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1206))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
    ) -> int:
        """How many returns the packets that are wanted (P,) hold at most."""

    def decode(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1206))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
        stamp_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        gap_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        kind: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        out: Returns,
    ) -> int:
        """
        Fill in an entry for each return of the packets that are wanted (P,); returns how many.

        Stamps, the times to the next ones (0 for the last) and the types of single returns are (P,).
        """

def write_velodyne_returns(
    range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    number: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    offset_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    limits: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(4))],
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1206))],
) -> None:
    """
    Write into packets (P, size): slot s holds return number[s] of range_m and reflectivity (P, N).

    Limits are the least and greatest range, the unit, and how many units there may be.
    """

def write_velodyne_near_returns(
    range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    azimuth: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    number: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    laser: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    lasers: NearLasers,
    limits: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(4))],
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1206))],
) -> None:
    """
    Write those returns again whose distances are corrected for x and y apart: at azimuth (P, N or N / 2).
    """

def uncorrect_velodyne_intensities(
    laser: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    focal: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1206))],
) -> None:
    """
    Write intensities again: those that the corrections (L, 4) make what they are, or come nearest.
    """

class RobosenseDecoder:
    """Decodes data packets (P, size) of one sensor."""

    def __init__(self, slots: BlockSlots, lasers: BlockLasers, period_ns: int, group_ns: int, unit_m: float) -> None:
        """
        Copies the tables. From packet to packet it is period_ns, from group to group of blocks group_ns.
        """

    def count(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1248))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
    ) -> int:
        """How many returns the packets that are wanted (P,) hold at most."""

    def decode(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1248))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
        stamp_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        gap_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        kind: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        out: Returns,
    ) -> int:
        """
        Fill in an entry for each return of the packets that are wanted (P,); returns how many.

        Stamps, the times to the next ones (0 for the last) and the types of single returns are (P,).
        """

def write_robosense_returns(
    range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    number: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    offset_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    limits: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(4))],
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1248))],
) -> None:
    """
    Write into packets (P, size): slot s holds return number[s] of range_m and reflectivity (P, N).

    Limits are the least and greatest range, the unit, and how many units there may be.
    """

class AiryDecoder:
    """Decodes data packets (P, size) of one sensor."""

    def __init__(self, slots: BlockSlots, lasers: BlockLasers, period_ns: int, group_ns: int, unit_m: float) -> None:
        """
        Copies the tables. From packet to packet it is period_ns, from group to group of blocks group_ns.
        """

    def count(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1248))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
    ) -> int:
        """How many returns the packets that are wanted (P,) hold at most."""

    def decode(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1248))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
        stamp_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        gap_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        kind: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        out: Returns,
    ) -> int:
        """
        Fill in an entry for each return of the packets that are wanted (P,); returns how many.

        Stamps, the times to the next ones (0 for the last) and the types of single returns are (P,).
        """

def write_airy_returns(
    range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    number: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    offset_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    limits: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(4))],
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, 1248))],
) -> None:
    """
    Write into packets (P, size): slot s holds return number[s] of range_m and reflectivity (P, N).

    Limits are the least and greatest range, the unit, and how many units there may be.
    """

class HesaiDecoder:
    """Decodes packets (P, size) of one sensor."""

    def __init__(self, lasers: HesaiLasers, blocks: int, return_bytes: int, near_m: float, least: int) -> None:
        """
        Copies the tables. Distances of less than `least` units are no returns, those below `near_m` have near_ns.
        """

    def count(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
    ) -> int:
        """How many returns the packets that are wanted (P,) hold at most."""

    def decode(
        self,
        packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
        wanted: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
        fields: HesaiFields,
        out: Returns,
    ) -> int:
        """
        Fill in an entry for each return of the packets that are wanted (P,); returns how many.
        """

def write_hesai_returns(
    range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))],
    reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None, None))],
    laser: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    column: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    inside: Annotated[NDArray[numpy.bool_], dict(shape=(None, None))],
    limits: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(4))],
    lasers: int,
    return_bytes: int,
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
) -> None:
    """
    Write into packets (P, size): block b holds column[b] of range_m and reflectivity (P, G F, R).

    Those are of laser (P, G F), if the group of blocks is inside (P, G).
    """

class OusterLayout:
    """Where columns and pixels are in a packet, in bytes."""

    def __init__(
        self, head: int, columns_per_packet: int, column: int, column_head: int, pixels: int, pixel: int
    ) -> None: ...
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
    def __reduce__(self) -> tuple[Any, ...]: ...

class OusterProfile:
    """Where a column's status and a pixel's returns are."""

    def __init__(
        self,
        status: int,
        status_mask: int,
        returns: Annotated[NDArray[numpy.int64], dict(shape=(None, 3))],
        range_mask: int,
        unit_m: float,
    ) -> None: ...
    @property
    def status(self) -> int: ...
    @property
    def status_mask(self) -> int: ...
    @property
    def returns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, 3))]: ...
    @property
    def range_mask(self) -> int: ...
    @property
    def unit_m(self) -> float: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class OusterBeams:
    """The L pixels of a column, in a frame whose z is the axis."""

    def __init__(
        self,
        ahead: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        right: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        up: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        heading: Annotated[NDArray[numpy.float64], dict(shape=(None, 2))],
        ahead_m: float,
        origin_m: float,
        shift_m: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))],
        ring: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        return_type: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
    ) -> None: ...
    @property
    def ahead(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def right(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def up(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def heading(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 2))]: ...
    @property
    def ahead_m(self) -> float: ...
    @property
    def origin_m(self) -> float: ...
    @property
    def shift_m(self) -> Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))]: ...
    @property
    def ring(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def return_type(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class OusterLimits:
    """The ranges that packets can hold."""

    def __init__(self, least_m: float, most_m: float, start_m: float, unit_m: float, most_units: float) -> None: ...
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
    def __reduce__(self) -> tuple[Any, ...]: ...

def decode_ouster_points(
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    layout: OusterLayout,
    profile: OusterProfile,
    beams: OusterBeams,
    xyz_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    time_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    ring: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
    intensity: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
    return_type: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
) -> int:
    """
    Write the returns in packets (P, size), column by column, to columns with room for all; returns how many.
    """

def quantize_ouster_returns(
    range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    limits: OusterLimits,
    photons: Annotated[NDArray[numpy.float64], dict(shape=(256))],
    strongest_first: bool,
    out: Annotated[NDArray[numpy.uint32], dict(shape=(None, None))],
) -> None:
    """
    Write range, reflectivity and signal of (N, R) as packets have them to out (3 R, N); photons (256,) at 1 m.
    """

def pack_ouster_fields(
    values: Annotated[NDArray[numpy.uint32], dict(shape=(None, None))],
    bits: Annotated[NDArray[numpy.int64], dict(shape=(None, 3))],
    layout: OusterLayout,
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
) -> None:
    """
    Write fields (F, N) at bits (F, 3: word, shift, mask) into the pixels of packets (P, size).
    """

def unpack_ouster_fields(
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
    bits: Annotated[NDArray[numpy.int64], dict(shape=(None, 3))],
    layout: OusterLayout,
    out: Annotated[NDArray[numpy.uint32], dict(shape=(None, None))],
) -> None:
    """
    Read fields at bits (F, 3: word, shift, mask) from the pixels of packets (P, size) to out (F, N).
    """

def crc64(
    packets: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))], size: int
) -> Annotated[NDArray[numpy.uint64], dict(shape=(None,))]:
    """
    (P,) CRC-64/XZ of the first bytes, a multiple of four, of packets (P, n).
    """

def fire(
    revolutions: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    stamp_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    offset_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    revolutions_per_ns: float,
    time_ns: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
    encoder_rad: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
) -> None:
    """
    Write times and azimuths (P, N) of firings that come at offsets (N,) after stamps (P,).
    """
