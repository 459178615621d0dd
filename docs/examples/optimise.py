"""Placing sensors: from a study to a rig.

Run it from the project's folder, cell by cell in an editor that knows `# %%`, or whole:
.venv/bin/python docs/examples/optimise.py
"""

from pathlib import Path

import lidarcfg

# %% A study says which sensors may sit where
# Four VLP-16 on a saloon car: two on the roof, one in each bumper, each free within bounds. What is not free to move
# has equal bounds; the rest is what the search is about.
study = lidarcfg.load_study("data/studies/sedan.yaml")
print(f"{len(study.slots)} sensors, {study.space.free.sum()} free coordinates, {study.region.included.sum():,} cuboids")

# %% A short search
# The study asks for 20,000 evaluations; 400 will do to see how it goes. A seed makes it repeat, on any number of
# threads.
found = lidarcfg.optimize(study, evaluations=400, seed=1)
print(f"max VSR {found.evaluation.max_vsr_m:.3f} m, at the midpoint of the bounds {found.midpoint_max_vsr_m:.3f} m")
assert found.evaluation.max_vsr_m < found.midpoint_max_vsr_m

# %% How it got there
# The history has one row a cycle; the best never gets worse.
for cycle in found.history[:: max(len(found.history) // 5, 1)]:
    print(f"after {cycle.evaluations:5d} evaluations: {cycle.best:.3f} m")
best = [cycle.best for cycle in found.history]
assert best == sorted(best, reverse=True)

# %% The rig
# Poses are in the vehicle's frame: x forward, y left, z up, metres and radians.
for mount in found.rig.mounts:
    x, y, z = mount.position_m
    print(f"{mount.name:13} at {x:6.2f} {y:6.2f} {z:6.2f} m")
out = Path("out/examples")
out.mkdir(parents=True, exist_ok=True)
lidarcfg.save_rig(found.rig, out / "sedan.yaml")
assert lidarcfg.load_rig(out / "sedan.yaml").mounts == found.rig.mounts
