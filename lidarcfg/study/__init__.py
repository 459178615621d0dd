"""A study: which sensors may be mounted where on a vehicle, what is minimised, and how well one rig does.

To read in this order: `file` has the keys, `mounting` which sensors may be mounted within which bounds, `surfaces`
where on a body, `search_space` the unit cube that a solver searches, `zones` parts of the region that weigh more;
`loading` makes a `study` of them, and `checks` warns about what looks wrong. An `objective` is a weighted mean of
`terms`, a module each; a `trial` is a rig whose terms a `criterion` computes. `return_counts` says how often objects
get enough returns.

`evaluation` judges one rig in full: `detection` how often it detects objects, `extents` where the worst subspaces are,
`spheres` the largest ball in each, `extrapolation` max VSR for ever smaller cuboids. `verification` gives the verdict
alone.

The costs of a search's trials come from an `evaluator`: shortfalls of requirements, then `objective_costs`, which take
failures and mounting errors into account, then `bounded_costs`, which end as soon as a trial has lost.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
