"""How long the first runs of a new user take, and the same again: python tools/bench_first_run.py [--runs N].

Each command is typed on a terminal of 120 columns, once with an empty folder for compiled loops, then with that folder
as it was left. Prints seconds on the clock, seconds of processors, and the longest time in which nothing changed on
the screen.
"""

import argparse
import os
import pty
import select
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from page import ROOT, machine

COMMANDS = {
    "optimize, 5 s of search": "optimize data/studies/sedan.yaml --seconds 5 -o OUT/search",
    "export of 1 s": "export data/rigs/roof.yaml --scene data/scenes/street.yaml --duration 1 -o OUT/c.pcap",
    "decode of that": "decode OUT/c.pcap --rig data/rigs/roof.yaml -o OUT/c.ply",
    "evaluate": "evaluate data/studies/sedan.yaml data/rigs/roof.yaml",
    "sensors list": "sensors list",
    "--help": "--help",
}


@dataclass(frozen=True)
class Run:
    """What a command took."""

    clock_s: float
    processors_s: float
    blank_s: float  # the longest time without a change on the screen


def run(words: list[str], cache: Path) -> Run:
    """Type a command on a terminal."""
    began = last = time.monotonic()
    blank = 0.0
    process, terminal = pty.fork()
    if process == 0:
        os.environ |= {"NUMBA_CACHE_DIR": str(cache), "COLUMNS": "120", "TERM": "xterm"}
        os.execv(sys.executable, [sys.executable, "-m", "lidarcfg", *words])
    while True:
        if select.select([terminal], [], [], 0.02)[0]:
            try:
                if not os.read(terminal, 65536):
                    break
            except OSError:  # its end was closed
                break
            now = time.monotonic()
            blank, last = max(blank, now - last), now
    _, status, used = os.wait4(process, 0)
    if status:
        sys.exit(f"{' '.join(words)}: ended with {os.waitstatus_to_exitcode(status)}")
    return Run(time.monotonic() - began, used.ru_utime + used.ru_stime, blank)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1, help="of each kind; the medians are printed")
    runs = parser.parse_args().runs
    os.chdir(ROOT)
    print(f"{machine()}, median of {runs}")
    print("\n| command | first: s | processors | longest blank | again: s | processors | longest blank |")
    print("|---|---|---|---|---|---|---|")
    fresh: dict[str, list[Run]] = {name: [] for name in COMMANDS}
    again: dict[str, list[Run]] = {name: [] for name in COMMANDS}
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            for name, words in COMMANDS.items():
                typed = words.replace("OUT", folder).split()
                with tempfile.TemporaryDirectory() as cache:
                    fresh[name].append(run(typed, Path(cache)))
                    again[name].append(run(typed, Path(cache)))
    for name in COMMANDS:
        cells = [
            f"{statistics.median(getattr(one, key) for one in of):.2f}"
            for of in (fresh[name], again[name])
            for key in ("clock_s", "processors_s", "blank_s")
        ]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
