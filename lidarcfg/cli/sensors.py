"""lidarcfg sensors: the catalogue of models."""

from pathlib import Path

import click
import cloup

from lidarcfg.cli.completion import complete_model
from lidarcfg.cli.options import Png, quiet_option


@cloup.group(
    invoke_without_command=True,
    epilog="""
    \b
    Example:
      lidarcfg sensors show vlp-16
    """,
)
@click.pass_context
def sensors(context: click.Context) -> None:
    """List or show the sensor models of the catalogue."""
    if context.invoked_subcommand is None:
        context.invoke(list_sensors)


@sensors.command("list")
@quiet_option
def list_sensors(quiet: bool = False) -> None:
    """List the models: name, beams, elevations, range."""
    from lidarcfg.report.sensors import print_sensors
    from lidarcfg.sensors.sensor import catalogue, load_sensor

    if not quiet:
        print_sensors([load_sensor(name) for name in catalogue()])


@sensors.command(
    "show",
    epilog="""
    \b
    Example:
      lidarcfg sensors show vlp-16
      lidarcfg sensors show qt128 --png out/qt128.png
    """,
)
@cloup.argument("name", metavar="MODEL", shell_complete=complete_model, help="A name from the list, or a YAML file.")
@cloup.option("--png", type=Png(), help="Draw the beam table: elevations, azimuth offsets, firing times.")
@quiet_option
def show_sensor(name: str, png: Path | None, quiet: bool) -> None:
    """Show a model: beam table, timing and packet facts with their sources."""
    from lidarcfg.report.plots import save_figure
    from lidarcfg.report.sensors import draw_sensor, print_sensor
    from lidarcfg.sensors.sensor import load_sensor

    sensor = load_sensor(name)
    if png:
        save_figure(draw_sensor(sensor), png)
    if not quiet:
        print_sensor(sensor)
