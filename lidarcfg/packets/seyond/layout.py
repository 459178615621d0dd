"""Seyond's packets, byte by byte: blocks of points in one of three kinds, and the table of a Robin W's angles.

Layout: Seyond-Inc/inno-lidar-sdk 3.103.4, src/sdk_common/inno_lidar_packet.h; the header of version 1, which a Falcon
K1 sends: src/sdk_client/inno_lidar_packet_v1_adapt.h. All is little endian. Bit fields begin at the lowest bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.geometry import Bytes
from lidarcfg.sensors.rig import Clock

Packets = NDArray[np.void]
Integers = NDArray[np.int64]
MAGIC = 0x176A
HALF_TURN = 32768  # units of angles
WORKING = 3  # the lidar's mode
NORMAL = 2  # its status
CLOCKS: Mapping[Clock, int] = {"free": 0, "gps": 4, "ptp": 7}  # what sets the clock, and that it does
CONFIDENT = 3  # of the frame's points, at most
TICK_NS = 10_000  # the unit of a block's time
SINGLE = 1  # return modes
TWO_STRONGEST = 2
STRONGEST_FURTHEST = 3
TABLE = 100  # the type of a packet with a Robin W's table of angles
OTHER_DATA = frozenset(range(4, 23))  # the types of other packets with points
PAYLOAD_MAX = 1472  # bytes, of a datagram that is not sent in fragments


class BitField(NamedTuple):
    """Some bits of an integer."""

    key: str  # of the integer
    shift: int
    width: int

    def of(self, record: Packets) -> Integers:
        """Its values, without sign."""
        word = record[self.key].astype(np.uint64) >> np.uint64(self.shift)
        return np.asarray(word & np.uint64((1 << self.width) - 1)).astype(np.int64)

    def signed(self, record: Packets) -> Integers:
        """Its values, in two's complement."""
        half = 1 << (self.width - 1)
        return (self.of(record) + half) % (2 * half) - half

    def put(self, record: Packets, values: NDArray[Any] | int) -> None:
        """Write values into bits that are 0."""
        kind = record[self.key].dtype
        bits = np.asarray(values).astype(np.int64) & ((1 << self.width) - 1)
        record[self.key] |= (bits << self.shift).astype(kind)


def _fields(key: str, **widths: int) -> dict[str, BitField]:
    """Fields that follow each other."""
    found = {}
    shift = 0
    for name, width in widths.items():
        found[name] = BitField(key, shift, width)
        shift += width
    return found


PACKET_BITS = {
    **_fields("clock", source=4, sync=4),
    **_fields("type_and_count", type=8, count=24),
    **_fields(
        "flags",
        upwards=1,
        reflectance=1,
        returns=3,
        confidence=2,
        last_sub_frame=1,
        last_sequence=1,
        tail=1,
        locked=1,
        first_sub_frame=1,
        four=1,
        far=1,
    ),
}
BASE = [
    *[("magic", "<u2"), ("major", "u1"), ("minor", "u1"), ("firmware", "<u2"), ("crc", "<u4"), ("size", "<u4")],
    *[("clock", "u1"), ("lidar", "u1"), ("start_us", "<f8"), ("mode", "u1"), ("status", "u1"), ("frame", "<u8")],
    *[("sub_frame", "<u2"), ("sequence", "<u2"), ("type_and_count", "<u4"), ("item_size", "<u2"), ("topic", "<u4")],
    *[("flags", "<u2"), ("roi_azimuth", "<i2"), ("roi_elevation", "<i2")],
]
HEADER_1 = np.dtype(BASE)  # of version 1: 54 bytes
HEADER = np.dtype([*BASE, ("reserved", "u1", (16,))])  # since version 2: 70 bytes
CRC = 6, 10  # the bytes that it has, and does not cover


def header_of(major: int) -> np.dtype[np.void]:
    """The header of packets of a major version."""
    return HEADER_1 if major == 1 else HEADER


@dataclass(frozen=True)
class BlockKind:
    """One kind of blocks: the points of one firing of several channels. Distances are in units."""

    name: str  # of the catalogue's sensor that sends it
    type: int  # of packets with them
    channels: int
    units_per_m: int
    head: np.dtype[np.void]
    point: np.dtype[np.void]
    head_bits: Mapping[str, BitField]
    point_bits: Mapping[str, BitField]
    spacing: int = 0  # units of elevation between channels, to which the block adds differences
    reflectivity_step: int = 1  # of one of ours

    def block(self, returns: int) -> np.dtype[np.void]:
        """A block with 1 or 2 returns of each channel."""
        return np.dtype([("head", self.head), ("points", self.point, (returns, self.channels))])

    def packet(self, major: int, returns: int, count: int) -> np.dtype[np.void]:
        """A packet of this many blocks."""
        return np.dtype([("header", header_of(major)), ("blocks", self.block(returns), (count,))])


