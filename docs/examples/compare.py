"""Comparing rigs: which one, and why.

.venv/bin/python docs/examples/compare.py
"""

from pathlib import Path

import numpy as np

import lidarcfg
from lidarcfg.report import Commands, save_comparison
from lidarcfg.report.comparison import contenders
from lidarcfg.report.inputs import report_inputs

# %% Two rigs in one study
# Two sensors on the roof; and the study's four, each at the midpoint of its bounds.
study = lidarcfg.load_study("data/studies/sedan.yaml")
roof = lidarcfg.load_rig("data/rigs/roof.yaml")
four = study.rig(study.space.poses(np.full((1, study.space.free.sum()), 0.5))[0])
found = {name: lidarcfg.evaluate(study, rig) for name, rig in (("roof", roof), ("four", four))}

# %% Side by side
# Max VSR should be low and detection rates high, and the two need not agree: here the rig of more sensors, untuned, has
# the larger gap at its worst, and yet it sees far more of what lies on the ground.
for name, evaluation in found.items():
    rates = "  ".join(f"{item} {detection.rate:.1%}" for item, detection in evaluation.detection.items())
    print(f"{name:5} max VSR {evaluation.max_vsr_m:.3f} m  {rates}")
assert found["four"].max_vsr_m > found["roof"].max_vsr_m
assert found["four"].detection["lost_cargo"].rate > found["roof"].detection["lost_cargo"].rate

# %% Where the beams are
# How many beams cross an upright pole, over all positions in the region.
rigs = {"roof": roof, "four": four}
full = {name: report_inputs(study, rig, found[name]) for name, rig in rigs.items()}
for name, rig in full.items():
    beams = rig.coverage
    print(f"{name:5} {beams.median_beams:.0f} beams in the median, none at {beams.by_none:.1%} of all positions")

# %% One page for a review
named = [(f"{name}.yaml", rig, full[name]) for name, rig in rigs.items()]
out = Path("out/examples/compared")
save_comparison(study, contenders(named), out, Commands("docs/examples/compare.py", ""))
print(f"{out}/compare.html, {(out / 'compare.html').stat().st_size / 1e6:.1f} MB")
