"""What the sections of the accuracy benchmark share: docs/accuracy.md, which they write into, and its tables."""

import os
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


def heading(seconds: float) -> str:
    """When and on what a section was run."""
    load = os.getloadavg()[0]
    return (
        f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, {seconds:.0f} s on {os.cpu_count()} cores "
        f"(load average {load:.1f} at the end, our own included)."
    )


def write_section(name: str, lines: Sequence[str], page: Path = PAGE) -> None:
    """Replace what stands between the section's markers in a page, docs/accuracy.md unless said."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, rest = page.read_text().split(begin)
    after = rest.split(end)[1]
    with replacing(page) as file:
        file.write("\n".join([before + begin, *lines, end + after]))
