"""Pages of results in docs/: the sections that tools write into them, their tables, and where they were measured."""

import os
import platform
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import lidarcfg
from lidarcfg.files import replacing

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs/accuracy.md"


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Lines of a table."""
    return ["| " + " | ".join(map(str, row)) + " |" for row in (header, ["---"] * len(header), *rows)]


def machine() -> str:
    """The line above a benchmark: date, versions, machine and load."""
    return (
        f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, Python {platform.python_version()}, "
        f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    )


def heading(seconds: float) -> str:
    """The line above a section of the accuracy benchmark, which took this long."""
    load = os.getloadavg()[0]
    return (
        f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, {seconds:.0f} s on {os.cpu_count()} cores "
        f"(load average {load:.1f} at the end, our own included)."
    )


def write_section(name: str, lines: Sequence[str], page: Path = PAGE) -> None:
    """Replace the lines between the markers of a section in a page, by default docs/accuracy.md."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, rest = page.read_text().split(begin)
    after = rest.split(end)[1]
    with replacing(page) as file:
        file.write("\n".join([before + begin, *lines, end + after]))
