"""A tour: from a study to a rig, its packets, its points and a picture, in a few lines each.

.venv/bin/python docs/examples/tour.py
"""

from pathlib import Path

import numpy as np

import lidarcfg

out = Path("out/examples")
out.mkdir(parents=True, exist_ok=True)

# %% Where should the sensors sit?
# A study has the region, the sensors with their bounds, and the objects to detect. A real search takes 30 s or more.
study = lidarcfg.load_study("data/studies/sedan.yaml")
found = lidarcfg.optimize(study, evaluations=200)
for mount in found.rig.mounts:
    print(f"{mount.name:12} at {np.round(mount.position_m, 2)} m, tilted by {np.degrees(mount.rpy_rad[:2]).round(1)}°")
print(f"max VSR {found.objective:.3f} m; at the midpoint of the bounds it was {found.midpoint_max_vsr_m:.3f} m")
lidarcfg.save_rig(found.rig, out / "tour.yaml")

# %% Is it better than a rig made by hand, and does it see what it must?
both = lidarcfg.compare(study, [found.rig, "data/rigs/roof.yaml"])  # a notebook shows the table
for letter, one in both.evaluations.items():
    print(f"rig {letter} misses {one.misses.mean:.2%}")
for one in lidarcfg.verify("data/studies/sedan-requirements.yaml", found.rig).requirements:
    print(f"{one.name:20} {'PASS' if one.passed else 'FAIL'} by {one.margin:+g} {one.unit}")

# %% What will it see?
# A capture has the packets that the sensors would send; a .ply, a bag or nuScenes has points with ground truth.
T_world_vehicle = lidarcfg.pose((2.0, 0.0, 0.0), (0.0, 0.0, np.radians(10)))
# Files or what is loaded from them: either will do.
lidarcfg.export(out / "tour.yaml", "data/scenes/street.yaml", out / "tour.pcap", duration_s=0.1, at=T_world_vehicle)
lidarcfg.export(found.rig, "data/scenes/street.yaml", out / "tour.npz", duration_s=0.1, at=T_world_vehicle)

# %% The points of the packets
# The record beside the capture names the rig.
cloud = lidarcfg.decode(out / "tour.pcap")
print(f"{len(cloud.xyz):,} points of {', '.join(cloud.sensor_names)}")
assert set(cloud.sensor_names) == {mount.name for mount in found.rig.mounts}

# %% A look at it
# A file, as the command `lidarcfg view` takes it, or what is loaded; a notebook shows the page itself.
lidarcfg.view(out / "tour.pcap", by="height").save(out / "tour.png")
lidarcfg.view(cloud, found.rig).save(out / "tour.html")
