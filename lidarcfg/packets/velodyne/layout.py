"""Velodyne's packets, byte by byte: 1206 bytes of returns, 512 bytes of position.

Layout: VLP-16 User Manual 63-9243 Rev D, sections 9.3 and 9.4; what differs between models comes from the
sensor's YAML, see `model`.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Bytes, Times
from lidarcfg.units import HOUR_NS

BLOCKS = 12  # in a data packet
SLOTS = 32  # returns in a block
PpsState = Literal["absent", "synchronising", "locked", "error"]
RETURN = np.dtype([("distance", "<u2"), ("intensity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("returns", RETURN, (SLOTS,))])
PACKET = np.dtype([("blocks", BLOCK, (BLOCKS,)), ("stamp_us", "<u4"), ("return_mode", "u1"), ("product_id", "u1")])
POSITION = np.dtype(
    {
        "names": ["inertial", "stamp_us", "pps", "nmea"],  # three groups of gyroscope, temperature, accelerometer x, y
        "formats": [("<u2", (3, 4)), "<u4", "u1", "S128"],
        "offsets": [14, 198, 202, 206],
        "itemsize": 512,
    }
)
REVOLUTION = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
DISTANCE_MAX = 65535  # units; 0 is no return
RETURNS = ("strongest", "last")  # the last axis of dual returns
HOUR_US = 3600 * 10**6
PPS_STATES: tuple[PpsState, ...] = ("absent", "synchronising", "locked", "error")
Packets = NDArray[np.void]


def packets_of(data: Bytes) -> Packets:
    """(P,) packets of (P, 1206) bytes, in the same memory."""
    return np.ascontiguousarray(data).view(PACKET)[:, 0]


def bytes_of(packets: NDArray[np.void]) -> Bytes:
    """(P, size) bytes of packets (P,), in the same memory."""
    return packets.view(np.uint8).reshape(len(packets), packets.dtype.itemsize)


def stamp_us(time_ns: Times) -> Times:
    """(P,) packets' stamps of device times (P,): microseconds past the hour, rounded."""
    return np.asarray((time_ns + 500) // 1000 % HOUR_US)


def gaps_ns(stamp_us: NDArray[np.uint32]) -> Times:
    """(P - 1,) from each of successive stamps (P,) past the hour to the next one."""
    past_hour_us: Times = stamp_us.astype(np.int64)
    return np.asarray(np.diff(past_hour_us) % HOUR_US * 1000)


def device_time_ns(stamp_us: NDArray[np.uint32], host_time_ns: Times) -> Times:
    """(P,) device times since 1970 from stamps (P,) past the hour: in the hour that is nearest to host times (P,)."""
    past_hour = stamp_us.astype(np.int64) * 1000
    return past_hour + (host_time_ns - past_hour + HOUR_NS // 2) // HOUR_NS * HOUR_NS
