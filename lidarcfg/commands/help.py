"""How help is laid out: commands by task, examples that fit the terminal."""

import re
import textwrap
from typing import Any

import click

GLUE = "\N{NO-BREAK SPACE}"


class _Page(click.HelpFormatter):
    """Breaks what stands in lines of its own (`\\b`) too: a command as a shell reads it, a row in its last column."""

    def write_text(self, text: str) -> None:
        parts = text.split("\n\n")
        super().write_text("\n\n".join(self._fitted(part) if part.startswith("\b") else part for part in parts))

    def _fitted(self, lines: str) -> str:
        whole = re.sub(r" *\\\n *", " ", lines)
        return "\n".join(map(self._broken, whole.splitlines()))

    def _broken(self, line: str) -> str:
        is_command = line.lstrip().startswith("lidarcfg ")
        width, end = self.width - self.current_indent, " \\" if is_command else ""
        if len(line) <= width:
            return line
        if is_command:
            line = re.sub(r"(?<= )(-\S+) (?!-)", rf"\1{GLUE}", line)  # an option stays with its value
            column = len(line) - len(line.lstrip()) + 4
        else:
            column = min(max((gap.end() for gap in re.finditer("  +", line)), default=0), width * 2 // 3)
        parts = textwrap.wrap(
            line,
            width - len(end),
            subsequent_indent=" " * column,
            break_long_words=False,
            break_on_hyphens=False,
        )
        return f"{end}\n".join(parts).replace(GLUE, " ")


class _PageContext(click.Context):
    formatter_class = _Page


class Tasks(click.Group):
    """A command whose help names its commands task by task, in the order of the work."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.context_class = _PageContext
        self.tasks: dict[str, tuple[click.Command, ...]] = {}

    def add_task(self, task: str, *commands: click.Command) -> None:
        """Commands that belong to one task."""
        self.tasks[task] = commands
        for command in commands:
            self.add_command(command)
            for each in (command, *getattr(command, "commands", {}).values()):
                each.context_class = _PageContext

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Commands first: they are what the page is about."""
        self.format_commands(ctx, formatter)
        click.Command.format_options(self, ctx, formatter)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A section a task, its column as wide as all commands need."""
        widest = max(map(len, self.commands))
        for task, commands in self.tasks.items():
            with formatter.section(task):
                formatter.write_dl(
                    [(f"{command.name:{widest}}", command.get_short_help_str(limit=200)) for command in commands]
                )
