#!/usr/bin/env python3
"""Our tracer beside Open3D's, the same rays in the same run, as medians of several runs by processor time.

.venv/bin/python tools/bench_tracer.py             # prints the table of docs/benchmarks.md
"""

import resource
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
import open3d as o3d
from bench_capture import pave, rays_of
from page import machine

from lidarcfg.core import world
from lidarcfg.geometry import Array
from lidarcfg.rig import load_rig
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import NO_SLOT, TRIANGLE, Found, Tracer

RUNS = 9
PIECES = 16  # into which rays are cut for threads, so that both have as much to do
SIMULATED_NS = 2_000_000_000
REGIONS = {  # centres of 48,000 cuboids around a body in the middle: low and high corner, cuboids
    "the paper's region": ((-30.0, -10.0, -0.75), (30.0, 10.0, 3.25), (60, 40, 20)),
    "a region as deep as high": ((-20.0, -20.0, -3.0), (20.0, 20.0, 3.0), (40, 40, 30)),
}
BODY = (50, 50)  # quads of a body of some 4,900 triangles
MILLION = 708  # quads a side of a mesh of a million triangles


def measured(functions: dict[str, Callable[[], object]]) -> dict[str, Array]:
    """Seconds of the processor (RUNS,) of each, in turn; the first run does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for run in range(RUNS + 1):
        for name, function in functions.items():
            began = time.process_time()
            function()
            if run:
                seconds[name].append(time.process_time() - began)
    return {name: np.array(values) for name, values in seconds.items()}


def raycasting(vertices: Array, triangles: Array) -> o3d.t.geometry.RaycastingScene:
    """Open3D's, of a mesh."""
    scene, tensor = o3d.t.geometry.RaycastingScene(), o3d.core.Tensor.from_numpy
    scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(triangles.astype(np.uint32)))
    return scene


