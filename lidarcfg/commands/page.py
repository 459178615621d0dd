"""How help is laid out: commands by task, examples that fit the terminal."""

import re
import textwrap

import click

GLUE = "\N{NO-BREAK SPACE}"


class _Page(click.HelpFormatter):
    """Breaks long command lines in examples as a shell reads them, with a backslash."""

    def write_text(self, text: str) -> None:
        whole = re.sub(r" *\\\n *", " ", text)
        super().write_text("\n".join(self._fitted(line) for line in whole.splitlines()))

    def _fitted(self, line: str) -> str:
        if not line.lstrip().startswith("lidarcfg "):
            return line
        indent = " " * (len(line) - len(line.lstrip()))
        parts = textwrap.wrap(
            re.sub(r"(?<= )(-\S+) (?!-)", rf"\1{GLUE}", line),  # an option stays with its value
            self.width - self.current_indent - len(" \\"),
            subsequent_indent=indent + "    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        return " \\\n".join(parts).replace(GLUE, " ")


class _PageContext(click.Context):
    formatter_class = _Page


class Tasks(click.Group):
    """A command whose help names its commands task by task, in the order of the work."""

    def __init__(self, *args: object, **settings: object) -> None:
        super().__init__(*args, **settings)  # type: ignore[arg-type]
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
