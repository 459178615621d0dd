"""Sensor models: tables on the terminal, and a picture of where each laser points and when it fires."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from lidarcfg.packets.families import codec
from lidarcfg.report.describe import counted
from lidarcfg.report.plots import COLOURS, new_figure
from lidarcfg.report.table import COUNT, NOTHING, Column, Table
from lidarcfg.report.terminal import print_table, terminal
from lidarcfg.report.text import truncate
from lidarcfg.sensors.scan_pattern import ScanPattern
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.units import MICROSECOND_NS, MILLISECOND_NS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TABLE_KEYS = {"elevation_deg", "azimuth_offset_deg", "vertical_offset_mm", "offset_ns", "source"}
LIST_WIDTH = 240  # where there is no terminal: the longest description fits
NUMBERED = 40  # lasers, up to which their numbers stand beside the marks
DRAWN = 200_000  # firings of a scan pattern, at most


def print_sensors(sensors: Sequence[Sensor]) -> None:
    """Print a row for each model, in one line where there is no terminal, so that `grep` finds whole rows."""
    names = ("name", "beams", "elevation (°)", "range (m)", "exported", "description")
    rows = [
        [
            sensor.name,
            f"{len(sensor.pattern.time_ns):,} firings" if sensor.scan_pattern else str(sensor.count),
            _span(sensor.elevation_span_deg),
            _span((sensor.range.min_m, sensor.range.max_m)) if sensor.range else NOTHING,
            sensor.codec or ("as points" if sensor.range else NOTHING),
            sensor.description,
        ]
        for sensor in sensors
    ]
    print_table(Table("Sensor models", [Column(name) for name in names], rows), width=LIST_WIDTH)


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:g} to {ends[1]:g}"


def print_sensor(sensor: Sensor) -> None:
    """Print a model: the beam table or the channels of its scan pattern, then every fact with its source."""
    console = terminal()
    console.print(f"{sensor.name}  {sensor.maker}  {sensor.description}", style="bold")
    print_table(_channel_table(sensor.pattern) if sensor.scan_pattern else _beam_table(sensor))
    facts = sensor.model_dump(mode="json", exclude_none=True)
    if sensor.scan_pattern:
        del facts["beams"]
    parts = {part: values for part, values in facts.items() if isinstance(values, dict) and part != sensor.codec}
    for part, values in (parts | dict(facts.get(sensor.codec or "", {}))).items():
        for one in values if isinstance(values, list) else [values]:
            _print_part(console, part, one)


def _channel_table(pattern: ScanPattern) -> Table:
    """A row for each channel of a scan pattern, and one for all."""
    columns = [
        Column("channel"),
        Column("firings", COUNT),
        Column("elevation", unit="°"),
        Column("azimuth (°), clockwise"),
        Column("firings a frame", ",.6g"),
    ]
    azimuth_deg = (np.degrees(pattern.azimuth_rad) + 180) % 360 - 180
    elevation_deg = np.degrees(pattern.elevation_rad)
    every = pattern.channel >= 0
    chosen = [(str(channel), pattern.channel == channel) for channel in range(pattern.channels)]
    rows = [
        [
            name,
            int(some.sum()),
            _span((elevation_deg[some].min(), elevation_deg[some].max())),
            _span((azimuth_deg[some].min(), azimuth_deg[some].max())),
            float(some.sum() / pattern.frames),
        ]
        for name, some in ((*chosen, ("all", every)) if len(chosen) > 1 else chosen)
    ]
    return Table("Channels", columns, rows)


def _beam_table(sensor: Sensor) -> Table:
    """A row for each laser."""
    columns = [
        Column("laser", COUNT),
        Column("ring", COUNT),
        Column("elevation", "g", "°"),
        Column("azimuth", "g", "°"),
        Column("height", "g", "mm"),
        Column("fires at", ".0f", "ns"),
    ]
    firing_ns: Sequence[int | None] = [None] * sensor.count
    if sensor.codec:
        firing_ns = codec(sensor).firing_ns().tolist()
    elif sensor.firing:
        firing_ns = sensor.firing.offset_ns or [0] * sensor.count
    beams = sensor.beams
    zeros = [0.0] * sensor.count
    by_laser = (beams.elevation_deg, beams.azimuth_offset_deg or zeros, beams.vertical_offset_mm or zeros, firing_ns)
    rows = list(zip(range(sensor.count), sensor.ring, *by_laser, strict=True))
    return Table("Lasers", columns, rows)


def _print_part(console: Console, part: str, values: dict[str, Any]) -> None:
    """The facts of a section of a sensor's file with their source, then those of its subsections that name a source."""
    inner = {key: value for key, value in values.items() if isinstance(value, dict) and "source" in value}
    shown = {key: value for key, value in values.items() if key not in TABLE_KEYS and key not in inner and value != []}
    if values:
        console.print(f"{part}  " + "  ".join(f"{k}: {v}" for k, v in shown.items()))
        console.print(f"  source: {values.get('source', '').strip() or 'not said'}", style="dim")
    for key, value in inner.items():
        _print_part(console, f"{part}.{key}", value)


