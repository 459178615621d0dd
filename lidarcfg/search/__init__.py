"""Searches: for the best rig, for the cheapest, for the sensors themselves, and many searches at once.

    study = load_study("paper.yaml")  # what may be placed where
    rig = place(study)  # a solver proposes rigs; the one with the least cost is kept

`run` is a search in progress, which `optimize` runs to its end. It may begin with given points (`points_first`):
`starts` are the user's rigs, `plain_rigs` those that an engineer would try. `misses_search` goes on from them at ever
more places; `requirements_search` looks for rigs that meet requirements, and then for the best of them; `achievable`
says what no rig can meet.

Choosing sensors: `combinations` are what may be chosen, `screen` ranks their plain rigs, `front` searches price against
objective, `cheapest` finds the cheapest rig that meets all requirements. `plan` and `sweep` run many searches, in
processes or on a cluster (`workers`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
