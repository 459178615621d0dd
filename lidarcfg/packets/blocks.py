"""Packets of blocks of returns, as Velodyne and RoboSense send them: what the core knows of a sensor."""

from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns

D = TypeVar("D", bound=np.generic)


class BlockSlots(NamedTuple):
    """The W slots of each of a packet's G groups of blocks, which are fired together."""

    laser: Times  # (W,)
    fraction: Array  # (G, W) of the step from the group's azimuth to the next one's
    offset_ns: Times  # (G, W) after the packet's stamp
    kind: Bytes  # (W,) with dual returns: 0 strongest, 1 last
    other: Times  # (W,) where in the group the pair's other return is; empty with single returns


class BlockLasers(NamedTuple):
    """The L lasers: angles in radians, lengths in metres."""

    elevation: Array
    azimuth_offset: Array
    forward: Array  # where the beam begins, along the head's direction
    left: Array  # the same, across the beam's direction
    up: Array
    distance_offset: Array
    ring: Bytes
    near_offset: Array  # (L, 2), or (0, 2) if distances near by are as those far off
    focal: Array  # (L, 4) focal distance, slope, least and greatest intensity; or (0, 4) if they are right as they come


def decode(
    decoder: core.VelodyneDecoder | core.RobosenseDecoder | core.AiryDecoder,
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
    return out.first(decoder.decode(data, wanted, stamp_ns, np.append(gap_ns, 0), kind, out))


def by_packet(values: NDArray[Any], packets: int, dtype: type[D]) -> NDArray[D]:
    """(P, n) the values in the order of packets, a row for each packet; contiguous."""
    return np.ascontiguousarray(values, dtype).reshape(packets, -1)
