"""lidarcfg completion: the script that a shell needs to complete commands, options and names."""

import os
from pathlib import Path

import click
import cloup
from click.shell_completion import get_completion_class


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

    The script completes commands, options, sensor names and files. For bash or zsh, add the first line of the
    examples, with the shell's name, to ~/.bashrc or ~/.zshrc.
    """
    command = click.get_current_context().find_root().command
    kind = get_completion_class(shell)
    assert kind is not None
    script = kind(command, {}, "lidarcfg", "_LIDARCFG_COMPLETE")
    click.echo(script.source_template % script.source_vars())
