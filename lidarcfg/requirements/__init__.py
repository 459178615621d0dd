"""What a rig must see, and the verdict: does it?

To read in this order: `file` has the keys of requirements; `footprint`, `target` and `places` say where an object may
stand; `sensor_counts` has its returns, sensor by sensor. `objects`, `posts`, `shadow`, `scenario_requirement` and
`prices` each judge a kind of requirement: their `judge` decides PASS or FAIL. `robustness` has the failures and
mounting errors that a rig must withstand, `margins` what they leave of a requirement. `requirements` resolves those of
a study, `verify` judges a rig by all of them and collects the evidence, and `verdict` is the result. `trials` has the
shortfalls of many rigs, for searches.

For scenarios, `braking` says when braking must begin, `scenario` where vehicle, target and parked cars are, `sight`
when the target can first be seen, and `scenario_run` what the sensors see in each frame, and whether that is in time.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
