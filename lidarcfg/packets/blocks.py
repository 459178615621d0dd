"""Packets of blocks of returns, as Velodyne and RoboSense send them: what the core knows of a sensor."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.geometry import Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns

D = TypeVar("D", bound=np.generic)


def decode(
    decoder: core.VelodyneDecoder | core.RobosenseDecoder | core.AiryDecoder | core.FairyDecoder,
    data: Bytes,
    wanted: Flags,
    stamp_ns: Times,
    gap_ns: Times,
    kind: Bytes,
    polar: bool,
) -> DecodedReturns:
    """The returns of the wanted (P,) among successive packets (P, size); the others only give the head's motion.

    `gap_ns` (P - 1,) are the times between stamps (P,), and `kind` (P,) the types of single returns. Without `polar`,
    ranges and azimuths are empty.
    """
    out = DecodedReturns.allocate(decoder.count(data, wanted), polar)
    return out.first(decoder.decode(data, wanted, stamp_ns, np.append(gap_ns, 0), kind, core.Returns(*out)))


def by_packet(values: NDArray[Any], packets: int, dtype: type[D]) -> NDArray[D]:
    """(P, n) the values in the order of packets, a row for each packet; contiguous."""
    return np.ascontiguousarray(values, dtype).reshape(packets, -1)
