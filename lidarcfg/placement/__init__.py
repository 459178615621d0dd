"""Placement: where the LiDARs should sit, by Liu, Arief and Zhao (2018) and beyond.

The paper in two calls, each a page to read:

    study = load_study("paper.yaml")  # what may be placed where
    rig = place(study)  # a solver proposes rigs; the one with the least cost is kept
    max_vsr(study.region, rig_lidars(rig))  # region -> cones -> labels -> subspaces -> VSR

`max_vsr` is in `metric`, `place` in `optimize`. To read in this order. The measure: `region` cuts the space around the
vehicle into cuboids; `cones` finds between which beams of a LiDAR a point lies, `visibility` what the LiDAR cannot see;
`subspace` connects neighbouring cuboids of the same label; `metric` computes the volume-to-surface ratio of each
subspace. The search: `study_file`, `slots` and `study` read a study, `checks` warns about what looks wrong in it;
`solvers` minimise over a unit cube; `evaluator` computes the costs of a `batch` of trials; `search_run` is a search in
progress, which `optimize` runs to its end. The result: `evaluation` judges one rig, `report_inputs` adds what only a
report shows.

Beyond the paper: `objective` has the terms that may be minimised, `zones` weigh parts of the region, `detection` and
`return_counts` compute how often objects are detected, `blind_spots` what no LiDAR sees; `study_evaluator` takes
failures and mounting errors into account; `surfaces` are where on a body sensors may sit; `extrapolation` finds
what max VSR would be for ever smaller cuboids; `combinations` and `front` choose sensors by
price; `plan` and `sweep` run many searches, on `workers`. A search may begin with given points (`points_first`):
`starts` are the user's rigs, `plain_rigs` those that an engineer would try; `misses_search` goes on from them at ever
more places. For
requirements: `screen` ranks plain rigs, `requirements_search` has the costs and the search, `cheapest` finds the
cheapest rig, and `achievable` what no rig can meet.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
