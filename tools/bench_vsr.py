#!/usr/bin/env python3
"""How fast VSR and its search are, as medians of several runs, beside the natural pipeline from the package index.

    .venv/bin/python -m pip install connected-components-3d
    .venv/bin/python tools/bench_vsr.py

Prints the tables of docs/evidence/benchmarks.md.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cc3d
import numpy as np
from page import ROOT, machine

from lidarcfg.geometry import Array
from lidarcfg.requirements.robustness import Robust
from lidarcfg.search.optimize import optimize
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.study import Study, with_solver
from lidarcfg.vsr.cones import Lidar
from lidarcfg.vsr.region import Region

SEED = 1
RIGS = 5


def commands() -> None:
    """Whole commands, each in a process of its own: the first after the installation, and the median of five more."""
    print("\n| command, s | first run | later runs | first over later |\n|---|---|---|---|")
    study = ROOT / "data/studies/sedan.yaml"
    rig = ROOT / "data/rigs/roof.yaml"
    for name, options in (
        ("evaluate", ["evaluate", str(study), str(rig)]),
        ("optimize, 1,000 evaluations", ["optimize", str(study), "--evaluations", "1000"]),
    ):
        took = []
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(6):
                began = time.perf_counter()
                words = [sys.executable, "-m", "lidarcfg", *options, "--quiet", "-o", f"{folder}/{len(took)}"]
                subprocess.run(words, capture_output=True, check=True)
                took.append(time.perf_counter() - began)
        later = statistics.median(took[1:])
        print(f"| {name} | {took[0]:.2f} | {later:.2f} | {took[0] / later:.1f} |", flush=True)


def timed(function: Callable[[], object], repeats: int) -> list[float]:
    """Seconds of some runs after one that is not counted."""
    function()
    out = []
    for _ in range(repeats):
        started = time.perf_counter()
        function()
        out.append(time.perf_counter() - started)
    return out


def row(name: str, seconds: list[float], remark: str = "") -> None:
    """One line of a table, in milliseconds."""
    middle, least, most = (1e3 * f(seconds) for f in (statistics.median, min, max))
    print(f"| {name} | {middle:.2f} | {least:.2f} to {most:.2f} | {remark} |", flush=True)


def pipeline(region: Region, lidars: list[Lidar]) -> float:
    """Max VSR as one would write it: numpy, connected-components-3d, bincount."""
    x, y, z = np.meshgrid(*region.centres(), indexing="ij", sparse=True)
    label = np.zeros(region.shape, np.uint32)
    for one in lidars:
        dx, dy, dz = x - one.position_m[0], y - one.position_m[1], z - one.position_m[2]
        sine = (dx * one.axis[0] + dy * one.axis[1] + dz * one.axis[2]) / np.sqrt(dx * dx + dy * dy + dz * dz)
        label = label * (one.sin_elevation.size + 1) + np.searchsorted(one.sin_elevation, sine, "right").astype(
            np.uint32
        )
    part = cc3d.connected_components(np.where(region.included, label + 1, 0), connectivity=6)
    count = part.max() + 1
    internal = []
    for axis in range(3):
        low, high = np.take(part, range(part.shape[axis] - 1), axis), np.take(part, range(1, part.shape[axis]), axis)
        internal.append(np.bincount(low[low == high], minlength=count))
    cuboids = np.bincount(part.ravel(), minlength=count)[1:]
    outer = cuboids[:, None] - np.stack(internal, axis=1)[1:]
    edges = region.cuboid_m
    return float((cuboids * edges.prod() / (2 * outer * edges.prod() / edges).sum(axis=1)).max())


def rigs(study: Study) -> list[tuple[str, Array]]:
    """Poses (LiDARs, 6) at random in the bounds, and some near an optimum, where subspaces are many and small."""
    rng = np.random.default_rng(SEED)
    poses = study.space.poses(rng.random((RIGS, study.space.dimensions)))
    found = optimize(with_solver(study, method="abc", bees=40, cycles=60)).rig.mounts
    best = np.array([[*mount.position_m, *mount.rpy_rad] for mount in found])
    near = best + rng.normal(0.0, 0.01, (RIGS, *best.shape))
    return [("at random", p) for p in poses] + [("near an optimum", p) for p in near]


def largest(bounded: BoundedCosts, poses: Array) -> float:
    """Max VSR in metres, evaluated in full."""
    trial = poses[None]
    return float(bounded.costs(trial, np.zeros(1, np.int64), trial, np.full(1, np.inf))[0])


def evaluations(study: Study) -> None:
    """One evaluation, in full, on one thread."""
    print("\n| one evaluation, 48,000 cuboids, 4 × 16 beams, one thread | median (ms) | spread | |\n|---|---|---|---|")
    seconds: dict[tuple[str, str], list[float]] = {}
    with BoundedCosts(study.region, lidars_at(study.slots, study.space.midpoint), threads=1, skip=False) as bounded:
        for name, poses in rigs(study):
            lidars = list(lidars_at(study.slots, poses))
            assert abs(largest(bounded, poses) - pipeline(study.region, lidars)) < 1e-12
            for label, function in (
                ("lidarcfg", partial(largest, bounded, poses)),
                ("numpy + cc3d + bincount", partial(pipeline, study.region, lidars)),
            ):
                seconds.setdefault((label, name), []).extend(timed(function, 25))
    for (label, name), values in seconds.items():
        ours = statistics.median(seconds["lidarcfg", name])
        ratio = statistics.median(values) / ours
        row(f"{label}, rigs {name}", values, "" if label == "lidarcfg" else f"{ratio:.1f} × ours")


FINE_GRID = """
import json, resource, statistics, sys, time
import numpy as np
from lidarcfg.vsr.cones import lidar
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.vsr.region import Region
part, poses, sines = json.loads(sys.argv[1])
region = Region.from_boxes((0, 0, 0), (60, 20, 4), np.array([1, 0.5, 0.2]) / part, (((27, 8, 0), (33, 12, 4)),))
lidars = [lidar(row[:3], row[3:], np.array(sines)) for row in poses[0]]
seconds = []
with BoundedCosts(region, lidars, threads=1, skip=False) as bounded:
    for number, rig in enumerate([poses[0], *poses]):
        trial = np.array([rig])
        for _ in range(3):
            started = time.perf_counter()
            bounded.costs(trial, np.zeros(1, np.int64), trial, np.full(1, np.inf))
            seconds += [time.perf_counter() - started] * (number > 0)
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([region.included.size, statistics.median(seconds), max(seconds), memory]))
"""


def fine_grids(study: Study) -> None:
    """The same on finer and finer grids, each in a process of its own."""
    print("\n| edges | cuboids | median (ms) | most (ms) | peak (MB) | growth |\n|---|---|---|---|---|---|")
    before = None
    rng = np.random.default_rng(SEED)
    poses = study.space.poses(rng.random((2 * RIGS, study.space.dimensions))).tolist()
    for part in (1, 2, 4, 8):
        given = json.dumps([part, poses, study.slots[0].sensor.sin_elevation.tolist()])
        words = [sys.executable, "-c", FINE_GRID, given]
        size, median, most, mb = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
        growth = f"{median / before:.1f} ×" if before else ""
        print(f"| 1/{part} | {size:,} | {1e3 * median:.1f} | {1e3 * most:.1f} | {mb:.0f} | {growth} |", flush=True)
        before = median


SEDAN_WITH_BODY = """
import json, statistics, sys, time
from dataclasses import replace
import numpy as np
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.search.optimize import optimize
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.objective_costs import segments_of_trial
from lidarcfg.study.study import with_solver
study, cycles = load_study(sys.argv[1]), int(sys.argv[2])
rng = np.random.default_rng(1)
seconds = [], []
for poses in study.space.poses(rng.random((10, study.space.dimensions))):
    trial = poses[None]
    for of, sight in zip(seconds, (study.visibility, None), strict=True):
        lidars = lidars_at(study.slots, poses)
        with BoundedCosts(study.region, lidars, threads=1, skip=False, visibility=sight) as bounded:
            for n in range(6):
                started = time.perf_counter()
                bounded.costs(trial, np.zeros(1, np.int64), trial, np.full(1, np.inf))
                of += [time.perf_counter() - started] * (n > 0)
