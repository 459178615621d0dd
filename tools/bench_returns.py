#!/usr/bin/env python3
"""How fast returns are counted: over an object's places, beside Open3D's rays alone; and in a search, by the solver.

    .venv/bin/python tools/bench_returns.py

Prints the tables of docs/evidence/benchmarks.md, section "Detection by returns", by processor time.
"""

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d
from page import ROOT, machine, table

from lidarcfg.placement.cones import poses, rig_lidars
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.study import Study, load_study, with_solver
from lidarcfg.returns.counts import returns
from lidarcfg.returns.scanners import PHASES, compiled, scanner
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import load_rig
from lidarcfg.world.meshes import read_mesh

OBJECTS = ("pedestrian", "child", "cyclist", "car", "tyre")
SEARCHED = ("pedestrian", "child", "tyre")
STEP_M = 1.0  # between places
SEARCH_STEP_M = 2.0
EVALUATIONS = {"annealing": 2000, "cmaes": 300, "abc": 600}
REPEATS = 5
RAYS = 2_000_000


def seconds(function: Callable[[], object]) -> float:
    """The median of the processor time of some runs, after one that is not counted."""
    function()
    taken = []
    for _ in range(REPEATS):
        begun = time.process_time()
        function()
        taken.append(time.process_time() - begun)
    return statistics.median(taken)


def places(step_m: float) -> np.ndarray:
    """(P, 4) around the sedan."""
    x, y = np.meshgrid(np.arange(-30, 30.1, step_m), np.arange(-10, 10.1, step_m), indexing="ij")
    beside = (abs(x) > 3.5) | (abs(y) > 2.5)
    return np.stack([x[beside], y[beside], 0 * x[beside], 0 * x[beside]], axis=1)


def counting(study: Study) -> list[list[str]]:
    """A row an object: returns a place, microseconds a place, and a ray of Open3D's at the same object."""
    mounts = load_rig(ROOT / "data/rigs/roof.yaml").mounts
    scanners = compiled([scanner(mount) for mount in mounts])
    at = poses(rig_lidars(load_rig(ROOT / "data/rigs/roof.yaml")))
    where = places(STEP_M)
    rows = []
    for name in OBJECTS:
        mesh = read_mesh(ROOT / f"data/objects/{name}.ply")
        target = Target(mesh)
        found = returns(where, target, scanners, at, study.obstacles, threads=1)
        taken = seconds(lambda target=target: returns(where, target, scanners, at, study.obstacles, threads=1))
        ray = open3d_seconds(mesh) / RAYS
        counted = found.mean.mean() * PHASES
        rows.append([name, f"{found.mean.mean():.1f}", f"{1e6 * taken / len(where):.1f}", f"{1e6 * ray * counted:.1f}"])
    return rows


def open3d_seconds(mesh: tuple[np.ndarray, np.ndarray]) -> float:
    """The processor time of Open3D's first hits of rays that all aim at a mesh from 10 m away."""
    vertices, triangles = mesh
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(np.asarray(triangles, np.uint32)))
    rng = np.random.default_rng(1)
    goal = vertices[triangles[rng.integers(len(triangles), size=RAYS)]].mean(axis=1)
    start = np.array([10.0, 0.0, 1.5])
    rays = np.concatenate([np.broadcast_to(start, goal.shape), goal - start], axis=1).astype(np.float32)
    tensor = o3d.core.Tensor(rays)
    return seconds(lambda: scene.cast_rays(tensor, nthreads=1))


def searched() -> Study:
    """The sedan, searched by three objects on a grid of 2 m."""
    text = (ROOT / "data/studies/sedan.yaml").read_text().replace("../", f"{ROOT}/data/").partition("solver:")[0]
    objects = ", ".join(
        f"{{name: {name}, mesh: {ROOT}/data/objects/{name}.ply, returns: 10, step_m: {SEARCH_STEP_M}}}"
        for name in SEARCHED
    )
    weights = ", ".join(f"{name}: 1" for name in SEARCHED)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(f"{text}objective: {{detection: {{{weights}}}}}\ndetection: [{objects}]\n")
        return load_study(path)


def searching(study: Study) -> list[list[str]]:
    """A row a solver: evaluations, and how many in a second of the processor, on one thread."""
    rows = []
    for method, evaluations in EVALUATIONS.items():
        one = with_solver(study, method=method, evaluations=evaluations, seed=1)
        begun = time.process_time()
        optimize(one, threads=1)
        taken = time.process_time() - begun
        rows.append([method, f"{evaluations:,}", f"{evaluations / taken:.0f}"])
    return rows


def main() -> None:
    """Print both tables."""
    print(machine())
    print(f"\nFour VLP-16 on the sedan, one thread, {PHASES} phases, {len(places(STEP_M)):,} places:\n")
    header = ("object", "returns a place", "µs a place", "of which Open3D takes for as many rays that hit (µs)")
    print("\n".join(table(header, counting(load_study(ROOT / "data/studies/sedan.yaml")))))
    study = searched()
    print(f"\nSearch by returns of {', '.join(SEARCHED)}, {len(study.detection_targets[0].places):,} places:\n")
    print("\n".join(table(("solver", "evaluations", "a second"), searching(study))))


if __name__ == "__main__":
    main()
