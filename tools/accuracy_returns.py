#!/usr/bin/env python3
"""Returns from objects at 10,000 places beside the simulator: each object put into the scene, simulated, counted.

    .venv/bin/python tools/accuracy_returns.py [PLACES_PER_OBJECT]

Four VLP-16 on the sedan, each in a random phase; five objects of data/objects at any heading. Only firings that point
at an object's bounding sphere are simulated, for the others cannot hit it; of every fiftieth place all are.
"""

import sys
import time
from dataclasses import replace

import numpy as np
from page import ROOT, argument

sys.path.insert(0, str(ROOT))

from lidarcfg.geometry import directions
from lidarcfg.packets.codec import Firings
from lidarcfg.packets.families import pattern
from lidarcfg.placement.returns import PHASES, Target, compiled, placed, returns, scanner
from lidarcfg.placement.sight import Obstacles
from lidarcfg.rig import Mount
from lidarcfg.world.meshes import read_mesh
from lidarcfg.world.tracer import bvh
from tests.returns_cases import at_place, lidars, mount, revolution, scene_with, simulated, tracer_of

OBJECTS = "pedestrian", "child", "cyclist", "car", "tyre"
MOUNTS = (
    mount("vlp-16", (0.3, 0.55, 1.72), (12, 5, 40)),
    mount("vlp-16", (0.3, -0.55, 1.72), (-12, 5, -40)),
    mount("vlp-16", (2.45, 0.0, 0.6), (0, 0, 0)),
    mount("vlp-16", (-2.45, 0.0, 0.6), (0, 0, 180)),
)
NEAREST_M, FARTHEST_M, ALL_OF = 5.0, 40.0, 50


def towards(one: Mount, fired: Firings, centre_m: np.ndarray, radius_m: float) -> Firings:
    """The firings whose beams pass a sphere, or nearly."""
    sensor, T = one.sensor, one.T_vehicle_sensor
    azimuth = fired.encoder_rad + sensor.azimuth_offset_rad[fired.laser]
    way = directions(azimuth, sensor.elevation_rad[fired.laser]) @ T[:3, :3].T
    offset = centre_m - T[:3, 3]
    ahead = way @ offset
    beside = np.linalg.norm(offset - ahead[:, None] * way, axis=1)
    near = (beside <= radius_m + 0.3) & (ahead > 0)
    return replace(fired, **{key: values[near] for key, values in vars(fired).items()})


def main(count: int) -> None:
    """Print a table's rows: places, returns, and how many counts differ."""
    rng, body = np.random.default_rng(11), read_mesh(ROOT / "data/vehicles/sedan.ply")
    around = Obstacles.of(bvh(scene_with([body]), np.array([True]), np.zeros(3)), np.zeros(3))
    sensors, at = compiled([scanner(one, pattern) for one in MOUNTS]), placed(lidars(MOUNTS))
    revolutions = [[revolution(one, phase, PHASES) for phase in range(PHASES)] for one in MOUNTS]
    print("| object | places | returns simulated | counts | that differ | seconds |\n|---|---|---|---|---|---|")
    for name in OBJECTS:
        started, target = time.perf_counter(), Target(read_mesh(ROOT / f"data/objects/{name}.ply"))
        far, angle, heading = (
            rng.uniform(a, b, count) for a, b in ((NEAREST_M, FARTHEST_M), (0, 2 * np.pi), (0, 2 * np.pi))
        )
        places = np.stack([far * np.cos(angle), far * np.sin(angle), 0 * far, heading], axis=1)
        counts = returns(places, target, sensors, at, around).counts
        middle, radius = target.size_m[2] / 2, float(np.linalg.norm(target.size_m)) / 2
        origin = np.array(
            [*(target.mesh[0].min(axis=0) + target.mesh[0].max(axis=0))[:2] / 2, target.mesh[0][:, 2].min()]
        )
        own = target.mesh[0] - origin, target.mesh[1]
        total = differ = 0
        for p, place in enumerate(places):
            tracer = tracer_of([body, at_place(own, place)])
            for s, one in enumerate(MOUNTS):
                phase = int(rng.integers(PHASES))
                fired = revolutions[s][phase]
                if p % ALL_OF:
                    fired = towards(one, fired, place[:3] + np.array([0, 0, middle]), radius)
                expected = simulated(one, s, fired, tracer, 1) if len(fired.laser) else 0
                total, differ = total + expected, differ + (expected != counts[p, s, phase])
        seconds = time.perf_counter() - started
        print(f"| {name} | {count:,} | {total:,} | {count * len(MOUNTS):,} | {differ} | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main(argument(__doc__, int, 2000))
