"""Where the beams of firings start and point, from encoder angles and the motion of the vehicle."""

import numpy as np

from lidarcfg import maths
from lidarcfg.core import simulate
from lidarcfg.geometry import Array
from lidarcfg.sensors.firing import Firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory

WORLD_M = np.zeros(3)  # its origin
AXIS = np.zeros(1)  # the only ray of a thin beam


def lasers_of(sensor: Sensor, across: Array, above: Array) -> simulate.Lasers:
    """The lasers of a sensor. `across` and `above` (K,) are tangents of the angles of a beam's rays to its axis."""
    return simulate.Lasers(
        cos_elevation=maths.cos(sensor.elevation_rad),
        sin_elevation=maths.sin(sensor.elevation_rad),
        cos_offset=maths.cos(sensor.azimuth_offset_rad),
        sin_offset=maths.sin(sensor.azimuth_offset_rad),
        forward_m=np.ascontiguousarray(sensor.forward_offset_m),
        left_m=np.ascontiguousarray(sensor.lateral_offset_m),
        up_m=np.ascontiguousarray(sensor.vertical_offset_m),
        across=across,
        above=above,
    )


def mounting_of(mount: Mount, trajectory: Trajectory, origin_m: Array = WORLD_M) -> simulate.Mounting:
    """The place of a mount's sensor on a trajectory, relative to a point (3,) of the world."""
    T_world_start = np.array(trajectory.T_world_start)
    T_world_start[:3, 3] -= origin_m
    return simulate.Mounting(
        T_world_start=T_world_start,
        path=trajectory.path.compiled,
        zero_ns=trajectory.zero_ns,
        T_vehicle_sensor=np.ascontiguousarray(mount.T_vehicle_sensor),
    )


def firings_of(fired: Firings) -> simulate.Firings:
    """Firings as the core has them."""
    return simulate.Firings(fired.time_ns, fired.laser, fired.encoder_rad, fired.elevation_rad, fired.start_m)


def aim(mount: Mount, trajectory: Trajectory, fired: Firings) -> tuple[Array, Array]:
    """Where the beams of N firings start in the world (N, 3), each at its time, and their unit vectors (N, 3).

    Raises ConfigError outside timed poses.
    """
    if len(fired.time_ns):
        seconds = (fired.time_ns - trajectory.zero_ns) / SECOND_NS
        trajectory.path.check_span(float(seconds.min()), float(seconds.max()))
    shape = len(fired.time_ns), 3
    lasers = lasers_of(mount.sensor, AXIS, AXIS)
    origins_m, directions = np.empty(shape), np.empty(shape)
    simulate.aim_firings(lasers, mounting_of(mount, trajectory), firings_of(fired), origins_m, directions)
    return origins_m, directions
