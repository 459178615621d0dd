"""What a rig must see, and the verdict: does it?

To read in this order: `file` has the keys of requirements; `footprint`, `target` and `places` say where an object may
stand; `sensors` counts its returns, sensor by sensor; `objects`, `scenarios` and `prices` judge a kind of requirement
each; `robustness` says what failures and mounts that are off leave of a rig; `requirements` resolves a study's,
`verify` judges a rig by all of them, and `verdict` is what it finds. `trials` has the shortfalls of many rigs, for
searches.

Of scenarios, `braking` says when braking must begin, `scenario` where vehicle, target and parked cars are, `sight` from
when on anything could be seen, `frames` and `clusters` what the sensors see, and `detection` whether that is in time.
"""
