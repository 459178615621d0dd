"""Inertial measurements, which a Livox sends to a port of their own."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.inertial import measured, samples
from lidarcfg.packets.livox.layout import INERTIAL, TIME_TYPES, VERSION, DataType, Packets, bytes_of, crcs
from lidarcfg.packets.livox.model import Inertial, LivoxUnit
from lidarcfg.sensors.rig import Mount
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.world.motion import Trajectory


def imu_payloads(
    unit: LivoxUnit, imu: Inertial, mount: Mount, trajectory: "Trajectory", start_ns: int, due_ns: range
) -> Iterator[Payloads]:
    """A packet a measurement: rates in rad/s, accelerations in g, gravity included."""
    headers = unit.facts.headers
    for number, time_ns, sent_ns in samples(start_ns, due_ns, SECOND_NS // imu.rate_hz):
        packets: Packets = np.zeros(len(number), INERTIAL)
        header = packets["header"]
        header["version"] = VERSION
        header["length"] = INERTIAL.itemsize
        header["points"] = 1
        header["count"] = number % 2**16
        header["type"] = DataType.INERTIAL
        header["time_type"] = TIME_TYPES[mount.clock or "ptp"]
        header["time_ns"] = time_ns
        acceleration_g, rate_deg_s = measured(mount, trajectory, np.array(imu.position_mm) / 1000, time_ns)
        packets["acceleration_g"] = acceleration_g
        packets["rate_rad_s"] = np.radians(rate_deg_s)
        header["crc"] = crcs(bytes_of(packets))
        yield Payloads(sent_ns, bytes_of(packets), mount.telemetry_port, headers, headers.imu, int(number[0]))
