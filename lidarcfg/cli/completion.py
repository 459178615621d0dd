"""lidarcfg completion: the script for the shell; and the completion of sensors' and mounts' names."""

import os
from pathlib import Path

import click
import cloup
from click.shell_completion import CompletionItem, get_completion_class


def complete_model(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The catalogue's sensors whose names start with `incomplete`; files if there are none."""
    from lidarcfg.sensors.sensor import catalogue

    names = [CompletionItem(name) for name in catalogue() if name.startswith(incomplete)]
    return names or [CompletionItem(incomplete, type="file")]


def complete_mount(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The mounts of the rig given by --rig whose names start with `incomplete`; nothing if it cannot be read."""
    from lidarcfg.errors import LidarcfgError
    from lidarcfg.sensors.rig import load_rig

    try:
        names = [mount.name for mount in load_rig(ctx.params["rig"]).mounts] if ctx.params.get("rig") else []
    except LidarcfgError:
        names = []
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _own_shell() -> str:
    return Path(os.environ.get("SHELL", "")).name


@cloup.command(
    epilog="""
    \b
    Examples:
      source <(lidarcfg completion bash)
      lidarcfg completion fish > ~/.config/fish/completions/lidarcfg.fish
    """
)
@cloup.argument(
    "shell", type=click.Choice(["bash", "zsh", "fish"]), default=_own_shell, help="[default: the shell in $SHELL]"
)
def completion(shell: str) -> None:
    """Print the script for TAB completion in a shell.

    The script completes commands, options, sensor names and files. For bash or zsh, add the first example,
    with the shell's name, to ~/.bashrc or ~/.zshrc.
    """
    command = click.get_current_context().find_root().command
    kind = get_completion_class(shell)
    assert kind is not None
    script = kind(command, {}, "lidarcfg", "_LIDARCFG_COMPLETE")
    click.echo(script.source_template % script.source_vars())
