"""Measurements of the inertial sensors inside a LiDAR along a trajectory, gravity included."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.geometry import Array, Times, product, rotation_vectors, transform
from lidarcfg.sensors.rig import Mount
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.world.motion import Trajectory

STEP_NS = SECOND_NS // 200  # before and after, over which motion is taken
GRAVITY_M_S2 = 9.80665
CHUNK = 1024  # measurements at a time


def samples(start_ns: int, due_ns: range, period_ns: int) -> Iterator[tuple[Times, Times, Times]]:
    """The measurements due so long after the start, some at a time.

    Numbers (n,), when they are taken, and when the host gets them, in whole µs.
    """
    begin, end = (-(-at_ns // period_ns) for at_ns in (due_ns.start, due_ns.stop))
    for first in range(begin, end, CHUNK):
        number = np.arange(first, min(first + CHUNK, end))
        time_ns = start_ns + number * period_ns
        yield number, time_ns, (time_ns + 500) // 1000 * 1000


def measured(mount: Mount, trajectory: "Trajectory", position_m: Array, time_ns: Times) -> tuple[Array, Array]:
    """Acceleration in g and rates in degrees a second (n, 3) in the sensor's frame, over 10 ms around each time.

    `position_m` (3,) is the inertial sensor's in that frame. Timed poses are not asked for beyond their ends: there the
    motion next to them counts.
    """
    span = trajectory.path.times_s
    middle_ns = time_ns
    if len(span):
        ends_ns = trajectory.zero_ns + np.round(span[[0, -1]] * SECOND_NS).astype(np.int64)
        middle_ns = np.clip(time_ns, ends_ns[0] + STEP_NS, ends_ns[1] - STEP_NS)
    mounted = mount.T_vehicle_sensor
    arm = np.tile(transform(mounted, position_m[None]), (len(time_ns), 1))
    before, here, after = (trajectory.world(arm, middle_ns + step) for step in (-STEP_NS, 0, STEP_NS))
    step_s = STEP_NS / SECOND_NS
    acceleration = (after - here - (here - before)) / step_s**2 + np.array([0, 0, GRAVITY_M_S2])
    first, middle, last = (_attitude(trajectory, mounted, middle_ns + step) for step in (-STEP_NS, 0, STEP_NS))
    rate = rotation_vectors(product(first.swapaxes(1, 2), last)) / (2 * step_s)
    own = product(middle.swapaxes(1, 2), acceleration[..., None])[..., 0]
    return own / GRAVITY_M_S2, np.degrees(rate)


def _attitude(trajectory: "Trajectory", mounted: Array, time_ns: Times) -> Array:
    """(n, 3, 3): from the sensor's frame into the world's."""
    R, _ = trajectory.motion(time_ns)
    R = np.broadcast_to(R, (len(time_ns), 3, 3))
    return product(product(trajectory.T_world_start[:3, :3], R), mounted[:3, :3])