def draw_sensor(sensor: Sensor) -> "Figure":
    """Elevation by laser, azimuth offsets, and firing times where the sensor's packets are known; or a scan pattern."""
    return _draw_pattern(sensor) if sensor.scan_pattern else _draw_beams(sensor)


def _draw_pattern(sensor: Sensor) -> "Figure":
    """The directions of a scan pattern's first frame and of the whole of it, and when its first frame points where."""
    pattern = sensor.pattern
    azimuth_deg = (np.degrees(pattern.azimuth_rad) + 180) % 360 - 180
    elevation_deg = np.degrees(pattern.elevation_rad)
    frame = slice(0, pattern.count_before(pattern.frame_ns))
    every = slice(None, None, -(-len(azimuth_deg) // DRAWN))
    figure = new_figure(13, 6.5)
    one, whole, by_time = figure.subplots(1, 3, sharey=True)
    for axes, rows, title in ((one, frame, "one frame"), (whole, every, f"{counted(pattern.frames, 'frame')}")):
        axes.scatter(
            azimuth_deg[rows], elevation_deg[rows], c=[COLOURS[n % len(COLOURS)] for n in pattern.channel[rows]], s=1
        )
        axes.set(title=title, xlabel="azimuth (°), clockwise")
    one.set_ylabel("elevation (°)")
    by_time.plot(pattern.time_ns[frame] / MILLISECOND_NS, elevation_deg[frame], ".", color=COLOURS[0], ms=1)
    by_time.set(title="one frame", xlabel="time (ms)")
    for axes in (one, whole, by_time):
        axes.grid(alpha=0.3)
    figure.suptitle(f"{truncate(sensor.name)}  {truncate(sensor.maker)}\n{_summary(sensor)}", parse_math=False)
    return figure


def _draw_beams(sensor: Sensor) -> "Figure":
    elevation = np.array(sensor.beams.elevation_deg)
    offset = np.degrees(sensor.azimuth_offset_rad)
    laser = np.arange(sensor.count)
    figure = new_figure(13, 6.5)
    by_laser, by_azimuth, by_time = figure.subplots(1, 3, sharey=True)
    _mark(by_laser, laser, elevation, numbered=False)
    by_laser.set(xlabel="laser, as packets have them", ylabel="elevation (°)")
    by_laser.xaxis.get_major_locator().set_params(integer=True)
    _mark(by_azimuth, offset, elevation, numbered=sensor.count <= NUMBERED)
    by_azimuth.set(xlabel="azimuth offset (°), clockwise")
    if sensor.codec:
        firing_ns = codec(sensor).firing_ns()
        _mark(by_time, (firing_ns - firing_ns.min()) / MICROSECOND_NS, elevation, numbered=sensor.count <= NUMBERED)
        by_time.set(xlabel="firing time after the first laser (µs)")
    else:
        by_time.set_axis_off()
        by_time.text(
            0.5, 0.5, "exported as points:\nits packets are not known", transform=by_time.transAxes, ha="center"
        )
    figure.suptitle(f"{truncate(sensor.name)}  {truncate(sensor.maker)}\n{_summary(sensor)}", parse_math=False)
    return figure


def _mark(axes: "Axes", across: np.ndarray, elevation: np.ndarray, numbered: bool) -> None:
    """A mark for each laser; if all have one abscissa, it is centred in a degree or a microsecond."""
    axes.margins(x=0.08)
    axes.plot(across, elevation, "o", color=COLOURS[0], ms=3 if len(across) > NUMBERED else 5)
    if np.ptp(across) == 0:
        axes.set_xlim(across[0] - 0.5, across[0] + 0.5)
    if numbered:
        for laser, at in enumerate(zip(across, elevation, strict=True)):
            axes.annotate(str(laser), at, xytext=(5, 0), textcoords="offset points", fontsize=7, va="center")
    axes.grid(alpha=0.3)


def _summary(sensor: Sensor) -> str:
    elevation = np.sort(sensor.beams.elevation_deg)
    low, high = sensor.elevation_span_deg
    parts = [f"{sensor.count} lasers from {low:.4g}° to {high:.4g}°"]
    if sensor.scan_pattern:
        pattern = sensor.pattern
        parts = [
            f"{len(pattern.time_ns):,} firings from {low:.4g}° to {high:.4g}°",
            counted(pattern.channels, "channel"),
            f"{pattern.frames} × {pattern.frame_ns / MILLISECOND_NS:g} ms",
        ]
    gaps = np.round(np.diff(elevation), 2)
    if len(gaps):
        apart = f"{gaps.min():g}°" if gaps.min() == gaps.max() else f"{gaps.min():g}° to {gaps.max():g}°"
        parts.append(f"{apart} apart")
    if sensor.range:
        parts.append(f"{sensor.range.min_m:g} to {sensor.range.max_m:g} m")
        if sensor.range.at_10_percent_m:
            parts.append(f"{sensor.range.at_10_percent_m:g} m at 10 %")
    return ", ".join(parts)
