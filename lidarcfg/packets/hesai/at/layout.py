"""The packets of Hesai's AT series, byte by byte; all is little endian but where it says otherwise.

Protocol 4.3 (AT128): Hesai's SDK 2.0, udp_protocol_v4_3.h; Nebula, pandar_at128.hpp. Protocol 4.7 (ATX): the SDK's
udp_protocol_v4_7.h.
"""

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Times
from lidarcfg.packets.hesai.layout import HEADER, RETURN, SEQUENCE, SIGNED, Packets, time_ns_of
from lidarcfg.units import SECOND_NS

Protocol = Literal["4.3", "4.7"]

AZIMUTH_BYTES = 3  # of a block: an AT128's has hundredths of a degree, and 256ths of these
TAIL = np.dtype(
    [
        *[("status", "u1", (10,)), ("frame", "u1"), ("more", "u1", (7,))],  # the frame's number in protocol 4.7 only
        *[("speed", "<i2"), ("microseconds", "<u4"), ("return_mode", "u1"), ("factory", "u1"), ("date", "u1", (6,))],
    ]
)
E2E = np.dtype([("length", ">u2"), ("counter", ">u2"), ("data_id", ">u4"), ("crc", ">u4")])
SIGNATURE = 32  # bytes
ATX_STEP = 100  # of angles that an ATX's blocks say, in 25600ths of a degree


@lru_cache
def packet(protocol: Protocol, lasers: int, blocks: int, flags: int) -> np.dtype[np.void]:
    """The dtype of a packet with this many lasers and blocks, and with the parts that its flags say."""
    block = np.dtype([("azimuth", "<u2"), ("fine", "u1"), ("returns", RETURN, (lasers,))])
    return np.dtype(
        [
            *[("header", HEADER), ("blocks", block, (blocks,)), ("body_crc", "<u4"), ("tail", TAIL)],
            *([("sequence", "<u4")] if flags & SEQUENCE else []),
            ("tail_crc", "<u4") if protocol == "4.3" else ("e2e", E2E),
            *([("signature", "u1", (SIGNATURE,))] if flags & SIGNED else []),
        ]
    )


def angles(packets: Packets) -> Times:
    """(P, B) the mirror's angle of each block, in 25600ths of a degree.

    An ATX says 256ths of a degree, and nothing finer.
    """
    blocks = packets["blocks"]
    said = blocks["azimuth"].astype(np.int64)
    return np.asarray(said * ATX_STEP if is_atx(packets) else said << 8 | blocks["fine"])


def write_angles(packets: Packets, angle: Times) -> None:
    """The inverse: write the mirror's angles (P, B)."""
    blocks = packets["blocks"]
    blocks["azimuth"] = angle // ATX_STEP if is_atx(packets) else angle >> 8
    blocks["fine"] = 0 if is_atx(packets) else angle & 255


def is_atx(packets: Packets) -> bool:
    """Whether packets are of protocol 4.7."""
    return "e2e" in (packets.dtype.names or ())


def seconds_of(time_ns: Times) -> NDArray[np.uint8]:
    """(N, 6): the seconds since 1970 in the last four bytes, the most significant first, after two zeros."""
    seconds = time_ns // SECOND_NS
    return np.stack([0 * seconds, 0 * seconds, *(seconds >> shift & 255 for shift in (24, 16, 8, 0))], -1).astype("u1")


def device_time_ns(packets: Packets) -> Times:
    """(P,) the packets' stamps, UTC."""
    return time_ns_of(packets["tail"]["date"], packets["tail"]["microseconds"])
