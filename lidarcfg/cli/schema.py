"""lidarcfg schema: the JSON Schema of a kind of file."""

from pathlib import Path

import click
import cloup

from lidarcfg.cli.options import FILE

KINDS = ("study", "rig", "scene", "sensor", "requirements", "scenario", "vehicle", "trajectory", "plan", "faults")


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg schema study -o out/study.schema.json
    """
)
@cloup.argument("kind", type=click.Choice(KINDS), metavar="KIND", help=f"The kind: {', '.join(KINDS)}.")
@cloup.option("-o", "--output", type=FILE, metavar="FILE", help="Where to write it.  [default: standard output]")
def schema(kind: str, output: Path | None) -> None:
    """Print the JSON Schema of a kind of file.

    With it, editors complete keys and mark mistakes; docs/files.md shows how.
    """
    import json

    from lidarcfg.cli.json_schemas import schema as json_schema
    from lidarcfg.files import replacing

    text = json.dumps(json_schema(kind), indent=2, ensure_ascii=False)
    if output is None:
        click.echo(text)
        return
    with replacing(output) as file:
        file.write(text + "\n")
