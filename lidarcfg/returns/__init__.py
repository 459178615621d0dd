"""What sensors at poses get from an object at places: the one engine that counts returns.

To read in this order: `target` is an object that should be seen, `places` says where it may stand, `silhouettes` where
bodies hide it in their narrow shadows, `scanners` how a sensor fires in a revolution. `counts` counts the returns, by
phase or by cluster; `known` keeps what is known of sensors at poses, rig after rig, for searches and verdicts alike.
`reach` is what a rig reaches at places with sensors lost, `refinement` looks between places for less, and
`post_visibility` says where beside the vehicle posts are seen. `misses` is the measure of what a rig sees: the share of
places where objects get too few returns; `missed_map` has it from above. `beams` says what each beam does at a place,
for pictures.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
