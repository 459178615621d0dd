"""Filters that cut away the vehicle's own body: a crop box for Autoware, and for each sensor an azimuth window."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.config.document import yaml_text
from lidarcfg.errors import ConversionError
from lidarcfg.geometry import Flags, transform
from lidarcfg.io.ros_names import BASE_LINK
from lidarcfg.sensors.firing import NO_ELEVATIONS
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.simulate.scans import beam_ends
from lidarcfg.world.vehicle import Vehicle

OUSTER = "ouster"
BOX_MARGIN_M = 0.1  # of the box around the body: more than the noise of a range
STEPS = 3600  # azimuths of a revolution at which beams are cast
STEP_DEG = 360 / STEPS
MARGIN_STEPS = 10  # 1 deg on either side of what meets the body, which also covers what lies between two steps


def crop_box(bodies: Vehicle) -> str:
    """Parameters of Autoware's crop_box_filter, which removes the points in the box: the body's bounds and a margin."""
    vertices_m = bodies.scene.mesh()[0]
    low_m = np.floor((vertices_m.min(axis=0) - BOX_MARGIN_M) * 1000) / 1000
    high_m = np.ceil((vertices_m.max(axis=0) + BOX_MARGIN_M) * 1000) / 1000
    bounds = {f"min_{axis}": float(value) for axis, value in zip("xyz", low_m, strict=True)}
    bounds |= {f"max_{axis}": float(value) for axis, value in zip("xyz", high_m, strict=True)}
    frames = {"input_frame": BASE_LINK, "output_frame": BASE_LINK}
    return yaml_text({"/**": {"ros__parameters": {**frames, **bounds, "negative": True}}}, blocks=True)


def azimuth_windows(rig: Rig, bodies: Vehicle, on_warning: Callable[[str], None]) -> str:
    """The azimuth window of each sensor in which no beam meets the body, as JSON; for an Ouster also its own setting.

    Raises ConversionError if beams of every sensor meet the body all around.
    """
    sensors = []
    for mount in rig.mounts:
        window_deg = free_window_deg(mount, bodies)
        if window_deg is None:
            on_warning(f"{mount.name}: its beams meet the body all around; no window cuts that away, but --to crop-box")
            continue
        settings: dict[str, object] = {"name": mount.name, "host": mount.host, "azimuth_fov_deg": list(window_deg)}
        if mount.sensor.codec == OUSTER:
            settings["config"] = {"azimuth_window": ouster_window(window_deg)}
        sensors.append(settings)
    if not sensors:
        raise ConversionError("the beams of every sensor meet the body all around; use --to crop-box")
    return json.dumps({"name": rig.name, "sensors": sensors}, indent=2) + "\n"


def ouster_window(window_deg: tuple[float, float]) -> list[int]:
    """The setting azimuth_window of an Ouster's config: millidegrees, counterclockwise from behind the connector."""
    low, high = window_deg
    if abs(high - low) == 360:
        return [0, 360_000]
    return [round((180 - end) * 1000) % 360_000 for end in (high, low)]


def free_window_deg(mount: Mount, bodies: Vehicle) -> tuple[float, float] | None:
    """The widest field of view, from and to, clockwise, in which no beam meets the body; None if there is none.

    It lies within the mount's own. 0 to 360 is all around.
    """
    fov_deg = mount.azimuth_fov_deg or (0.0, 360.0)
    met = meets_body(mount, bodies)
    if not met.any():
        return fov_deg
    near = np.zeros(STEPS, np.bool_)
    for shift in range(-MARGIN_STEPS, MARGIN_STEPS + 1):
        near |= np.roll(met, shift)
    width_deg = (fov_deg[1] - fov_deg[0]) % 360 or 360.0
    free = ~near & ((np.arange(STEPS) * STEP_DEG - fov_deg[0]) % 360 <= width_deg)
    taken = np.flatnonzero(~free)
    if len(taken) == STEPS:
        return None
    gaps = np.diff([*taken, taken[0] + STEPS])  # from each step that is taken to the next
    widest = int(gaps.argmax())
    if gaps[widest] < 3:
        return None
    first = (taken[widest] + 1) % STEPS
    last = (taken[widest] + gaps[widest] - 1) % STEPS
    return round(first * STEP_DEG, 1), round(last * STEP_DEG, 1)


def meets_body(mount: Mount, bodies: Vehicle) -> Flags:
    """(STEPS,) whether some beam meets the body while the head points at each azimuth, clockwise from the x axis.

    Of a scan pattern, whether some beam at each azimuth does.
    """
    sensor = mount.sensor
    laser: NDArray[np.integer[Any]] = np.tile(np.arange(sensor.count), STEPS)
    heads_rad = np.repeat(np.arange(STEPS) * np.radians(STEP_DEG), sensor.count)
    elevation_rad = NO_ELEVATIONS
    if sensor.scan_pattern:
        laser = sensor.pattern.channel
        heads_rad = sensor.pattern.azimuth_rad
        elevation_rad = sensor.pattern.elevation_rad
    T = mount.T_vehicle_sensor
    starts, ends = (
        transform(T, beam_ends(sensor, laser, heads_rad, np.full(len(laser), range_m), elevation_rad))
        for range_m in (0.0, 1.0)
    )
    hits = np.isfinite(bodies.tracer.cast(starts, ends - starts).range_m)
    step = np.rint(np.degrees(heads_rad) / STEP_DEG).astype(np.int64) % STEPS
    return np.bincount(step[hits], minlength=STEPS) > 0
