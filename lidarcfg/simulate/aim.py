"""Where the beams of firings start and point, from encoder angles and the motion of the vehicle."""

from typing import NamedTuple

import numpy as np

from lidarcfg import maths
from lidarcfg.core import simulate, world
from lidarcfg.geometry import Array
from lidarcfg.sensors.firing import Firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory

WORLD_M = np.zeros(3)  # its origin
AXIS = np.zeros(1)  # the only ray of a thin beam


class LaserRays(NamedTuple):
    """The L lasers of a sensor, and the K rays of a beam of each."""

    cos_elevation: Array  # (L,)
    sin_elevation: Array
    cos_offset: Array  # of the azimuth
    sin_offset: Array
    forward_m: Array
    left_m: Array
    up_m: Array
    across: Array  # (K,) tangents of the angles by which the rays of a beam leave its axis
    above: Array

    @classmethod
    def of(cls, sensor: Sensor, across: Array, above: Array) -> "LaserRays":
        """The lasers of a sensor, with rays (K,) so far from the axis of each."""
        return cls(
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


class Mounting(NamedTuple):
    """Where a sensor is: mounted in a vehicle that moves along a path in the world, relative to an origin in it."""

    T_world_start: Array  # (4, 4)
    path: world.Path
    zero_ns: int  # its time 0
    T_vehicle_sensor: Array  # (4, 4)

    @classmethod
    def of(cls, mount: Mount, trajectory: Trajectory, origin_m: Array = WORLD_M) -> "Mounting":
        """The place of a mount's sensor on a trajectory, relative to a point (3,)."""
        T_world_start = np.array(trajectory.T_world_start)
        T_world_start[:3, 3] -= origin_m
        return cls(
            T_world_start=T_world_start,
            path=trajectory.path.compiled,
            zero_ns=trajectory.zero_ns,
            T_vehicle_sensor=np.ascontiguousarray(mount.T_vehicle_sensor),
        )


class Axes(NamedTuple):
    """The axes of N beams in the world."""

    origins_m: Array  # (N, 3)
    directions: Array  # (N, 3) unit vectors


def aim(mount: Mount, trajectory: Trajectory, fired: Firings) -> Axes:
    """The axes of the beams of N firings, each at its time. Raises ConfigError outside timed poses."""
    if len(fired.time_ns):
        seconds = (fired.time_ns - trajectory.zero_ns) / SECOND_NS
        trajectory.path.check_span(float(seconds.min()), float(seconds.max()))
    shape = len(fired.time_ns), 3
    axes = Axes(np.empty(shape), np.empty(shape))
    simulate.aim_firings(LaserRays.of(mount.sensor, AXIS, AXIS), Mounting.of(mount, trajectory), fired, axes)
    return axes
