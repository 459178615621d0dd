"""A picture of a sensor's beam table: where each laser points, and when it fires."""

from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.packets.families import codec
from lidarcfg.report.names import truncate
from lidarcfg.report.plots import COLOURS, new_figure
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NUMBERED = 40  # lasers, up to which their numbers stand beside the marks
MICROSECOND_NS = 1000


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
