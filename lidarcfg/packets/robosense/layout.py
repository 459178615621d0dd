"""RoboSense's packets, byte by byte: MSOP holds returns, DIFOP what the sensor says of itself; 1248 bytes each.

Layout: manuals of Helios 16 and Helios 32, V1.1, tables 11 to 14 and appendix C; what MSOP reserves, by a recording.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Bytes, Times
from lidarcfg.units import SECOND_NS

BLOCKS = 12  # in a packet
SLOTS = 32  # returns in a block
SIZE = 1248
MSOP_ID = bytes.fromhex("55aa055a")
DIFOP_ID = bytes.fromhex("a5ff005a11115555")
BLOCK_ID = 0xFFEE
MSOP_TAIL = 0x00FF
DIFOP_TAIL = 0x0FF0
HELIOS = 0x06  # the LiDAR type
RESOLUTION = 0x01  # what is said of 2.5 mm
REVOLUTION = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
DISTANCE_MAX = 65535  # units; 0 is no return
MODES = {"dual": 0x00, "strongest": 0x04, "last": 0x05, "first": 0x06}
PTP = 0x02  # the clock's source
PTP_LOCKED = 0x02  # it is synchronised
TIME = [("seconds", "u1", (6,)), ("microseconds", ">u4")]
RETURN = np.dtype([("distance", ">u2"), ("intensity", "u1")])
BLOCK = np.dtype([("id", ">u2"), ("azimuth", ">u2"), ("returns", RETURN, (SLOTS,))])
MSOP = np.dtype(
    [
        *[("id", "S4"), ("version", ">u2"), ("reserved", "u1", (2,)), ("top_count", "u1", (4,)), ("count", ">u4")],
        *[("reserved_2", "u1"), ("resolution", "u1"), ("interval", ">u2"), *TIME, ("old_type", "u1"), ("type", "u1")],
        *[("model", "u1"), ("reserved_3", "u1", (9,)), ("blocks", BLOCK, (BLOCKS,)), ("index", ">u4"), ("tail", ">u2")],
    ]
)
ANGLE = np.dtype([("sign", "u1"), ("hundredths", ">u2")])
DIFOP = np.dtype(
    [
        *[("id", "S8"), ("rpm", ">u2"), ("host", "u1", (4,)), ("destination", "u1", (4,)), ("mac", "u1", (6,))],
        *[("msop_port", ">u2", (2,)), ("difop_port", ">u2", (2,)), ("fov", ">u2", (2,)), ("reserved", "u1", (2,))],
        *[("phase", ">u2"), ("versions", "u1", (20,)), ("reserved_2", "u1", (232,)), ("serial", "u1", (6,))],
        *[("zero", ">u2"), ("return_mode", "u1"), ("sync", "u1"), ("sync_state", "u1"), *TIME, ("status", "u1", (29,))],
        *[("diagnosis", "u1", (40,)), ("gprmc", "u1", (86,)), ("vertical", ANGLE, (32,)), ("horizontal", ANGLE, (32,))],
        *[("reserved_3", "u1", (586,)), ("tail", ">u2")],
    ]
)
Packets = NDArray[np.void]


def packets_of(data: Bytes) -> Packets:
    """(P,) MSOP packets of (P, 1248) bytes, in the same memory."""
    return np.ascontiguousarray(data).view(MSOP)[:, 0]


def bytes_of(packets: Packets) -> Bytes:
    """(P, 1248) bytes of packets (P,), in the same memory."""
    return packets.view(np.uint8).reshape(len(packets), SIZE)


def write_time(packets: Packets, time_ns: Times) -> None:
    """Stamp packets (P,) with times (P,), rounded to microseconds."""
    seconds, microseconds = np.divmod((time_ns + 500) // 1000, 10**6)
    packets["seconds"] = seconds.astype(">u8").view(np.uint8).reshape(-1, 8)[:, 2:]
    packets["microseconds"] = microseconds


def read_time_ns(packets: Packets) -> Times:
    """(P,) the stamps; those beyond the range of int64 nanoseconds become its last value."""
    wide = np.zeros((len(packets), 8), np.uint8)
    wide[:, 2:] = packets["seconds"]
    seconds = np.minimum(wide.view(">u8")[:, 0], 9 * 10**9).astype(np.int64)
    return np.asarray(seconds * SECOND_NS + packets["microseconds"].astype(np.int64) * 1000)


def lidar_type(packets: Packets) -> NDArray[np.uint8]:
    """(P,) the series: firmware of 2022 says it a byte before its place in the manual."""
    return np.where(packets["type"] == 0, packets["old_type"], packets["type"])
