"""RoboSense's packets, byte by byte: MSOP holds returns, DIFOP describes the sensor; 1248 bytes each.

Layout: manuals of Helios 16 and Helios 32, V1.1, tables 11 to 14 and appendix C; what MSOP reserves, by a recording.
Airy's: its manual, V1.3 (RoboSense-Robotics/product-manual, docs/en/Airy.md at b399c0f), tables 9 to 12 and appendix C;
what that reserves, as rs_driver 1.5.19 reads it, decoder_RSAIRY.hpp.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.geometry import Bytes, Times
from lidarcfg.sensors.rig import Clock
from lidarcfg.units import SECOND_NS

SIZE = 1248
MSOP_ID = bytes.fromhex("55aa055a")
DIFOP_ID = bytes.fromhex("a5ff005a11115555")
BLOCK_ID = 0xFFEE
MSOP_TAIL = 0x00FF
DIFOP_TAIL = 0x0FF0
TYPE_AT = 31  # the byte of the LiDAR type
OLD_TYPE_AT = 30  # where firmware of 2022 has it
REVOLUTION = 36000  # azimuth is in hundredths of a degree
RADIANS = math.pi / 18000
PTP = 0x02  # the clock's source: Nebula's helios.hpp
GPS = 0x00
UNLOCKED = 0x00  # the clock's state
GPS_LOCKED = 0x01
TIME = [("seconds", "u1", (6,)), ("microseconds", ">u4")]
RETURN = np.dtype([("distance", ">u2"), ("intensity", "u1")])
ANGLE = np.dtype([("sign", "u1"), ("hundredths", ">u2")])
MSOP_HEADER: list[Any] = [
    *[("id", "S4"), ("version", ">u2"), ("reserved", "u1", (2,)), ("top_count", "u1", (4,)), ("count", ">u4")],
    *[("reserved_2", "u1"), ("kind", "u1"), ("interval", ">u2"), *TIME, ("old_type", "u1"), ("type", "u1")],
    *[("model", "u1"), ("reserved_3", "u1", (9,))],
]
DIFOP_HEADER: list[Any] = [
    *[("id", "S8"), ("rpm", ">u2"), ("host", "u1", (4,)), ("destination", "u1", (4,)), ("mac", "u1", (6,))],
    *[("msop_port", ">u2", (2,)), ("difop_port", ">u2", (2,)), ("fov", ">u2", (2,)), ("reserved", "u1", (2,))],
    *[("phase", ">u2"), ("versions", "u1", (20,)), ("reserved_2", "u1", (229,)), ("install_mode", "u1")],
    *[("reserved_3", "u1", (2,)), ("serial", "u1", (6,)), ("zero", ">u2"), ("return_mode", "u1"), ("sync", "u1")],
    *[("sync_state", "u1"), *TIME],
]


def _block(slots: int) -> np.dtype[np.void]:
    return np.dtype([("id", ">u2"), ("azimuth", ">u2"), ("returns", RETURN, (slots,))])


@dataclass(frozen=True, eq=False)
class Series:
    """A series of LiDARs with packets of one layout."""

    name: str
    lidar_type: int
    lasers: tuple[int, ...]  # that its models may have
    blocks: int  # in an MSOP packet
    slots: int  # returns in a block
    msop: np.dtype[np.void]
    difop: np.dtype[np.void]
    kinds: tuple[int, int]  # byte 17 of MSOP packets with single and with dual returns
    modes: Mapping[str, int]  # what DIFOP packets say of the return mode
    clocks: tuple[Clock, ...]  # what they can say of the clock
    clock_locked: int  # the same of one that is synchronised by PTP
    distance_max: int  # units; 0 is no return
    counts: int  # packets until the counter begins again
    decoder: Callable[..., core.RobosenseDecoder | core.AiryDecoder]
    write_returns: Callable[..., None]

    @property
    def says_dual(self) -> bool:
        """Whether MSOP packets say themselves that their returns are dual."""
        return self.kinds[0] != self.kinds[1]

    @property
    def mode_names(self) -> dict[int, str]:
        """Return modes by what DIFOP packets say."""
        return {code: name for name, code in self.modes.items()}


HELIOS = Series(
    name="Helios",
    lidar_type=0x06,
    lasers=(16, 32),
    blocks=12,
    slots=32,
    msop=np.dtype([*MSOP_HEADER, ("blocks", _block(32), (12,)), ("index", ">u4"), ("tail", ">u2")]),
    difop=np.dtype(
        [
            *[*DIFOP_HEADER, ("status", "u1", (29,)), ("diagnosis", "u1", (40,)), ("gprmc", "u1", (86,))],
            *[("vertical", ANGLE, (32,)), ("horizontal", ANGLE, (32,)), ("reserved_4", "u1", (586,)), ("tail", ">u2")],
        ]
    ),
    kinds=(0x01, 0x01),  # a unit is 2.5 mm
    modes={"dual": 0x00, "strongest": 0x04, "last": 0x05, "first": 0x06},
    clocks=("ptp", "gps", "free"),
    clock_locked=0x02,
    distance_max=0xFFFF,
    counts=2**32,
    decoder=core.RobosenseDecoder,
    write_returns=core.write_robosense_returns,
)
AIRY = Series(
    name="Airy",
    lidar_type=0x31,
    lasers=(96,),
    blocks=8,
    slots=48,
    msop=np.dtype(
        [*MSOP_HEADER, ("blocks", _block(48), (8,)), ("index", ">u4"), ("tail", ">u2"), ("reserved_4", "u1", (16,))]
    ),
    difop=np.dtype(
        [
            *[*DIFOP_HEADER, ("reserved_4", "u1", (60,)), ("real_rpm", ">u2"), ("reserved_5", "u1", (93,))],
            *[("vertical", ANGLE, (96,)), ("horizontal", ANGLE, (96,)), ("status", "u1", (48,))],
            *[("imu_rotation", ">f4", (4,)), ("imu_place", ">f4", (3,)), ("clock_error", "u1", (4,))],
            *[("mounting", ">f4", (3,)), ("reserved_6", "u1", (110,)), ("tail", ">u2")],
        ]
    ),
    kinds=(0x00, 0x03),
    modes={"strongest": 0x00, "first": 0x01, "last": 0x02, "dual": 0x03},  # table 2; dual is a guess, as in `kinds`
    clocks=("ptp", "free"),
    clock_locked=0x01,
    distance_max=0x3FFF,  # two bits more are a feature of the return, in rs_driver
    counts=2**16,
    decoder=core.AiryDecoder,
    write_returns=core.write_airy_returns,
)
SERIES = {series.lidar_type: series for series in (HELIOS, AIRY)}
IMU_ID = bytes.fromhex("aa555a05")
IMU_TAIL = 0xF00F
IMU = np.dtype(  # an Airy's inertial measurement: its guide, table 13; the order of bytes as in rs_driver
    [
        *[("id", "S4"), *TIME, ("acceleration", ">i4", (3,)), ("rate", ">i4", (3,)), ("temperature", ">i4")],
        *[("frequency", "u1"), ("acceleration_range", "u1"), ("rate_range", "u1"), ("count", ">u4"), ("tail", ">u2")],
    ]
)
IMU_HZ = (25, 50, 100, 200, 1000)  # by what the packet says
IMU_FULL = 32768  # a value at the end of the range
Packets = NDArray[np.void]


def series_of(data: Bytes) -> Series:
    """The series that most of these MSOP packets (P, 1248) name; the Helios if that is not known."""
    types, counts = np.unique(
        np.where(data[:, TYPE_AT] == 0, data[:, OLD_TYPE_AT], data[:, TYPE_AT]), return_counts=True
    )
    return SERIES.get(int(types[counts.argmax()]), HELIOS)


def packets_of(data: Bytes, series: Series) -> Packets:
    """(P,) MSOP packets of (P, 1248) bytes, in the same memory."""
    return np.ascontiguousarray(data).view(series.msop)[:, 0]


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
