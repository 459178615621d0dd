#!/usr/bin/env python3
"""How fast a drive's rays become packets, as medians of several runs: our own tracer through Drive, Caster and Writer
beside export in the same run, Writer alone, and the start of a drive after an hour.

    .venv/bin/python tools/bench_hub.py    # prints the tables of docs/evidence/benchmarks.md

The scene is data/scenes/street.yaml. Files of both ways are compared. Writer alone is given ranges in memory; its speed
is by CPU time, that of one core.
"""

import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from page import ROOT, argument, machine, table

import lidarcfg

RUNS = 9
STEP_S = 0.1
LATE_S = 3600.0
DRIVES = {"vlp-16": (4, 3.0), "os1-128": (1, 3.0), "ot128": (1, 2.0)}  # sensors, seconds
WRITES = {"vlp-16": 6.0, "ot128": 1.0, "os1-128": 2.0}  # seconds


def rig_of(model: str, count: int, **keys: object) -> lidarcfg.Rig:
    """Sensors above each other."""
    sensors = [{"name": f"s{n}", "model": model, "position_m": [0, 0, 2 + 0.1 * n], **keys} for n in range(count)]
    return lidarcfg.load_rig({"name": model, "sensors": sensors})


def cast(rig: lidarcfg.Rig, scene: lidarcfg.Scene, path: Path, seconds: float) -> None:
    """A capture through the hub."""
    drive = lidarcfg.Drive(rig, origin=scene.file.geo_origin)
    with lidarcfg.Writer(drive, path) as writer:
        for rays, range_m, intensity in lidarcfg.Caster(drive, scene).cast(drive.firings(0, seconds, STEP_S)):
            writer.write(rays, range_m, intensity)


def beside_export(folder: Path, runs: int) -> list[list[object]]:
    """Rows of both ways, in turns."""
    scene = lidarcfg.load_scene(ROOT / "data/scenes/street.yaml")
    rows: list[list[object]] = []
    for model, (count, seconds) in DRIVES.items():
        rig = rig_of(model, count)
        ours, theirs = folder / "hub.pcap", folder / "export.pcap"
        times = []
        for run in range(runs + 1):
            pair = *timed(lidarcfg.export, rig, scene, theirs, seconds), *timed(cast, rig, scene, ours, seconds)
            times += [pair] * (run > 0)  # the first is not counted
        assert ours.read_bytes() == theirs.read_bytes()
        wall = [hub_s / export_s for export_s, _, hub_s, _ in times]
        cpu = [hub_s / export_s for _, export_s, _, hub_s in times]
        wall_ms = [1e3 * statistics.median(one[at] for one in times) for at in (0, 2)]
        rows.append([f"{count} × {model}, {seconds:g} s", *(f"{ms:.0f}" for ms in wall_ms), spread(wall), spread(cpu)])
    return rows


def writing(folder: Path, runs: int) -> list[list[object]]:
    """Rows of Writer alone."""
    rng = np.random.default_rng(1)
    rows: list[list[object]] = []
    for model, seconds in WRITES.items():
        drive = lidarcfg.Drive(rig_of(model, 1))
        batches = list(drive.firings(0, seconds, STEP_S))
        hits = [(rng.uniform(2, 60, len(rays)), rng.integers(0, 100, len(rays), np.uint8)) for rays in batches]
        speeds = []
        for _ in range(runs):
            with lidarcfg.Writer(drive, folder / "alone.pcap") as writer:
                began = time.process_time()
                for rays, hit in zip(batches, hits, strict=True):
                    writer.write(rays, *hit)
                speeds.append(sum(map(len, batches)) / (time.process_time() - began) / 1e6)
        rows.append([model, spread(speeds)])
    return rows


def starting(runs: int) -> list[list[object]]:
    """Rows of the first batch after an hour, and of the first of all."""
    rows: list[list[object]] = []
    for model, view in (("vlp-16", None), ("ot128", None), ("os1-128", None), ("mid-360", None), ("vlp-16", (10, 100))):
        drive = lidarcfg.Drive(rig_of(model, 1, azimuth_fov_deg=view))
        took = [statistics.median(timed(next, drive.firings(at_s))[0] for _ in range(runs)) for at_s in (LATE_S, 0.0)]
        rows.append([model + (f", {view[0]} to {view[1]}°" if view else ""), *(f"{1e3 * one:.1f}" for one in took)])
    return rows


def timed(function: Callable[..., object], *arguments: object) -> tuple[float, float]:
    """Seconds by the clock, and of all threads."""
    began = time.perf_counter()
    began_cpu = time.process_time()
    function(*arguments)
    return time.perf_counter() - began, time.process_time() - began_cpu


def spread(values: Sequence[float]) -> str:
    """Median, least and most."""
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def main() -> None:
    """Print the machine and the tables."""
    runs = argument(__doc__, int, RUNS)
    print(machine(), f"{runs} runs", sep=", ")
    with tempfile.TemporaryDirectory() as name:
        heads = "", "export, ms", "through the hub, ms", "hub / export", "by CPU time"
        print("", *table(heads, beside_export(Path(name), runs)), sep="\n")
        print("", *table(("write alone", "million points/s"), writing(Path(name), runs)), sep="\n")
    print("", *table(("start", "after an hour, ms", "at once, ms"), starting(runs)), sep="\n")


if __name__ == "__main__":
    main()
