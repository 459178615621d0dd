#!/usr/bin/env python3
"""Attacks on every command: kills, full disks, bombs, liars, names, the page's server; and what came of each.

    .venv/bin/python tools/attack.py              all, about half an hour on two cores
    .venv/bin/python tools/attack.py kills names  some of them: prints, leaves docs/ alone
    .venv/bin/python tools/attack.py --quick      a few of each: prints, leaves docs/ alone
    .venv/bin/python tools/attack.py --times 300 --rows rows.jsonl  so many kills of each command, resumable

Writes the table of docs/reliability.md between its markers. A short run is part of the tests. Linux only. Exits with
1 if anything failed.
"""

import argparse
import json
import os
import platform
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

import attack_corners  # noqa: E402
import attack_inputs  # noqa: E402
import attack_names  # noqa: E402
import attack_save  # noqa: E402
import attack_server  # noqa: E402
import attack_writes  # noqa: E402
from attack_commands import COMMANDS, prepare  # noqa: E402
from attack_run import Row, load_libraries  # noqa: E402
from attack_warm import attacked  # noqa: E402

PAGE = ROOT / "docs/reliability.md"
BEGIN, END = "<!-- attacks: begin -->", "<!-- attacks: end -->"
SEED = 1
WRITES = ("kills", "signals", "full_disk", "read_only", "two_writers")
QUICK = [command for command in COMMANDS if command.name in ("convert a rig to .urdf", "export to .ply")]
GROUPS = (*WRITES, "bombs", "liars", "names", "corners", "server", "save")


def rows(name: str, folder: Path, given: argparse.Namespace, done: set[str]) -> Iterator[Row]:
    """The rows of a group of attacks; of kills without those that are done."""
    if given.quick or name not in WRITES:  # forks of a process that has loaded less are faster
        load_libraries()
    if name in WRITES:
        yield from merged(_written(name, folder, given, done))
    elif name in ("bombs", "liars"):
        yield from getattr(attack_inputs, name)(folder, given.quick)
    elif name == "names":
        yield from attack_names.attacks(folder)
    elif name == "corners":
        yield from attack_corners.attacks(folder, given.quick)
    elif name == "save":
        yield from attack_save.attacks(folder, 2 if given.quick else given.times, random.Random(SEED))
    else:
        yield from attack_server.attacks(given.quick)


def _written(name: str, folder: Path, given: argparse.Namespace, done: set[str]) -> Iterator[Row]:
    """The rows of each command."""
    prepare(folder)
    times = 2 if given.quick else given.times
    many = times if name == "kills" else max(times // 15, 1)
    for command in QUICK if given.quick else COMMANDS:
        if name != "kills" or f"kill -9: {command.name}" not in done:
            rng = random.Random(f"{SEED} {name} {command.name}")
            attack = getattr(attack_writes, name)
            yield from attacked(folder, command, lambda warm, attack=attack, rng=rng: attack(warm, many, rng))


def merged(found: Iterable[Row]) -> Iterator[Row]:
    """Rows that follow one another as they come, but those of one name, which many commands have, as one at the end."""
    of: dict[str, Row] = {}
    for row in found:
        for failure in row.failures:
            print(f"  {row.what}: {failure}", file=sys.stderr, flush=True)
        if row.what.startswith("kill -9: "):
            yield row
        else:
            known = of.setdefault(row.what, Row(row.what))
            known.cases += row.cases
            known.failures += row.failures
    yield from of.values()


def table(found: list[dict[str, Any]]) -> list[str]:
    """The rows as Markdown."""
    lines = ["| attack | cases | failures | commit | |", "| --- | ---: | ---: | --- | --- |"]
    return lines + [
        f"| {r['what']} | {r['cases']:,} | {len(r['failures']):,} | {r['commit']} | {r['seen']} |" for r in found
    ]


def write_page(lines: list[str]) -> None:
    """Put the lines between the page's markers."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{END}{rest.partition(END)[2]}")


class Kept:
    """The rows of a table in a file, a line of JSON each: what is there is not done again."""

    def __init__(self, path: Path | None, quick: bool) -> None:
        self._path, self.rows = path, list[dict[str, Any]]()
        if path and path.exists() and not quick:
            self.rows = [json.loads(line) for line in path.read_text().splitlines()]
        words = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
        self._commit = subprocess.run(words, capture_output=True, text=True).stdout.strip()

    @property
    def done(self) -> set[str]:
        """What was attacked."""
        return {row["what"] for row in self.rows} | {row["group"] for row in self.rows if row["group"] != "kills"}

    def add(self, group: str, found: Iterable[Row]) -> None:
        """More rows of a group, which are there together or not at all."""
        for row in found:
            said = f"{row.what}: {row.cases:,} cases, {len(row.failures):,} failures; {row.seen}"
            print(said, flush=True)
            about = {"group": group, "commit": self._commit, "date": time.strftime("%Y-%m-%d")}
            self.rows.append(about | asdict(row))
            if self._path and group == "kills":
                self._save()
        if self._path:
            self._save()

    def _save(self) -> None:
        assert self._path
        aside = self._path.with_suffix(".part")
        aside.write_text("".join(json.dumps(row) + "\n" for row in self.rows))
        aside.replace(self._path)


def page(kept: Kept) -> list[str]:
    """What the page says of all rows that are there."""
    found = sorted(kept.rows, key=lambda row: GROUPS.index(row["group"]))
    cases, failures = sum(row["cases"] for row in found), sum(len(row["failures"]) for row in found)
    where = f"Linux {platform.machine()}, Python {platform.python_version()}, {os.cpu_count()} cores, seed {SEED}"
    dates = " to ".join(sorted({found[0]["date"], max(row["date"] for row in found)}))
    said = f"Measured on {dates}, {where}: {cases:,} attacks, {failures:,} failures."
    return [said, "", *table(found)]


def main(arguments: list[str] | None = None) -> int:
    """Run what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="group", help=f"of {', '.join(GROUPS)}; all without any")
    parser.add_argument("--quick", action="store_true", help="a few of each; prints only")
    parser.add_argument("--times", type=int, default=100, help="kills of each command, and a fifteenth of the rest")
    parser.add_argument("--rows", type=Path, help="a file that keeps the rows: what it has is not done again")
    parser.add_argument("--write", action="store_true", help="write the page even if only some groups ran")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - set(GROUPS):
        parser.error(f"no group is called {', '.join(sorted(unknown))}; allowed: {', '.join(GROUPS)}")
    kept, began = Kept(given.rows, given.quick), time.perf_counter()
    for name in given.names or GROUPS:
        if name not in kept.done:
            with tempfile.TemporaryDirectory() as folder:
                kept.add(name, rows(name, Path(folder), given, kept.done))
    cases, failures = sum(row["cases"] for row in kept.rows), sum(len(row["failures"]) for row in kept.rows)
    print(f"{cases:,} attacks, {failures:,} failures, in {(time.perf_counter() - began) / 60:.0f} minutes")
    if not given.quick and (given.write or not given.names):
        write_page(page(kept))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
