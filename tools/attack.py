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
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

import attack_corners
import attack_inputs
import attack_names
import attack_save
import attack_server
import attack_writes
from attack_commands import COMMANDS, Command, prepare
from attack_run import Row, load_libraries
from attack_warm import Warm, attacked
from page import write_section

PAGE = ROOT / "docs/reliability.md"
SEED = 1
WRITES = ("kills", "signals", "full_disk", "read_only", "two_writers")
QUICK = [command for command in COMMANDS if command.name in ("convert a rig to .urdf", "export to .ply")]
GROUPS = (*WRITES, "bombs", "liars", "names", "corners", "server", "save")


def rows(name: str, folder: Path, given: argparse.Namespace) -> Iterator[Row]:
    """The rows of a group of attacks on what is read, or on the page."""
    load_libraries()
    if name in ("bombs", "liars"):
        yield from getattr(attack_inputs, name)(folder, given.quick)
    elif name == "names":
        yield from attack_names.attacks(folder)
    elif name == "corners":
        yield from attack_corners.attacks(folder, given.quick)
    elif name == "save":
        yield from attack_save.attacks(folder, 2 if given.quick else given.times, random.Random(SEED))
    else:
        yield from attack_server.attacks(given.quick)


def written(names: list[str], folder: Path, given: argparse.Namespace, kept: "Kept") -> Iterator[list[Row]]:
    """The rows of each command that writes, but for those that are there."""
    if not names:
        return
    if given.quick:  # otherwise not: forks of a process that has loaded less are faster
        load_libraries()
    prepare(folder)
    times = 2 if given.quick else given.times
    for command in QUICK if given.quick else COMMANDS:
        missing = [name for name in names if (name, command.name) not in kept.done]

        def attack(warm: Warm, missing: list[str] = missing, command: Command = command) -> list[Row]:
            found = []
            for name in missing:
                rng = random.Random(f"{SEED} {name} {command.name}")
                many = times if name == "kills" else max(times // 15, 1)
                made = getattr(attack_writes, name)(warm, many, rng)
                found += [replace(row, group=name, command=command.name) for row in made]
            return found

        if missing:
            yield attacked(folder, command, attack)


def merged(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each attack, which many commands have."""
    of: dict[str, dict[str, Any]] = {}
    for row in sorted(found, key=lambda row: GROUPS.index(row["group"])):
        if row["what"] not in of:
            of[row["what"]] = row | {"commit": [row["commit"]], "failures": [*row["failures"]]}
            continue
        known = of[row["what"]]
        known["cases"] += row["cases"]
        known["failures"] += row["failures"]
        known["commit"] += [row["commit"]] if row["commit"] not in known["commit"] else []
    return list(of.values())


def table(found: list[dict[str, Any]]) -> list[str]:
    """The rows as Markdown."""
    lines = ["| attack | cases | failures | commit | |", "| --- | ---: | ---: | --- | --- |"]
    for row in merged(found):
        commit = ", ".join(row["commit"])
        lines.append(f"| {row['what']} | {row['cases']:,} | {len(row['failures']):,} | {commit} | {row['seen']} |")
    return lines


class Kept:
    """The rows of a table in a file, a line of JSON each: what is there is not done again.

    Of a group that was stopped the rows that were finished are there, as `open`; it is done again, and replaces them.
    """

    def __init__(self, path: Path | None, quick: bool) -> None:
        self._path, self.rows = path, list[dict[str, Any]]()
        if path and path.exists() and not quick:
            self.rows = [json.loads(line) for line in path.read_text().splitlines()]
        words = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
        self._commit = subprocess.run(words, capture_output=True, text=True).stdout.strip()

    @property
    def done(self) -> set[tuple[str, str]]:
        """What was attacked: the group, and the command of those that write."""
        return {(row["group"], row["command"]) for row in self.rows if not row.get("open")}

    def add(self, found: Iterable[Row]) -> None:
        """More rows, which are there together or not at all."""
        self.rows += map(self._told, found)
        self._save()

    def follow(self, group: str, found: Iterable[Row]) -> None:
        """The rows of a group, each as it comes."""
        for row in found:
            self.rows = [one for one in self.rows if (one["group"], one["what"]) != (group, row.what)]
            self.rows.append(self._told(replace(row, group=group)) | {"open": True})
            self._save()
        for one in self.rows:
            if one["group"] == group:
                one.pop("open", None)
        self._save()

    def _told(self, row: Row) -> dict[str, Any]:
        """Print a row; returns it as the file has it."""
        of = f" ({row.command})" if row.command and row.command not in row.what else ""
        print(f"{row.what}{of}: {row.cases:,} cases, {len(row.failures):,} failures; {row.seen}", flush=True)
        for failure in row.failures if row.command else ():  # the others have said so
            print(f"  {row.what}: {failure}", file=sys.stderr, flush=True)
        return {"commit": self._commit, "date": time.strftime("%Y-%m-%d")} | asdict(row)

    def _save(self) -> None:
        if not self._path:
            return
        aside = self._path.with_suffix(".part")
        aside.write_text("".join(json.dumps(row) + "\n" for row in self.rows))
        aside.replace(self._path)


def page(kept: Kept) -> list[str]:
    """What the page says of all rows that are there."""
    found = kept.rows
    cases, failures = sum(row["cases"] for row in found), sum(len(row["failures"]) for row in found)
    where = f"Linux {platform.machine()}, Python {platform.python_version()}, {os.cpu_count()} cores, seed {SEED}"
    dates = " to ".join(sorted({min(row["date"] for row in found), max(row["date"] for row in found)}))
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
    names = given.names or GROUPS
    with tempfile.TemporaryDirectory() as folder:
        for found in written([name for name in names if name in WRITES], Path(folder), given, kept):
            kept.add(found)
    for name in names:
        if name not in WRITES and (name, "") not in kept.done:
            with tempfile.TemporaryDirectory() as folder:
                kept.follow(name, rows(name, Path(folder), given))
    cases, failures = sum(row["cases"] for row in kept.rows), sum(len(row["failures"]) for row in kept.rows)
    print(f"{cases:,} attacks, {failures:,} failures, in {(time.perf_counter() - began) / 60:.0f} minutes")
    if not given.quick and (given.write or not given.names):
        write_section("attacks", ["", *page(kept), ""], PAGE)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
