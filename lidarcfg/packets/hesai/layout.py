"""Hesai's packets, byte by byte: protocol 6.1 (PandarXT and XT32M2X) and 3.2 (QT128C2X). All is little endian.

Layout: PandarXT, XT32M2X and QT128C2X user manuals, sections 3.1; Nebula's decoders; recordings.
"""

import math
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.units import SECOND_NS

Protocol = Literal["6.1", "3.2"]
Packets = NDArray[np.void]

START = b"\xee\xff"
HEADER = np.dtype(
    [
        *[("start", "S2"), ("major", "u1"), ("minor", "u1"), ("reserved", "<u2"), ("lasers", "u1"), ("blocks", "u1")],
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
FLAGS = {"6.1": 0x01, "3.2": 0x1D}  # sequence; and functional safety, signature, confidence
RESERVED = {"6.1": 0, "3.2": 3}  # of the header, as recorded
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
def packet(protocol: Protocol, lasers: int, blocks: int) -> np.dtype[np.void]:
    """The dtype of a packet with this many lasers and blocks, and with a UDP sequence number."""
    block = np.dtype([("azimuth", "<u2"), ("returns", RETURN, (lasers,))])
    head = [("header", HEADER), ("blocks", block, (blocks,))]
    if protocol == "6.1":
        return np.dtype([*head, ("status", "u1", (10,)), ("tail", TAIL)])
    safety = [("body_crc", "<u4"), ("safety", SAFETY), ("status", "u1", (5,)), ("mode_flag", "u1")]
    end = [("tail_crc", "<u4"), ("signature", "u1", (32,))]
    return np.dtype([*head, *safety, ("counters", "u1", (6,)), ("tail", TAIL), *end])


def bytes_of(packets: Packets) -> Bytes:
    """(P, size) bytes of packets (P,), in the same memory."""
    return packets.view(np.uint8).reshape(len(packets), packets.dtype.itemsize)


def is_dual(packets: Packets) -> Flags:
    """(P,) whether each packet holds two returns of each firing.

    The return mode says it: in an XT32M2X's recording with 0x3C the header's number of returns is 3.
    """
    return np.asarray(np.logical_or.reduce([packets["tail"]["return_mode"] == mode for mode in DUAL_MODES]))


def encoder_rad(azimuth: NDArray[np.integer]) -> Array:
    """Where the head points, clockwise from the x axis, of azimuths in hundredths clockwise from the y axis."""
    return np.asarray((azimuth.astype(np.int64) - QUARTER) % REVOLUTION * RADIANS)


def azimuth_of(encoder_rad: Array) -> NDArray[np.int64]:
    """The inverse, rounded."""
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
