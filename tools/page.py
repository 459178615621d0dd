"""What tools print above and in their tables: where and when it was measured, and rows of Markdown."""

import argparse
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import lidarcfg
from lidarcfg.files import replacing

ROOT = Path(__file__).parent.parent
T = TypeVar("T")


def argument(help_page: str | None, kind: Callable[[str], T], default: T) -> T:
    """What a tool is given, if anything. `--help` shows its docstring."""
    parser = argparse.ArgumentParser(description=help_page, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("value", nargs="?", type=kind, default=default, help=f"by default {default}")
    given: T = parser.parse_args().value
    return given


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Lines of a table."""
    return ["| " + " | ".join(map(str, row)) + " |" for row in (header, ["---"] * len(header), *rows)]


def machine() -> str:
    """The line above a table: date, versions, machine and load."""
    return (
        f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, Python {platform.python_version()}, "
        f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    )


def write_section(name: str, lines: Sequence[str], page: Path) -> None:
    """Replace the lines between the markers of a section in a page."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, rest = page.read_text().split(begin)
    after = rest.split(end)[1]
    with replacing(page) as file:
        file.write("\n".join([before + begin, *lines, end + after]))
