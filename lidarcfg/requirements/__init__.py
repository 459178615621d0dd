"""What a rig must see, and the verdict: does it?

To read in this order: `kind` is the protocol of a kind of requirement, and `kinds` the table of those that there are.
`object`, `post`, `shadow`, `scenario`, `price` and `sensor_count` are a kind each: its keys in files, the requirement
of a study that they resolve to, and the judge, whose `judge` decides PASS or FAIL, and whose `bounds` say how far a
search's `trial_rig` is from it. `file` reads requirements of all kinds; `resolved` has those of a study, by its
`context`. `judges` makes a judge for each, `verify` judges a rig by all of them, `verdict` is the result and `evidence`
what shows it. `shortfalls` judges many rigs, for searches.

Of objects, `object_requirement` has the requirement and its judge, `place_counts` what an object reaches at places, and
`refinement` looks between the places of a grid.

Kinds share: `zone`, where something must be seen; `robustness`, the failures and mounting errors that a rig must
withstand, and `margins`, what they leave of a requirement; `allowed_rigs`, what all rigs of a study can reach.
`post_visibility` says where posts are seen.

For scenarios, `scenario_file` has their files, `braking` says when braking must begin, `approach` where vehicle, target
and parked cars are, `sight` when the target can first be seen, and `scenario_run` what the sensors see in each frame,
and whether that is in time.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
