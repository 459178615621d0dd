"""Hesai's packets, byte by byte; all is little endian.

Protocol 6.1 (PandarXT, XT32M2X) and 3.2 (QT128C2X): their user manuals, sections 3.1; Nebula's decoders; recordings.
Protocol 1.4 (Pandar128, OT128, JT128): Hesai's SDK 2.0, udp_protocol_v1_4.h; Nebula; Pandar128 User Manual, section 3.
"""

import math
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.units import SECOND_NS

Protocol = Literal["6.1", "3.2", "1.4"]
Packets = NDArray[np.void]

START = b"\xee\xff"
HEADER = np.dtype(
    [
        *[("start", "S2"), ("major", "u1"), ("minor", "u1"), ("model", "u1"), ("reserved", "u1")],
        *[("lasers", "u1"), ("blocks", "u1")],
        *[("first_return", "u1"), ("unit_mm", "u1"), ("returns", "u1"), ("flags", "u1")],
    ]
)
RETURN = np.dtype([("distance", "<u2"), ("reflectivity", "u1"), ("confidence", "u1")])
SAFETY = np.dtype(
    [
        *[("version", "u1"), ("state", "u1"), ("faults", "u1"), ("fault_code", "<u2"), ("reserved", "u1", (8,))],
        ("crc", "<u4"),
    ]
)
TAIL = np.dtype(
    [
        *[("return_mode", "u1"), ("rpm", "<u2"), ("date", "u1", (6,)), ("microseconds", "<u4")],
        *[("factory", "u1"), ("sequence", "<u4")],
    ]
)
IMU = np.dtype([("temperature", "<i2"), ("units", "<u2", (2,)), ("ticks", "<u4"), ("motion", "<i2", (6,))])

SEQUENCE = 0x01  # parts of a packet that the header's flags say
INERTIAL = 0x02
SAFE = 0x04
SIGNED = 0x08
MORE = (0x10, 0x20, 0x40)  # after each reflectivity a byte: confidence, weight factor, environment light
FLAGS = {"6.1": 0x01, "3.2": 0x1D}  # sequence; and functional safety, signature, confidence
MODEL = {"6.1": 0, "3.2": 3}  # of the header, as recorded
HIGH_RESOLUTION = 0  # operational states of protocol 1.4
STANDARD = 2
FACTORY = 0x42
FIRST_LAST = 1  # the header's first return with dual returns, as recorded; the manuals call it reserved

FIRST = 0x33
STRONGEST = 0x37
LAST = 0x38
DUAL = 0x39
FIRST_AND_LAST = 0x3B
FIRST_AND_STRONGEST = 0x3C
TWO_STRONGEST = 0x3E
RETURN_MODE_CODES = {
    "first": FIRST,
    "strongest": STRONGEST,
    "last": LAST,
    "dual": DUAL,
    "first-last": FIRST_AND_LAST,
    "first-strongest": FIRST_AND_STRONGEST,
    "two-strongest": TWO_STRONGEST,
}
MODES = {  # the return mode byte, as the manuals have it
    FIRST: "first",
    STRONGEST: "strongest",
    LAST: "last",
    DUAL: "last and strongest",
    FIRST_AND_LAST: "first and last",
    FIRST_AND_STRONGEST: "first and strongest",
    TWO_STRONGEST: "strongest and second strongest",
}
DUAL_MODES = (DUAL, FIRST_AND_LAST, FIRST_AND_STRONGEST, TWO_STRONGEST)

REVOLUTION = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
QUARTER = REVOLUTION // 4  # azimuth 0 is the y axis, and encoder angles begin at the x axis
DISTANCE_MAX = 65535  # units; 0 is no return
BASE_YEAR = 1900


@lru_cache
def packet(protocol: Protocol, lasers: int, blocks: int, flags: int = 0) -> np.dtype[np.void]:
    """The dtype of a packet with this many lasers and blocks; in protocol 1.4 with the parts that its flags say.

    Raises ValueError for flags of protocol 1.4 without a UDP sequence number.
    """
    if protocol == "1.4":
        return _packet_1_4(lasers, blocks, flags)
    block = np.dtype([("azimuth", "<u2"), ("returns", RETURN, (lasers,))])
    head = [("header", HEADER), ("blocks", block, (blocks,))]
    if protocol == "6.1":
        return np.dtype([*head, ("status", "u1", (10,)), ("tail", TAIL)])
    safety = [("body_crc", "<u4"), ("safety", SAFETY), ("status", "u1", (5,)), ("mode_flag", "u1")]
    end = [("tail_crc", "<u4"), ("signature", "u1", (32,))]
    return np.dtype([*head, *safety, ("counters", "u1", (6,)), ("tail", TAIL), *end])


