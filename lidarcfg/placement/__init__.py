"""Placement: where the LiDARs should sit, by Liu, Arief and Zhao (2018) and beyond.

To read in the order of the paper: `region` cuts the space around the vehicle into cuboids; `cones` says between which
beams of a LiDAR a point lies; `grid` links neighbouring cuboids that no cone separates; `subspace` has what the links
connect; `metric` its volume to surface; `worst_subspaces` finds the largest ratio without the others; `solvers` propose
rigs; `evaluator` says what many of them cost; `optimize` runs a search, and `evaluation` says all of one rig.

Beyond the paper: `visibility` is what bodies, ranges and fields of view hide; `detection` and `return_counts` what
becomes of objects; `terms`, `objective` and `criterion` what is minimised; `robustness` what failures and mounts that
are off cost; `surfaces` where on a body sensors may sit; `choices` and `front` which sensors for which money; `plan`
and `sweep` many searches. A study, in `study_file` and `study`, says which of it is wanted.
"""