def sheet(columns: int, rows: int) -> tuple[Array, Array]:
    """A closed wavy body around the origin, as vertices and triangles."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, columns), np.linspace(0.02, np.pi - 0.02, rows), indexing="ij")
    size = 1 + 0.03 * np.sin(9 * u) * np.sin(7 * v)
    vertices = np.stack(
        [2.2 * size * np.cos(u) * np.sin(v), 0.9 * size * np.sin(u) * np.sin(v), 0.7 * size * np.cos(v)], -1
    )
    number = np.arange(columns * rows).reshape(columns, rows)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return vertices.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def bvh_of(vertices: Array, triangles: Array) -> world.Bvh:
    """Ours."""
    number = np.arange(len(triangles), dtype=np.int32)
    shapes = vertices[triangles].reshape(-1, 9)
    return world.Bvh(shapes, np.full(len(triangles), TRIANGLE, np.uint8), number, number)


def row(name: str, ours: Array, theirs: Array, count: int, required: str) -> None:
    """A line: rates in millions a second, and how many times as fast."""
    ratio = theirs / ours
    rates = f"{count / np.median(ours) / 1e6:.1f} | {count / np.median(theirs) / 1e6:.1f}"
    print(f"| {name} | {rates} | {np.median(ratio):.2f} | {ratio.min():.2f} to {ratio.max():.2f} | {required} |")


def first_hits(folder: Path) -> None:
    """Four VLP-16 in the paved street, laser by laser; and two threads beside one, by the clock."""
    scene, rig = load_scene(pave(folder)), load_rig(folder / "rig.yaml")
    vertices, triangles = scene.mesh(0.001)
    chunks = [chunk for mount in rig.mounts for chunk in rays_of(mount, SIMULATED_NS)]
    orders = [np.argsort(fired.laser, kind="stable") for fired, _, _ in chunks]
    origins, along = (
        np.concatenate([chunk[k][order] for chunk, order in zip(chunks, orders, strict=True)]) for k in (1, 2)
    )
    count, tracer = len(origins), Tracer(scene, np.zeros(3))
    no_ground = world.World(np.inf, tracer.world.fixed, [], np.empty((0, 3)), np.empty(0), [])
    cuts = np.linspace(0, count, PIECES + 1).astype(int)
    pieces = [
        [np.ascontiguousarray(rows[low:high].T) for rows in (origins, along)] for low, high in pairwise(cuts.tolist())
    ]
    whole = [np.ascontiguousarray(rows.T) for rows in (origins, along)]
    theirs, both = raycasting(vertices, triangles), np.concatenate([origins, along], 1).astype(np.float32)
    given = o3d.core.Tensor.from_numpy(both)

    def trace(rays: list[Array]) -> None:
        n = rays[0].shape[1]
        found = Found(np.empty(n), np.full(n, NO_SLOT, np.int32), np.empty((0, 3)), np.empty(0))
        no_ground.cast(*rays, np.zeros(n), np.inf, found)

    seconds = measured({"ours": lambda: trace(whole), "theirs": lambda: theirs.cast_rays(given, nthreads=1)})
    row(
        f"first hit, four VLP-16, {len(triangles):,} triangles", seconds["ours"], seconds["theirs"], count, "1.0 to 1.2"
    )
    gain, cores = [], []
    with ThreadPoolExecutor(1) as single, ThreadPoolExecutor(2) as pair:
        for run in range(RUNS + 1):
            took = []
            for pool in (single, pair):
                began, spent = time.perf_counter(), time.process_time()
                list(pool.map(trace, pieces))
                took.append((time.perf_counter() - began, time.process_time() - spent))
            if run:
                gain.append(took[0][0] / took[1][0])
                cores.append(took[1][1] / took[1][0])
    spread = f"{min(gain):.2f} to {max(gain):.2f}"
    what = f"two threads against one, by the clock (they had {np.median(cores):.2f} cores)"
    print(f"| {what} | | | {np.median(gain):.2f} | {spread} | 1.8 |")


def any_hits(name: str) -> None:
    """The cuboids of a region, seen from one sensor on the roof of a body."""
    vertices, triangles = sheet(*BODY)
    axes = [low + (np.arange(n) + 0.5) * (high - low) / n for low, high, n in zip(*REGIONS[name], strict=True)]
    targets = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    origin = np.array([0.4, 0.3, 0.95])
    bvh = bvh_of(vertices, triangles)
    starts, along = np.tile(origin[:, None], (1, len(targets))), np.ascontiguousarray((targets - origin).T)
    out = np.empty(len(targets), np.bool_)
    theirs = raycasting(vertices, triangles)
    given = o3d.core.Tensor.from_numpy(np.concatenate([starts.T, along.T], 1).astype(np.float32))
    seconds = measured(
        {
            "ours": lambda: world.any_hits(bvh, starts, along, out),
            "theirs": lambda: theirs.test_occlusions(given, 0.0, 1.0, nthreads=1),
        }
    )
    same = (theirs.test_occlusions(given, 0.0, 1.0).numpy() == out).mean()
    row(
        f"any hit, {len(out):,} cuboids of {name}, {len(triangles):,} triangles ({same:.3%} agree)",
        *seconds.values(),
        len(out),
        "2",
    )


def building() -> None:
    """A million triangles: seconds, and how much the process grew at its peak."""
    vertices, triangles = sheet(MILLION, MILLION)
    seconds = []
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for _ in range(3):
        began = time.process_time()
        bvh_of(vertices, triangles)
        seconds.append(time.process_time() - began)
    grown_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before_mb
    spread = f"{min(seconds):.2f} to {max(seconds):.2f}"
    print(f"| build, {len(triangles):,} triangles, s | {np.median(seconds):.2f} | | | {spread} | 3 |")
    print(f"| the same, growth of the process, MB | {grown_mb:.0f} | | | | 300 |")


def main() -> None:
    print(f"{machine()}, Open3D {o3d.__version__} with one thread, medians of {RUNS} runs\n")
    print("| million a second | ours | Open3D | ratio | spread | required |\n|---|---|---|---|---|---|")
    building()
    with tempfile.TemporaryDirectory() as folder:
        first_hits(Path(folder))
    for name in REGIONS:
        any_hits(name)


if __name__ == "__main__":
    main()
