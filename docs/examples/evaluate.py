"""Evaluating a rig: how large the gaps between its beams are, and what gets lost in them.

.venv/bin/python docs/examples/evaluate.py
"""

import lidarcfg

# %% A rig in a study's region
# The beams are the rig's; the region and the objects to detect are the study's.
study = lidarcfg.load_study("data/studies/sedan.yaml")
rig = lidarcfg.load_rig("data/rigs/roof.yaml")
found = lidarcfg.evaluate(study, rig)
print(f"max VSR {found.max_vsr_m:.3f} m, {len(found.subspaces):,} subspaces")

# %% The worst subspaces
# Each is a body that no beam cuts: so large, there, and between these beams of each sensor.
for worst in found.worst[:3]:
    where = ", ".join(f"{value:.1f}" for value in worst.centroid_m)
    print(f"{worst.vsr_m:.3f} m, {worst.volume_m3:.1f} m³ around {where}, between {worst.between_deg}")
assert found.worst[0].vsr_m == found.max_vsr_m

# %% Detection
# The fraction of an object's places on the ground where it touches enough subspaces to be seen.
for name, detection in found.detection.items():
    print(f"{name:10} {detection.rate:6.1%}")
assert found.detection["car"].rate > found.detection["lost_cargo"].rate  # what is larger is seen more often

# %% Without the grid
# `max_vsr_m` depends on the size of the cuboids. With a tolerance their edges are halved until what it would be for
# ever smaller ones is known to it.
exact = lidarcfg.evaluate(study, rig, tolerance=0.1).extrapolated
assert exact is not None
print(f"{exact.max_vsr_m:.3f} m ± {exact.error_m:.3f} m, on cuboids of {exact.cuboid_m} m")
assert exact.reached

# %% As an Open3D voxel grid
# The region in true proportions, coloured by the VSR of each place's subspace: blue to red. A cuboid is some voxels.
grid = found.subspaces.voxel_grid(found.vsr_m)
print(f"{len(grid.get_voxels()):,} voxels")
assert len(grid.get_voxels()) >= study.region.included.sum()
