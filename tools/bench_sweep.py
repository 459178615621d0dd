#!/usr/bin/env python3
"""How much faster a sweep is with two local workers than with one.

    .venv/bin/python tools/bench_sweep.py [ROUNDS]

Prints the seconds of the whole command, from start to end, of each round, and the median of their ratios.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from page import ROOT, argument, machine

PLAN = f"""
study: {ROOT}/data/studies/liu2018-3x8.yaml
vary:
  solver.method: [auto]
  solver.cycles: [null]
  solver.evaluations: [8000]
  solver.seed: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]
"""


def seconds(plan: Path, workers: int) -> float:
    """Of one command, and all its processes."""
    words = [sys.executable, "-m", "lidarcfg", "sweep", str(plan), "--workers", str(workers), "--quiet", "-o"]
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        subprocess.run([*words, folder], check=True)
        return time.perf_counter() - started


def main() -> None:
    rounds = argument(__doc__, int, 3)
    print(f"{machine()}, 16 runs")
    with tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "plan.yaml"
        plan.write_text(PLAN)
        ratios = []
        for _ in range(rounds):
            one, two = seconds(plan, 1), seconds(plan, 2)
            ratios.append(one / two)
            load = os.getloadavg()[0]
            print(
                f"one worker {one:.1f} s, two {two:.1f} s: {one / two:.2f} times as fast; load {load:.1f}", flush=True
            )
    print(f"median {statistics.median(ratios):.2f} times as fast")


if __name__ == "__main__":
    main()
