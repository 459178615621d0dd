"""Inertial measurements as an Ouster sends them, gravity included."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Payloads, Times
from lidarcfg.packets.ouster.facts import IMU_MEASUREMENTS, Mode, Unit
from lidarcfg.packets.ouster.layout import Heads, write_heads
from lidarcfg.packets.ouster.pixels import ALERTS, crc64
from lidarcfg.packets.ouster.schedule import phase
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.rig import Mount
    from lidarcfg.world.motion import Trajectory

PERIOD_NS = SECOND_NS // 100  # as in all recordings
STEP_NS = PERIOD_NS // 2  # before and after, over which motion is taken
CHUNK = 1024
GRAVITY_M_S2 = 9.80665
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
    """A packet of 48 bytes every 10 ms: three times, of the system and of both sensors, which are the same; values."""
    total = -(-duration_ns // PERIOD_NS)
    for first in range(0, total, CHUNK):
        time_ns = start_ns + np.arange(first, min(first + CHUNK, total)) * PERIOD_NS
        packets = np.zeros(len(time_ns), PACKET)
        packets["time_ns"] = time_ns[:, None]
        packets["acceleration_g"], packets["rate_deg_s"] = measured(unit, mount, trajectory, time_ns)
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
        acceleration_g, rate_deg_s = measured(unit, mount, trajectory, values["time_ns"].ravel().astype(np.int64))
        values["acceleration_m_s2"] = (acceleration_g * GRAVITY_M_S2).reshape(*sample.shape, 3)
        values["rate_rad_s"] = np.radians(rate_deg_s).reshape(*sample.shape, 3)
        octets = packets.view(np.uint8).reshape(len(packets), FRAMED.itemsize)
        write_heads(mode.layout, octets, Heads(revolution, mode.init, mode.serial, ALERTS))
        octets[:, 0] = FRAMED_KIND
        packets["crc"] = crc64(octets)
        sent_ns = (zero_ns + (number + 1) * period_ns + 500) // 1000 * 1000
        headers, fragments = unit.facts.headers, mode.settings.fragments
        yield Payloads(sent_ns, octets, mount.telemetry_port, headers, headers.imu, first - begin, fragments)


def measured(unit: Unit, mount: "Mount", trajectory: "Trajectory", time_ns: Times) -> tuple[Array, Array]:
    """Acceleration in g and rates in degrees a second (n, 3) in the sensor's frame, over 10 ms around each time.

    Timed poses are not asked for beyond their ends: there the motion next to them counts.
    """
    from scipy.spatial.transform import Rotation

    span = trajectory.path.times_s
    middle_ns = time_ns
    if len(span):
        ends_ns = trajectory.zero_ns + np.round(span[[0, -1]] * SECOND_NS).astype(np.int64)
        middle_ns = np.clip(time_ns, ends_ns[0] + STEP_NS, ends_ns[1] - STEP_NS)
    mounted = mount.T_vehicle_sensor
    imu_m = mounted[:3, :3] @ np.array(unit.facts.imu.position_mm) / 1000 + mounted[:3, 3]
    arm = np.tile(imu_m, (len(time_ns), 1))
    before, here, after = (trajectory.world(arm, middle_ns + step) for step in (-STEP_NS, 0, STEP_NS))
    step_s = STEP_NS / SECOND_NS
    acceleration = (after - here - (here - before)) / step_s**2 + np.array([0, 0, GRAVITY_M_S2])
    first, middle, last = (
        Rotation.from_matrix(_attitude(trajectory, mounted, middle_ns + step)) for step in (-STEP_NS, 0, STEP_NS)
    )
    rate = (first.inv() * last).as_rotvec() / (2 * step_s)
    return middle.inv().apply(acceleration) / GRAVITY_M_S2, np.degrees(rate)


def _attitude(trajectory: "Trajectory", mounted: Array, time_ns: Times) -> Array:
    """(n, 3, 3): from the sensor's frame into the world's."""
    R, _ = trajectory.motion(time_ns)
    R = np.broadcast_to(R, (len(time_ns), 3, 3))
    return np.asarray(trajectory.T_world_start[:3, :3] @ R @ mounted[:3, :3])
