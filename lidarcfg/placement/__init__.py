"""Placement: where the LiDARs should sit, by Liu, Arief and Zhao (2018) and beyond.

The paper in two calls, each a page to read:

    study = load_study("paper.yaml")  # what may be placed where
    rig = place(study)  # a solver proposes rigs; the one with the least cost is kept
    max_vsr(study.region, rig_lidars(rig))  # region -> cones -> labels -> subspaces -> VSR

`max_vsr` is in `metric`, `place` in `optimize`. To read in this order: `region` cuts the space around the vehicle into
cuboids; `cones` says between which beams of a LiDAR a point lies; `visibility` what it does not see; `subspace`
connects neighbouring cuboids of the same label; `metric` has their volume to surface;
`solvers` minimise over a unit cube; `evaluator` says what many rigs cost; `search_run` is a search in progress, which
`optimize` runs to its end, a `batch` of trials at a time. `evaluation` says everything of one rig, `report_inputs`
what a report shows besides. `study_file`, `slots` and `study` read a study, and `checks` warns of what looks wrong in
it.

Beyond the paper: `objective` has the terms that may be minimised, `zones` what weighs more, `detection`,
`return_counts` and `blind_spots` what becomes of objects; `study_evaluator` what failures and mounts that are off
cost; `surfaces` where on a body sensors may sit; `analytic` and `boundaries` the error of the measure;
`combinations` and `front` which sensors for which money; `plan` and `sweep` many searches. By requirements:
`plain_rigs` are tried first, `requirements_search` has the costs and the search, `cheapest` with
`symmetry` the cheapest rig, and `achievable` what none can meet.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
