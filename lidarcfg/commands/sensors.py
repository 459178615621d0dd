"""lidarcfg sensors: the catalogue of models."""

import click

from lidarcfg.commands.options import MODEL, quiet_option


@click.group(invoke_without_command=True)
@click.pass_context
def sensors(context: click.Context) -> None:
    """The catalogue of sensor models.

    \b
    Example:
      lidarcfg sensors show vlp-16
    """
    if context.invoked_subcommand is None:
        context.invoke(list_sensors)


@sensors.command("list")
@quiet_option
def list_sensors(quiet: bool = False) -> None:
    """List the models: name, beams, elevations, and what is known of them."""
    from lidarcfg import report
    from lidarcfg.sensor import catalogue, load_sensor

    if not quiet:
        report.print_sensors([load_sensor(name) for name in catalogue()])


@sensors.command("show")
@click.argument("name", type=MODEL)
@quiet_option
def show_sensor(name: str, quiet: bool) -> None:
    """Show the model NAME: its beam table, timing and packet facts with their sources.

    \b
    Example:
      lidarcfg sensors show vlp-16
    """
    from lidarcfg import report
    from lidarcfg.sensor import load_sensor

    sensor = load_sensor(name)
    if not quiet:
        report.print_sensor(sensor)
