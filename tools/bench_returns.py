#!/usr/bin/env python3
"""How fast returns are counted: over an object's places, beside Open3D's rays alone; in a search; and misses.

    .venv/bin/python tools/bench_returns.py

Prints the tables of docs/evidence/benchmarks.md, sections "Detection by returns" and "Misses", by processor time. With
`--patterns` only that of sensors with a scan pattern.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import judge_misses as judge
import numpy as np
import open3d as o3d
from page import ROOT, machine, table

from lidarcfg.geometry import rotations
from lidarcfg.returns.counts import returns
from lidarcfg.returns.known import KnownReturns, RigAt
from lidarcfg.returns.misses import FRESH, FRESH_PLACES, SEARCH_PLACES
from lidarcfg.returns.scanners import PHASES, compiled, scanner
from lidarcfg.returns.target import Target
from lidarcfg.search.misses_search import MissesRun
from lidarcfg.search.optimize import optimize, search_run
from lidarcfg.search.run import Budget
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study, with_solver
from lidarcfg.vsr.cones import poses, rig_lidars
from lidarcfg.world.meshes import read_mesh

OBJECTS = ("pedestrian", "child", "cyclist", "car", "tyre")
SEARCHED = ("pedestrian", "child", "tyre")
STEP_M = 1.0  # between places
SEARCH_STEP_M = 2.0
EVALUATIONS = {"annealing": 2000, "abc": 600}
REPEATS = 5
RAYS = 2_000_000
MOVES = 2000  # of one sensor of a rig
PATTERN = "mid-360"  # a sensor with a scan pattern, two of it on a robot
PATTERN_MOVES = 200
PATTERN_WITHIN_M = (5, 20)  # the default around a robot, and around a car
ROBOT = """region: {min_m: [-8, -8, 0], max_m: [8, 8, 2], cuboid_m: [0.5, 0.25, 0.1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.25], size_m: [0.8, 0.6, 0.4]}]}
sensors:
  - model: PATTERN
    min: {position_m: [0.3, -0.3, 0.5], rpy_deg: [-15, 0, -60]}
    max: {position_m: [0.4, 0.3, 0.7], rpy_deg: [15, 45, 60]}
  - model: PATTERN
    min: {position_m: [-0.4, -0.3, 0.5], rpy_deg: [-15, 0, 120]}
    max: {position_m: [-0.3, 0.3, 0.7], rpy_deg: [15, 45, 240]}
objective: {misses: {within_m: [0.1, WITHIN]}}
"""
JUDGED = 20  # places of each object, by Open3D


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


def moved(study: Study, count: int) -> list[np.ndarray]:
    """The poses of so many rigs, each with one sensor elsewhere than in the one before."""
    rng = np.random.default_rng(1)
    poses = study.space.midpoint.copy()
    found = []
    for number in range(count):
        one = number % len(poses)
        poses[one] = study.space.poses(rng.random((1, study.space.dimensions)))[0, one]
        found.append(poses.copy())
    return found


def kernel(study: Study, count: int) -> float:
    """Evaluations a second of the kernel alone, at the places of a search."""
    misses = study.misses
    assert misses
    known = misses.known(SEARCH_PLACES)
    number = known.numbers(study.rig(study.space.midpoint).mounts)
    rigs = [RigAt(number, rotations(one[:, 3:]), np.ascontiguousarray(one[:, :3])) for one in moved(study, count)]
    begun = time.process_time()
    for rig in rigs:
        known.misses(rig, misses.weights, misses.returns)
    return count / (time.process_time() - begun)


def scanning() -> list[list[str]]:
    """A row a distance of objects: median, least and most evaluations a second of two sensors of a scan pattern."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        for within_m in PATTERN_WITHIN_M:
            path.write_text(ROBOT.replace("PATTERN", PATTERN).replace("WITHIN", str(within_m)))
            study = load_study(path)
            found = [kernel(study, PATTERN_MOVES) for _ in range(REPEATS)]
            rows.append([f"{within_m}", f"{statistics.median(found):,.3g}", f"{min(found):,.3g} to {max(found):,.3g}"])
    return rows


