"""What a rig must see, and the verdict: does it?

To read in this order: `file` has the keys of requirements; `footprint`, `target` and `places` say where an object may
stand; `sensors` counts its returns, sensor by sensor; `objects`, `posts`, `shadow`, `scenarios` and `prices` judge a
kind of requirement each; `robustness` says what failures and mounts that are off leave of a rig, and `margins` what
they leave of a requirement; `requirements` resolves a study's, `verify` judges a rig by all of them, and shows it;
`verdict` is what it finds. `trials` has the shortfalls of many rigs, for searches.

Of scenarios, `braking` says when braking must begin, `scenario` where vehicle, target and parked cars are, `sight` from
when on anything could be seen, `frames` what the sensors see, and `detection` whether that is in time.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
