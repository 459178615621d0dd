"""What a Hesai says of its condition: the speed of its motor, and that it is hot, or has a fault.

Protocol 6.1 has the high temperature shutdown flag (PandarXT User Manual, tail). Protocols 3.2 and 1.4 have functional
safety: the state, and how many faults there are (Pandar128E3X and QT128C2X User Manuals, section 3.1). Which fault code
means what is in Hesai's Safety Manual, which is not public: codes are 0.
"""

import numpy as np

from lidarcfg.geometry import Bytes
from lidarcfg.packets.condition import Condition
from lidarcfg.packets.hesai.encode import write_checksums
from lidarcfg.packets.hesai.layout import bytes_of
from lidarcfg.packets.hesai.model import HesaiUnit

SHUTDOWN_AT = 9  # the flag's byte in the status of protocol 6.1
REPORT_FAULT = 2  # states of functional safety
DEGRADED = 4
PRE_SHUTDOWN = 5
STATE_AT = 5  # bit
CURRENT = 1 << 3  # a fault that there is now
COUNT_AT = 4  # bit
FIRST = 1  # the fault's number in the queue


def report(unit: HesaiUnit, data: Bytes, condition: Condition) -> Bytes:
    """Packets (P, size) with what the sensor says."""
    packets = unit.packets_of(data.copy())
    packets["tail"]["rpm"] = np.rint(condition.rpm / unit.facts.packet.speed_unit_rpm)
    if unit.facts.packet.protocol == "6.1":
        packets["status"][:, SHUTDOWN_AT] = condition.hot
        return bytes_of(packets)
    assert packets.dtype.names
    if "safety" in packets.dtype.names:
        faults = condition.hot.astype(np.int64) + condition.unpowered + condition.dirty
        state = np.select([condition.hot, condition.dirty, condition.unpowered], [PRE_SHUTDOWN, DEGRADED, REPORT_FAULT])
        safety = packets["safety"]
        safety["state"] |= (state << STATE_AT | CURRENT * (faults > 0)).astype(np.uint8)
        safety["faults"] = (faults << COUNT_AT) + FIRST * (faults > 0)
    write_checksums(packets)
    return bytes_of(packets)