def missing(study: Study) -> list[tuple[str, str]]:
    """Rows: evaluations a second at the places of a search; and a rig at fresh places, by parts."""
    misses = study.misses
    assert misses
    rows = []
    rows.append(("evaluations a second, the kernel alone", f"{kernel(study, MOVES):,.0f}"))
    searched = with_solver(study, method="auto", evaluations=MOVES, seed=1)
    run = search_run(searched)
    assert isinstance(run, MissesRun)
    budget = Budget.of(searched.solver)
    with run.evaluator(1) as evaluator:
        begun = time.process_time()
        while not run.is_over(budget):
            run.step(evaluator, budget)
        taken = time.process_time() - begun
    trials = run.evaluations + run.asked["first"]
    rows.append((f"a search's, which ends at {run.places} places", f"{trials / taken:,.0f}"))
    drawn = seconds(lambda: [one.places(FRESH_PLACES, FRESH) for one in misses.objects])
    rows.append((f"drawing {FRESH_PLACES:,} places of each object (s)", f"{drawn:.2f}"))
    mounts = study.rig(study.space.midpoint).mounts
    standing = misses.fresh.objects
    counted = seconds(lambda: misses.found_at(KnownReturns(standing, misses.obstacles), mounts))
    rows.append(("a rig's misses there (s)", f"{counted:.2f}"))
    rows.append(("the same at a place (µs)", f"{1e6 * counted / (FRESH_PLACES * len(standing)):.1f}"))
    rows.append(("tools/judge_misses.py at a place, of one phase instead of four (µs)", f"{1e6 * judged(study):.0f}"))
    return rows


def judged(study: Study) -> float:
    """The processor time that the outside judge takes for a place, with the same objects, at places that are given."""
    body = o3d.io.read_triangle_mesh(str(ROOT / "data/vehicles/sedan.ply"))
    bodies = judge.scene_of(np.asarray(body.vertices), np.asarray(body.triangles))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.yaml"
        save_rig(study.rig(study.space.midpoint), path)
        rays = [judge.rays_of(one, path.parent) for one in judge.yaml.safe_load(path.read_text())["sensors"]]
    clear_m = [judge.hits_m(bodies, one.start_m, one.direction) for one in rays]
    things = judge.things(ROOT / "data/objects")
    assert study.misses
    given = {one.name.replace("pedestrian", "adult"): one.places(JUDGED, FRESH) for one in study.misses.objects}
    taken = seconds(
        lambda: [
            judge.returns(rays, clear_m, things[name], place[[0, 1, 3]])
            for name, some in given.items()
            for place in some
        ]
    )
    return taken / (JUDGED * len(given))


def main() -> None:
    """Print the tables."""
    print(machine())
    if "--patterns" not in sys.argv[1:]:
        rest()
    print(f"\nMisses of two {PATTERN} on a robot, six objects, {SEARCH_PLACES} places each, one thread:\n")
    print("\n".join(table(("within (m)", "evaluations a second, the kernel alone", "spread"), scanning())))


def rest() -> None:
    """Print the tables of sensors that turn."""
    print(f"\nFour VLP-16 on the sedan, one thread, {PHASES} phases, {len(places(STEP_M)):,} places:\n")
    header = ("object", "returns a place", "µs a place", "of which Open3D takes for as many rays that hit (µs)")
    print("\n".join(table(header, counting(load_study(ROOT / "data/studies/sedan.yaml")))))
    study = searched()
    print(f"\nSearch by returns of {', '.join(SEARCHED)}, {len(study.detection_targets[0].places):,} places:\n")
    print("\n".join(table(("solver", "evaluations", "a second"), searching(study))))
    print(f"\nMisses of four VLP-16 on the sedan, six objects, {SEARCH_PLACES} places each in a search, one thread:\n")
    print("\n".join(table(("misses", ""), missing(load_study(ROOT / "data/studies/sedan.yaml")))))


if __name__ == "__main__":
    main()
