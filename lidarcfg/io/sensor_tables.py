"""Beam tables for other simulators: which formats there are, what each lacks, and how they are written."""

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidarcfg import maths
from lidarcfg.errors import ConversionError
from lidarcfg.files import replacing
from lidarcfg.io.beam_table import BeamTable, beam_table
from lidarcfg.io.omni_lidar import omni_lidar
from lidarcfg.sensors.sensor import Sensor

BEAM_COLUMNS = (
    "channel",
    "azimuth_offset_deg",
    "elevation_deg",
    "firing_time_ns",
    "forward_offset_m",
    "lateral_offset_m",
    "vertical_offset_m",
)
RAY_COLUMNS = "time_ns", "azimuth_deg", "elevation_deg", "channel"  # as scan patterns are read

HAS: dict[str, Callable[[BeamTable], bool]] = {  # what a format may lack, and whether a sensor has it
    "firing times": lambda table: bool(table.frame.time_ns.any()),
    "channels": lambda table: table.sensor.count > 1,
    "beam offsets": lambda table: bool(table.cycle.start_m.any()),
    "forward beam offsets": lambda table: bool(table.cycle.start_m[:, 0].any()),
    "range": lambda table: table.sensor.range is not None,
    "beam divergence": lambda table: table.sensor.optics is not None,
    "dual returns": lambda table: table.sensor.codec is not None,
    "frames after the first": lambda table: table.frames > 1,
}


@dataclass(frozen=True)
class TableFormat:
    """A format of a sensor's beam table."""

    name: str  # as --format has it
    suffix: str
    lacks: tuple[str, ...]  # of HAS
    write: Callable[[BeamTable], bytes]


def save_table(sensor: Sensor, output: Path, name: str) -> tuple[int, list[str]]:
    """Write a sensor's table in a format, whole or not at all; returns the number of rays, and what it lacks.

    Raises LidarcfgError: another format, another suffix, or a sensor of which it is not known when lasers fire.
    """
    form = next((form for form in TABLE_FORMATS if form.name == name), None)
    if form is None:
        raise ConversionError(f"no table is called {name!r}; allowed: {', '.join(form.name for form in TABLE_FORMATS)}")
    if output.suffix != form.suffix:
        raise ConversionError(f"{output}: does not end in {form.suffix}, as {name} does")
    table = beam_table(sensor)
    with replacing(output, "wb") as file:
        file.write(form.write(table))
    rays = table.cycle if name in OF_A_CYCLE else table.frame
    return len(rays.channel), [thing for thing in form.lacks if HAS[thing](table)]


def _csv(table: BeamTable) -> bytes:
    """A row for each laser of a cycle, its azimuth clockwise from the head's; of a scan pattern for each ray."""
    rays = table.cycle
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    if table.step_deg:
        writer.writerow(BEAM_COLUMNS)
        columns = [rays.channel, _tidy(rays.azimuth_deg - rays.head_deg), _tidy(rays.elevation_deg), rays.time_ns]
        columns += [_tidy(column) for column in rays.start_m.T]
    else:
        writer.writerow(RAY_COLUMNS)
        columns = [rays.time_ns, _tidy(rays.azimuth_deg), _tidy(rays.elevation_deg), rays.channel]
    writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
    return text.getvalue().encode()


def _tidy(values: np.ndarray) -> np.ndarray:
    """Without what degrees to radians and back add in the last places, nor negative zeros."""
    return np.round(values, 9) + 0.0


def _mujoco_lidar(table: BeamTable) -> bytes:
    """theta, phi (N,) in radians: azimuth counterclockwise from x, elevation."""
    file = io.BytesIO()
    theta, phi = np.radians(-table.frame.azimuth_deg), np.radians(table.frame.elevation_deg)
    np.savez_compressed(file, theta=theta.astype(np.float32), phi=phi.astype(np.float32))
    return file.getvalue()


def _rgl(table: BeamTable) -> bytes:
    """A pose (3, 4) a ray, rows first, in float32: the ray leaves along the pose's z axis."""
    rays = table.frame
    yaw_rad, pitch_rad = np.radians(-rays.azimuth_deg), np.radians(90 - rays.elevation_deg)
    head_rad = np.radians(-rays.head_deg)
    forward_m, left_m, up_m = rays.start_m.T
    zero = np.zeros(len(yaw_rad))
    cy, sy, cp, sp = maths.cos(yaw_rad), maths.sin(yaw_rad), maths.cos(pitch_rad), maths.sin(pitch_rad)
    ch, sh = maths.cos(head_rad), maths.sin(head_rad)
    rows = [
        [cy * cp, -sy, cy * sp, ch * forward_m - sh * left_m],
        [sy * cp, cy, sy * sp, sh * forward_m + ch * left_m],
        [-sp, zero, cp, up_m],
    ]
    return np.moveaxis(np.array(rows), 2, 0).astype("<f4").tobytes()


def _isaaclab(table: BeamTable) -> bytes:
    """Python that makes `lidar_cfg`: the rays of one frame, which a solid-state scan fires once."""
    rays = table.frame
    lines = [
        f'"""The rays of one frame of {table.sensor.name}, for Isaac Lab."""',
        "",
        "from isaaclab_ov.renderers import OVRTXLidarCfg",
        "",
        "lidar_cfg = OVRTXLidarCfg(",
        '    prim_path="{ENV_REGEX_NS}/Lidar",',
        '    scan_type="solidState",',
        f"    azimuth_deg={_tidy(-rays.azimuth_deg).tolist()},",
        f"    elevation_deg={_tidy(rays.elevation_deg).tolist()},",
        f"    fire_time_ns={rays.time_ns.tolist()},",
        f"    channel_id={rays.channel.tolist()},",
        "    max_returns=1,",
        ")",
        "",
    ]
    return "\n".join(lines).encode()


DIRECTIONS_ALONE = ("firing times", "channels", "range", "beam divergence", "dual returns", "frames after the first")
TABLE_FORMATS = (
    TableFormat(
        "omni-lidar-usd",
        ".usda",
        ("forward beam offsets", "dual returns", "frames after the first"),
        lambda table: omni_lidar(table).encode(),
    ),
    TableFormat(
        "isaaclab",
        ".py",
        ("beam offsets", "range", "beam divergence", "dual returns", "frames after the first"),
        _isaaclab,
    ),
    TableFormat("mujoco-lidar", ".npz", ("beam offsets", *DIRECTIONS_ALONE), _mujoco_lidar),
    TableFormat("rgl", ".mat3x4f", DIRECTIONS_ALONE, _rgl),
    TableFormat("csv", ".csv", ("range", "beam divergence", "dual returns", "frames after the first"), _csv),
)
OF_A_CYCLE = ("omni-lidar-usd", "csv")  # the others hold a frame