def _packet_1_4(lasers: int, blocks: int, flags: int) -> np.dtype[np.void]:
    if not flags & SEQUENCE:
        raise ValueError(f"flags 0x{flags:02X} are without a UDP sequence")
    more = sum(flags & flag > 0 for flag in MORE)
    value = np.dtype([("distance", "<u2"), ("reflectivity", "u1"), *([("more", "u1", (more,))] if more else [])])
    block = np.dtype([("azimuth", "<u2"), ("returns", value, (lasers,))])
    return np.dtype(
        [
            *[("header", HEADER), ("blocks", block, (blocks,)), ("body_crc", "<u4")],
            *([("safety", SAFETY)] if flags & SAFE else []),
            *[("status", "u1", (9,)), ("azimuth_state", "<u2"), ("operational_state", "u1"), ("tail", TAIL)],
            *([("imu", IMU)] if flags & INERTIAL else []),
            ("tail_crc", "<u4"),
            *([("signature", "u1", (32,))] if flags & SIGNED else []),
        ]
    )


def return_bytes(packets: np.dtype[np.void]) -> int:
    """The size of one return in packets of this dtype."""
    return packets["blocks"].base["returns"].base.itemsize


def azimuth_states(packets: Packets) -> NDArray[np.uint8]:
    """(P, B): each block's in packets of protocol 1.4, of which there are eight at most; from the top two bits down."""
    shift = 14 - 2 * np.arange(packets["blocks"].shape[1], dtype=np.uint16)
    return (packets["azimuth_state"][:, None] >> shift & 3).astype(np.uint8)


def azimuth_state_of(states: NDArray[np.integer]) -> NDArray[np.uint16]:
    """(P,): the inverse, of (P, B)."""
    shift = 14 - 2 * np.arange(states.shape[1])
    return np.asarray((states.astype(np.int64) << shift).sum(axis=1), np.uint16)


def bytes_of(packets: Packets) -> Bytes:
    """(P, size) bytes of packets (P,), in the same memory."""
    return packets.view(np.uint8).reshape(len(packets), packets.dtype.itemsize)


def is_dual(packets: Packets) -> Flags:
    """(P,) whether each packet holds two returns of each firing.

    The return mode says it: in an XT32M2X's recording with 0x3C the header's number of returns is 3.
    """
    return np.asarray(np.logical_or.reduce([packets["tail"]["return_mode"] == mode for mode in DUAL_MODES]))


def encoder_rad(azimuth: NDArray[np.integer]) -> Array:
    """Head angles clockwise from the x axis, of azimuths, in any shape, in hundredths of a degree from the y axis."""
    return np.asarray((azimuth.astype(np.int64) - QUARTER) % REVOLUTION * RADIANS)


def azimuth_of(encoder_rad: Array) -> NDArray[np.int64]:
    """Azimuths in hundredths of a degree of head angles, in any shape: the inverse of `encoder_rad`, rounded."""
    return np.asarray((np.rint(encoder_rad / RADIANS).astype(np.int64) + QUARTER) % REVOLUTION)


def date_of(time_ns: Times) -> NDArray[np.uint8]:
    """(N, 6): the UTC year after 1900, month, day, hour, minute and second."""
    second = (time_ns // SECOND_NS).astype("datetime64[s]")
    month = second.astype("datetime64[M]")
    year = second.astype("datetime64[Y]")
    day = second.astype("datetime64[D]")
    past = (second - day).astype(np.int64)
    columns = [
        year.astype(np.int64) + 1970 - BASE_YEAR,
        (month - year).astype(np.int64) + 1,
        (day - month).astype(np.int64) + 1,
        *(past // 3600, past // 60 % 60, past % 60),
    ]
    return np.stack(columns, axis=-1).astype(np.uint8)


def time_ns_of(date: NDArray[np.uint8], microseconds: NDArray[np.uint32]) -> Times:
    """(N,) UTC of dates (N, 6). With year 0 the last four bytes are seconds since 1970, the most significant first."""
    part = date.astype(np.int64)
    month = (part[:, 0] + BASE_YEAR - 1970) * 12 + part[:, 1] - 1
    day = month.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + part[:, 2] - 1
    seconds = ((day * 24 + part[:, 3]) * 60 + part[:, 4]) * 60 + part[:, 5]
    plain = part[:, 2:] @ (256 ** np.arange(3, -1, -1))
    return np.where(part[:, 0] == 0, plain, seconds) * SECOND_NS + microseconds.astype(np.int64) * 1000


def device_time_ns(packets: Packets) -> Times:
    """(P,) the packets' stamps, UTC."""
    return time_ns_of(packets["tail"]["date"], packets["tail"]["microseconds"])
