#!/usr/bin/env python3
"""Attacks on every command: kills, full disks, bombs, liars, names, the page's server; and what came of each.

    .venv/bin/python tools/attack.py              all, about half an hour on two cores
    .venv/bin/python tools/attack.py kills names  some of them: prints, leaves docs/ alone
    .venv/bin/python tools/attack.py --quick      a few of each: prints, leaves docs/ alone
    .venv/bin/python tools/attack.py --times 300  so many kills of each command

Writes the table of docs/reliability.md between its markers. A short run is part of the tests. Linux only. Exits with
1 if anything failed.
"""

import argparse
import os
import platform
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

import attack_inputs  # noqa: E402
import attack_names  # noqa: E402
import attack_server  # noqa: E402
import attack_writes  # noqa: E402
from attack_run import Row, load_libraries  # noqa: E402

PAGE = ROOT / "docs/reliability.md"
BEGIN, END = "<!-- attacks: begin -->", "<!-- attacks: end -->"
SEED = 1
WRITES = ("kills", "signals", "full_disk", "read_only", "two_writers")
GROUPS = (*WRITES, "bombs", "liars", "names", "server")


def rows(name: str, folder: Path, times: int, quick: bool) -> Iterator[Row]:
    """The rows of a group of attacks."""
    if name in WRITES:
        attack_writes.prepare(folder)
        commands = attack_writes.COMMANDS[7:9] if quick else attack_writes.COMMANDS
        many = times if name == "kills" else max(times // 15, 1)
        yield from getattr(attack_writes, name)(folder, commands, many, random.Random(SEED))
    elif name in ("bombs", "liars"):
        yield from getattr(attack_inputs, name)(folder, quick)
    elif name == "names":
        yield from attack_names.attacks(folder)
    else:
        yield from attack_server.attacks(quick)


def table(found: list[Row]) -> list[str]:
    """The rows as Markdown."""
    lines = ["| attack | cases | failures | |", "| --- | ---: | ---: | --- |"]
    return lines + [f"| {row.what} | {row.cases:,} | {len(row.failures):,} | {row.seen} |" for row in found]


def write_page(lines: list[str]) -> None:
    """Put the lines between the page's markers."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{END}{rest.partition(END)[2]}")


def main(arguments: list[str] | None = None) -> int:
    """Run what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="group", help=f"of {', '.join(GROUPS)}; all without any")
    parser.add_argument("--quick", action="store_true", help="a few of each; prints only")
    parser.add_argument("--times", type=int, default=100, help="kills of each command, and a fifteenth of the rest")
    parser.add_argument("--write", action="store_true", help="write the page even if only some groups ran")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - set(GROUPS):
        parser.error(f"no group is called {', '.join(sorted(unknown))}; allowed: {', '.join(GROUPS)}")
    load_libraries()
    found: list[Row] = []
    began = time.perf_counter()
    for name in given.names or GROUPS:
        with tempfile.TemporaryDirectory() as folder:
            for row in rows(name, Path(folder), 2 if given.quick else given.times, given.quick):
                print(f"{row.what}: {row.cases:,} cases, {len(row.failures):,} failures; {row.seen}", flush=True)
                found.append(row)
    minutes = (time.perf_counter() - began) / 60
    cases, failures = sum(row.cases for row in found), sum(len(row.failures) for row in found)
    said = f"{cases:,} attacks, {failures:,} failures, in {minutes:.0f} minutes"
    print(said)
    if not given.quick and (given.write or not given.names):
        where = f"Linux {platform.machine()}, Python {platform.python_version()}, {os.cpu_count()} cores, seed {SEED}"
        write_page([f"Measured on {time.strftime('%Y-%m-%d')}, {where}: {said}.", "", *table(found)])
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
