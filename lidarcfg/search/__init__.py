"""Searches: for the best rig, for the cheapest, for the sensors themselves, and many searches at once.

    study = load_study("paper.yaml")  # what may be placed where
    rig = place(study)  # a solver proposes rigs; the one with the least cost is kept: the bare loop of `run`

`run` is a search in progress, which `optimize` runs to its end; `log` is what it is resumed from. It may be `seeded`
with points: `start_rigs` are the user's, `plain_rigs` those that an engineer would try. `misses_search` goes on from
them at ever more places; `requirements_search` looks for rigs that meet requirements, and then for the best of
them.

Many searches: `chooser` has `workers` do the turns of many candidates, in this process, in others or on a cluster. Its
three policies are `front`, price against objective; `cheapest`, the rig that meets all requirements; and `sweep`, the
cases of a `sweep_plan`. The candidates of the first two are `combinations` of sensors, which learn from each other by
`transfer`; `screening` judges their plain rigs all at once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
