#!/usr/bin/env python3
"""Kill a sweep's workers, its scheduler and the command itself at random moments; compare with an undisturbed sweep.

    .venv/bin/python tools/stress_sweep.py [--kills 50] [--cluster]

Prints a line of counts. Exits with 1 if a row is missing, there twice, or differs in a bit, or a process is left over.
"""

import argparse
import csv
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

from lidarcfg.report.sweep import TABLES

PORT = 8786
PLAN = """
study:
  region: {min_m: [-20, -10, 0], max_m: [20, 10, 4], cuboid_m: [1, 0.5, 0.25]}
  sensors:
    - model: fan-8
      min: {position_m: [-1, -1, 1.2], rpy_deg: [-20, -20, 0]}
      max: {position_m: [1, 1, 1.5], rpy_deg: [20, 20, 0]}
  solver: {method: cmaes, evaluations: 500}
  detection: [{name: box, size_m: [1, 1, 1]}]
vary:
  "sensors[0].count": [1, 2, 3]
  solver.seed: [%s]
"""
VICTIMS = ["command", "scheduler", "worker 1", "worker 1", "worker 2", "worker 2"]  # of a cluster
SILENT = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


def result(folder: Path) -> list[tuple[dict[str, str], bytes]]:
    """Each row but its seconds, with its rig."""
    with open(folder / TABLES[0], newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        del row["seconds"]
    return [(row, (folder / row["rig"]).read_bytes()) for row in rows]


def children(pid: int) -> list[int]:
    """The processes that a process has started, from any of its threads: those replace workers."""
    found: list[int] = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            found += map(int, path.read_text().split())
    return found


def workers_of(pid: int) -> list[int]:
    """Those of its processes that do runs."""
    found = []
    for one in children(pid):
        with suppress(OSError):
            if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes():
                found.append(one)
    return found


class Cluster:
    """A scheduler and two workers, which are started again once they are gone."""

    def __init__(self) -> None:
        dask = [sys.executable, "-m", "dask"]
        address = f"tcp://127.0.0.1:{PORT}"
        worker = [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny", "--death-timeout", "60"]
        self.commands = {
            "scheduler": [*dask, "scheduler", "--host", address, "--no-dashboard"],
            "worker 1": worker,
            "worker 2": worker,
        }
        self.parts: dict[str, subprocess.Popen[bytes]] = {}

    def start(self) -> None:
        for name, words in self.commands.items():
            if name not in self.parts or self.parts[name].poll() is not None:
                self.parts[name] = subprocess.Popen(words, **SILENT)

    def kill(self, name: str) -> None:
        self.parts[name].kill()
        self.parts[name].wait()

    def close(self) -> None:
        for name in self.parts:
            self.kill(name)


def disturbed(words: list[str], kills: int, draw: random.Random, cluster: Cluster | None) -> Counter[str]:
    """Run a command until it ends by itself, after so many kills; who was killed how often."""
    killed: Counter[str] = Counter()
    command = None
    while True:
        if cluster:
            cluster.start()
        if command is None or command.poll() is not None:
            if command and command.returncode == 0:
                return killed
            command = subprocess.Popen(words, **SILENT)
        if killed.total() >= kills:
            time.sleep(0.1)
            continue
        time.sleep(draw.uniform(0.2, 4.0))
        victim = draw.choice(VICTIMS if cluster else ["command", "worker", "worker", "worker"])
        if victim == "command":
            command.kill()
            command.wait()
        elif cluster:
            cluster.kill(victim)
        else:
            while not (theirs := workers_of(command.pid)) and command.poll() is None:
                time.sleep(0.1)  # it has only begun
            if not theirs:
                continue
            with suppress(ProcessLookupError):
                os.kill(draw.choice(theirs), signal.SIGKILL)
        killed[victim.split()[0]] += 1


def left_over(folder: Path) -> int:
    """How many processes still work for a sweep that has ended."""
    time.sleep(1.0)
    found = 0
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            found += f"SWEEP_OF={folder}".encode() in path.read_bytes()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seeds", type=int, default=40, help="three runs each")
    parser.add_argument("--cluster", action="store_true", help="also the scheduler and workers of a Dask cluster")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan = folder / "plan.yaml"
        plan.write_text(PLAN % ", ".join(map(str, range(arguments.seeds))))
        words = [sys.executable, "-m", "lidarcfg", "sweep", str(plan), "-o"]
        subprocess.run([*words, str(folder / "serial"), "--workers", "1"], check=True, **SILENT)
        cluster = Cluster() if arguments.cluster else None
        where = ["--scheduler", f"tcp://127.0.0.1:{PORT}"] if cluster else ["--workers", "2"]
        started, draw = time.perf_counter(), random.Random(1)
        try:
            os.environ["SWEEP_OF"] = name
            disturb = [*words, str(folder / "out"), *where]
            killed = disturbed(disturb, arguments.kills, draw, cluster)
            subprocess.run(disturb, check=True, **SILENT)  # once more for runs that lost every worker they had
        finally:
            if cluster:
                cluster.close()
            del os.environ["SWEEP_OF"]
        expected, found = result(folder / "serial"), result(folder / "out")
        differ = sum(one != other for one, other in zip(expected, found, strict=False))
        differ += abs(len(expected) - len(found))
        left = left_over(folder)
    who = ", ".join(f"{count} × {name}" for name, count in sorted(killed.items()))
    took = time.perf_counter() - started
    print(f"{killed.total()} kills ({who}) in {took:.0f} s: {len(found)} rows, {differ} differ, {left} processes left")
    sys.exit(bool(differ or left))


if __name__ == "__main__":
    main()
