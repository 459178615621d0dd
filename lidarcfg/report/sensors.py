"""Sensor models as tables on the terminal."""

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from lidarcfg.packets.families import codec
from lidarcfg.report.terminal import terminal
from lidarcfg.sensors.sensor import Sensor

TABLE_KEYS = {"elevation_deg", "azimuth_offset_deg", "vertical_offset_mm", "offset_ns", "source"}


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