_TAIL = {"scan": 9, "roi": 2, "facet": 3, "reserved": 2}
_EN_BITS = _fields("angles", h1=11, h2=11, h3=12, v1=10, v2=10, v3=10) | _fields("tail", **_TAIL)
_FALCON_BITS = _fields("bits", scan=9, h1=9, h2=10, h3=11, v1=8, v2=9) | _fields("tail", v3=9, roi=2, facet=3)
FALCON = BlockKind(  # InnoBlock, whose bits are 56 and 16
    name="falcon-k1",
    type=1,
    channels=4,
    units_per_m=200,
    head=np.dtype(
        {
            "names": ["azimuth", "elevation", "ticks", "column", "bits", "tail"],
            "formats": ["<i2", "<i2", "<u2", "<u2", "<u8", "<u2"],
            "offsets": [0, 2, 4, 6, 8, 15],
        }
    ),
    point=np.dtype([("bits", "<u4")]),
    head_bits=_FALCON_BITS,
    point_bits=_fields("bits", distance=17, reflectivity=8, second=1, type=2, elongation=4),
    spacing=196,
)
FALCON_2 = BlockKind(  # InnoEnBlock
    name="falcon-k2",
    type=9,
    channels=4,
    units_per_m=400,
    head=np.dtype(
        [
            *[("azimuth", "<i2"), ("elevation", "<i2"), ("ticks", "<u2"), ("angles", "<u8"), ("column", "<u2")],
            ("tail", "<u2"),
        ]
    ),
    point=np.dtype([("reflectivity", "<u2"), ("intensity", "<u2"), ("bits", "<u4")]),
    head_bits=_EN_BITS,
    point_bits={
        "reflectivity": BitField("reflectivity", 0, 16),
        **_fields("bits", elongation=7, second=1, distance=19, type=2, strong=1),
    },
    spacing=196,
    reflectivity_step=256,
)
ROBIN_W = BlockKind(  # InnoCoBlock: the polygon's angle, by which the table has those of the channels
    name="robin-w",
    type=13,
    channels=8,
    units_per_m=400,
    head=np.dtype([("polygon", "<i2"), ("galvo", "<i2"), ("ticks", "<u2"), ("column", "<u2"), ("tail", "<u2")]),
    point=np.dtype([("bits", "<u4")]),
    head_bits=_fields("tail", **_TAIL),
    point_bits=_fields("bits", reflectivity=12, distance=18, second=1, strong=1),
    reflectivity_step=16,
)
KINDS = {one.type: one for one in (FALCON, FALCON_2, ROBIN_W)}
FACETS = 4  # of a Robin W's polygon
SETS = 6  # of its channels, which fire in turn
TURNS = 65  # of its polygon, for which the table has angles
TURN_STEP = 256  # units from one to the next
FIRST_TURN = -HALF_TURN // 4
EDGE = 10922  # units: a Robin W's points beyond 60 degrees to either side do not count, by the SDK
ANGLES = np.dtype([("elevation", "<i2"), ("azimuth", "<i2")])
ANGLE_TABLE = np.dtype(
    [
        *[("major", "u1"), ("minor", "u1"), ("id", "<u8"), ("angles", ANGLES, (FACETS, TURNS, SETS, 8))],
        ("reserved", "u1", (512,)),
    ]
)
TABLE_PACKET = np.dtype([("header", HEADER), ("table", ANGLE_TABLE)])


def headers_of(data: Bytes) -> Packets:
    """(P,) the headers of packets (P, size), as far as all versions have them, in the same memory."""
    data = np.ascontiguousarray(data)
    return np.ndarray(len(data), HEADER_1, data, strides=data.strides[:1])


def bytes_of(packets: Packets) -> Bytes:
    """(P, size) bytes of packets (P,), in the same memory."""
    return packets.view(np.uint8).reshape(len(packets), packets.itemsize)


def crcs(data: Bytes) -> NDArray[np.uint32]:
    """(P,) the CRC-32C of packets (P, size), which covers all but itself."""
    return core.crc32c(np.ascontiguousarray(data), *CRC)
