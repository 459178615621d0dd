"""How sensors fire in one revolution, whichever way their heads point at first.

Sensors turn independently of each other, each in any of PHASES phases, unless its encoder triggers it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidarcfg import core, maths
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.packets.families import pattern
from lidarcfg.sensors.firing import FramePattern, Pattern
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor

PHASES = 4  # a power of 2, so that means over phases are exact


@dataclass(frozen=True)
class Scanner:
    """The firing pattern of a sensor, independent of its pose."""

    sensor: Sensor
    pattern: Pattern | FramePattern
    range_m: tuple[float, float]  # least, greatest
    azimuth_fov_deg: tuple[float, float] | None = None  # from, to, clockwise; None: all around


def scanner(mount: Mount) -> Scanner:
    """The scanner of a mount's sensor. Raises ConfigError if the sensor's file lacks facts."""
    sensor = mount.sensor
    range_m = mount.range_m
    fires = pattern(mount)
    if range_m is None:
        if sensor.range is None:
            raise ConfigError(f"sensor {sensor.name!r} has no range facts")
        range_m = sensor.range.min_m, sensor.range.max_m
    return Scanner(sensor, fires, range_m, mount.azimuth_fov_deg)


class Poses(NamedTuple):
    """Where S sensors are in the vehicle frame."""

    R: Array  # (S, 3, 3)
    t: Array  # (S, 3)


def compiled(scanners: Sequence[Scanner], phases: int = PHASES) -> tuple[core.returns.Scanner, ...]:
    """Sensors as the core takes them."""
    return tuple(_compiled(one, phases) for one in scanners)


def _compiled(one: Scanner, phases: int) -> core.returns.Scanner:
    beams = one.pattern.beams(one.sensor, phases)
    low, high = one.azimuth_fov_deg or (0.0, 360.0)
    return core.returns.Scanner(
        cos_head=maths.cos(beams.heads_rad),
        sin_head=maths.sin(beams.heads_rad),
        start_rad=beams.heads_rad[0],
        step_rad=beams.step_rad,
        phases=beams.phases,
        lag_rad=beams.lag_rad,
        gating_rad=beams.gating_rad,
        offset_rad=beams.offset_rad,
        elevation_rad=beams.elevation_rad,
        start_m=beams.start_m,
        phase=beams.phase,
        range_m=one.range_m,
        fov_rad=np.radians((low, (high - low) % 360 or 360.0)),
    )


def scanners_of(mounts: Sequence[Mount]) -> tuple[core.returns.Scanner, ...]:
    """How the mounts' sensors fire in a revolution. Raises ConfigError if that is not known."""
    found = []
    for mount in mounts:
        try:
            found.append(scanner(mount))
        except ConfigError as error:
            raise error.of(mount.name) from None
    return compiled(found)


def poses_of(mounts: Sequence[Mount]) -> Poses:
    """Where the mounts are."""
    T = np.array([mount.T_vehicle_sensor for mount in mounts])
    return Poses(np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3]))
