"""The rays of a sensor as other simulators ask for them: of one frame, and of the cycle that a turning head repeats."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, Times
from lidarcfg.packets.families import timing
from lidarcfg.sensors.firing import Firings, Pattern, joined
from lidarcfg.sensors.rig import RPM, Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.units import SECOND_NS


@dataclass(frozen=True)
class Rays:
    """N rays of a sensor by the time at which they are fired."""

    time_ns: Times  # (N,) after the first
    channel: NDArray[np.int64]  # (N,) or laser
    head_deg: Array  # (N,) where the head points, clockwise from x; 0 if it does not turn
    azimuth_deg: Array  # (N,) of the ray, clockwise from x
    elevation_deg: Array  # (N,)
    start_m: Array  # (N, 3) where it starts: ahead of and left of where the head points, up


@dataclass(frozen=True)
class BeamTable:
    """Which rays a sensor fires, at its usual speed and with one return a ray."""

    sensor: Sensor
    frame_ns: int  # of a revolution, or of a frame
    frame: Rays  # of the first
    frames: int  # that differ; 1 of a turning head
    step_deg: float  # that the head turns from one cycle to the next; 0: it does not turn
    cycle: Rays  # from the head's 0; of a scan pattern the frame


def beam_table(sensor: Sensor) -> BeamTable:
    """The rays of a sensor at 600 rpm, or at the nearest speed that it has. Raises ConfigError: no timing is known."""
    mount = _mount(sensor)
    when = timing(sensor)
    packets = math.ceil(mount.frame_ns / when.pace(mount).period_ns) + 2  # of firings that precede their packet's stamp
    fired = joined([batch.firings for batch in when.schedule(mount, 0, [range(packets)])])
    first_ns = int(fired.time_ns.min())
    frame = _rays(sensor, fired[fired.time_ns < first_ns + mount.frame_ns])
    pattern = when.pattern(mount)
    if not isinstance(pattern, Pattern):
        return BeamTable(sensor, mount.frame_ns, frame, sensor.pattern.frames, 0.0, frame)
    count = len(pattern.laser)  # the schedule begins with a cycle
    cycle = _rays(sensor, Firings(fired.time_ns[:count], fired.laser[:count], pattern.lag_rad))
    return BeamTable(sensor, mount.frame_ns, frame, 1, math.degrees(pattern.step_rad), cycle)


def rate_hz(table: BeamTable) -> float:
    """Its frames in a second."""
    return SECOND_NS / table.frame_ns


def _mount(sensor: Sensor) -> Mount:
    rotation = sensor.rotation
    return Mount(
        name=sensor.name,
        sensor=sensor,
        position_m=(0.0, 0.0, 0.0),
        rpy_rad=(0.0, 0.0, 0.0),
        model=None,
        host="192.168.1.201",
        data_port=2368,
        telemetry_port=8308,
        rpm=min(max(RPM, rotation.rpm_min), rotation.rpm_max) if rotation else RPM,
        return_mode="strongest",
        azimuth_fov_deg=sensor.field_of_view_deg(None),
    )


def _rays(sensor: Sensor, fired: Firings) -> Rays:
    """The rays of some firings, in the order of their times."""
    fired = fired[np.argsort(fired.time_ns, kind="stable")]
    laser = fired.laser.astype(np.int64)
    head_deg = np.degrees(fired.encoder_rad)
    if len(fired.elevation_rad):
        azimuth_deg, head_deg = head_deg, np.zeros(len(laser))
        elevation_deg = np.degrees(fired.elevation_rad)
        start_m = fired.start_m if len(fired.start_m) else np.zeros((len(laser), 3))
    else:
        azimuth_deg = head_deg + np.degrees(sensor.azimuth_offset_rad[laser])
        elevation_deg = np.degrees(sensor.elevation_rad[laser])
        offsets_m = sensor.forward_offset_m, sensor.lateral_offset_m, sensor.vertical_offset_m
        start_m = np.stack([column[laser] for column in offsets_m], axis=1)
    return Rays(fired.time_ns - fired.time_ns[0], laser, head_deg, azimuth_deg, elevation_deg, start_m)
