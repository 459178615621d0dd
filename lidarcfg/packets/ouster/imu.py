"""Inertial measurements as an Ouster sends them, gravity included."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.inertial import GRAVITY_M_S2, measured
from lidarcfg.packets.ouster.facts import IMU_MEASUREMENTS, Mode, Unit
from lidarcfg.packets.ouster.layout import Heads, write_heads
from lidarcfg.packets.ouster.pixels import ALERTS, crc64
from lidarcfg.packets.ouster.schedule import phase
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.rig import Mount
    from lidarcfg.world.motion import Trajectory

PERIOD_NS = SECOND_NS // 100  # as in all recordings
CHUNK = 1024
PACKET = np.dtype([("time_ns", "<u8", (3,)), ("acceleration_g", "<f4", (3,)), ("rate_deg_s", "<f4", (3,))])
MEASUREMENT = np.dtype(
    [
        *[("time_ns", "<u8"), ("column", "<u2"), ("status", "<u2")],
        *[("acceleration_m_s2", "<f4", (3,)), ("rate_rad_s", "<f4", (3,))],
    ]
)
FRAMED = np.dtype(  # as ouster-sdk's parsing.cpp has it
    [
        *[("head", "u1", (32,)), ("nmea_ns", "<u8"), ("sentence", "S92")],
        *[("measured", MEASUREMENT, (IMU_MEASUREMENTS,)), ("reserved", "u1", (24,)), ("crc", "<u8")],
    ]
)
FRAMED_KIND = 2  # of the packet, in its header


def legacy_payloads(
    unit: Unit, mode: Mode, mount: "Mount", trajectory: "Trajectory", start_ns: int, duration_ns: int
) -> Iterator[Payloads]:
    """A packet of 48 bytes every 10 ms: three equal times, of the system and both sensors, then the values."""
    total = -(-duration_ns // PERIOD_NS)
    for first in range(0, total, CHUNK):
        time_ns = start_ns + np.arange(first, min(first + CHUNK, total)) * PERIOD_NS
        packets = np.zeros(len(time_ns), PACKET)
        packets["time_ns"] = time_ns[:, None]
        packets["acceleration_g"], packets["rate_deg_s"] = measured(mount, trajectory, _position_m(unit), time_ns)
        sent_ns = (time_ns + 500) // 1000 * 1000
        headers, octets = unit.facts.headers, packets.view(np.uint8).reshape(len(packets), PACKET.itemsize)
        yield Payloads(sent_ns, octets, mount.telemetry_port, headers, headers.imu, first, mode.settings.fragments)


def framed_payloads(
    unit: Unit, mode: Mode, mount: "Mount", trajectory: "Trajectory", start_ns: int, duration_ns: int
) -> Iterator[Payloads]:
    """Packets of profile ACCEL32_GYRO32_NMEA, which count revolutions as the lidar's do; without a sentence."""
    zero_ns, _ = phase(mode, start_ns, mount.phase_deg)
    period_ns = mode.revolution_ns // mode.imu_packets
    begin, end = -(-(start_ns - zero_ns) // period_ns), (start_ns + duration_ns - zero_ns) // period_ns
    for first in range(begin, end, CHUNK):
        number = np.arange(first, min(first + CHUNK, end))
        revolution, place = np.divmod(number, mode.imu_packets)
        sample = place[:, None] * IMU_MEASUREMENTS + np.arange(IMU_MEASUREMENTS)
        since_ns = sample * mode.revolution_ns // (mode.imu_packets * IMU_MEASUREMENTS)
        packets = np.zeros(len(number), FRAMED)
        values = packets["measured"]
        values["time_ns"] = zero_ns + revolution[:, None] * mode.revolution_ns + since_ns
        values["column"] = sample * mode.layout.columns_per_frame // (mode.imu_packets * IMU_MEASUREMENTS)
        values["status"] = 1
        at_ns = values["time_ns"].ravel().astype(np.int64)
        acceleration_g, rate_deg_s = measured(mount, trajectory, _position_m(unit), at_ns)
        values["acceleration_m_s2"] = (acceleration_g * GRAVITY_M_S2).reshape(*sample.shape, 3)
        values["rate_rad_s"] = np.radians(rate_deg_s).reshape(*sample.shape, 3)
        octets = packets.view(np.uint8).reshape(len(packets), FRAMED.itemsize)
        write_heads(mode.layout, octets, Heads(revolution, mode.init, mode.serial, ALERTS))
        octets[:, 0] = FRAMED_KIND
        packets["crc"] = crc64(octets)
        sent_ns = (zero_ns + (number + 1) * period_ns + 500) // 1000 * 1000
        headers, fragments = unit.facts.headers, mode.settings.fragments
        yield Payloads(sent_ns, octets, mount.telemetry_port, headers, headers.imu, first - begin, fragments)


def _position_m(unit: Unit) -> Array:
    """(3,): where the inertial sensor is in the sensor's frame."""
    return np.array(unit.facts.imu.position_mm) / 1000
