"""What a rig must see, and the verdict: does it?

To read in this order: `file` has the keys of requirements. `objects`, `posts`, `shadow`, `scenario_requirement` and
`prices` each judge a kind of requirement: their `judge` decides PASS or FAIL, and their `bounds` say how far a search's
`trial_rig` is from it. `robustness` has the failures and mounting errors that a rig must withstand, `margins` what they
leave of a requirement. `requirements` resolves those of a study, `judges` has a judge for each, `verify` judges a rig
by all of them and collects the evidence, and `verdict` is the result. `shortfalls` judges many rigs, for searches.

For scenarios, `braking` says when braking must begin, `scenario` where vehicle, target and parked cars are, `sight`
when the target can first be seen, and `scenario_run` what the sensors see in each frame, and whether that is in time.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
