"""Inertial measurements as an Ouster sends them: acceleration in g, gravity included; rates in degrees a second."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Payloads, Times
from lidarcfg.packets.ouster.facts import Unit
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.rig import Mount
    from lidarcfg.world.motion import Trajectory

PERIOD_NS = SECOND_NS // 100  # as in all recordings
STEP_NS = PERIOD_NS // 2  # before and after, over which motion is taken
CHUNK = 1024
GRAVITY_M_S2 = 9.80665
PACKET = np.dtype([("time_ns", "<u8", (3,)), ("acceleration_g", "<f4", (3,)), ("rate_deg_s", "<f4", (3,))])


def imu_payloads(
    unit: Unit, mount: "Mount", trajectory: "Trajectory", start_ns: int, duration_ns: int, fragments: bool
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
        yield Payloads(sent_ns, octets, mount.telemetry_port, headers, headers.imu, first, fragments)


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
