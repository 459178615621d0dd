"""What a RoboSense says of its condition: temperature, voltage, the motor's speed, whether its clock is synchronised.

MSOP packets have the temperature as rs_driver reads it (1.5.19, basic_attr.hpp). DIFOP packets have the rest: Helios 32
manual 1.1, tables 25, 27 and 28; of an Airy or a Fairy only the speed and the clock. None says whether the window is
dirty.
"""

import numpy as np

from lidarcfg.geometry import Array, Bytes, Flags
from lidarcfg.packets.condition import Condition
from lidarcfg.packets.robosense.layout import Packets, Series, bytes_of, packets_of

UNSYNCHRONISED = 0  # a state of the clock
TEMPERATURE_AT = 5  # bytes into the reserved ones of an MSOP packet's header
SIXTEENTH_C = 0.0625  # the unit of temperatures there
STEPS = 4096  # of DIFOP's values
FULL_V = 24.5  # of the supply
FULL_C = 503.975  # of the bottom board's FPGA
ZERO_C = 273.15
VOLTAGE_AT = 4  # bytes into the status
RPM_AT = 10  # bytes into the diagnosis


def report_msop(series: Series, data: Bytes, condition: Condition) -> Bytes:
    """MSOP packets (P, 1248) with what the sensor says."""
    packets = packets_of(data.copy(), series)
    hot = condition.hot
    units = np.rint(np.nan_to_num(condition.temperature_c) / SIXTEENTH_C).astype(np.int64)
    low = (abs(units) & 31) << 3
    high = abs(units) >> 5 & 127 | (units < 0) << 7
    place = packets["reserved_3"][:, TEMPERATURE_AT : TEMPERATURE_AT + 2]
    place[hot] = np.stack([low, high], axis=1)[hot]
    return bytes_of(packets)


def report_difop(series: Series, data: Bytes, condition: Condition) -> Bytes:
    """DIFOP packets (P, 1248) with what the sensor says."""
    packets: Packets = np.ascontiguousarray(data.copy()).view(series.difop)[:, 0]
    packets["sync_state"][~condition.synchronised] = UNSYNCHRONISED
    if "real_rpm" in (series.difop.names or ()):
        packets["real_rpm"] = np.rint(condition.rpm)
        return bytes_of(packets)
    _write(packets["diagnosis"], RPM_AT, condition.rpm, np.rint(condition.rpm) != packets["rpm"])
    hot = condition.hot
    _write(packets["diagnosis"], 0, (condition.temperature_c + ZERO_C) / FULL_C * STEPS, hot)
    _write(packets["status"], VOLTAGE_AT, condition.voltage_v / FULL_V * STEPS, condition.unpowered)
    return bytes_of(packets)


def _write(place: Bytes, at: int, numbers: Array, which: Flags) -> None:
    """Write some of the numbers (P,) as two bytes, the more significant first."""
    whole = np.clip(np.rint(numbers[which]), 0, 0xFFFF).astype(np.int64)
    place[which, at] = whole >> 8
    place[which, at + 1] = whole & 255
