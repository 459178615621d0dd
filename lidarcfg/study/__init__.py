"""A study: which sensors may sit where on a vehicle, what is minimised, and how well one rig does.

To read in this order: `file` has the keys, `slots` what may be mounted where, `surfaces` where on a body; `study` puts
them together, and `checks` warns about what looks wrong. An `objective` is a weighted sum of `terms`, a module each;
`return_counts` says how often objects get enough returns. A `trial` is a rig whose terms are computed: one by one, or
by `evaluator` a `batch` at a time; `study_evaluator` takes failures and mounting errors into account. `evaluation`
judges one rig in full.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
