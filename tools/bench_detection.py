#!/usr/bin/env python3
"""How fast detection by returns is, beside Open3D's cast_rays of the same rays in the same run.

    .venv/bin/python tools/bench_detection.py

Some 2,000 places × 5 objects × 4 VLP-16 on the sedan, four phases. Open3D casts at the object alone, and its rays are
ready made. Prints the table of docs/benchmarks.md.
"""

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import open3d as o3d
from page import ROOT

sys.path.insert(0, str(ROOT))

from lidarcfg import core
from lidarcfg.geometry import directions
from lidarcfg.packets.families import pattern
from lidarcfg.placement.returns import Poses, Target, compiled, placed, returns, scanner
from lidarcfg.placement.sight import Obstacles
from lidarcfg.world.meshes import Mesh, read_mesh
from lidarcfg.world.tracer import bvh
from tests.returns_cases import lidars, mount, scene_with

OBJECTS = "pedestrian", "child", "cyclist", "car", "tyre"
MOUNTS = tuple(mount("vlp-16", (0.3 * x, 0.5 * y, 1.8), (5 * y, 4 * x, 60 * y)) for x in (-1, 1) for y in (-1, 1))
Scanners = tuple[core.returns.Scanner, ...]
RUNS, PEER_PLACES, ENOUGH = 5, 20, 5


def seconds(function: Callable[[], object], runs: int = RUNS) -> float:
    """The median of some runs after one that is not counted."""
    function()
    out = []
    for _ in range(runs):
        started = time.perf_counter()
        function()
        out.append(time.perf_counter() - started)
    return statistics.median(out)


def raycasting(mesh: Mesh) -> o3d.t.geometry.RaycastingScene:
    """Open3D's scene of a mesh."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh[0].astype(np.float32), mesh[1].astype(np.uint32))
    return scene


def rays(places: np.ndarray, target: Target) -> list[np.ndarray]:
    """(N, 6) for each place the rays of all phases and sensors at its bounding box, in the object's frame."""
    out = []
    low, high = target.box_m
    for x, y, z, heading in places:
        c, s = np.cos(heading), np.sin(heading)
        R, parts = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), []
        for one in MOUNTS:
            fired, T = pattern(one), one.T_vehicle_sensor
            head = fired.heads_rad(4)[:, None] + fired.lag_rad
            way = (
                directions(head.ravel(), np.tile(one.sensor.elevation_rad[fired.laser], len(head))) @ T[:3, :3].T @ R.T
            )
            start = R @ (T[:3, 3] - (x, y, z))
            with np.errstate(divide="ignore", invalid="ignore"):
                first, last = (low - start) / way, (high - start) / way
            near, far = np.minimum(first, last).max(axis=1), np.maximum(first, last).min(axis=1)
            some = way[(near <= far) & (far > 0)]
            parts.append(np.concatenate([np.broadcast_to(start, some.shape), some], axis=1).astype(np.float32))
        out.append(np.concatenate(parts))
    return out


def missed(places: np.ndarray, target: Target, scanners: Scanners, at: Poses, obstacles: Obstacles) -> float:
    """In how many places the object is missed, for a search that knows nothing yet."""
    counter = core.returns.ReturnCounter(scanners, target.shape, places, np.array([len(places)]), obstacles, ENOUGH)
    return counter.missed(np.arange(len(scanners)), *at, 0, np.inf)


def main() -> None:
    """Print the table."""
    body = read_mesh(ROOT / "data/vehicles/sedan.ply")
    around = Obstacles.of(bvh(scene_with([body]), np.array([True]), np.zeros(3)), np.zeros(3))
    sensors, at = compiled([scanner(one, pattern) for one in MOUNTS]), placed(lidars(MOUNTS))
    x, y = np.meshgrid(np.arange(50) - 24.5, np.arange(40) - 19.5, indexing="ij")
    free = (abs(x) > 5) | (abs(y) > 3)
    places = np.stack([x[free], y[free], 0 * x[free], 0 * x[free]], axis=1)
    few, total = places[:: len(places) // PEER_PLACES], 0.0
    print(f"| {len(places):,} places, {len(MOUNTS)} VLP-16, 2 threads | seconds | returns a place | one thread, for "
          f"a search (s) | the rays at {len(few)} places: ours (ms) | Open3D's `cast_rays` (ms) |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    for name in OBJECTS:
        target = Target(read_mesh(ROOT / f"data/objects/{name}.ply"))
        mine = seconds(lambda target=target: returns(places, target, sensors, at, around, 2))
        found = returns(places, target, sensors, at, around, 2).mean.mean()
        search = seconds(lambda target=target: missed(places, target, sensors, at, around))
        alone = seconds(lambda target=target: returns(few, target, sensors, at, around, 2))
        some, scene = [o3d.core.Tensor(one) for one in rays(few, target)], raycasting(target.mesh)

        def peer(some=some, scene=scene) -> None:
            for one in some:
                scene.cast_rays(one, nthreads=2)

        other, total = seconds(peer), total + mine
        print(
            f"| {name} | {mine:.3f} | {found:.1f} | {search:.3f} | {1e3 * alone:.1f} | {1e3 * other:.1f} |", flush=True
        )
    print(f"| all five | {total:.3f} | | | | |")


if __name__ == "__main__":
    main()
