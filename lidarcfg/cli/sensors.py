"""lidarcfg sensors: the catalogue of models."""

from pathlib import Path

import click
import cloup

from lidarcfg.cli.completion import complete_model
from lidarcfg.cli.options import FILE, Png, quiet_option, warn


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
    """List, show or export the sensor models of the catalogue."""
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


@sensors.command(
    "export",
    epilog="""
    \b
    Example:
      lidarcfg sensors export vlp-16 --format omni-lidar-usd -o out/vlp-16.usda
    """,
)
@cloup.argument("name", metavar="MODEL", shell_complete=complete_model, help="A name from the list, or a YAML file.")
@cloup.option("--format", "form", metavar="FORMAT", required=True, help="The format; see above.")
@cloup.option("-o", "--output", type=FILE, required=True, help="The file to write.")
@quiet_option
def export_sensor(name: str, form: str, output: Path, quiet: bool) -> None:
    """Write a model's rays for another simulator.

    \b
    FORMAT          OUTPUT    FOR
    omni-lidar-usd  .usda     Isaac Sim 5 and 6
    isaaclab        .py       Isaac Lab
    mujoco-lidar    .npz      MuJoCo-LiDAR
    rgl             .mat3x4f  RobotecGPULidar
    csv             .csv      any other
    """
    from lidarcfg.io.sensor_tables import save_table
    from lidarcfg.sensors.sensor import load_sensor

    count, lacks = save_table(load_sensor(name), output, form)
    for thing in lacks:
        warn(f"{output}: {form} has no {thing}")
    if not quiet:
        click.echo(f"wrote {count:,} rays to {output}")
