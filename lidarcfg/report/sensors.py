"""Sensor models: tables on the terminal, and a picture of where each laser points and when it fires."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from lidarcfg.packets.families import codec
from lidarcfg.report.plots import COLOURS, new_figure
from lidarcfg.report.text import terminal, truncate
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TABLE_KEYS = {"elevation_deg", "azimuth_offset_deg", "vertical_offset_mm", "offset_ns", "source"}
NUMBERED = 40  # lasers, up to which their numbers stand beside the marks
MICROSECOND_NS = 1000


def print_sensors(sensors: Sequence[Sensor]) -> None:
    """Print one line per model."""
    table = Table("name", "beams", "elevation (°)", "range (m)", "exported", "description", box=SIMPLE)
    for sensor in sensors:
        low = min(sensor.beams.elevation_deg)
        high = max(sensor.beams.elevation_deg)
        table.add_row(
            sensor.name,
            str(sensor.count),
            f"{low:g} to {high:g}",
            f"{sensor.range.min_m:g} to {sensor.range.max_m:g}" if sensor.range else "–",
            sensor.codec or ("as points" if sensor.range else "–"),
            sensor.description,
        )
    terminal().print(table)


def print_sensor(sensor: Sensor) -> None:
    """Print a model: the beam table, then every fact with its source."""
    console = terminal()
    console.print(f"{sensor.name}  {sensor.maker}  {sensor.description}", style="bold")
    table = Table("laser", "ring", "elevation (°)", "azimuth (°)", "height (mm)", "fires at (ns)", box=SIMPLE)
    firing_ns: list[object] = ["–"] * sensor.count
    if sensor.codec:
        firing_ns = codec(sensor).firing_ns().tolist()
    elif sensor.firing:
        firing_ns = [*(sensor.firing.offset_ns or [0] * sensor.count)]
    for laser in range(sensor.count):
        table.add_row(
            str(laser),
            str(sensor.ring[laser]),
            f"{sensor.beams.elevation_deg[laser]:g}",
            f"{sensor.beams.azimuth_offset_deg[laser]:g}" if sensor.beams.azimuth_offset_deg else "0",
            f"{sensor.beams.vertical_offset_mm[laser]:g}" if sensor.beams.vertical_offset_mm else "0",
            str(firing_ns[laser]),
        )
    console.print(table)
    facts = sensor.model_dump(mode="json", exclude_none=True)
    parts = {part: values for part, values in facts.items() if isinstance(values, dict) and part != sensor.codec}
    for part, values in (parts | dict(facts.get(sensor.codec or "", {}))).items():
        _print_part(console, part, values)


def _print_part(console: Console, part: str, values: dict[str, Any]) -> None:
    """The facts of a part of a sensor's file, their source, and the same of parts that have sources of their own."""
    inner = {key: value for key, value in values.items() if isinstance(value, dict) and "source" in value}
    shown = {key: value for key, value in values.items() if key not in TABLE_KEYS and key not in inner and value != []}
    if values:
        console.print(f"{part}  " + "  ".join(f"{k}: {v}" for k, v in shown.items()))
        console.print(f"  source: {values.get('source', '').strip() or 'not said'}", style="dim")
    for key, value in inner.items():
        _print_part(console, f"{part}.{key}", value)


def draw_sensor(sensor: Sensor) -> "Figure":
    """Elevation by laser, azimuth offsets, and firing times where the sensor's packets are known."""
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
    parts = [f"{sensor.count} lasers from {elevation[0]:.4g}° to {elevation[-1]:.4g}°"]
    gaps = np.round(np.diff(elevation), 2)
    if len(gaps):
        apart = f"{gaps.min():g}°" if gaps.min() == gaps.max() else f"{gaps.min():g}° to {gaps.max():g}°"
        parts.append(f"{apart} apart")
    if sensor.range:
        parts.append(f"{sensor.range.min_m:g} to {sensor.range.max_m:g} m")
        if sensor.range.at_10_percent_m:
            parts.append(f"{sensor.range.at_10_percent_m:g} m at 10 %")
    return ", ".join(parts)
