"""lidarcfg completion: the script that a shell needs to complete commands, options and names."""

import os
from pathlib import Path

import click
from click.shell_completion import get_completion_class


def _own_shell() -> str:
    return Path(os.environ.get("SHELL", "")).name


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]), default=_own_shell)
def completion(shell: str) -> None:
    """Print the script that makes TAB complete commands, options, sensor names and files.

    Without a shell's name it is for the shell that $SHELL names. The first line of the example, with zsh in it for zsh,
    belongs into ~/.bashrc or ~/.zshrc.

    \b
    Example:
      source <(lidarcfg completion bash)
      lidarcfg completion fish > ~/.config/fish/completions/lidarcfg.fish
    """
    command = click.get_current_context().find_root().command
    kind = get_completion_class(shell)
    assert kind is not None
    script = kind(command, {}, "lidarcfg", "_LIDARCFG_COMPLETE")
    click.echo(script.source_template % script.source_vars())
