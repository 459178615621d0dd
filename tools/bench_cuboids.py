#!/usr/bin/env python3
"""What evaluating a rig takes on finer and finer cuboids, report and pictures included.

    .venv/bin/python tools/bench_cuboids.py
    .venv/bin/python tools/bench_cuboids.py --beside ../lidarcfg-0.1   # another checkout, in turns

Prints the table of docs/objectives.md: processor seconds of all threads, by the clock, and the peak of the memory. Each
run is a process of its own; the first on the study's own cuboids does not count, for what is compiled there.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from page import ROOT, machine

from lidarcfg.placement.study import load_study
from lidarcfg.rig import save_rig

STUDIES = {"liu2018-4x16": "4 × 16 beams, 3 objects", "sedan": "the sedan with its body, 4 objects"}
EDGES_M = ("0.5, 0.25, 0.08", "0.2, 0.125, 0.04", "0.12, 0.08, 0.032", "0.08, 0.04, 0.02")
LIMIT_S = 170

EVALUATION = """
import sys, time
from lidarcfg.cli import main
started, path = time.perf_counter(), sys.argv.pop(1)
try:
    main()
except SystemExit as ended:
    assert not ended.code, ended.code
lines = open("/proc/self/status").read().splitlines()
peak = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
open(path, "w").write(f"{time.process_time()} {time.perf_counter() - started} {peak * 1024e-9}")
"""


def measured(root: Path, study: Path, rig: Path, folder: Path) -> str:
    """Cells of a table: processor seconds, seconds by the clock, peak in GB."""
    out = folder / "measured"
    words = [sys.executable, "-c", EVALUATION, out, "evaluate", study, rig, "-o", folder / "out", "--quiet"]
    try:
        subprocess.run(words, env=os.environ | {"PYTHONPATH": str(root)}, cwd=folder, check=True, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return f"| more than {LIMIT_S} s by the clock | | "
    processor, clock, peak = map(float, out.read_text().split())
    return f"| {processor:.1f} | {clock:.1f} | {peak:.2f} "


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beside", type=Path, metavar="CHECKOUT", help="another version, measured in turns")
    beside = parser.parse_args().beside
    roots = [beside.resolve(), ROOT.resolve()] if beside else [ROOT.resolve()]
    print(f"{machine()}\n\n| study | cuboids {'| processor (s) | clock (s) | GB ' * len(roots)}|")
    print("|---" * (2 + 3 * len(roots)) + "|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for study_name, what in STUDIES.items():
            own = ROOT / f"data/studies/{study_name}.yaml"
            study, rig, path = load_study(own), folder / "rig.yaml", folder / "study.yaml"
            poses = study.poses(np.random.default_rng(1).random((1, int(study.free.sum()))))[0]
            save_rig(study.rig(poses), rig)
            for root in roots:
                measured(root, own, rig, folder)
            for edges in EDGES_M:
                text = own.read_text().replace("../vehicles", str(ROOT / "data/vehicles"))
                path.write_text(re.sub(r"cuboid_m: .*", f"cuboid_m: [{edges}]", text))
                cuboids = load_study(path).region.included.size
                cells = "".join(measured(root, path, rig, folder) for root in roots)
                print(f"| {what} | {cuboids:,} {cells}|", flush=True)


if __name__ == "__main__":
    main()