runs = []
for one in (study, replace(study, visibility=None, vehicle=None)) if cycles else ():
    optimize(with_solver(one, method="abc", bees=10, cycles=2), threads=1)
    found = optimize(with_solver(one, method="abc", bees=200, cycles=cycles), threads=1)
    asked = found.evaluations + found.first_evaluations + found.scout_evaluations
    segments = segments_of_trial(one)
    cast = found.segments / (asked * segments) if segments else 0.0
    runs.append([found.seconds, 1 - found.full_evaluations / asked, cast])
triangles, cuboids = len(study.vehicle.scene.triangles), int(study.region.included.size)
print(json.dumps([triangles, cuboids, *map(statistics.median, seconds), max(seconds[0]), runs]))
"""


def with_a_body() -> None:
    """The sedan with a body and without: one evaluation, on a fine grid too, and a whole search; one thread each."""
    text = (ROOT / "data/studies/sedan.yaml").read_text()
    if "vehicle:" not in text:
        text += f"vehicle: {{meshes: [{{name: body, file: {ROOT / 'data/vehicles/sedan.ply'}}}]}}\n"
    text = text.replace("../vehicles", str(ROOT / "data/vehicles"))
    print("\n| the sedan, one thread | with its body (ms) | most (ms) | without (ms) | |\n|---|---|---|---|---|")
    for part, cycles in ((1, 800), (4, 0)):
        edges = ", ".join(f"{edge / part:g}" for edge in (1, 0.5, 0.2))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "sedan.yaml"
            path.write_text(text.replace("cuboid_m: [1, 0.5, 0.2]", f"cuboid_m: [{edges}]"))
            words = [sys.executable, "-c", SEDAN_WITH_BODY, str(path), str(cycles)]
            done = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        triangles, cuboids, body, plain, most, runs = json.loads(done)
        what = f"an evaluation, {cuboids:,} cuboids, {triangles:,} triangles"
        print(
            f"| {what} | {1e3 * body:.2f} | {1e3 * most:.2f} | {1e3 * plain:.2f} | {body / plain:.1f} × |", flush=True
        )
        if runs:
            (seconds, early, cast), (without, early_without, _) = runs
            settled = f"settled early {early:.1%}, without {early_without:.1%}; {cast:.2%} of the segments cast"
            ratio = f"{seconds / without:.1f} ×; {settled}"
            print(f"| 200 bees × 800 cycles (s) | {seconds:.1f} | | {without:.1f} | {ratio} |", flush=True)


def with_one_lost(study: Study) -> None:
    """Searches for the best rig with any one LiDAR lost, beside plain ones of as many evaluations; one thread."""
    print("\n| 4 × 16 beams, one thread | plain (s) | `lost: 1` (s) | | |\n|---|---|---|---|---|")
    for method, budget in (("abc", {"bees": 100, "cycles": 60}), ("auto", {"evaluations": 6000})):
        plain = with_solver(study, method=method, **budget)
        pairs = []
        for _ in range(3):
            runs = [optimize(one, threads=1) for one in (plain, replace(plain, robust=Robust(lost=1)))]
            pairs.append([run.seconds for run in runs])
        seconds, lost = (statistics.median(of) for of in zip(*pairs, strict=True))
        ratio = statistics.median(b / a for a, b in pairs)
        print(
            f"| {method}, {runs[0].evaluations:,} evaluations | {seconds:.2f} | {lost:.2f} | {ratio:.2f} × | |",
            flush=True,
        )


PAPERS_RUN = """
import json, resource, sys
from lidarcfg.search.optimize import optimize
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
study = load_study(sys.argv[1])
optimize(with_solver(study, bees=10, cycles=2))
found = optimize(study, threads=int(sys.argv[2]))
all_asked = found.evaluations + found.first_evaluations + found.scout_evaluations
skipped, memory = 1 - found.full_evaluations / all_asked, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"seconds": found.seconds, "max_vsr_m": found.objective,
    "evaluations": found.evaluations, "skipped": skipped, "mb": memory}))
"""


def papers_run() -> None:
    """4 × 16 beams, 200 bees × 800 cycles, in a process of its own."""
    print("\n| the paper's run, 4 × 16 beams | seconds | ms an evaluation | settled early | max VSR (m) | peak (MB) |")
    print("|---|---|---|---|---|---|")
    study = str(ROOT / "data/studies/liu2018-4x16.yaml")
    for threads in (2, 1):
        words = [sys.executable, "-c", PAPERS_RUN, study, str(threads)]
        one = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
        each_ms = 1e3 * one["seconds"] / one["evaluations"]
        print(
            f"| {threads} threads | {one['seconds']:.1f} | {each_ms:.3f} | {one['skipped']:.1%} "
            f"| {one['max_vsr_m']:.6f} | {one['mb']:.0f} |",
            flush=True,
        )


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    study = load_study(ROOT / "data/studies/liu2018-4x16.yaml")
    print(f"{machine()}, seed {SEED}")
    commands()  # before anything else has run
    papers_run()  # then: a child's peak is no less than what its parent had
    with_a_body()
    with_one_lost(study)
    fine_grids(study)
    evaluations(study)
    print(f"\npeak memory of this process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
