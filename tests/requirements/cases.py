"""Small requirements around a small body, random rigs, and a brute force over all places."""

import math
from dataclasses import replace

import numpy as np

from lidarcfg.requirements.object_judge import ObjectJudge, ObjectRequirement
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.places import Stand, StandZone
from lidarcfg.returns.reach import reached
from lidarcfg.returns.target import box_target
from lidarcfg.world.footprint import Footprint
from tests.returns_cases import box, mount
from tests.simulate.test_returns import obstacles

BODY = box(2.0, 1.0, 1.2)
AROUND = obstacles(BODY)
COARSE = {"columns": 512}
ALL = 1 << 20  # a cap that nothing reaches


def requirement(within_m=(0.3, 2.5), size_m=(0.5, 0.5, 1.0), headings_deg=(0,), **changes):
    """A box around BODY."""
    target = box_target(size_m)
    zone = StandZone(Footprint.of(BODY), within_m)
    stand = Stand(zone, Footprint.of(target.mesh), np.radians(headings_deg), 0.0, None)
    return ObjectRequirement(
        **{"name": "box", "target": target, "stand": stand, "returns": 10, "obstacles": AROUND} | changes
    )


def random_rig(rng, count=3):
    """Sensors around and above the body, tilted a little."""
    mounts = []
    for n in range(count):
        x, y, z = rng.uniform((-1.1, -0.6, 1.3), (1.1, 0.6, 2.0))
        roll, pitch = rng.uniform(-20, 20, 2)
        model, settings = ("vlp-16", None) if n == 2 else ("os0-32", COARSE)  # the former in any phase
        made = mount(model, (float(x), float(y), float(z)), (roll, pitch, rng.uniform(0, 360)), 1200.0, None, settings)
        mounts.append(replace(made, name=f"s{n}"))
    return tuple(mounts)


def brute_force(item, mounts, step_m=0.05, headings_deg=None):
    """The least count at all places of a grid in the zone."""
    low, high = item.stand.zone.body.bounds_m
    reach = item.stand.zone.within_m[1] + item.stand.footprint.radius_m
    x, y = (np.arange(math.floor((low[a] - reach) / step_m), math.ceil((high[a] + reach) / step_m) + 1) * step_m
            for a in (0, 1))  # fmt: skip
    headings = item.stand.headings_rad if headings_deg is None else np.radians(headings_deg)
    columns = np.meshgrid(x, y, [item.stand.ground_m], headings, indexing="ij")
    places = np.stack([column.ravel() for column in columns], axis=1)
    places = np.ascontiguousarray(places[item.stand.holds(places)])
    lowest = lowest_at(places, item.target, mounts, AROUND, ALL, len(mounts) + 1)
    return int(reached(lowest.counts, item.lost, item.sensors).min()), len(places)


def verdict(item, mounts, robust=None):
    """The verdict on a rig by one requirement."""
    return ObjectJudge(replace(item, robust=robust)).judge(mounts)
