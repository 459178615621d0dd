"""The packets of RoboSense's EMX, byte by byte: MSOP holds returns of a column, two DIFOP packets describe the sensor.

Layout: EMX manual V1.0.9 (RoboSense-Robotics/product-manual, docs/EMX_CN.md at 49086c4), tables 6 to 8; what MSOP
reserves, as rs_driver 1.5.19 reads it, decoder_RSEMX.hpp. All is big endian.
"""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Bytes, Times
from lidarcfg.units import SECOND_NS

ROWS = 192  # pixels of a column
MSOP_ID = bytes.fromhex("55aa5aa5")
STATE_ID = bytes.fromhex("a5ff005a")
ANGLES_ID = bytes.fromhex("a5ff00ae")
YAW = 512  # units of azimuth in a degree, to the left
PITCH = 200  # units of elevation in a degree
PITCH_OFFSET = 32768  # units in a degree of what is taken off the elevations of a packet
DISTANCE_MAX = 0xFFFF  # units; 0 is no return
NORMAL = 0x01  # a point's attribute
NORMAL_MODE = 0x0A  # the sensor's
SURFACES = 2  # clockwise, anti-clockwise
VCSELS = 24  # of a column
MODES = {"first-last": 0x00, "strongest": 0x04, "last": 0x05, "first": 0x06}
TIME = [("seconds", "u1", (6,)), ("microseconds", ">u4")]
E2E = [("length", ">u2"), ("number_sent", ">u2"), ("data_id", ">u4"), ("crc", ">u4")]
MSOP = np.dtype(
    [
        *[("id", "S4"), ("number", ">u2"), ("pitch_offset", ">i2"), ("return_mode", "u1"), ("clock", "u1"), *TIME],
        *[("frame_sync", "u1"), ("frame_rate", "u1"), ("column", ">u2"), ("yaw", ">i2"), ("pack_mode", "u1")],
        *[("surface", "u1"), ("temperature", ">u2"), ("type", "u1"), ("device_temperature", "u1")],
        ("points", [("distance", ">u2"), ("intensity", "u1"), ("attribute", "u1")], (ROWS,)),
        *E2E,
    ]
)
STATE = np.dtype(
    [
        *[("id", "S4"), ("reserved", "u1", (20,)), ("software", "u1", (3,)), ("hardware", "u1", (2,))],
        *[("reserved_2", "u1", (6,)), ("serial", "S16"), ("work_mode", "u1"), ("frame_rate", "u1")],
        *[("return_mode", "u1"), ("roi_mode", "u1"), ("calibration_mode", "u1"), ("blockage", "u1", (19,))],
        *[("reserved_3", "u1", (14,)), ("clock", "u1"), ("clock_state", "u1"), *TIME, ("phy_mode", "u1")],
        *[("host", "u1", (4,)), ("netmask", "u1", (4,)), ("mac", "u1", (6,)), ("msop_to", "u1", (4,))],
        *[("msop_ports", ">u2", (2,)), ("difop_to", "u1", (4,)), ("difop_ports", ">u2", (2,))],
        *[("reserved_4", "u1", (24,)), ("temperatures", "u1", (2,)), ("reserved_5", "u1", (71,))],
        *[("faults", "u1", (15,)), *E2E],
    ]
)
ANGLES = np.dtype(
    [
        *[("id", "S4"), ("reserved", "u1", (63,)), ("surfaces", "u1"), ("pixels", "u1"), ("vcsels", "u1")],
        *[("yaw_offset", "i1", (VCSELS,)), ("pitch", ">i2", (ROWS,)), ("surface_pitch_offset", ">i2", (SURFACES,))],
        *[("roll_offset", ">i2"), ("reserved_2", "u1", (4,)), *E2E],
    ]
)
Packets = NDArray[np.void]


def packets_of(data: Bytes) -> Packets:
    """(P,) MSOP packets of (P, 812) bytes, in the same memory."""
    return np.ascontiguousarray(data).view(MSOP)[:, 0]


def bytes_of(packets: Packets) -> Bytes:
    """(P, size) bytes of packets (P,), in the same memory."""
    return packets.view(np.uint8).reshape(len(packets), packets.itemsize)


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
